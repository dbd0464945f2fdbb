"""What a live page shows is the newest of everything, and bounded."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from oracle_pipeline.live import shown as module
from oracle_pipeline.live.shown import EVERY_NS, MOST_POSES, MOST_RAYS, MOST_VERDICTS, Shown, points
from oracle_pipeline.live.watch import MessageHeard
from tests.oracle_pipeline.features.conftest import scan
from tests.oracle_pipeline.live.happenings import HOSTILE, events, messages, verdict

PARTS = {"status", "graph", "verdicts", "alarms", "notes", "scans", "path"}


def filled() -> Shown:
    shown = Shown()
    for event in events():
        shown.show(event)
    return shown


def test_everything_that_happened_is_shown_once_and_then_only_what_changes() -> None:
    shown = filled()
    change, parts = shown.since(0)
    assert set(parts) == PARTS
    assert shown.since(change) == (change, {})
    shown.show(verdict(4))
    later, parts = shown.since(change)
    assert set(parts) == {"verdicts"}
    assert later > change
    assert len(parts["verdicts"]) == 5


def test_what_is_shown_is_plain_json_without_control_characters() -> None:
    _, parts = filled().since(0)
    text = json.dumps(parts, allow_nan=False)
    assert "\\u001b" not in text
    assert any(node["label"].startswith(HOSTILE[:10]) for node in parts["graph"]["nodes"])


def test_a_score_that_is_no_number_is_none() -> None:
    shown = Shown()
    shown.show(replace(verdict(0), score=math.inf))
    assert shown.since(0)[1]["verdicts"][0]["score"] is None


def test_the_newest_verdicts_are_kept_and_no_more() -> None:
    shown = Shown()
    for number in range(MOST_VERDICTS + 7):
        shown.show(verdict(number))
    kept = shown.since(0)[1]["verdicts"]
    assert len(kept) == MOST_VERDICTS
    assert kept[-1]["end_s"] == verdict(MOST_VERDICTS + 6).end_s


def test_the_path_is_bounded_and_ends_where_the_robot_is() -> None:
    (first,) = [m for m in messages() if m.topic == "/odom"][:1]
    shown = Shown()
    for number in range(MOST_POSES + 10):
        shown.show(replace(first, stamp_ns=first.stamp_ns + number * EVERY_NS))
    path = shown.since(0)[1]["path"]
    assert 0 < len(path) <= MOST_POSES


def test_a_fast_topic_is_decoded_at_most_five_times_a_second(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (first,) = [m for m in messages() if m.topic == "/odom"][:1]
    decoded = []
    store = module.typestore()

    class Counting:
        def deserialize_cdr(self, data: bytes, msgtype: str) -> object:
            decoded.append(msgtype)
            return store.deserialize_cdr(data, msgtype)

    monkeypatch.setattr(module, "typestore", Counting)
    shown = Shown()
    for number in range(1000):  # of one second
        shown.show(replace(first, stamp_ns=first.stamp_ns + number * 1_000_000))
    assert len(decoded) == 5


ranges = st.floats(0.0, 40.0, width=32) | st.sampled_from([math.nan, math.inf, -math.inf])


@given(hnp.arrays(np.float32, st.integers(0, 3000), elements=ranges))
def test_points_lie_where_rays_end_and_are_bounded(values: np.ndarray) -> None:
    message = scan(0.0, values)
    found = points(message)
    assert len(found) <= MOST_RAYS
    distances = np.hypot(*np.array(found).T) if found else np.array([])
    assert (distances >= message.range_min - 0.01).all()
    assert (distances <= message.range_max + 0.01).all()


def test_messages_of_other_types_are_only_counted() -> None:
    shown = Shown()
    for number in range(10):
        shown.show(MessageHeard("/odd", "pkg/msg/Odd", number * EVERY_NS, b"no message"))
    _, parts = shown.since(0)
    assert parts.keys() == {"status"}
    assert parts["status"] == {"heard": 10, "now_s": pytest.approx(1.8)}
