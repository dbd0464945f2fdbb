"""A number on a ROS topic, with Cyclone DDS alone."""

import os
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

LONGEST_NS = 10_000_000_000  # that a write may wait for slow subscribers, before it raises an error
RELIABLE = Qos(Policy.Reliability.Reliable(LONGEST_NS), Policy.History.KeepLast(10))


@dataclass
class Number(IdlStruct, typename="std_msgs::msg::dds_::Float64_"):
    """``std_msgs/msg/Float64``."""

    data: float


participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))


def writer(topic):
    """Publish a topic."""
    return DataWriter(participant, Topic(participant, f"rt/{topic}", Number), RELIABLE)


def reader(topic):
    """Subscribe to a topic."""
    return DataReader(participant, Topic(participant, f"rt/{topic}", Number), RELIABLE)
