"""An in-process ROS 2: nodes, topics, services and actions on one simulated clock.

``executor`` keeps simulated time, ``domain`` holds the endpoints, delivers messages and answers
introspection, ``node`` is the interface for a robot's software, ``action`` builds on it, ``tf``
keeps transforms, ``geometry`` has planar SE(2), ``qos`` the profiles, and ``stamps`` the times and
headers of messages.
"""
