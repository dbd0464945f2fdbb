"""Laws that hold for all nodes of a run, tested on everything that each of them published while
Nav2 was started and the robot drove off."""

import functools
import itertools
import re
from dataclasses import fields, is_dataclass

import pytest

from oracle_pipeline.bags.protocol import is_hidden
from oracle_pipeline.bags.types import deserialize, message_class, serialize
from oracle_pipeline.bags.writer import BagWriter
from sim.middleware import qos
from sim.middleware.endpoints import Subscription
from sim.middleware.geometry import Pose2D
from sim.middleware.stamps import stamp_ns
from sim.nav2.amcl import TRANSFORM_TOLERANCE_NS
from sim.nav2.lifecycle import State
from tests.sim import humble
from tests.sim.introspection import clients_of, publishers_of, services_of, subscriptions_of
from tests.sim.system import NODES, System

Header = message_class("std_msgs/msg/Header")
Time = message_class("builtin_interfaces/msg/Time")

GOAL = Pose2D(-0.55, 0.55, 1.0)
DRIVE_S = 6.0

# Who says nothing at all, as in life: windows, containers, recorders and launchers have no news,
# and the camera has no rendering context.
SILENT = {
    f"{humble.CAMERA}_driver",
    "/nav2_container",
    "/launch_ros_PID",
    humble.LISTENER,
    "/rviz",
    "/rviz_navigation_dialog_action_client",
    "/bt_navigator_navigate_through_poses_rclcpp_node",
    humble.RECORDER,
}
PLACELESS = {"/bond", "/diagnostics", "/joint_states", "/performance_metrics"}  # no frame
# How many messages of a publisher are decoded, from the first to the last: fewer of large ones.
LOOKED_AT, LOOKED_AT_BYTES = 12, 200_000
NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
LISTENERS = [f"{humble.LISTENER} {number}" for number in range(humble.LISTENERS)]
EVERY_NODE = [*LISTENERS, *(node for node in NODES if node != humble.LISTENER)]


class Drive:
    """A short drive and every message of it, by publisher: (number, time, bytes)."""

    def __init__(self, folder):
        self.system = System()
        self.domain = self.system.domain
        self.heard = {}
        self._number = itertools.count()
        self.system.activate(watch=self.listen)
        with BagWriter(folder / "bag") as bag:
            self.system.complete(bag)
            self.listen()
            self.system.nav2.navigator.follow([GOAL])
            self.system.run(DRIVE_S)
        names = self.domain.node_names()
        listeners = [name for name in names if humble.plain(name) == humble.LISTENER]
        self.names = dict(zip(LISTENERS, listeners, strict=True))
        self.names |= {humble.plain(name): name for name in names if name not in listeners}

    def listen(self):
        """Subscribe to new publishers, on a separate connection."""
        for publisher in self.domain.publishers():
            if publisher not in self.heard:
                heard = self.heard[publisher] = []
                publisher.connect(
                    Subscription(
                        "/test", publisher.topic, publisher.msgtype, qos.profile(1, latched=True),
                        self.recorder(heard), raw=True, latency_ns=0,
                    )
                )  # fmt: skip

    def recorder(self, heard):
        executor = self.system.executor
        return lambda data: heard.append((next(self._number), executor.now_ns, data))

    def publishers(self, node):
        return [(p, self.heard[p]) for p in self.domain.publishers() if p.node == self.names[node]]

    @functools.cache  # noqa: B019 -- one drive a module
    def messages(self, node):
        """Return publisher, time, bytes and message of some of a node's messages."""
        return [
            (publisher, time_ns, data, deserialize(data, publisher.msgtype))
            for publisher, heard in self.publishers(node)
            for _, time_ns, data in some_of(heard)
        ]

    @functools.cached_property
    def frames(self):
        """The parent of every frame in the transforms."""
        return {
            transform.child_frame_id: transform.header.frame_id
            for node in self.names
            for publisher, _, _, message in self.messages(node)
            if publisher.topic in ("/tf", "/tf_static")
            for transform in message.transforms
        }


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    return Drive(tmp_path_factory.mktemp("first"))


@pytest.fixture(scope="module")
def again(tmp_path_factory):
    return Drive(tmp_path_factory.mktemp("second"))


@pytest.fixture(params=EVERY_NODE)
def node(request):
    return request.param


