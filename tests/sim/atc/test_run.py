"""Recorded runs of block 0: normal and attacked."""

from dataclasses import replace

import pytest

from oracle_pipeline.bags.reader import BagReader, read_ground_truth
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC, deserialize, serialize
from oracle_pipeline.graphs.differences import graph_differences
from oracle_pipeline.graphs.intervals import read_intervals
from sim.atc.airspace import AirSpace
from sim.atc.fusion import ADSB, PSR, SSR
from sim.atc.geodesy import Place, distance, to_geodetic
from sim.atc.recipes import AtcRecipe
from sim.atc.run import AtcRun
from sim.atc.sensors import SECTOR_NS
from sim.campaigns import Campaign
from sim.experiments import recipe_for, record_run
from sim.fuzzing.scenario import ScenarioError
from sim.middleware import qos
from sim.middleware.executor import SECOND
from sim.middleware.node import Node
from sim.middleware.stamps import stamp_ns
from sim.modes import modes
from sim.testbed import Mode
from tests.sim.introspection import publishers_of, subscriptions_of

pytestmark = pytest.mark.slow

TARGET = "C07AB1"
GHOST = Place(44.25, -76.55)
ONSET_S = 60.0
OVERHEAD_S = 260  # soon after, the target is so high above the radar that it cannot be seen
CAMPAIGN = Campaign(timeout_s=300.0)


def later(mode):
    """The same, from ``ONSET_S`` on."""
    document = {**mode.scenario.document, "activation": {"onset": {"seconds": ONSET_S}}}
    return Mode(replace(mode.scenario, document=document))


MODES = {
    "atc_normal": modes()["atc_normal"],
    "atc_delete_by_id": later(modes()["atc_delete_by_id"]),
    "atc_delete_by_id_shadow": later(modes()["atc_delete_by_id_shadow"]),
    "atc_ghost_static": later(modes()["atc_ghost_static"]),
    "atc_altitude_decrease": modes()["atc_altitude_decrease"],
}


def record(root, name):
    directory = RunDirectory(root, name, 0)
    target = {"target": TARGET} if "target" in MODES[name].scenario.drawn else {}
    record_run(recipe_for(MODES[name], 0, CAMPAIGN, target), directory)
    return directory


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    root = tmp_path_factory.mktemp("atc")
    return {mode: record(root, mode) for mode in MODES}


def messages(directory, topic):
    """Seconds of the recording, and message, of everything on a topic."""
    with BagReader(directory.bag) as bag:
        return [
            (message.stamp_ns / SECOND - 15.0, bag.deserialize(message))
            for message in bag.messages([topic])
        ]


def tracks(directory, icao24):
    """The fused tracks of an aircraft, by second."""
    return {
        round(second): track
        for second, array in messages(directory, "/tracks")
        for track in array.tracks
        if track.icao24 == icao24
    }


def test_fused_tracks_are_where_the_aircraft_are(runs):
    recipe = AtcRecipe.from_dict(runs["atc_normal"].manifest().recipe)
    air = AirSpace(recipe.flights, recipe.session.wind)
    number = {flight.icao24: index for index, flight in enumerate(recipe.flights)}
    compared = 0
    for _, array in messages(runs["atc_normal"], "/tracks"):
        air.advance_to(stamp_ns(array.header.stamp))
        for track in array.tracks:
            if (state := air.state(number[track.icao24])) is not None:
                here = Place(*to_geodetic(state.x, state.y))
                assert distance(here, Place(track.latitude, track.longitude)) < 100.0
                assert track.altitude_m == pytest.approx(state.altitude_m, abs=15.0)
                compared += 1
    assert compared > 0.95 * 300 * 5


def test_all_three_sensors_see_an_aircraft_that_flies_as_it_should(runs):
    far_away = (t for s, t in tracks(runs["atc_normal"], TARGET).items() if s < OVERHEAD_S)
    seen = [track.sources for track in far_away]
    assert seen.count(ADSB + PSR + SSR) > 0.9 * len(seen)


def test_without_an_attack_there_is_no_advisory(runs):
    assert messages(runs["atc_normal"], "/advisories") == []


def test_the_ghost_is_a_fused_track_that_no_radar_sees(runs):
    seen = tracks(runs["atc_ghost_static"], "GHOST1")
    assert min(seen) == pytest.approx(ONSET_S + 3, abs=1)
    assert sorted(seen) == list(range(min(seen), 301))
    assert {track.sources for track in seen.values()} == {ADSB}
    for track in seen.values():
        assert distance(Place(track.latitude, track.longitude), GHOST) < 1.0
        assert track.altitude_m == pytest.approx(1_500.0)
    assert tracks(runs["atc_normal"], "GHOST1") == {}
    (_, screen) = messages(runs["atc_ghost_static"], "/display_state")[-1]
    assert "GHO001 049 00" in screen.labels


