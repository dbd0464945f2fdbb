import os
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from mcap.reader import make_reader
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.reader import BagReader, read_ground_truth
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC, serialize
from oracle_pipeline.bags.writer import BagWriter
from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.execution import PASSTHROUGH, execute
from sim.fuzzing.offline import mutate_bag
from sim.fuzzing.scenario import parse_scenarios
from sim.fuzzing.scenario_node import ScenarioNode
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import Executor
from sim.middleware.node import Node
from sim.recording import Recorder
from sim.scenarios import builtin_scenarios
from tests.oracle_pipeline.bags.makers import McapChannel, write_channels
from tests.sim.fuzzing.workbench import BUILTINS, SCAN, builtin, examples, odometry, scans

pytestmark = pytest.mark.slow

LATENCY_NS = 3_000_000
BEGIN_NS = 1_000_000_000  # of the small recording
ONSET_S = 2.1

_FOREIGN = os.environ.get("ORACLE_FOREIGN_BAGS")
FOREIGN_BAGS = sorted(Path(_FOREIGN).glob("*/metadata.yaml")) if _FOREIGN else []


@pytest.fixture(params=[*FOREIGN_BAGS, "simulated"], ids=lambda p: str(p)[-40:])
def any_bag(request):
    """Each available real bag, and that of a simulated run."""
    if isinstance(request.param, Path):
        return request.param.parent
    return request.getfixturevalue("recorded")[0]


def content(path, topics=None):
    with BagReader(path) as bag:
        return list(bag.messages(topics))


def on(path, topic):
    return [(m.stamp_ns, m.data) for m in content(path, [topic])]


def scenario_for(path):
    """A scenario that adds noise to the topic of the bag with the most numbers."""
    with BagReader(path) as bag:
        topic = next(
            topic
            for msgtype, field in (
                ("sensor_msgs/msg/LaserScan", "ranges"),
                ("sensor_msgs/msg/Imu", "linear_acceleration_covariance"),
            )
            for topic in bag.topics.values()
            if topic.msgtype == msgtype
        )
    field = {"LaserScan": "ranges", "Imu": "linear_acceleration.x"}[topic.msgtype.split("/")[-1]]
    text = f"""\
schema: mutant/v1
id: noisy
label: malicious
main: {{type: {topic.msgtype}, input: {topic.name}, output: {topic.name}_fuzzed}}
transform:
  actions:
    - name: noise
      do: [{{noise: {{field: {field}, dist: gauss, absolute: 0.1}}}}, {{delay: {{seconds: 0.05}}}}]
"""
    (scenario,) = parse_scenarios(text.encode(), "noisy.yaml")
    return compile_scenario(scenario)


def test_a_mutated_bag_has_all_that_was_recorded_and_the_output_besides(any_bag, tmp_path):
    program = scenario_for(any_bag)
    summary = mutate_bag(any_bag, tmp_path / "mutant", program, 1)
    ours = {program.output_topic}
    assert content(any_bag) == [m for m in content(tmp_path / "mutant") if m.topic not in ours]
    with BagReader(any_bag) as before, BagReader(tmp_path / "mutant") as after:
        kept = {name: topic for name, topic in after.topics.items() if name not in ours}
        assert kept == before.topics
        assert after.topics[program.output_topic].count == summary.published
        assert before.topics[program.input_topic].count == summary.received == summary.touched
    truth = read_ground_truth(tmp_path / "mutant")
    assert Counter(message.operation for _, message in truth) == {"noise": summary.touched}


def test_a_mutated_bag_opens_in_other_readers(any_bag, tmp_path):
    program = scenario_for(any_bag)
    mutate_bag(any_bag, tmp_path / "mutant", program, 1)
    told = Counter(m.topic for m in content(tmp_path / "mutant"))
    with Reader(tmp_path / "mutant") as bag:
        found = Counter(connection.topic for connection, _, _ in bag.messages())
    assert found == told | {GROUND_TRUTH_TOPIC: found[GROUND_TRUTH_TOPIC]}
    files = list((tmp_path / "mutant").glob("*.mcap"))
    assert [f.suffix for f in (tmp_path / "mutant").iterdir() if f.suffix != ".yaml"] == [
        next(f.suffix for f in any_bag.iterdir() if f.suffix != ".yaml")
    ]
    for file in files:
        with file.open("rb") as stream:
            read = Counter(channel.topic for _, channel, _ in make_reader(stream).iter_messages())
        assert read == found


