import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.features.engine.timeline import Timeline
from oracle_pipeline.features.extraction import only_robot
from oracle_pipeline.opened_run import open_run
from oracle_pipeline.scoring.contract import FEWEST_RECORDINGS, Contract, Observation, Observer
from oracle_pipeline.scoring.fingerprints import Copies
from oracle_pipeline.scoring.isolation import extracted
from oracle_pipeline.scoring.pace import Pace
from oracle_pipeline.scoring.parameters import ReportedParameters
from tests.oracle_pipeline.features.conftest import drive, write_bag

names = st.sampled_from(["/scan", "/odom", "/tf", "/cmd_vel", "/rosout"])
profiles = st.sampled_from([(), ("reliable, volatile",), ("best effort, volatile",)])
rates = st.none() | st.floats(0.1, 1000.0)
topics = st.tuples(st.sampled_from(["a/msg/A", "b/msg/B"]), profiles, rates)
elements = st.sampled_from(["node:/a", "node:/b", "node:/a -> topic:/tf", "topic:/tf -> node:/b"])
observations = st.builds(
    Observation,
    st.dictionaries(names, topics),
    st.none() | st.frozensets(elements),
    st.dictionaries(names, st.builds(Pace, st.floats(0.0, 1e3), st.integers(0, 9), st.just(9))),
    st.dictionaries(
        names, st.dictionaries(st.sampled_from(["frame", "range"]), st.sampled_from(["1", "2"]))
    ),
    st.dictionaries(
        names, st.dictionaries(names, st.builds(Copies, st.integers(0, 9), st.just(9)))
    ),
)

NORMAL = [
    Observation(
        {
            "/scan": ("sensor_msgs/msg/LaserScan", ("best effort, volatile",), rate_hz),
            "/goal": ("geometry_msgs/msg/PoseStamped", ("reliable, volatile",), None),
            **({"/bt": ("std_msgs/msg/String", (), 0.1)} if rate_hz > 5.0 else {}),
        },
        frozenset({"node:/amcl", "topic:/scan -> node:/amcl"}),
    )
    for rate_hz in (4.9, 5.0, 5.1)
]
CONTRACT = Contract.learned(NORMAL)


def breaches(**changed):
    seen = replace(NORMAL[1], **changed)
    return [breach.text for breach in CONTRACT.breaches(seen)]


def with_topic(name, *terms):
    return {"topics": {**NORMAL[1].topics, name: terms}}


@given(st.lists(observations, min_size=1, max_size=6))
def test_no_recording_breaches_the_contract_learned_from_it(normal):
    contract = Contract.learned(normal)
    assert all(contract.breaches(seen) == [] for seen in normal)


def test_a_robot_that_is_gone_breaches_the_contract_of_its_fleet(tmp_path):
    seen = {}
    for count in (1, 2, 3):
        fleet = [
            (time_s, f"/r{robot}{name}", message)
            for time_s, name, message in drive() for robot in range(count)
        ]  # fmt: skip
        write_bag(tmp_path / f"{count}", fleet)
        seen[count] = extracted(tmp_path / f"{count}")[0].observation
    contract = Contract.learned([seen[3], seen[2]])
    assert contract == Contract.from_dict(json.loads(json.dumps(contract.to_dict())))
    told = "The recording has 1 of the 2 robots that every normal recording has."
    assert [b.text for b in contract.breaches(seen[1]) if b.term == "robots"] == [told]
    assert not [b for b in contract.breaches(seen[2]) if b.term == "robots"]


@pytest.mark.parametrize(
    ("constants", "texts"),
    [
        ({"frame": "'laser'", "range": "4"}, []),
        (
            {"range": "3"},
            [
                "Field frame of topic /scan changes or is missing; in normal recordings it is "
                "'laser'."
            ],
        ),
        (
            {"frame": "'spy'", "range": "3"},
            ["Field frame of topic /scan is 'spy' instead of 'laser'."],
        ),
    ],
)
def test_a_change_of_a_constant_field_is_a_breach(constants, texts):
    normal = [
        replace(NORMAL[1], constants={"/scan": {"frame": "'laser'", "range": str(number)}})
        for number in range(FEWEST_RECORDINGS)
    ]
    seen = replace(NORMAL[1], constants={"/scan": constants})
    contract = Contract.learned(normal)
    assert [each.text for each in contract.breaches(seen)] == texts
    assert Contract.learned(normal[1:]).breaches(seen) == []


