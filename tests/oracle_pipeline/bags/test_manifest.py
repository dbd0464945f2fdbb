import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from oracle_pipeline.bags import seals
from oracle_pipeline.bags.errors import ManifestError
from oracle_pipeline.bags.manifest import (
    LABELS,
    UNKNOWN_WORLD,
    Change,
    Contact,
    Drive,
    GoalResult,
    Manifest,
    Measured,
    Pose,
    Software,
    TopicCount,
    schema,
)

numbers = st.floats(allow_nan=False, allow_infinity=False)
seconds = st.floats(0.0, 600.0)
counts = st.integers(0, 2**40)
outcomes = st.sampled_from(["succeeded", "aborted", "timeout"])
names = st.text(min_size=1)
parameters = st.dictionaries(names, numbers | names | st.booleans() | st.lists(numbers))
poses = st.builds(Pose, numbers, numbers, numbers)
manifests = st.builds(
    Manifest,
    mode=st.from_regex(r"[a-z0-9_]+", fullmatch=True),
    label=st.sampled_from(LABELS),
    run=counts, block=counts, session=counts, world=names, seed=counts,
    start=poses,
    goals=st.lists(poses).map(tuple),
    goal_results=st.lists(
        st.builds(GoalResult, seconds, st.none() | seconds, outcomes, seconds, counts)
    ).map(tuple),
    outcome=outcomes,
    onset_s=st.none() | seconds,
    attack=parameters, attack_seed=st.none() | st.integers(0, 2**64 - 1),
    scenario=names, scenario_hash=names,
    task_effect=st.none() | st.dictionaries(names, seconds),
    drive=st.none() | st.builds(Drive, st.none() | seconds, counts, counts),
    recording_s=seconds,
    contacts=st.lists(st.builds(Contact, seconds, names)).map(tuple),
    topics=st.dictionaries(names, st.builds(TopicCount, names, counts)),
    content_hash=st.from_regex(r"[0-9a-f]{64}", fullmatch=True),
    recipe=parameters,
    software=st.builds(Software, names, names, names),
    measured=st.builds(
        Measured, seconds, st.dictionaries(names, counts),
        files=st.dictionaries(names, st.from_regex(r"[0-9a-f]{64}", fullmatch=True)),
    ),
    changes=st.lists(
        st.builds(Change, seconds, st.integers(1, 100), st.none() | seconds)
    ).map(tuple),
)  # fmt: skip


def example() -> Manifest:
    return Manifest(
        mode="fake_object", label="malicious", run=3, block=3, session=0, world="house-7", seed=7,
        start=Pose(-2.0, -0.5, 0.0), goals=(Pose(1.0, 0.5, 0.0),),
        goal_results=(GoalResult(1.0, 21.5, "succeeded", 4.2, 0),), outcome="succeeded",
        onset_s=31.0,
        attack={"radius_m": 0.2}, scenario="fake_object", scenario_hash="abc", task_effect=None,
        recording_s=40.0, contacts=(), topics={"/scan": TopicCount("sensor_msgs/msg/LaserScan", 2)},
        content_hash="0" * 64, recipe={}, software=Software("0.1.0", "abc", "x86_64"),
        measured=Measured(2.5, {"bag": 1000}),
    )  # fmt: skip


@settings(max_examples=30)
@given(manifests)
def test_a_saved_value_is_loaded_unchanged(tmp_path_factory, manifest):
    path = tmp_path_factory.mktemp("run") / "manifest.json"
    manifest.save(path)
    assert Manifest.load(path) == manifest


def test_schema_and_dataclasses_have_the_same_fields():
    definitions = {
        "start": Pose, "goal_results": GoalResult, "contacts": Contact, "topics": TopicCount,
    }  # fmt: skip
    assert set(schema()["required"]) == set(schema()["properties"])
    assert set(schema()["required"]) == names_of(Manifest) | {"seal"}
    for name, definition in zip(("pose", "goal_result", "contact", "topic"), definitions.values(),
                                strict=True):  # fmt: skip
        assert set(schema()["$defs"][name]["required"]) == names_of(definition)
    for name, definition in (("software", Software), ("measured", Measured), ("drive", Drive)):
        assert set(schema()["properties"][name]["properties"]) == names_of(definition)


def names_of(definition) -> set[str]:
    return {field.name for field in dataclasses.fields(definition)}


