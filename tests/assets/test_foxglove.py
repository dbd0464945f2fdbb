"""The Foxglove layout that ships with the project, compared with a recorded run."""

import json
import re
from pathlib import Path

import pytest

from oracle_pipeline.bags.graph_files import read_gexf
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.bags.types import typestore
from tests.assets.laboratory import KEY, Laboratory

pytestmark = pytest.mark.slow

FILE = Path(__file__).parents[2] / "docs" / "foxglove" / "turtlebot3_nav2.json"
LAYOUT = json.loads(FILE.read_text(encoding="utf-8"))
PANELS = LAYOUT["configById"]
# /topic.field[:]{name=="value"}.field
STEP = re.compile(r'\.(?P<name>\w+)(?P<slice>\[:\])?(\{(?P<where>\w+)=="[^"]*"\})?')
ARRAYS = (3, 4)  # kinds of fields in rosbags' definitions


def message_paths() -> list[str]:
    """Return every message path of the layout, and every topic."""
    paths = [path for panel in PANELS.values() for path in panel.get("topics", ())]
    for panel in PANELS.values():
        paths += [series["value"] for series in panel.get("paths", ())]
        paths += [panel[key] for key in ("topicPath", "topicToRender") if key in panel]
    return paths


def topic_of(path: str) -> str:
    return re.split(r"[.\[{]", path, maxsplit=1)[0]


def shown(node: object) -> list[str]:
    """Return the panels in a part of the layout, tabs included."""
    if isinstance(node, dict):
        assert node["direction"] in ("row", "column")
        assert 0 < node["splitPercentage"] < 100
        return shown(node["first"]) + shown(node["second"])
    assert isinstance(node, str)
    tabs = PANELS[node].get("tabs", ())
    return [node, *(panel for tab in tabs for panel in shown(tab["layout"]))]


def fields(msgtype: str) -> dict[str, tuple]:
    return dict(typestore().fielddefs[msgtype][1])


def test_each_panel_is_in_the_layout_once() -> None:
    assert set(LAYOUT) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    assert sorted(shown(LAYOUT["layout"])) == sorted(PANELS)
    kinds = [panel.split("!")[0] for panel in PANELS]
    assert {"3D", "Plot", "RawMessages", "RosOut", "StateTransitions"} <= set(kinds)


def test_every_topic_of_the_layout_has_a_publisher(campaign: Laboratory) -> None:
    run = campaign.store.run(KEY)
    graph = read_gexf(run.graphs / "run.gexf")
    published = {
        vertex.removeprefix("topic:")
        for vertex, data in graph.nodes(data=True)
        if data["kind"] == "topic" and graph.in_degree(vertex)
    }
    with BagReader(run.bag) as bag:
        silent = {name for name, topic in bag.topics.items() if not topic.count}
    topics = set(map(topic_of, message_paths()))
    assert topics - published == set()
    assert topics & silent == set()


@pytest.mark.parametrize("path", message_paths())
def test_a_message_path_names_fields_that_exist(path: str, campaign: Laboratory) -> None:
    topic = topic_of(path)
    msgtype = campaign.store.run(KEY).manifest().topics[topic].type
    steps = list(STEP.finditer(path, len(topic)))
    assert topic + "".join(step[0] for step in steps) == path
    for step in steps:
        kind, of = fields(msgtype)[step["name"]]
        assert bool(step["slice"]) == (int(kind) in ARRAYS)
        if step["slice"]:
            kind, of = of[0]
        msgtype = str(of[0] if isinstance(of, tuple) else of)
        assert step["where"] is None or step["where"] in fields(msgtype)


def test_frames_of_the_layout_are_those_of_the_robot(campaign: Laboratory) -> None:
    frames = set()
    with BagReader(campaign.store.run(KEY).bag) as bag:
        for message in bag.messages({"/tf"}):
            frames |= {step.header.frame_id for step in bag.deserialize(message).transforms}
    assert PANELS["3D!world"]["followTf"] in frames
