"""ROS graphs over time: intervals, views, and differences between two runs.

Graphs are ``networkx.DiGraph`` with the schema of ``oracle_pipeline.bags.graph_files``, which also
reads and writes them.
"""
