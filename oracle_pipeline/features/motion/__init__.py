"""Features of the robot's motion, by odometry, IMU, transforms, scans and commands."""