@pytest.mark.parametrize(
    ("seen", "texts"),
    [
        ("like 'goal #' or 'idle'", []),
        ("'goal 7'", []),
        (
            "like 'FAIL' or 'idle'",
            ["Field data of topic /scan is 'FAIL' instead of 'goal #' or 'idle'."],
        ),
    ],
)
def test_a_text_that_no_normal_recording_has_is_a_breach(seen, texts):
    few = ["like 'goal #' or 'idle'", "'idle'"]
    normal = [replace(NORMAL[1], constants={"/scan": {"data": few[n % 2]}}) for n in range(6)]
    contract = Contract.from_dict(Contract.learned(normal).to_dict())
    found = contract.breaches(replace(NORMAL[1], constants={"/scan": {"data": seen}}))
    assert [each.text for each in found] == texts
    assert all(contract.breaches(each) == [] for each in normal)


def test_texts_that_only_one_normal_recording_has_are_no_terms():
    said = [f"like 'at dock' or 'seen {name}'" for name in "abcdef"]
    normal = [replace(NORMAL[1], constants={"/scan": {"data": text}}) for text in said]
    assert Contract.learned(normal).constants["/scan"] == {}


def test_a_localisation_that_rests_at_other_places_is_no_mount():
    paths = ("map -> odom translation", "base -> laser translation")
    moving = replace(NORMAL[1], **with_topic("/tf", "tf2_msgs/msg/TFMessage", (), None))
    normal = [
        replace(moving, constants={"/tf": {paths[0]: str(number), paths[1]: "[0.1, 0, 0]"}})
        for number in range(FEWEST_RECORDINGS)
    ]
    seen = replace(moving, constants={"/tf": {paths[1]: "[0.15, 0, 0]"}})
    assert [each.text for each in Contract.learned(normal).breaches(seen)] == [
        "Field base -> laser translation of topic /tf is [0.15, 0, 0] instead of [0.1, 0, 0]."
    ]


@given(st.lists(observations, min_size=1, max_size=6))
def test_a_contract_survives_json(normal):
    contract = Contract.learned(normal)
    assert Contract.from_dict(contract.to_dict()) == contract


def test_a_clock_that_is_set_back_is_a_breach_unless_normal_recordings_have_it():
    seen = replace(NORMAL[1], set_back=((5.1, 2.0),))
    assert [each.text for each in Contract.learned(NORMAL).breaches(seen)] == [
        "The recorder's clock was set back by 2 s at 5.10 s; in no normal recording it was."
    ]
    assert Contract.learned([*NORMAL, seen]).breaches(seen) == []


def test_a_missing_topic_is_a_breach():
    rest = {name: of for name, of in NORMAL[1].topics.items() if name != "/scan"}
    assert breaches(topics=rest) == ["Topic /scan is gone: every normal recording has it."]


def test_a_topic_that_only_some_normal_recordings_have_may_be_absent():
    assert "/bt" not in NORMAL[1].topics
    assert breaches() == []


def test_a_new_topic_is_a_breach():
    assert breaches(**with_topic("/spy", "std_msgs/msg/String", (), None)) == [
        "Topic /spy (std_msgs/msg/String) is new."
    ]


def test_a_changed_type_or_qos_is_a_breach():
    assert breaches(**with_topic("/scan", "std_msgs/msg/String", ("reliable, volatile",), 5.0)) == [
        "Topic /scan has type std_msgs/msg/String instead of sensor_msgs/msg/LaserScan.",
        "Topic /scan is offered with QoS reliable, volatile instead of best effort, volatile.",
    ]