@pytest.mark.parametrize(
    ("field", "value"),
    [("mode", "a/../b"), ("label", "evil"), ("run", -1), ("run", 1.5), ("onset_s", "soon"),
     ("topics", {"/scan": {"type": 3, "messages": 1}}), ("goals", [{"x": 1.0}]),
     ("content_hash", "xyz"), ("start", None), ("changes", [[0.0, 0, 0.1]])],
)  # fmt: skip
def test_a_wrong_field_is_named(field, value, tmp_path):
    path = tmp_path / "manifest.json"
    example().save(path)
    path.write_text(json.dumps({**json.loads(path.read_text()), field: value}))
    with pytest.raises(ManifestError, match=rf"{path}, field {field}"):
        Manifest.load(path)


@pytest.mark.parametrize("change", ["missing", "unknown"])
def test_fields_are_complete_and_no_others(change, tmp_path):
    path = tmp_path / "manifest.json"
    example().save(path)
    document = json.loads(path.read_text())
    if change == "missing":
        del document["seed"]
    else:
        document["colour"] = "red"
    path.write_text(json.dumps(document))
    with pytest.raises(ManifestError, match=r"\(top level\).*('seed'|'colour')"):
        Manifest.load(path)


def test_another_schema_version_is_an_error(tmp_path):
    path = tmp_path / "manifest.json"
    path.write_text('{"schema_version": 7}')
    with pytest.raises(ManifestError, match="schema version 7, this release reads 5"):
        Manifest.load(path)


@pytest.mark.parametrize(("version", "lacks"), [(3, ("world",)), (2, ("world", "changes"))])
def test_fields_that_an_older_version_lacks_have_defaults(version, lacks, tmp_path):
    path = tmp_path / "manifest.json"
    example().save(path)
    document = json.loads(path.read_text())
    for name in ("seal", "drive", *lacks):
        del document[name]
    del document["measured"]["files"]
    older = {**document, "schema_version": version, "task_effect": True}  # it was yes or no
    path.write_text(json.dumps(older))
    expected = dataclasses.replace(example(), world=UNKNOWN_WORLD)
    assert Manifest.load(path) == expected
    content = bytearray(json.dumps({**older, "schema_version": 4, "seal": seals.BLANK}).encode())
    seals.seal(content)
    if "changes" not in lacks:
        path.write_bytes(content)
        assert Manifest.load(path) == expected


def test_a_manifest_that_lost_its_seal_is_not_taken_for_an_older_one(tmp_path):
    path = tmp_path / "manifest.json"
    example().save(path)
    document = json.loads(path.read_text())
    path.write_text(json.dumps({**document, "schema_version": 3}))
    with pytest.raises(ManifestError, match="schema version 3"):
        Manifest.load(path)
    path.write_text(json.dumps({**document, "schema_version": 4}))
    with pytest.raises(ManifestError, match="its content and its seal differ"):
        Manifest.load(path)
    del document["seal"]
    path.write_text(json.dumps(document))
    with pytest.raises(ManifestError, match="'seal' is a required property"):
        Manifest.load(path)


def test_an_edited_manifest_is_an_error(tmp_path):
    path = tmp_path / "manifest.json"
    example().save(path)
    path.write_text(path.read_text().replace("malicious", "normal"))
    with pytest.raises(ManifestError, match="was changed after it was written"):
        Manifest.load(path)


def test_no_flipped_bit_of_a_manifest_gives_another(tmp_path):
    """At any place; a sample of all bits, as far as time permits."""
    path = tmp_path / "manifest.json"
    example().save(path)
    content = path.read_bytes()
    for at in np.random.default_rng(15).choice(8 * len(content), 300, replace=False):
        flipped = bytearray(content)
        flipped[at // 8] ^= 1 << at % 8
        path.write_bytes(flipped)
        with pytest.raises(ManifestError):
            Manifest.load(path)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "\udcff"])
def test_a_file_that_is_no_manifest_is_an_error(text, tmp_path):
    path = tmp_path / "manifest.json"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(ManifestError, match=str(path)):
        Manifest.load(path)
    with pytest.raises(ManifestError, match="absent"):
        Manifest.load(tmp_path / "absent")


@pytest.mark.parametrize(
    "changes", [{"label": "evil"}, {"recording_s": float("nan")}, {"attack": {"a": object()}}]
)
def test_a_manifest_that_could_not_be_loaded_is_not_saved(changes, tmp_path):
    with pytest.raises(ManifestError):
        dataclasses.replace(example(), **changes).save(tmp_path / "manifest.json")
    assert list(tmp_path.iterdir()) == []
