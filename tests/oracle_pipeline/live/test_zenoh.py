"""A watch records what robots with rmw_zenoh publish, and counts what is lost on the way."""

import itertools
import json
import struct
import threading
import time

import pytest
import zenoh
from rosbags.interfaces import QosDurability, QosReliability

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.graph_files import vertex_id
from oracle_pipeline.bags.types import message_class, serialize, typestore
from oracle_pipeline.live.events import MessageReceived
from oracle_pipeline.live.graph_snapshot import snapshot
from oracle_pipeline.live.watch import Watch
from oracle_pipeline.live.zenoh_source import ZenohRouter, guid_of
from oracle_pipeline.opened_run import open_run
from tests.oracle_pipeline.live.robots import STRING
from tests.servers import free_port

DOMAIN = 7
TYPE = "std_msgs::msg::dds_::String_/RIHS01_00"


class Robot:
    """A router and the nodes of a robot, with keys, tokens and attachments as of rmw_zenoh."""

    def __init__(self, endpoint):
        config = zenoh.Config()
        config.insert_json5("mode", '"router"')
        config.insert_json5("listen/endpoints", json.dumps([endpoint]))
        self.session = zenoh.open(config)
        self.tokens = []

    def declare(self, node, kind="NN", topic="", qos="::,10:,:,:,,"):
        """Declare a node or an endpoint, and return its guid."""
        rest = f"/{topic.replace('/', '%')}/{TYPE}/{qos}" if topic else ""
        number = len(self.tokens)
        token = f"@ros2_lv/{DOMAIN}/{self.session.zid()}/0/{number}/{kind}/%/%robot/{node}{rest}"
        self.tokens.append(self.session.liveliness().declare_token(token))
        return guid_of(token)

    def publisher(self, topic):
        return zenoh.ext.declare_advanced_publisher(
            self.session,
            f"{DOMAIN}{topic}/{TYPE}",
            cache=zenoh.ext.CacheConfig(10),
            publisher_detection=True,
        )

    def put(self, publisher, guid, number):
        text = serialize(message_class(STRING)(str(number)), STRING)
        attachment = struct.pack("<qq", number, time.time_ns()) + b"\x10" + guid
        publisher.put(text, attachment=attachment)


@pytest.mark.slow
def test_topics_of_rmw_zenoh_are_recorded_with_graph_profiles_and_losses(tmp_path):
    endpoint, ended = f"tcp/127.0.0.1:{free_port()}", threading.Event()
    robot = Robot(endpoint)
    robot.declare("ear", "MS", "/words")
    robot.declare("careless", "MP", "/odd", "2::,ten:,:,:,,")  # anyone can write a token
    robot.declare("careless", "MP", "/no/name/")
    words, latched = (
        robot.declare("talker", "MP", topic, qos)
        for topic, qos in (("/words", "2::,10:,:,:,,"), ("/map", ":1:,1:,:,:,,"))
    )
    on_words, on_map = robot.publisher("/words"), robot.publisher("/map")
    robot.put(on_map, latched, 1)

    def speak():
        for number in itertools.count():
            if number % 10 < 7:  # the others are lost on the way
                robot.put(on_words, words, number)
            ended.wait(0.005)
            if ended.is_set():
                return

    speaker = threading.Thread(target=speak)
    speaker.start()
    numbers = []
    with Watch(ZenohRouter(endpoint, DOMAIN), folder=tmp_path, name="today") as watch:
        for event in watch:
            if isinstance(event, MessageReceived) and event.topic == "/words":
                numbers.append(int(typestore().deserialize_cdr(event.data, STRING).data))
                if len(numbers) == 100:
                    watch.stop()
    ended.set()
    speaker.join()
    graph = snapshot(watch.discovery, {})
    robot.session.close()
    talker, topic = vertex_id("node", "/robot/talker"), vertex_id("topic", "/words")
    assert set(graph.edges) >= {(talker, topic), (topic, vertex_id("node", "/robot/ear"))}
    with open_run(tmp_path / "today") as run:
        counts = {name: topic.count for name, topic in run.bag.topics.items()}
        assert counts == {"/words": len(numbers), "/map": 1, "/odd": 0}
        assert run.disturbances.lost == {"/words": numbers[-1] - numbers[0] + 1 - len(numbers)}
        (of_words,), (of_map,) = (run.bag.topics[name].qos for name in ("/words", "/map"))
    assert (of_words.reliability, of_words.depth) == (QosReliability.BEST_EFFORT, 10)
    assert (of_map.durability, of_map.depth) == (QosDurability.TRANSIENT_LOCAL, 1)


def test_a_router_that_is_not_there_is_reported():
    with pytest.raises(OracleError, match="no Zenoh router"):
        ZenohRouter(f"tcp/127.0.0.1:{free_port()}", DOMAIN)
