"""The ROS package, as ``colcon build`` installs it."""

from setuptools import setup

NAME = "oracle_graph_recorder"

setup(
    name=NAME,
    version="0.3.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/record_graphs.launch.py"]),
    ],
    install_requires=["setuptools", "ros2-behaviour-oracle"],
    zip_safe=True,
    maintainer="The behaviour oracle's maintainers",
    maintainer_email="maintainers@example.org",
    description="Records the ROS graph of every 10 s as GEXF, for the behaviour oracle.",
    license="Apache-2.0",
    entry_points={"console_scripts": [f"recorder = {NAME}.recorder_node:main"]},
)
