"""The state of a live page is current and bounded."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from oracle_pipeline.live import page_state
from oracle_pipeline.live.events import MessageReceived
from oracle_pipeline.live.page_state import EVERY_NS, MOST, MOST_POSES, MOST_RAYS, PageState, points
from tests.oracle_pipeline.features.conftest import scan
from tests.oracle_pipeline.live.happenings import HOSTILE, events, messages, verdict

PARTS = {"status", "graph", "verdicts", "alarms", "notes", "scans", "path"}


def filled() -> PageState:
    state = PageState()
    for event in events():
        state.update(event)
    return state


def test_the_first_request_gets_all_parts_and_later_ones_only_the_changes() -> None:
    state = filled()
    change, parts = state.since(0)
    assert set(parts) == PARTS
    assert state.since(change) == (change, {})
    state.update(verdict(4))
    later, parts = state.since(change)
    assert set(parts) == {"verdicts"}
    assert later > change
    assert len(parts["verdicts"]) == 5


def test_the_state_is_plain_json_without_control_characters() -> None:
    _, parts = filled().since(0)
    text = json.dumps(parts, allow_nan=False)
    assert "\\u001b" not in text
    assert any(node["label"].startswith(HOSTILE[:10]) for node in parts["graph"]["nodes"])


def test_only_scans_of_the_robot_that_is_drawn_are_shown() -> None:
    state = PageState()
    for message in messages():
        for space in ("/robot1", "/robot2"):
            state.update(replace(message, topic=space + message.topic))
    shown = state.since(0)[1]["scans"]
    assert shown
    assert all(name.startswith("/robot1/") for name in shown)


def test_an_infinite_score_is_null() -> None:
    state = PageState()
    state.update(replace(verdict(0), score=math.inf))
    assert state.since(0)[1]["verdicts"][0]["score"] is None


def test_only_the_newest_verdicts_are_kept() -> None:
    state = PageState()
    for number in range(MOST["verdicts"] + 7):
        state.update(verdict(number))
    kept = state.since(0)[1]["verdicts"]
    assert len(kept) == MOST["verdicts"]
    assert kept[-1]["end_s"] == verdict(MOST["verdicts"] + 6).end_s


def test_the_path_is_bounded_and_ends_where_the_robot_is() -> None:
    (first,) = [m for m in messages() if m.topic == "/odom"][:1]
    state = PageState()
    for number in range(MOST_POSES + 10):
        state.update(replace(first, stamp_ns=first.stamp_ns + number * EVERY_NS))
    path = state.since(0)[1]["path"]
    assert 0 < len(path) <= MOST_POSES


def test_a_fast_topic_is_decoded_at_most_five_times_a_second(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (first,) = [m for m in messages() if m.topic == "/odom"][:1]
    decoded = []
    store = page_state.typestore()

    class Counting:
        def deserialize_cdr(self, data: bytes, msgtype: str) -> object:
            decoded.append(msgtype)
            return store.deserialize_cdr(data, msgtype)

    monkeypatch.setattr(page_state, "typestore", Counting)
    state = PageState()
    for number in range(1000):  # of one second
        state.update(replace(first, stamp_ns=first.stamp_ns + number * 1_000_000))
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
    state = PageState()
    for number in range(10):
        state.update(MessageReceived("/odd", "pkg/msg/Odd", number * EVERY_NS, b"no message"))
    _, parts = state.since(0)
    assert parts.keys() == {"status"}
    assert parts["status"] == {"received": 10, "now_s": pytest.approx(1.8)}
