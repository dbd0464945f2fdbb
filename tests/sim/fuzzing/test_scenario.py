import re
from pathlib import Path

import jsonschema
import pytest
import yaml

from sim.fuzzing.operators import OPERATORS
from sim.fuzzing.scenario import MAX_BYTES, ScenarioError, load_scenarios, parse_scenarios
from sim.fuzzing.schema_words import schema
from sim.scenarios import builtin_scenarios

GOOD = """\
schema: mutant/v1
id: tried
label: malicious
main: {type: sensor_msgs/msg/LaserScan, input: /in, output: /out}
"""


def parse(text):
    return parse_scenarios(text.encode() if isinstance(text, str) else text, "tried.yaml")


def test_the_schema_is_a_json_schema():
    jsonschema.Draft202012Validator.check_schema(schema())


@pytest.mark.parametrize("scenario", builtin_scenarios().values(), ids=lambda s: s.id)
def test_a_built_in_scenario_is_parsed_as_by_any_yaml_parser(scenario):
    documents = list(yaml.safe_load_all(Path(scenario.file).read_text()))
    assert scenario.document in documents


def test_the_thesis_modes_and_the_air_traffic_are_there():
    assert builtin_scenarios().keys() >= {
        "lidar_passthrough", "lidar_passthrough_odom", "fake_object", "random_noise",
        "delayed_passthrough", "delayed_fakeobject", "random_noise_thesis", "message_mutator",
        "sensor_freeze", "sensor_replay", "sensor_drop", "sensor_delay", "range_drift",
        "blinded_sector", "odometry_spoof", "command_injection", "topic_flood",
        "atc_delete_by_id", "atc_delete_timer_callsign", "atc_deadzone", "atc_ghost_static",
        "atc_ghost_following", "atc_altitude_decrease", "atc_gps_alteration", "atc_follow_closest",
    }  # fmt: skip


def test_a_delayed_mode_differs_from_the_other_in_name_and_activation_only():
    for delayed, at_once in (
        ("delayed_fakeobject", "fake_object"),
        ("delayed_passthrough", "lidar_passthrough_odom"),
    ):
        one, other = (
            {
                k: v
                for k, v in builtin_scenarios()[name].document.items()
                if k not in ("id", "title")
            }
            for name in (delayed, at_once)
        )
        assert one.pop("activation") == {
            "onset": {"after": "goal_accepted", "seconds": [25, 35]},
            "before": "absent",
        }
        assert one == other


def test_a_file_may_hold_several_scenarios():
    texts = [GOOD, GOOD.replace("tried", "tried_too")]
    assert [s.id for s in parse("---\n".join(texts))] == ["tried", "tried_too"]


def test_lines_are_counted_through_all_documents():
    with pytest.raises(ScenarioError, match=r"^tried.yaml:8:1: label: expected one of malicious"):
        parse(GOOD + "---\n" + GOOD.replace("tried", "other").replace("malicious", "evil"))


@pytest.mark.parametrize("name", builtin_scenarios())
def test_the_place_of_a_key_is_where_it_stands_in_the_file(name):
    scenario = builtin_scenarios()[name]
    lines = Path(scenario.file).read_text("utf-8").splitlines()
    for key, place in scenario.places.items():
        if key and isinstance(key[-1], str):
            assert re.match(rf"['\"]?{key[-1]}\b", lines[place.line - 1][place.column - 1 :]), key


def test_the_digest_depends_on_content_and_not_on_formatting():
    (one,), (same,), (other,) = (
        parse(GOOD),
        parse("# a comment\n\n" + GOOD.replace("{type", "{  type")),
        parse(GOOD + "seed: 1\n"),
    )
    assert one.digest == same.digest != other.digest


def test_a_shadow_differs_from_its_attack_in_name_label_and_control_only():
    scenario = builtin_scenarios()["fake_object"]
    shadow = scenario.as_shadow()
    assert (shadow.id, shadow.label, shadow.control) == ("fake_object_shadow", "control", "shadow")
    changed = {"id", "title", "label", "control"}
    assert {k: v for k, v in shadow.document.items() if k not in changed} == {
        k: v for k, v in scenario.document.items() if k not in changed
    }


def test_plain_scalars_mean_what_yaml_1_2_says():
    (parsed,) = parse(GOOD + "constants: {a: 1e-3, b: -2, c: yes, d: 1:30, e: '7', f: false}\n")
    assert parsed.document["constants"] == {
        "a": 1e-3, "b": -2, "c": "yes", "d": "1:30", "e": "7", "f": False,
    }  # fmt: skip


def act(*operators):
    do = "".join(f"        - {operator}\n" for operator in operators)
    return GOOD + f"transform:\n  actions:\n    - name: act\n      do:\n{do}"


