"""Nav2 as in ROS 2 Humble, one module for each node; the mathematics is in separate modules.

``bringup`` makes and connects the nodes. Localisation: ``map_server``, ``amcl``. Costs:
``costmap``, ``costmap_layers``, ``costmap_node``. Planning: ``planner_server``, ``navfn``.
Only endpoints: ``idle_servers``, ``rviz``.
"""
