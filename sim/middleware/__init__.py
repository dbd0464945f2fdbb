"""An in-process ROS 2: nodes, topics, services and actions on one simulated clock.

``executor`` owns time, ``domain`` owns the endpoints, answers introspection and delivers,
``node`` is what a robot's software is written against, ``action`` builds on it, ``tf`` keeps
transforms, ``geometry`` is planar SE(2), ``qos`` the profiles, ``stamps`` the message header.
"""