def test_the_deleted_aircraft_is_gone_from_ads_b_and_not_from_radar(runs):
    directory = runs["atc_delete_by_id"]

    def heard(topic):
        return [s for s, message in messages(directory, topic) if message.icao24 == TARGET]

    assert max(heard("/adsb_fuzzed")) < ONSET_S + 0.1
    assert max(heard("/adsb")) > 299.0
    turns = [second for second in heard("/ssr") if ONSET_S < second < OVERHEAD_S]
    assert len(turns) > 0.9 * (OVERHEAD_S - ONSET_S) / 4.8
    fused = tracks(directory, TARGET)
    after = [fused[second] for second in range(round(ONSET_S) + 11, OVERHEAD_S)]
    assert {track.sources & ADSB for track in after} == {0}
    assert [track.sources for track in after].count(PSR + SSR) > 0.9 * len(after)


def test_the_altitude_attack_raises_advisories(runs):
    levels = {
        (message.icao24, message.intruder, message.level)
        for _, message in messages(runs["atc_altitude_decrease"], "/advisories")
    }
    recipe = AtcRecipe.from_dict(runs["atc_altitude_decrease"].manifest().recipe)
    for overtaken in (flight.icao24 for flight in recipe.flights[1:3]):
        for level in (0, 1, 2):
            assert {(TARGET, overtaken, level), (overtaken, TARGET, level)} <= levels
    altitudes = {s: t.altitude_m for s, t in tracks(runs["atc_altitude_decrease"], TARGET).items()}
    assert altitudes[201] == pytest.approx(altitudes[1] - 1_000.0, abs=10.0)
    screens = messages(runs["atc_altitude_decrease"], "/display_state")
    assert max(screen.resolution_advisories for _, screen in screens) >= 2


def test_the_truth_has_the_changes_and_only_attacks_have_any(runs):
    for mode, directory in runs.items():
        changed = [truth for _, truth in read_ground_truth(directory.bag) if truth.magnitude > 0.0]
        assert bool(changed) == (MODES[mode].label == "malicious")
        manifest = directory.manifest()
        assert sum(change.messages for change in manifest.changes) == len(changed)
        if changed:
            assert manifest.changes[0].start_s == manifest.onset_s


def test_a_finished_run_is_verified_and_not_simulated_again(runs):
    directory = runs["atc_normal"]
    before = directory.manifest_path.stat().st_mtime_ns
    assert record(directory.root, "atc_normal") == directory
    assert directory.manifest_path.stat().st_mtime_ns == before


def test_the_manifest_has_the_scenario_and_its_target(runs):
    manifest = runs["atc_altitude_decrease"].manifest()
    assert manifest.attack == {"target": TARGET, "rate_m_s": 5.0}
    assert manifest.scenario_hash == MODES["atc_altitude_decrease"].scenario.digest
    assert (manifest.label, manifest.onset_s, manifest.task_effect) == ("malicious", 0.0, None)


def test_graphs_of_every_mode_are_equal(runs):
    normal = read_intervals(runs["atc_normal"].graphs)
    assert len(normal) == 30
    for directory in runs.values():
        assert graph_differences(normal, read_intervals(directory.graphs)) == []


def test_a_shadow_control_is_the_normal_run_message_for_message(runs):
    with (
        BagReader(runs["atc_normal"].bag) as right,
        BagReader(runs["atc_delete_by_id_shadow"].bag) as shadow,
    ):
        assert list(right.messages()) == list(shadow.messages())


def test_before_its_onset_an_attack_and_its_control_are_the_same_run(runs):
    before = []
    for mode in ("atc_normal", "atc_ghost_static"):
        with BagReader(runs[mode].bag) as bag:
            onset_ns = round((15.0 + ONSET_S) * SECOND)
            before.append([m for m in bag.messages() if m.stamp_ns < onset_ns])
    assert before[0] == before[1]
    assert len(before[0]) > 1_000


def test_the_same_recipe_gives_the_same_messages(runs, tmp_path):
    again = record(tmp_path, "atc_ghost_static").manifest()
    manifest = runs["atc_ghost_static"].manifest()
    assert again.content_hash == manifest.content_hash
    assert replace(again, measured=manifest.measured) == manifest
    assert manifest.content_hash != runs["atc_normal"].manifest().content_hash
    for graph in (tmp_path / "runs" / "atc_ghost_static" / "run000" / "graphs").iterdir():
        assert graph.read_bytes() == (runs["atc_ghost_static"].graphs / graph.name).read_bytes()