def record_online(program, path, storage="mcap"):
    """Record a program at work on a few seconds of messages."""
    executor = Executor()
    domain = Domain(executor)
    sender = Node(domain, "/sender")
    outlets = {program.input_topic: program.type.name}
    outlets |= {source.topic: source.type.name for source in program.sources.values()}
    publishers = {topic: sender.create_publisher(kind, topic) for topic, kind in outlets.items()}
    executor.run_until(BEGIN_NS)
    onset_ns = BEGIN_NS + round(ONSET_S * 1e9)

    def start_node():
        node = ScenarioNode(domain, "/mutant", execute(program, 1), latency_ns=LATENCY_NS)
        node.begin(onset_ns)

    with BagWriter(path, storage) as writer:
        if program.activation.before == "forward":
            start_node()
        Recorder(domain, writer)
        for n, message in enumerate(examples(program, 60)):
            publish = publishers[program.input_topic].publish
            executor.call_at(BEGIN_NS + n * 200_000_000, publish, message)
            if "/odom" in publishers and program.input_topic != "/odom":
                place = odometry(n, 0.01 * n, 0.0, 0.1 * n)
                executor.call_at(BEGIN_NS + n * 200_000_000, publishers["/odom"].publish, place)
        if program.activation.before == "absent":
            executor.call_at(onset_ns, start_node)
        executor.run_until(BEGIN_NS + 70 * 200_000_000)


# What is altered in place was never published as it was, so the bag cannot show both. Parameters
# and QoS are not in a bag at all.
@pytest.mark.parametrize("name", [
    name for name in BUILTINS
    if not builtin(name).is_in_place and not builtin(name).scenario.needs_simulator
])  # fmt: skip
def test_offline_gives_the_bytes_that_the_node_gave(name, tmp_path):
    program = builtin(name)
    record_online(program, tmp_path / "online")
    mutate_bag(tmp_path / "online", tmp_path / "offline", program, 1, at_s=ONSET_S)
    online, offline = (on(tmp_path / bag, program.output_topic) for bag in ("online", "offline"))
    assert len(online) > 20
    # The node received it a moment later; what was under way at the end is in one of them only.
    end = min(len(online), len(offline))
    assert [data for _, data in offline[:end]] == [data for _, data in online[:end]]
    assert {late - at for (at, _), (late, _) in zip(offline, online, strict=False)} == {LATENCY_NS}


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_both_storages_give_the_same_bytes(storage, tmp_path):
    program = builtin("random_noise")
    record_online(program, tmp_path / "bag", storage)
    mutate_bag(tmp_path / "bag", tmp_path / "mutant", program, 1, at_s=ONSET_S)
    assert on(tmp_path / "mutant", program.output_topic) != []
    record_online(program, tmp_path / "other")
    mutate_bag(tmp_path / "other", tmp_path / "other_mutant", program, 1, at_s=ONSET_S)
    assert content(tmp_path / "mutant") == content(tmp_path / "other_mutant")


def test_passthrough_over_a_run_is_what_its_node_published(run_bag, tmp_path):
    bag, _ = run_bag
    program = builtin("lidar_passthrough_odom")
    mutate_bag(bag, tmp_path / "mutant", program, 1)
    published = [data for _, data in on(bag, program.output_topic)]
    received = [data for _, data in on(tmp_path / "mutant", program.output_topic)]
    assert len(published) > 20
    assert received[: len(published)] == published
    assert len(received) - len(published) <= 1  # one may have been under way at the end


def test_a_run_shows_when_its_goal_was_accepted(run_bag, tmp_path):
    bag, manifest = run_bag
    program = builtin("sensor_freeze")
    summary = mutate_bag(bag, tmp_path / "mutant", program, 1)
    accepted_s = manifest.goal_results[0].accepted_s
    assert summary.onset_s == pytest.approx(accepted_s + 5.0, abs=0.2)
    truth = read_ground_truth(tmp_path / "mutant")
    with BagReader(bag) as reader:
        frozen = [(ns - reader.start_ns) / 1e9 for ns, m in truth if m.operation != PASSTHROUGH]
    assert frozen[0] == pytest.approx(summary.onset_s, abs=0.2)
    assert len(frozen) == summary.touched