def test_a_rate_out_of_range_is_a_breach_and_a_silent_topic_counts_as_0_hz():
    scan = NORMAL[1].topics["/scan"][:2]
    assert breaches(**with_topic("/scan", *scan, 5.3)) == []
    assert breaches(**with_topic("/scan", *scan, 9.0)) == [
        "Topic /scan has 9 Hz instead of 4.9 to 5.1 Hz."
    ]
    assert breaches(**with_topic("/scan", *scan, None)) == [
        "Topic /scan has 0 Hz instead of 4.9 to 5.1 Hz."
    ]


def test_a_recording_breaks_no_rate_that_it_is_too_short_to_show():
    scan = NORMAL[1].topics["/scan"][:2]
    few = with_topic("/scan", *scan, None)
    assert breaches(**few, duration_s=2.0) == []
    assert len(breaches(**few, duration_s=20.0)) == 1
    slow = with_topic("/scan", *scan, 4.2)
    assert breaches(**slow, duration_s=5.0) == []
    assert len(breaches(**slow, duration_s=50.0)) == 1


@pytest.mark.parametrize(
    ("rate_hz", "range_m", "copies", "severities"),
    [
        (4.5, "3.5000001", 0, ["note", "note", "note"]),
        (2.4, "3.6", 2, ["breach", "breach", "breach"]),
        (4.0, "3.5", 7, ["note"]),  # the relay has what its source lost
        (None, "3.5", 10, ["breach"]),
    ],
)
def test_what_an_honest_filter_or_another_machine_does_is_a_note_with_its_reason(
    rate_hz, range_m, copies, severities
):
    def seen(rate_hz, range_m, copies):
        topics = {
            name: ("sensor_msgs/msg/LaserScan", (), hz)
            for name, hz in (("/relay", 5.0), ("/scan", rate_hz))
        }
        relays = {"/relay": {"/scan": Copies(copies, 10)}, "/scan": {}}
        return Observation(topics, None, {}, {"/scan": {"range_max": range_m}}, relays)

    contract = Contract.learned([seen(5.0, "3.5", 10)] * FEWEST_RECORDINGS)
    found = contract.breaches(seen(rate_hz, range_m, copies))
    assert [each.severity for each in found] == severities
    assert all(("This is a note" in each.text) == (each.severity == "note") for each in found)
    broken = contract.broken_terms(seen(rate_hz, range_m, copies))
    assert bool(broken) == ("breach" in severities)


def test_a_topic_without_a_steady_rate_may_have_any():
    goal = NORMAL[1].topics["/goal"][:2]
    assert breaches(**with_topic("/goal", *goal, 50.0)) == []


def test_missing_and_new_nodes_and_edges_are_reported_as_sentences():
    seen = frozenset({"node:/amcl", "node:/spy", "topic:/scan -> node:/spy"})
    assert breaches(graph=seen) == [
        "The subscription to /scan in node /amcl is gone.",
        "Node /spy is new.",
        "The subscription to /scan in node /spy is new.",
    ]


def test_a_recording_without_graphs_has_no_breaches_by_nodes():
    assert breaches(graph=None) == []


@given(st.lists(st.integers(0, 100 * 10**9), min_size=1, max_size=200))
def test_a_recording_does_not_breach_its_own_pace(stamps_ns):
    stamps = np.array(sorted(stamps_ns), dtype=np.int64)
    end_ns = int(stamps[-1]) + 5 * 10**9
    contract = Contract({}, frozenset(), frozenset(), {"/scan": Pace.of(stamps, end_ns)})
    longest_s = np.diff(stamps, append=end_ns).max() / 10**9
    assert contract.breach_of_silence("/scan", longest_s) is None
    for end in range(int(stamps[0]) + 10 * 10**9, end_ns + 1, 10**9):
        count = int(np.sum((stamps >= end - 10 * 10**9) & (stamps < end)))
        assert contract.breach_of_count("/scan", count) is None


def test_an_unusual_pace_is_a_breach():
    contract = Contract({}, frozenset(), frozenset(), {"/scan": Pace(0.25, 49, 51)})
    (silence, few, many) = (
        contract.breach_of_silence("/scan", 2.0),
        contract.breach_of_count("/scan", 25),
        contract.breach_of_count("/scan", 100),
    )
    assert silence.text.startswith("Topic /scan has been silent for 2.0 s")
    assert "25 messages in 10 s" in few.text
    assert "100 messages in 10 s" in many.text
    assert contract.breach_of_silence("/odom", 100.0) is None
    assert contract.breach_of_count("/odom", 0) is None


