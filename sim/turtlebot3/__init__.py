"""The TurtleBot3 Waffle in its world: geometry, physics, map, frames, and Gazebo's nodes."""
