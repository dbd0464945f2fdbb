"""ROS 2's names on DDS, and the encoding of message bytes there.

The names are those of all RMW implementations [1]_: ``/scan`` is the DDS topic ``rt/scan``, and
``sensor_msgs/msg/LaserScan`` the type ``sensor_msgs::msg::dds_::LaserScan_``.

References
----------
.. [1] https://design.ros2.org/articles/topic_and_service_names.html
"""

import os
import re

from oracle_pipeline.bags.errors import DdsError

DOMAIN_VARIABLE = "ROS_DOMAIN_ID"  # environment variable with ROS 2's domain
ENTITIES_TOPIC = "ros_discovery_info"  # on DDS: lists the endpoints of each node
ENTITIES_TYPE = "rmw_dds_common/msg/ParticipantEntitiesInfo"

_TOPIC_PREFIX = "rt"
_TYPE = re.compile(r"(\w+)::(msg|srv|action)::dds_::(\w+)_")
_HEADER = 4  # bytes: encoding, and options, of which the last two bits count padding bytes


def default_domain() -> int:
    """Return the domain that ROS 2 would use.

    Raises
    ------
    DdsError
        If ``ROS_DOMAIN_ID`` is not a number.
    """
    text = os.environ.get(DOMAIN_VARIABLE) or "0"
    if not text.isdecimal():
        raise DdsError(f"{DOMAIN_VARIABLE} is {text!r}; give a whole number from 0 on.")
    return int(text)


def dds_topic(topic: str) -> str:
    """Return the DDS topic of a ROS topic.

    Examples
    --------
    >>> dds_topic("/scan")
    'rt/scan'
    """
    return f"{_TOPIC_PREFIX}{topic}"


def ros_topic(name: str) -> str | None:
    """Return the ROS topic of a DDS topic; None if it is a service's or not of ROS."""
    prefix, slash, rest = name.partition("/")
    return f"/{rest}" if prefix == _TOPIC_PREFIX and slash and rest else None


def ros_service(name: str) -> str | None:
    """Return the service whose calls a DDS topic carries; None if it carries others.

    Examples
    --------
    >>> ros_service("rq/map_server/load_mapRequest")
    '/map_server/load_map'
    """
    prefix, _, rest = name.partition("/")
    is_request = prefix == "rq" and rest.endswith("Request")
    return f"/{rest.removesuffix('Request')}" if is_request else None


def dds_type(msgtype: str) -> str:
    """Return the DDS type of a message type.

    Examples
    --------
    >>> dds_type("sensor_msgs/msg/LaserScan")
    'sensor_msgs::msg::dds_::LaserScan_'
    """
    package, folder, name = msgtype.split("/")
    return f"{package}::{folder}::dds_::{name}_"


def ros_type(name: str) -> str | None:
    """Return the message type of a DDS type; None if it is not of ROS."""
    match = _TYPE.fullmatch(name)
    return None if match is None else "/".join(match.groups())


def to_wire(data: bytes) -> bytes:
    r"""Return CDR bytes as a DDS payload: padded to four bytes, with the padding in its header.

    Examples
    --------
    >>> to_wire(b"\0\1\0\0abcde").hex()
    '000100036162636465000000'
    """
    padding = -len(data) % 4
    if not padding:
        return data
    return b"".join((data[: _HEADER - 1], bytes([padding]), data[_HEADER:], bytes(padding)))


def from_wire(data: bytes) -> bytes:
    """Return the CDR bytes in a payload, without the padding that its header declares."""
    padding = data[_HEADER - 1] & 3 if len(data) >= _HEADER else 0
    if not padding:
        return data
    return b"".join((data[: _HEADER - 1], b"\0", data[_HEADER : len(data) - padding]))