def test_a_topic_with_few_messages_in_a_normal_recording_has_no_pace():
    paces = {"/scan": Pace(0.25, 49, 51), "/goal": Pace(9.0, 0, 1)}
    contract = Contract.learned([replace(NORMAL[0], paces=paces), *NORMAL[1:]])
    assert contract.paces == {}
    contract = Contract.learned([replace(seen, paces=paces) for seen in NORMAL])
    assert contract.paces == paces


def test_a_recording_shows_the_pace_of_its_topics(recorded_run):
    with open_run(recorded_run("lidar_passthrough").path) as run:
        robot = only_robot(run)
        paced, unpaced = Observer(robot, paced=True), Observer(robot)
        batches = list(run.bag.batches())
        for batch in batches:
            paced.see(batch)
            unpaced.see(batch)
        clock = Timeline((0,), (run.bag.start_ns,), (run.bag.end_ns,))
        times_ns = np.concatenate([batch.stamps_ns for batch in batches])
        observation = paced.observation(run, clock, times_ns)
        unrequested = replace(observation, paces={}, entropies={})
        assert unrequested == unpaced.observation(run, clock, times_ns)
        seen, entropies = observation.paces, observation.entropies
    assert seen["/scan"].longest_gap_s == pytest.approx(0.2, abs=0.1)
    assert 49 <= seen["/scan"].fewest <= seen["/scan"].most <= 51
    assert "/map" not in seen
    assert 0.0 < entropies["/local_costmap/costmap"] < entropies["/imu"] < 8.0


def test_terms_that_normal_recordings_break_among_themselves_are_notes():
    unsteady = replace(CONTRACT, unsteady=frozenset({"topic"}))
    seen = replace(NORMAL[1], **with_topic("/spy", "std_msgs/msg/String", (), None))
    (note,) = unsteady.breaches(seen)
    assert (note.severity, note.term) == ("note", "topic")
    assert unsteady.broken_terms(replace(seen, graph=frozenset())) == {"graph"}
    assert Contract.from_dict(json.loads(json.dumps(unsteady.to_dict()))) == unsteady


def with_parameters(values, *changed):
    return Observation({}, None, parameters=ReportedParameters(values, frozenset(changed)))


SPEED, MAP = "/controller_server max_vel_x", "/map_server yaml_filename"


@pytest.mark.parametrize(
    ("seen", "told"),
    [
        (with_parameters({SPEED: 0.26, MAP: "a.yaml"}), []),
        (with_parameters({}), []),  # the recorder began later
        (with_parameters({SPEED: 0.5}), [f"Parameter {SPEED} is 0.5 instead of 0.26."]),
        (with_parameters({SPEED: 0.26}, SPEED),
         [f"Parameter {SPEED} is set to 0.26; no normal recording sets it."]),
        (with_parameters({"/amcl seed": 9.0}), []),
        (with_parameters({"/amcl alpha": 9.0}), []),  # of a node that starts later
        (with_parameters({"/amcl alpha": 9.0}, "/amcl alpha"),
         ["Parameter /amcl alpha is set to 9.0; no normal recording sets it."]),
        (with_parameters({"/amcl goal": 9.0}, "/amcl goal"), []),
    ],
)  # fmt: skip
def test_a_parameter_that_is_set_or_has_another_value_breaks_the_contract(seen, told):
    normal = [
        with_parameters(
            {SPEED: 0.26, MAP: "a.yaml", "/amcl seed": n, "/amcl goal": n}, "/amcl goal"
        )
        for n in range(FEWEST_RECORDINGS)
    ]
    contract = Contract.from_dict(json.loads(json.dumps(Contract.learned(normal).to_dict())))
    assert [each.text for each in contract.breaches(seen)] == told
    few = Contract.learned(normal[1:])
    assert few.breaches(seen) == []
    former = {key: of for key, of in contract.to_dict().items() if key != "changed"}
    assert len(Contract.from_dict(former).breaches(seen)) == ("instead of" in "".join(told))