def some_of(heard):
    size = max((len(data) for _, _, data in heard), default=1)
    count = min(len(heard), LOOKED_AT, LOOKED_AT_BYTES // size + 1)
    return [heard[round(i * (len(heard) - 1) / max(count - 1, 1))] for i in range(count)]


def parts(message, kind):
    """Yield every part of a message that is of a type."""
    if isinstance(message, list):
        for element in message:
            yield from parts(element, kind)
    elif isinstance(message, kind):
        yield message
    elif is_dataclass(message):
        for field in fields(message):
            if field.name != "texture":  # of a marker: not in use, so its header is empty
                yield from parts(getattr(message, field.name), kind)


@pytest.mark.slow
def test_every_published_message_is_received(drive, node):
    for publisher, heard in drive.publishers(node):
        assert publisher.messages == len(heard), publisher.topic


def test_names_are_full_ros_names(drive, node):
    name = drive.names[node]
    topics = [*publishers_of(drive.domain, name), *subscriptions_of(drive.domain, name)]
    services = [*services_of(drive.domain, name), *clients_of(drive.domain, name)]
    for each in (name, *topics, *services):
        assert NAME.fullmatch(each)
        assert "__" not in each
    assert not is_hidden(name)


def test_every_node_logs_and_types_are_known(drive, node):
    name = drive.names[node]
    published, heard = publishers_of(drive.domain, name), subscriptions_of(drive.domain, name)
    assert published["/rosout"] == "rcl_interfaces/msg/Log"
    for msgtype in {*published.values(), *heard.values()}:
        assert is_dataclass(message_class(msgtype))


def test_every_message_is_of_its_declared_type_to_the_byte(drive, node):
    for publisher, _, data, message in drive.messages(node):
        assert serialize(message, publisher.msgtype) == data, publisher.topic


def test_a_subscription_is_connected_to_every_publisher_of_its_topic(drive, node):
    for subscription in drive.domain.subscriptions():
        if subscription.node == drive.names[node]:
            for publisher in drive.domain.publishers(subscription.topic):
                assert subscription in publisher.subscriptions


def test_a_lifecycle_node_comes_up_in_order_and_does_nothing_before_it_is_activated(drive, node):
    name = drive.names[node]
    said = {p.topic: heard for p, heard in drive.publishers(node)}
    services = set(services_of(drive.domain, name))
    event = f"{name}/transition_event"
    is_lifecycle = f"{name}/change_state" in services
    assert is_lifecycle == (event in said)
    if not is_lifecycle:
        return
    assert {f"{name}/{service}" for service in humble.LIFECYCLE_SERVICES} <= services
    kind = publishers_of(drive.domain, name)[event]
    events = [deserialize(data, kind) for _, _, data in said[event]]
    steps = [State.UNCONFIGURED, State.CONFIGURING, State.INACTIVE, State.ACTIVATING, State.ACTIVE]
    assert [(e.start_state.id, e.goal_state.id) for e in events] == list(itertools.pairwise(steps))
    activating, _, _ = said[event][2]
    for publisher, heard in drive.publishers(node):
        if publisher.topic not in ("/rosout", event):
            assert all(number > activating for number, _, _ in heard), publisher.topic


def test_exactly_the_topics_that_are_silent_in_the_real_system_are_silent(drive, node):
    said = [publisher.topic for publisher, heard in drive.publishers(node) if heard]
    assert (not said) == (node.partition(" ")[0] in SILENT)
    assert not humble.SILENT_TOPICS & set(said)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes_at_the_same_times(drive, again, node):
    def said(drive):
        return [
            (publisher.topic, [(time_ns, data) for _, time_ns, data in heard])
            for publisher, heard in drive.publishers(node)
        ]

    assert said(drive) == said(again)


def test_no_time_is_ahead_of_the_clock_but_the_stamp_of_map_to_odom(drive, node):
    for publisher, now_ns, _, message in drive.messages(node):
        is_tolerant = (node, publisher.topic) == ("/amcl", "/tf")
        latest_ns = now_ns + (TRANSFORM_TOLERANCE_NS if is_tolerant else 0)
        for time in parts(message, Time):
            assert 0 <= stamp_ns(time) <= latest_ns, publisher.topic


def test_every_frame_is_in_one_tree_below_the_map(drive, node):
    assert set(drive.frames.values()) - drive.frames.keys() == {"map"}
    for publisher, _, _, message in drive.messages(node):
        named = {header.frame_id for header in parts(message, Header)}
        if publisher.topic in PLACELESS:
            assert named == {""}
        else:
            assert named <= {"map", *drive.frames}, publisher.topic
