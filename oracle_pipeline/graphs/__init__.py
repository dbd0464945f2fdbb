"""ROS graphs over time: what is there, how it is looked at, and how two runs differ.

Graphs are ``networkx.DiGraph`` with the schema of ``oracle_pipeline.bags.graph_files``, which also
reads and writes them.
"""