def test_an_onset_can_be_given_and_an_absent_node_publishes_nothing_before(run_bag, tmp_path):
    bag, _ = run_bag
    program = builtin("delayed_fakeobject")
    place = {"x": 1.5, "y": 0.0, "radius": 0.3}
    summary = mutate_bag(bag, tmp_path / "mutant", program, 1, at_s=4.0, parameters=place)
    with BagReader(bag) as reader:
        start_ns = reader.start_ns
    first_ns, _ = on(tmp_path / "mutant", program.output_topic)[0]
    assert summary.onset_s == 4.0
    assert 4.0 <= (first_ns - start_ns) / 1e9 <= 4.3


def test_a_shadow_of_a_run_has_the_scans_that_came(run_bag, tmp_path):
    bag, _ = run_bag
    program = compile_scenario(builtin_scenarios()["fake_object"].as_shadow())
    mutate_bag(bag, tmp_path / "mutant", program, 1)
    came = [data for _, data in on(bag, program.input_topic)]
    assert [data for _, data in on(tmp_path / "mutant", program.output_topic)] == came


@pytest.mark.parametrize("name", ["fake_object", "random_noise"])
def test_over_one_bag_an_attack_and_its_shadow_differ_in_the_attacked_payload_only(
    run_bag, tmp_path, name
):
    bag, _ = run_bag
    attack, shadow = builtin_scenarios()[name], builtin_scenarios()[name].as_shadow()
    for scenario in (attack, shadow):
        mutate_bag(bag, tmp_path / scenario.id, compile_scenario(scenario), 1)
    attacked, control = content(tmp_path / attack.id), content(tmp_path / shadow.id)
    assert [m[:2] for m in attacked] == [m[:2] for m in control]
    changed = {a.topic for a, c in zip(attacked, control, strict=True) if a.data != c.data}
    assert changed == {attack.document["main"]["output"]}


def test_the_bag_that_is_mutated_stays_as_it_is(run_bag, tmp_path):
    bag, _ = run_bag
    before = {file.name: file.read_bytes() for file in bag.iterdir()}
    mutate_bag(bag, tmp_path / "mutant", builtin("random_noise"), 1)
    assert {file.name: file.read_bytes() for file in bag.iterdir()} == before


def write(path, *topics):
    with BagWriter(path) as bag:
        for name, message in topics:
            msgtype = message.__msgtype__
            bag.add_topic(name, msgtype, [qos.DEFAULT])
            bag.write(name, 1, serialize(message, msgtype))
    return path


def test_a_bag_without_the_topic_is_refused_with_the_existing_topics(tmp_path):
    (scan,) = scans(1)
    bag = write(tmp_path / "bag", ("/scan", scan))
    with pytest.raises(BagError, match=r"no topic /scan_tom, which random_noise .* it has /scan\."):
        mutate_bag(bag, tmp_path / "mutant", builtin("random_noise"), 1)
    assert not (tmp_path / "mutant").exists()


def test_a_topic_with_the_wrong_type_is_an_error(tmp_path):
    bag = write(tmp_path / "bag", ("/scan_tom", odometry()))
    with pytest.raises(BagError, match=r"/scan_tom as nav_msgs/msg/Odometry, random_noise needs"):
        mutate_bag(bag, tmp_path / "mutant", builtin("random_noise"), 1)


ROS1 = get_typestore(Stores.ROS1_NOETIC)
DEFINITION, _ = ROS1.generate_msgdef(SCAN, ros_version=1)


@pytest.fixture
def ros1_scans():
    """Scans in the encoding of ROS 1."""
    ros2 = get_typestore(Stores.ROS2_HUMBLE)
    return [bytes(ros2.cdr_to_ros1(serialize(scan, SCAN), SCAN)) for scan in scans(3)]


