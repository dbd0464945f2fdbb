"""RobotBench: recordings of robots that we have not simulated, judged by us and by baselines."""
