"""Nav2 as on Humble, one module for each node; the mathematics is in separate modules.

``bringup`` makes and wires the nodes. Localisation: ``map_server``, ``amcl``. Costs: ``costmap``,
``costmap_layers``, ``costmap_node``. Planning: ``planner_server``, ``navfn``, ``smoother_server``.
"""