def ros1_refusal(path, out):
    with pytest.raises(BagError, match="/scan_tom encoded as 'ros1', but a rosbag2 holds") as found:
        mutate_bag(path, out, builtin("random_noise"), 1)
    assert not out.exists()
    return str(found.value)


def test_for_a_ros1_bag_the_error_names_a_conversion_that_works(ros1_scans, tmp_path):
    bag, converted = tmp_path / "a.bag", tmp_path / "converted"
    with Writer1(bag) as writer:
        connection = writer.add_connection("/scan_tom", SCAN, typestore=ROS1)
        for stamp_ns, data in enumerate(ros1_scans, start=1):
            writer.write(connection, stamp_ns, data)
    error = ros1_refusal(bag, tmp_path / "mutant")
    words = re.search("`(rosbags-convert .*?)`", error)[1].split()
    words = [{"FILE.bag": bag, "FOLDER": converted}.get(word, word) for word in words]
    subprocess.run([Path(sys.executable).with_name(words[0]), *words[1:]], check=True)
    assert mutate_bag(converted, tmp_path / "mutant", builtin("random_noise"), 1).touched == 3


def test_ros1_messages_in_mcap_are_refused_even_among_others(ros1_scans, tmp_path):
    theirs = McapChannel("/scan_tom", SCAN, DEFINITION, ros1_scans, "ros1msg", "ros1")
    ours = McapChannel("/scan", SCAN, "", [serialize(scan, SCAN) for scan in scans(3)])
    write_channels(tmp_path / "a.mcap", [theirs])
    write_channels(tmp_path / "b.mcap", [ours, theirs])
    for name in ("a.mcap", "b.mcap"):  # rosbags-convert reads the bag they come from, no such file
        assert "the ROS 1 .bag file" in ros1_refusal(tmp_path / name, tmp_path / "mutant")


def test_topics_of_another_encoding_are_left_out_and_named(tmp_path):
    scan = McapChannel("/scan_tom", SCAN, "", [serialize(scan, SCAN) for scan in scans(3)])
    log = McapChannel("/log", "log", '{"type": "object"}', [b"{}"], "jsonschema", "json")
    write_channels(tmp_path / "a.mcap", [scan, log])
    summary = mutate_bag(tmp_path / "a.mcap", tmp_path / "mutant", builtin("random_noise"), 1)
    assert summary.touched == 3
    assert "/log" not in summary.topics
    assert any(note.startswith("/log is left out: its messages (1) are") for note in summary.notes)


def test_a_bag_without_cdr_is_refused(tmp_path):
    log = McapChannel("/log", "log", '{"type": "object"}', [b"{}"], "jsonschema", "json")
    write_channels(tmp_path / "a.mcap", [log])
    with pytest.raises(BagError, match="no topic encoded as CDR .*/log is 'json'"):
        mutate_bag(tmp_path / "a.mcap", tmp_path / "mutant", builtin("random_noise"), 1)


def test_a_bag_that_shows_no_goal_needs_an_onset(tmp_path):
    (scan,) = scans(1)
    bag = write(tmp_path / "bag", ("/scan_tom", scan))
    with pytest.raises(BagError, match="does not show when goal 1 was accepted"):
        mutate_bag(bag, tmp_path / "mutant", builtin("sensor_freeze"), 1)
    assert mutate_bag(bag, tmp_path / "mutant", builtin("sensor_freeze"), 1, at_s=0.0).touched == 1


def test_a_bag_is_never_written_over_another(run_bag, tmp_path):
    bag, _ = run_bag
    (tmp_path / "mutant").mkdir()
    with pytest.raises(BagError, match="exists already"):
        mutate_bag(bag, tmp_path / "mutant", builtin("random_noise"), 1)


def test_unchanged_messages_keep_their_bytes_even_unusual_ones(tmp_path):
    (scan,) = scans(1)
    msgtype = scan.__msgtype__
    odd = serialize(scan, msgtype) + b"\0\0\0"  # padding that a serializer left at the end
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/scan_tom", msgtype, [qos.DEFAULT])
        bag.write("/scan_tom", 1, odd)
    mutate_bag(tmp_path / "bag", tmp_path / "mutant", builtin("lidar_passthrough"), 1)
    assert on(tmp_path / "mutant", "/scan_fakeobject") == [(1, odd)]
