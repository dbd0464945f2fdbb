"""Short flights of block 0: normal, with a fault, and with the fault's shadow."""

import numpy as np
import pytest

from oracle_pipeline.bags.reader import BagReader, read_ground_truth
from oracle_pipeline.graphs.differences import graph_differences
from oracle_pipeline.graphs.intervals import read_intervals
from sim.campaigns import Campaign
from sim.crazyflie.airframe import MASS_KG
from sim.crazyflie.firmware import LOG
from sim.experiments import recipe_for
from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.scenario import ScenarioError, parse_scenarios
from sim.testbed import Mode

pytestmark = pytest.mark.slow

CAMPAIGN = Campaign(goals_per_run=1)
TOPICS = {
    "/cf231/battery": "sensor_msgs/msg/BatteryState",
    "/cf231/cmd_full_state": "crazyflie_interfaces/msg/FullState",
    "/cf231/controller": "crazyflie_interfaces/msg/LogDataGeneric",
    "/cf231/imu": "sensor_msgs/msg/Imu",
    "/cf231/motors": "crazyflie_interfaces/msg/LogDataGeneric",
    "/cf231/odom": "nav_msgs/msg/Odometry",
    "/cf231/pose": "geometry_msgs/msg/PoseStamped",
    "/cf231/status": "crazyflie_interfaces/msg/Status",
    "/poses": "motion_capture_tracking_interfaces/msg/NamedPoseArray",
    "/tf": "tf2_msgs/msg/TFMessage",
}
FAULT = """
schema: mutant/v1
id: fault
label: malicious
main:
  type: crazyflie_interfaces/msg/Status
  input: /cf231/status
  output: /cf231/status
set_parameters:
  - {{node: /world, name: {name}, value: {value}}}
"""


@pytest.fixture(scope="module")
def flights(recorded_run):
    names = ("cf_normal", "cf_propeller_cut", "cf_propeller_cut_shadow")
    return {name: recorded_run(name, campaign=CAMPAIGN) for name in names}


def messages(flight, topic):
    with BagReader(flight.bag) as bag:
        return [bag.deserialize(message) for message in bag.messages([topic])]


def hover(flight):
    """Mean of each logged variable in the middle of the flight."""
    log = np.array([message.values for message in messages(flight, "/cf231/controller")])
    third = len(log) // 3
    return dict(zip(LOG, log[third:-third].mean(axis=0), strict=True))


def fault(name, value):
    (scenario,) = parse_scenarios(FAULT.format(name=name, value=value).encode(), "fault.yaml")
    compile_scenario(scenario)  # without leave to move something
    return Mode(scenario)


def test_a_normal_flight_succeeds_and_publishes_the_topics_of_the_bridge(flights):
    manifest = flights["cf_normal"].manifest()
    assert (manifest.outcome, manifest.contacts) == ("succeeded", ())
    with BagReader(flights["cf_normal"].bag) as bag:
        held = {name: topic.msgtype for name, topic in bag.topics.items()}
    assert TOPICS.items() <= held.items()


def test_the_thrust_of_a_hover_carries_the_weight(flights):
    craft = flights["cf_normal"].manifest().recipe["session"]["craft"]
    log = np.array([m.values for m in messages(flights["cf_normal"], "/cf231/controller")])
    in_the_air = slice(len(log) // 3, -len(log) // 3)
    measured = [m.linear_acceleration.z for m in messages(flights["cf_normal"], "/cf231/imu")]
    assert np.mean(measured[in_the_air]) == pytest.approx(9.81, abs=0.1)
    heavier = craft["mass"] * MASS_KG / 0.029  # than the craft of the firmware's base thrust
    assert hover(flights["cf_normal"])["cmd_thrust"] == pytest.approx(36_000 * heavier, rel=0.25)


def test_a_cut_propeller_is_given_more_by_all_commands_that_reach_it(flights):
    sound, cut = (hover(flights[mode]) for mode in ("cf_normal", "cf_propeller_cut"))
    more = {name: cut[name] - sound[name] for name in LOG}
    assert more["cmd_thrust"] > 300
    assert (more["cmd_roll"] > 300, more["cmd_pitch"] < -300, more["cmd_yaw"] > 300) == (True,) * 3


def test_a_fault_of_the_world_is_in_the_truth_and_in_no_message_or_graph(flights):
    normal, cut, shadow = flights.values()
    assert cut.manifest().topics["/parameter_events"].messages == 0
    changed = [truth for _, truth in read_ground_truth(cut.bag) if truth.magnitude > 0.0]
    assert [truth.detail for truth in changed] == [
        f"/world m3.cut_{blade}_mm: 0 to 2" for blade in "ab"
    ]
    assert graph_differences(read_intervals(normal.graphs), read_intervals(cut.graphs)) == []
    with BagReader(normal.bag) as right, BagReader(shadow.bag) as computed:
        assert list(right.messages()) == list(computed.messages())


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [("m5.cut_a_mm", 1, "expected one of m1.cut_a_mm"), ("wind.x", 99, "wind.x is from -10 to 10")],
)
def test_an_impossible_condition_is_an_error_that_says_what_is_possible(
    name, value, words, tmp_path
):
    from sim.crazyflie.run import CrazyflieRun

    with pytest.raises(ScenarioError, match=words):
        CrazyflieRun(recipe_for(fault(name, value), 0, CAMPAIGN), tmp_path).go()


def test_a_craft_that_cannot_stay_in_the_air_has_not_reached_its_goal(recorded_run):
    flight = recorded_run(fault("m1.thrust", 0.0), campaign=CAMPAIGN).manifest()
    assert flight.outcome == "aborted"
