"""Logs that are no bags: CSV, Parquet, PX4 ULog, ArduPilot DataFlash, LeRobot, other MCAP.

A reader turns a log into topics of numbers (`log`). `recording` writes these as a rosbag2, which
everything else reads: a log has the same columns as a bag, since it becomes one.
"""
