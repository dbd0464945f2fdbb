"""RobotBench: recordings of robots that nobody here simulated, judged by us and by baselines."""
