from dataclasses import replace

import numpy as np
import pytest

from oracle_pipeline.features.lidar import permanence
from tests.oracle_pipeline.features.scenery import (
    Scanner,
    World,
    driving,
    extract,
    look,
    recording,
    still,
)

PLUGINS = permanence.register_features()
PILLAR = (1.0, 0.7, 0.2)
EMPTY, FURNISHED = World(()), World((PILLAR,))
AHEAD = (-0.2, 0.0, 0.15)  # where driving() comes through


@pytest.fixture
def extracted(tmp_path_factory):
    """Return a function from messages to values, where they are, and what is missing."""
    return lambda recorded: extract(PLUGINS, recorded, tmp_path_factory.mktemp("bag"))


def changing(before: Scanner, after: Scanner, at_s: float, seconds: float = 8.0):
    """What is recorded while driving if the scanner's world changes once."""
    rng = np.random.default_rng(0)
    recorded = recording([before], driving, seconds)
    return [
        (time_s, topic, look(after, time_s, driving(time_s), rng))
        if topic == before.topic and time_s >= at_s
        else (time_s, topic, message)
        for time_s, topic, message in recorded
    ]


def test_static_objects_do_not_move(extracted):
    values, _, missing = extracted(recording([Scanner("/scan", 0.1, FURNISHED)], driving, 8.0))
    assert missing == {}
    assert values["appeared"] == values["vanished"] == values["changed_peak"] == 0.0
    assert values["driven_across"] == 0.0
    assert values["loose"] < 0.05


def test_a_thing_that_comes_appears_and_one_that_goes_vanishes(extracted):
    with_it, without = Scanner("/scan", world=FURNISHED), Scanner("/scan", world=EMPTY)
    came, where, _ = extracted(changing(without, with_it, 4.0))
    gone, *_ = extracted(changing(with_it, without, 4.0))
    assert came["appeared"] > 0.03
    assert came["vanished"] == 0.0
    assert gone["vanished"] > 0.03
    assert gone["appeared"] == 0.0
    assert min(came["changed_peak"], gone["changed_peak"]) > 0.03
    assert where["appeared"] == "/scan"


def test_a_thing_that_keeps_ahead_of_the_robot_is_loose(extracted):
    fixed, *_ = extracted(recording([Scanner("/scan", world=FURNISHED)], driving, 8.0))
    rng = np.random.default_rng(0)
    held = []
    for time_s, topic, message in recording([Scanner("/scan", world=EMPTY)], driving, 8.0):
        shown = message
        if topic == "/scan":
            place, yaw = driving(time_s)
            centre = place + 0.6 * np.exp(1j * yaw)
            world = World(((centre.real, centre.imag, 0.1),))
            shown = look(Scanner("/scan", world=world), time_s, (place, yaw), rng)
        held.append((time_s, topic, shown))
    moving, *_ = extracted(held)
    assert moving["loose"] > fixed["loose"] + 0.03


def test_rounding_of_the_pose_moves_nothing(extracted):
    def trembling(time_s):
        place, yaw = still(time_s)
        return place + 1e-14 * np.sin(50.0 * time_s), yaw + 1e-14 * np.cos(70.0 * time_s)

    values, *_ = extracted(recording([Scanner("/scan", world=FURNISHED)], trembling))
    assert values["loose"] == 0.0


def test_returns_where_the_robot_drives_later_are_counted(extracted):
    real, *_ = extracted(recording([Scanner("/scan", world=FURNISHED)], driving, 8.0))
    fake, *_ = extracted(recording([Scanner("/scan", world=World((AHEAD,)))], driving, 8.0))
    assert real["driven_across"] == 0.0
    assert fake["driven_across"] > 0.2


def test_a_robot_that_stands_drives_across_nothing(extracted):
    scanner = Scanner("/scan", world=World(((0.15, 0.0, 0.05),)))
    values, *_ = extracted(recording([scanner], still))
    assert values["driven_across"] == 0.0


def test_the_scanner_that_contradicts_itself_is_named(extracted):
    honest, liar = Scanner("/honest", world=FURNISHED), Scanner("/liar", world=World((AHEAD,)))
    values, where, _ = extracted(recording([honest, replace(liar, x_m=0.1)], driving, 8.0))
    assert values["driven_across"] > 0.2
    assert where["driven_across"] == "/liar"


def test_without_odometry_there_is_no_value(extracted):
    _, _, missing = extracted(recording([Scanner("/scan")], odometry=False))
    assert set(missing.values()) == {"no odometry"}
