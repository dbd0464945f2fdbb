"""Nav2 as on Humble, one module a node; the mathematics stand in modules of their own.

``bringup`` makes and wires the nodes. Localisation: ``map_server``, ``amcl``. Costs: ``costmap``,
``costmap_layers``, ``costmap_node``. Planning: ``planner_server``, ``navfn``, ``smoother_server``.
"""
