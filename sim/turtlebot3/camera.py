"""The depth camera: Gazebo's driver of the r200, as it is without a rendering context.

It advertises its topics and publishes nothing.
"""

from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.node import Node

_TOPICS = (
    ("camera_info", "CameraInfo"),
    ("depth/camera_info", "CameraInfo"),
    ("depth/image_raw", "Image"),
    ("image_raw", "Image"),
    ("points", "PointCloud2"),
)


def add_depth_camera(domain: Domain) -> None:
    """Add the camera's node to a domain."""
    node = Node(domain, "/intel_realsense_r200_depth_driver")
    for topic, msgtype in _TOPICS:
        node.create_publisher(
            f"sensor_msgs/msg/{msgtype}", f"/intel_realsense_r200_depth/{topic}", qos.RELIABLE
        )