@pytest.mark.parametrize(
    ("text", "where", "expected"),
    [
        ("", "1", "expected a scenario, found an empty file"),
        ("- 1\n", "1: (scenario)", "expected a mapping, found [1]"),
        ("just words\n", "1: (scenario)", 'expected a mapping, found "just words"'),
        (GOOD.replace("label: malicious\n", ""), "1: (scenario)", "expected the key label"),
        (GOOD + "colour: red\n", "5: colour", "expected one of schema, id, title"),
        (GOOD.replace("mutant/v1", "mutant/v9"), "1: schema", 'expected mutant/v1, found "mutant'),
        (GOOD.replace("tried", "Tried"), "2: id", "expected a name such as random_noise"),
        (
            GOOD.replace("/in", "in"),
            "4: main.input",
            "expected a full topic name such as /scan_tom",
        ),
        (GOOD.replace("/msg", ""), "4: main.type", "expected a message type such as sensor_msgs"),
        (GOOD + "seed: -1\n", "5: seed", "expected at least 0, found -1"),
        (GOOD + "seed: many\n", "5: seed", 'expected a whole number, found "many"'),
        (GOOD + "control: maybe\n", "5: control", "expected one of none, passthrough, shadow"),
        (GOOD + "id: again\n", "5: id", "expected each key once"),
        (act("fly: {}"), "9: transform.actions[0].do[0].fly", "expected one of set, add, scale"),
        (act("drop: {how: 1}"), "9: transform.actions[0].do[0].drop.how", "expected nothing"),
        (act("set: {field: ranges}"), "9: transform.actions[0].do[0].set", "the key value"),
        (act("drop: {}", "{}"), "10: transform.actions[0].do[1]", "expected at least 1"),
        (act("replay: {messages: 0}"), "9: transform.actions[0].do[0].replay.messages", "least 1"),
        (
            act("set: {field: 'a[0]', value: 1}"),
            "9: transform.actions[0].do[0].set.field",
            "a field",
        ),
        (
            act("map_array: {field: ranges, as: [r, r], value: r}"),
            "9: transform.actions[0].do[0].map_array.as",
            'expected each value once, found ["r", "r"]',
        ),
        (
            GOOD + "activation: {probability: 2}\n",
            "5: activation.probability",
            "expected at most 1, found 2",
        ),
        (GOOD + f"constants: {{a: {'9' * 400}}}\n", "5: constants.a", "a number of 64 bits"),
        (GOOD + f"title: {'x' * 5000}\n", "5: title", "at most 4096 characters, found 5000"),
        (GOOD + "state: {s: {type: map, max_size: 4}}\n", "5: state.s", "expected the key value"),
        (GOOD + "state: {s: {type: float}}\n", "5: state.s", "expected the key default"),
        (GOOD + "1: [\n", "6", "expected YAML"),
        (GOOD + "\tx: 1\n", "5", "expected YAML"),
        (GOOD + "? [a]\n: 1\n", "1: (scenario)", "expected names for keys"),
        (GOOD + "seed: !!int '3'\n", "5", "found the tag tag:yaml.org,2002:int"),
        (GOOD + "title: !!python/object:os.system x\n", "5", "found the tag tag:yaml.org,2002:py"),
        (GOOD + "title: &a x\n", "5", "found the anchor &a"),
        (GOOD + "title: *a\n", "5", "found the alias *a"),
        (GOOD + "<<: {seed: 1}\n", "5: <<", "expected one of schema"),
        (GOOD + "constants: " + "[" * 5000, "5: constants[0]", "expected at most 24 levels"),
        (GOOD + "#" * MAX_BYTES, " ", f"expected at most {MAX_BYTES} bytes"),
        (GOOD.encode() + b"title: \xff\n", " ", "expected text"),
        (GOOD + "title: \x00\n", "1", "expected YAML"),
        (GOOD + "---\n" + GOOD, "7: id", "expected a new name, tried stands above"),
    ],
    ids=lambda value: value[:40] if isinstance(value, str) else None,
)
def test_a_wrong_file_is_refused_with_line_key_and_what_was_expected(text, where, expected):
    with pytest.raises(ScenarioError) as refused:
        parse(text)
    told = re.sub(r"^(tried.yaml:[0-9]+):[0-9]+", r"\1", str(refused.value))
    assert told.startswith(f"tried.yaml:{where}")
    assert expected in str(refused.value)
    assert len(str(refused.value)) < 400


def test_all_faults_of_a_file_are_reported_at_once():
    text = "colour: red\nsize: big\n" + GOOD.replace("tried", "Tried").replace("schema", "scheme")
    with pytest.raises(ScenarioError) as refused:
        parse(text)
    told = [line.split(": ")[1:3] for line in str(refused.value).splitlines()]
    assert [place for place, _ in told] == ["(scenario)", "colour", "size", "scheme", "id"]
    assert told[0][1] == "expected the key schema."


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ScenarioError, match=re.escape(str(tmp_path / "none.yaml"))):
        load_scenarios(tmp_path / "none.yaml")


def test_the_schema_lists_the_existing_operators():
    assert set(schema()["$defs"]["operator"]["properties"]) == set(OPERATORS)
