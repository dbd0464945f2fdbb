"""The files of a run are used only if they have the hashes in its manifest."""

import json
import logging
import shutil

import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.bags import seals
from oracle_pipeline.bags.errors import OracleError, RunDirectoryError
from oracle_pipeline.bags.integrity import damaged_files, hashes_of_files, require_undamaged
from oracle_pipeline.bags.manifest import Manifest, Measured, Pose, Software, TopicCount
from oracle_pipeline.bags.retention import retain
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.bags.writer import BagWriter
from oracle_pipeline.opened_run import open_run
from tests.oracle_pipeline.bags.conftest import CLOCK, clock


@pytest.fixture
def run(tmp_path):
    directory = RunDirectory(tmp_path, "fake_object", 3)
    with directory.staged() as scratch:
        (scratch / "graphs").mkdir()
        (scratch / "graphs" / "run.gexf").write_text("<gexf/>")
        with BagWriter(scratch / "bag") as bag:
            bag.add_topic("/clock", CLOCK, [])
            for number in range(20):
                bag.write("/clock", number, clock(number))
        Manifest(
            mode="fake_object", label="normal", run=3, block=3, session=0, world="w", seed=1,
            start=Pose(0.0, 0.0, 0.0), goals=(), goal_results=(), outcome="succeeded",
            onset_s=None, attack={}, scenario="s", scenario_hash="h", task_effect=None,
            recording_s=2.0, contacts=(), topics={"/clock": TopicCount(CLOCK, 20)},
            content_hash=bag.content_hash, recipe={}, software=Software("0", "0", "x"),
            measured=Measured(1.0, {"bag": 9999}, files=hashes_of_files(scratch)),
        ).save(scratch / "manifest.json")  # fmt: skip
    return directory


def append(path):
    with path.open("ab") as file:
        file.write(b" ")


@pytest.mark.parametrize(
    ("damage", "name"),
    [
        (lambda run: append(run.bag / "bag_0.mcap"), "bag/bag_0.mcap"),
        (lambda run: append(run.bag / "metadata.yaml"), "bag/metadata.yaml"),
        (lambda run: append(run.graphs / "run.gexf"), "graphs/run.gexf"),
        (lambda run: (run.graphs / "run.gexf").unlink(), "graphs/run.gexf"),
        (lambda run: append(run.graphs / "000000.gexf"), "graphs/000000.gexf"),
        (lambda run: shutil.rmtree(run.graphs), "graphs/run.gexf"),
    ],
)
def test_a_file_that_is_changed_lost_or_added_is_named_before_it_is_used(run, damage, name):
    require_undamaged(run.path, run.manifest())
    damage(run)
    assert damaged_files(run.path, run.manifest()) == [name]
    other = "bag" if name.startswith("graphs") else "graphs"
    assert damaged_files(run.path, run.manifest(), other) == []
    with pytest.raises(RunDirectoryError, match=f"damaged: {name} is not as recorded"):
        open_run(run.path)


def test_a_damaged_bag_is_not_trimmed(run):
    append(run.bag / "bag_0.mcap")
    with pytest.raises(OracleError, match="damaged"):
        retain(run, "trimmed", lambda _bag: ())
    assert run.manifest().measured.kept == "full"


@pytest.mark.parametrize("kept", ["trimmed", "recipe"])
def test_the_remaining_files_of_a_run_keep_their_hashes(run, kept):
    append(run.graphs / "run.gexf")
    retain(run, kept, lambda _bag: ())
    assert damaged_files(run.path, run.manifest()) == ["graphs/run.gexf"]
    assert damaged_files(run.path, run.manifest(), "bag") == []
    held = {file.split("/")[0] for file in run.manifest().measured.files}
    assert held == ({"bag", "graphs"} if kept == "trimmed" else {"graphs"})


def test_a_run_of_an_older_release_is_opened_with_a_warning(run, caplog):
    document = json.loads(run.manifest_path.read_text())
    del document["seal"], document["measured"]["files"], document["drive"]
    run.manifest_path.write_text(json.dumps({**document, "schema_version": 3}))
    append(run.graphs / "run.gexf")  # what it is now is taken as it is
    with caplog.at_level(logging.WARNING), open_run(run.path) as opened:
        assert opened.bag.message_count == 20
    assert "oracle-sim remake" in caplog.text
    retain(run, "recipe", lambda _bag: ())
    assert run.manifest().measured.files == {}  # what may be damaged is not declared sound


def test_a_manifest_is_amended_with_a_new_seal(run):
    run.amend(task_effect={"driven_m": 0.5})
    assert run.manifest().task_effect == {"driven_m": 0.5}


without_mark = st.binary().filter(lambda content: b"oracle-sha256:" not in content)


@given(before=st.binary(), after=without_mark, position=st.integers(0), bit=st.integers(0, 7))
def test_any_flipped_bit_of_a_sealed_file_breaks_its_seal(before, after, position, bit):
    content = bytearray(before + seals.BLANK.encode() + after)
    assert seals.check(content) == "wrong"
    seals.seal(content)
    assert seals.check(content) == "right"
    position %= len(content)
    content[position] ^= 1 << bit
    mark = range(len(before), len(before) + len(seals.BLANK) - 64)
    assert seals.check(content) == ("absent" if position in mark else "wrong")


def test_a_file_without_a_blank_seal_is_not_sealed():
    for content in (b"", seals.BLANK.encode()[:-64], b"text"):
        with pytest.raises(ValueError, match="no blank seal"):
            seals.seal(bytearray(content))
    assert seals.check(b"text") == "absent"
