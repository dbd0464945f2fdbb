"""Names must match completely: none with a trailing line feed becomes a mode or a folder."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

import oracle_pipeline.bags.manifest as manifests
from oracle_pipeline.bags.json_schema import faults
from sim.fuzzing import scenario as scenarios
from sim.fuzzing.scenario import ScenarioError, parse_scenarios
from sim.modes import FOLDER, left_out, modes

TEXT = """\
schema: mutant/v1
id: {id}
label: normal
main: {{type: {type}, input: {input}, output: /scan_fuzzed}}
transform: {{actions: [{{name: {name}, do: [{{set: {{field: {field}, value: 1.0}}}}]}}]}}
"""
WHOLE = {
    "id": "fine",
    "type": "sensor_msgs/msg/LaserScan",
    "input": "/scan",
    "name": "act",
    "field": "range_min",
}


@pytest.mark.parametrize("part", WHOLE)
def test_a_line_feed_behind_a_name_is_refused_where_it_stands(part):
    assert parse_scenarios(TEXT.format(**WHOLE).encode(), "f")
    spoilt = {**WHOLE, part: json.dumps(WHOLE[part] + "\n")}
    with pytest.raises(ScenarioError, match=r"^f:[2-5]:\d+: .*expected a "):
        parse_scenarios(TEXT.format(**spoilt).encode(), "f")


@pytest.mark.parametrize("schema", [scenarios.schema(), manifests.schema()])
def test_every_pattern_of_every_schema_refuses_a_line_feed_at_the_end(schema):
    patterns = set(re.findall(r'"pattern": ("(?:[^"\\]|\\.)*")', json.dumps(schema)))
    assert patterns
    samples = ["a", "/a", "a/msg/A", "0" * 64, "oracle-sha256:" + "0" * 64]
    for pattern in map(json.loads, patterns):
        rule = {"type": "string", "pattern": pattern}
        (good, *_) = [text for text in samples if not faults(text, rule)]
        assert faults(good + "\n", rule)


def test_an_invalid_file_is_left_out_and_the_others_are_modes(tmp_path, monkeypatch):
    monkeypatch.setenv(FOLDER, str(tmp_path))
    (tmp_path / "bad.yaml").write_text(TEXT.format(**{**WHOLE, "id": '"bad\\n"'}))
    (tmp_path / "fine.yaml").write_text(TEXT.format(**WHOLE))
    assert "fine" in modes()
    assert all(re.fullmatch("[a-z0-9_]+", name) for name in modes())
    assert [Path(text.split(":")[0]).name for text in left_out()] == ["bad.yaml"]


def test_a_manifest_whose_mode_ends_with_a_line_feed_is_refused(tmp_path):
    from tests.sim.test_pairs import manifest

    good = manifest()
    good.save(tmp_path / "manifest.json")
    with pytest.raises(manifests.ManifestError, match="field mode"):
        replace(good, mode="lidar_passthrough\n").save(tmp_path / "manifest.json")