def test_the_manifest_counts_the_messages_of_the_bag(runs):
    for directory in runs.values():
        manifest = directory.manifest()
        with BagReader(directory.bag) as bag:
            held = {name: topic.count for name, topic in bag.topics.items()}
        counts = {name: topic.messages for name, topic in manifest.topics.items()}
        assert {**counts, **held} == counts
        assert manifest.recording_s == 300.0
        assert manifest.label == MODES[directory.mode].label


def test_a_scenario_that_waits_for_a_goal_is_refused(tmp_path):
    scenario = modes()["atc_normal"].scenario
    activation = {"onset": {"after": "goal_accepted"}}
    mode = Mode(replace(scenario, document={**scenario.document, "activation": activation}))
    with pytest.raises(ScenarioError, match="this testbed has none"):
        AtcRun(recipe_for(mode, 0, CAMPAIGN), tmp_path)


def test_a_node_may_appear_at_the_onset(tmp_path):
    scenario = modes()["atc_normal"].scenario
    activation = {"onset": {"seconds": 10.0}, "before": "absent"}
    mode = Mode(replace(scenario, document={**scenario.document, "activation": activation}))
    directory = RunDirectory(tmp_path, mode.id, 0)
    record_run(recipe_for(mode, 0, Campaign(timeout_s=20.0)), directory)
    assert 10.0 <= min(second for second, _ in messages(directory, "/adsb_fuzzed")) < 11.0


# -- the contract of the nodes --------------------------------------------------------------

GRAPH = {  # node -> (subscriptions, publications), apart from /rosout, /clock and parameters
    "/adsb_receiver": (set(), {"/adsb"}),
    "/adsb_relay": ({"/adsb"}, {"/adsb_fuzzed", "/_oracle/ground_truth"}),
    "/airspace": (set(), {"/clock"}),
    "/conflict_detection": ({"/tracks"}, {"/advisories"}),
    "/controller_display": ({"/tracks", "/advisories"}, {"/display_state"}),
    "/fusion": ({"/adsb_fuzzed", "/psr", "/ssr"}, {"/tracks"}),
    "/primary_radar": (set(), {"/psr"}),
    "/secondary_radar": (set(), {"/ssr"}),
}
EVERY_NODE = {"/rosout", "/parameter_events"}


@pytest.fixture
def listened(tmp_path):
    """A run, and the messages that a further node received, with their bytes when sent."""
    recipe = recipe_for(modes()["atc_normal"], 0, Campaign(timeout_s=30.0))
    run = AtcRun(recipe, tmp_path)
    bystander, heard, sent = Node(run.domain, "/bystander"), [], []
    for _, sends in GRAPH.values():
        for topic in sends - {"/clock", "/advisories"}:
            msgtype = run.domain.topics[topic]

            def hear(message, topic=topic, msgtype=msgtype):
                heard.append((topic, msgtype, bystander.now_ns, message))

            def keep(data, topic=topic):
                sent.append((topic, data))

            bystander.create_subscription(msgtype, topic, keep, qos.SENSOR_DATA, raw=True)
            bystander.create_subscription(msgtype, topic, hear, qos.SENSOR_DATA)
    run.go()
    return run, heard, sent


def test_every_node_has_the_topics_of_the_documented_graph(listened):
    domain = listened[0].domain
    assert set(domain.node_names()) == {*GRAPH, "/bystander", "/rosbag2_recorder"}
    for node, (receives, sends) in GRAPH.items():
        assert set(subscriptions_of(domain, node)) - EVERY_NODE - {"/clock"} == receives
        assert set(publishers_of(domain, node)) - EVERY_NODE == sends


def test_no_node_writes_to_a_sent_message(listened):
    _, heard, sent = listened
    assert len(sent) > 1_000
    assert [(topic, serialize(message, msgtype)) for topic, msgtype, _, message in heard] == sent


def test_no_message_is_from_the_future_or_older_than_a_sector(listened):
    for topic, _, now_ns, message in listened[1]:
        if topic != GROUND_TRUTH_TOPIC:
            age_ns = now_ns - stamp_ns(message.header.stamp)
            assert 0 <= age_ns <= SECTOR_NS


def test_messages_survive_the_bag(runs):
    with BagReader(runs["atc_altitude_decrease"].bag) as bag:
        for message in bag.messages(["/tracks", "/advisories", "/display_state", "/adsb"]):
            msgtype = bag.topics[message.topic].msgtype
            assert serialize(deserialize(message.data, msgtype), msgtype) == message.data
