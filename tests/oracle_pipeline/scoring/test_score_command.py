"""``oracle score``: real recordings against tables of normal runs made from their features."""

import json
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from oracle_pipeline.cli import main
from oracle_pipeline.datasets import KEYS, Fields, feature_columns, feature_floors, write_table
from oracle_pipeline.features import FeatureTables, build_manager, extract
from oracle_pipeline.opened_run import open_run
from oracle_pipeline.scoring import isolation
from oracle_pipeline.scoring.card import ReferenceCard
from oracle_pipeline.scoring.card_output import card_as_text
from oracle_pipeline.scoring.judging import judge
from oracle_pipeline.scoring.learning import Cards, learn
from oracle_pipeline.scoring.output import as_json, as_text
from oracle_pipeline.scoring.reference import Reference, read_reference
from oracle_pipeline.scoring.verdict import ScoringError, Verdict
from tests.oracle_pipeline.datasets.synthetic import run_features
from tests.oracle_pipeline.features.conftest import drive, message_class, odometry, write_bag

pytestmark = pytest.mark.slow

FIRST = "contextual.total_turning"


def oracle_score(*arguments: object, expect: int):
    done = CliRunner().invoke(main, ["score", *map(str, arguments)])
    assert done.exit_code == expect, done.output
    return done


def spinning():
    """The same drive by a robot that turns thrice as fast in its last ten seconds."""
    return [
        (t, topic, odometry(t, 0.5, -0.5, 0.4 * t + 0.8 * max(0.0, t - 17.0), 0.4))
        if topic == "/odom" else (t, topic, message)
        for t, topic, message in drive()
    ]  # fmt: skip


@pytest.fixture(scope="module")
def bags(tmp_path_factory) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("bags")
    write_bag(root / "usual", drive())
    write_bag(root / "spinning", spinning())
    return {name: root / name for name in ("usual", "spinning")}


@pytest.fixture(scope="module")
def extracted(bags) -> dict[str, FeatureTables]:
    tables = {}
    for name, path in bags.items():
        with open_run(path) as run:
            tables[name] = extract(run, build_manager())
    return tables


def around(row: pd.DataFrame, blocks: int = 40, runs: int = 2, seed: int = 0) -> pd.DataFrame:
    """Return normal runs whose features scatter by their resolution around those of one run."""
    rng = np.random.default_rng(seed)
    columns, n = feature_columns(row), blocks * runs
    floors = pd.Series(feature_floors(row)).reindex(columns).to_numpy()
    values = row[columns].to_numpy() + 2.0 * floors * rng.normal(size=(n, len(columns)))
    table = pd.DataFrame(values, columns=columns)
    table.insert(0, "run_id", [f"patrol|run{number:03d}" for number in range(n)])
    table.insert(1, "mode", "patrol")
    table.insert(2, "label", "normal")
    table.insert(3, "block", np.repeat(np.arange(blocks), runs))
    table.insert(4, "session", table["block"] % 3)
    table.insert(5, "world", "hexagon-0")
    table["where"] = table["missing"] = "{}"
    table.attrs = dict(row.attrs)
    return table


@pytest.fixture(scope="module")
def normal(extracted) -> pd.DataFrame:
    return around(extracted["usual"].run)


@pytest.fixture
def reference(normal, tmp_path) -> Path:
    write_table(normal, tmp_path / "features.parquet")
    return tmp_path / "features.parquet"


def judged(tables: FeatureTables, normal: pd.DataFrame, far: float = 0.05):
    return judge("bag", tables, Cards(Reference(normal)).card_for(tables.run), far)


def test_a_recording_like_the_reference_passes(bags, reference):
    done = oracle_score(bags["usual"], "--reference", reference, expect=0)
    assert done.stdout.startswith("normal")
    assert "with 80 normal runs of 40 blocks." in done.stdout


def test_an_anomalous_recording_is_reported_with_evidence_and_time(bags, reference, extracted):
    done = oracle_score(bags["spinning"], "--reference", reference, "-v", expect=1)
    verdict, summary, aspects, *lines = done.stdout.splitlines()
    assert verdict.startswith("ANOMALOUS")
    assert "robot" in summary
    assert "in normal runs" in summary
    assert lines[-1].startswith("1 anomalous in ")
    quiet = oracle_score(bags["spinning"], "--reference", reference, "-q", expect=1)
    brief, tally = quiet.stdout.splitlines()
    assert brief == f"ANOMALOUS  {bags['spinning']}: {summary.strip()}"
    assert tally.startswith("1 anomalous in ")
    assert aspects.startswith("    Tampering p = ")
    assert "misbehaviour p = " in aspects
    first = lines[next(n for n, line in enumerate(lines) if "usual (5-95 %)" in line) + 1]
    assert FIRST in done.stdout
    assert f"{extracted['spinning'].run[FIRST].iloc[0]:.4g} rad" in done.stdout
    assert "from 17.5 s" in done.stdout
    assert first.startswith(("    contextual.", "    kinematics."))
    assert "features outside their usual range" in done.stdout


def test_json_is_one_object_with_the_basis_of_the_verdict(bags, reference, normal, extracted):
    done = oracle_score(bags["spinning"], "--reference", reference, "--format", "json", expect=1)
    document = json.loads(done.stdout)
    (found,) = document["recordings"]
    assert document["outcome"] == found["outcome"] == "anomalous"
    assert document["false_alarm_rate"] == 0.05
    assert found["p_value"] == found["suite_p_value"] == pytest.approx(1 / 41)
    assert (found["normal_runs"], found["normal_blocks"]) == (80, 40)
    assert set(found["aspects"]) == {"tampering", "misbehaviour"}
    for aspect in found["aspects"].values():
        assert 1 / 41 <= aspect["p_value"] == aspect["suite_p_value"] <= 1.0
    assert (found["alarms"], found["alarms_per_h"]) == ([], None)  # the table has no windows
    z = [abs(evidence["z"]) for evidence in found["evidence"]]
    assert z == sorted(z, reverse=True)
    (turning,) = [e for e in found["evidence"] if e["feature"] == FIRST]
    assert turning["value"] == extracted["spinning"].run[FIRST].iloc[0]
    assert turning["unit"] == "rad"
    assert [turning["usual_low"], turning["usual_high"]] == pytest.approx(
        np.percentile(normal[FIRST], [5, 95])
    )
    assert turning["window_start_s"] == 17.5  # it spins from 17 s on


def test_too_few_runs_give_a_ranking_and_the_number_needed_but_no_verdict(bags, normal, tmp_path):
    write_table(normal[normal["block"] < 18], tmp_path / "small.parquet")
    arguments = (bags["spinning"], "--reference", tmp_path / "small.parquet")
    done = oracle_score(*arguments, expect=2)
    assert done.stdout.startswith("NO VERDICT")
    assert FIRST in done.stdout
    assert "18 normal recordings cannot support a false positive rate of 0.05" in done.stdout
    assert done.stdout.count("19 are needed, 1 more") == 1
    oracle_score(*arguments, "--far", 0.06, expect=1)


def test_runs_of_one_block_count_once(bags, extracted, tmp_path):
    write_table(around(extracted["usual"].run, blocks=6, runs=10), tmp_path / "few.parquet")
    done = oracle_score(bags["spinning"], "--reference", tmp_path / "few.parquet", expect=2)
    assert "with 60 normal runs of 6 blocks" in done.stdout


def test_a_suite_in_which_no_single_alarm_is_possible_has_no_verdict(bags, normal, tmp_path):
    write_table(normal[normal["block"] < 20], tmp_path / "features.parquet")
    reference = ("--reference", tmp_path / "features.parquet")
    oracle_score(bags["spinning"], *reference, expect=1)
    done = oracle_score(bags["usual"], bags["spinning"], *reference, "--suite", expect=2)
    assert done.stdout.count("NO VERDICT") == 2
    assert "for 2 recordings judged together" in done.stdout
    assert "39 are needed, 19 more" in done.stdout


def test_attacked_runs_of_the_reference_are_ignored(normal, extracted):
    attacked = around(extracted["spinning"].run, seed=1).assign(label="malicious")
    attacked["run_id"] = "attack|" + attacked["run_id"]
    mixed = pd.concat([normal, attacked], ignore_index=True)
    mixed.attrs = normal.attrs
    tables = extracted["spinning"]
    assert judged(tables, mixed) == judged(tables, normal)


def test_the_order_of_the_reference_does_not_matter(normal, extracted):
    shuffled = normal.sample(frac=1.0, random_state=1)
    tables = extracted["usual"]
    one, other = (judged(tables, each) for each in (normal, shuffled))
    assert one.p_value == other.p_value
    assert one.score == pytest.approx(other.score)


def test_a_run_of_the_reference_is_not_compared_with_its_own_block(normal, extracted):
    own = extracted["usual"].run
    mixed = normal.copy()
    mixed.loc[0, feature_columns(own)] = own[feature_columns(own)].iloc[0]
    verdict = judged(extracted["usual"], mixed)
    assert verdict.normal_runs == len(normal) - 2
    assert verdict.normal_blocks == 39
    assert any("block is part of the reference" in note for note in verdict.notes)


def test_normal_runs_are_called_anomalous_as_rarely_as_promised():
    df = run_features(runs=90)
    df = df[df["mode"] == "lidar_passthrough"].assign(where="{}")
    reference, new = df[df["block"] < 60], df[df["block"] >= 60]
    windows = pd.DataFrame({"window_start_s": []})
    found = [
        judged(FeatureTables(new.iloc[[row]], windows), reference, 0.1) for row in range(len(new))
    ]
    assert {verdict.outcome for verdict in found} <= {"normal", "anomalous"}
    assert sum(verdict.outcome == "anomalous" for verdict in found) / len(found) <= 0.2


def test_thesis_features_and_shortcuts_do_not_affect_the_verdict(normal, extracted):
    fields = {**normal.attrs["fields"], "other.who": {"unit": "1", "shortcut": "true"}}
    wider = normal.assign(**{"thesis.size_0": 1.0, "other.who": 1.0})
    run = extracted["usual"].run.assign(**{"thesis.size_0": 9e9, "other.who": 9e9})
    wider.attrs["fields"] = run.attrs["fields"] = Fields(fields)
    verdict = judged(FeatureTables(run, extracted["usual"].windows), wider)
    assert verdict.outcome == "normal"
    assert all(e.feature not in ("thesis.size_0", "other.who") for e in verdict.evidence)


def test_missing_features_are_left_out_with_a_note(normal, extracted):
    wider = normal.assign(**{"structural.size": 5.0})
    tables = extracted["usual"]
    run = tables.run.assign(
        **{"structural.size": np.nan, "missing": json.dumps({"structural.size": "no graphs"})}
    )
    verdict = judged(FeatureTables(run, tables.windows), wider)
    assert verdict.features == judged(tables, normal).features
    assert any("structural.size (no graphs)" in note for note in verdict.notes)


def test_evidence_states_where_a_feature_was_attained(normal, extracted):
    run = extracted["spinning"].run.assign(where=json.dumps({FIRST: "/odom"}))
    verdict = judged(FeatureTables(run, extracted["spinning"].windows), normal)
    assert {e.feature: e.where for e in verdict.evidence}[FIRST] == "/odom"


def test_features_with_different_units_are_refused(normal, extracted):
    wider = normal.copy()
    wider.attrs = {"fields": {**normal.attrs["fields"], FIRST: {"unit": "deg"}}}
    with pytest.raises(ScoringError, match="is in deg in the reference and in rad"):
        judged(extracted["usual"], wider)


def test_a_system_without_a_common_feature_is_not_judged(normal, extracted):
    wider = normal[[*KEYS]].assign(**{"atc.tracks": 1.0})
    with pytest.raises(ScoringError, match="none of the features"):
        judged(extracted["usual"], wider)


def test_a_recording_is_judged_as_if_it_were_alone(bags, reference):
    arguments = ("--reference", reference, "--format", "json")
    among = oracle_score(bags["spinning"], *[bags["usual"]] * 9, *arguments, expect=1)
    alone = oracle_score(bags["spinning"], *arguments, expect=1)
    first = json.loads(among.stdout)["recordings"][0]
    assert first == json.loads(alone.stdout)["recordings"][0]
    text = oracle_score(*[bags["usual"]] * 9, "--reference", reference, expect=0).stdout
    assert "Of 9 normal recordings, 0.45 would be by chance." in text


def test_a_suite_is_judged_together_and_a_bad_bag_affects_no_other(bags, reference, tmp_path):
    report = tmp_path / "verdicts.xml"
    suite = (bags["usual"], bags["spinning"], tmp_path / "ab\x01sent")
    done = oracle_score(*suite, "--reference", reference, "--suite", "--junit", report, expect=2)
    assert "adjusted for a suite of 2" in done.stdout
    assert "COULD NOT JUDGE" in done.stdout
    root = ElementTree.parse(report).getroot()  # noqa: S314 -- our own file
    assert dict(root.attrib) == {
        "name": "oracle score", "tests": "3", "failures": "1", "errors": "1"
    }  # fmt: skip
    usual, odd, absent = root
    assert (usual.get("name"), len(usual)) == (str(bags["usual"]), 0)
    assert FIRST in odd.find("failure").text
    assert "normal runs" in odd.find("failure").get("message")
    assert "There is no bag" in absent.find("error").get("message")
    arguments = ("--reference", reference, "--suite", "--format", "json")
    done = oracle_score(*suite[:2], *arguments, expect=1)
    p = [found["suite_p_value"] for found in json.loads(done.stdout)["recordings"]]
    assert p[1] == pytest.approx(2 / 41)


def test_an_unfinished_recording_is_judged_with_a_note_unless_strict(bags, reference, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(next(bags["usual"].glob("*.mcap")).read_bytes()[:-100])
    done = oracle_score(cut, "--reference", reference, "--format", "json", expect=0)
    (verdict,) = json.loads(done.stdout)["recordings"]
    (caution,) = verdict["cautions"]
    assert "cut.mcap was not finished" in caution
    assert "messages were read, up to" in caution
    done = oracle_score(cut, "--reference", reference, "--strict", expect=2)
    assert "is incomplete" in done.stdout


def test_recordings_that_crash_their_process_are_errors_in_junit(bags, reference, tmp_path):
    (tmp_path / "odd.py").write_text(
        "import os\n"
        "from oracle_pipeline.features import Feature, FeaturePlugin, hookimpl\n"
        "def compute(window):\n"
        "    os._exit(7) if len(window.arrivals) == 1 else None\n"
        "    return {'value': 1.0}\n"
        "@hookimpl\n"
        "def register_features():\n"
        "    return [FeaturePlugin('o', 'o', (Feature('value', '1', 1.0, ''),), compute)]\n"
    )
    write_bag(tmp_path / "deadly", [each for each in drive() if each[1] == "/odom"])
    junit = tmp_path / "verdicts.xml"
    suite = [bags["usual"], tmp_path / "deadly", bags["spinning"]]
    options = ("--reference", reference, "--junit", junit, "--plugins", tmp_path)
    oracle_score(*suite, *options, expect=2)
    cases = list(ElementTree.parse(junit).getroot().iter("testcase"))  # noqa: S314 -- ours
    assert [[result.tag for result in case] for case in cases] == [[], ["error"], ["failure"]]
    assert "died (exit code 7)" in ElementTree.tostring(cases[1], encoding="unicode")


@pytest.fixture
def card(bags, normal, tmp_path) -> Path:
    """A card with the contract of the usual bag, and an attacked run that is to be left out."""
    (usual,) = isolation.extracted(bags["usual"])
    (attacked,) = isolation.extracted(bags["spinning"])
    topics = {**attacked.observation.topics, "/spy": ("std_msgs/msg/String", (), None)}
    seen = [usual.observation] * len(normal) + [replace(attacked.observation, topics=topics)]
    labels = ["normal"] * len(normal) + ["malicious"]
    table = pd.concat([normal, attacked.tables.run], ignore_index=True).assign(label=labels)
    table.attrs = dict(normal.attrs)
    learn(Reference(table, observations=tuple(seen))).save(tmp_path / "robot.card")
    return tmp_path / "robot.card"


def test_terms_that_several_normal_recordings_break_are_noted_in_the_card(bags, normal):
    (usual,) = isolation.extracted(bags["usual"])
    names = [f"field{number}" for number in range(len(normal) // 10)]
    steady = dict.fromkeys(names, "1")
    fields = [{**steady, name: "2"} for name in names] + [steady] * (len(normal) - len(names))
    seen = [replace(usual.observation, constants={"/odom": each}) for each in fields]
    found = learn(Reference(normal, observations=tuple(seen)))
    assert found.contract.unsteady == {"constant"}
    assert found.breaching == 0
    assert "Only noted, as normal recordings differ in it: constant." in card_as_text(found)


def test_a_normal_recording_that_breaks_the_contract_is_a_breach(bags, card, tmp_path):
    assert ReferenceCard.load(card).breaching == 0
    spied = [(0.5, "/spy", message_class("std_msgs/msg/String")(data="hello"))]
    write_bag(tmp_path / "spied", [*drive(), *spied])
    junit = tmp_path / "verdicts.xml"
    oracle_score(bags["usual"], "--reference", card, expect=0)
    done = oracle_score(
        bags["usual"], tmp_path / "spied", "--reference", card, "--far", "0.1", "--junit", junit,
        expect=1,
    )  # fmt: skip
    assert "Topic /spy (std_msgs/msg/String) is new." in done.output
    assert re.search(r"^BREACH +\S*spied", done.output, re.MULTILINE)
    usual, spied_case = ElementTree.parse(junit).findall("testcase")  # noqa: S314 -- ours
    assert (len(usual), [each.tag for each in spied_case]) == (0, ["failure"])
    oracle_score(tmp_path / "spied", "--reference", card, "--no-contract", expect=0)
    found = json.loads(
        oracle_score(tmp_path / "spied", "--reference", card, "--format", "json", expect=1).stdout
    )
    assert (found["outcome"], found["recordings"][0]["outcome"]) == ("breach", "breach")


def test_a_page_shows_the_same_verdicts(bags, reference, tmp_path):
    page = tmp_path / "verdicts.html"
    done = oracle_score(*bags.values(), "--reference", reference, "--page", page, expect=1)
    assert page.as_uri() in done.stderr
    html = page.read_text("utf-8").replace("<wbr>", "")
    for path, headline in zip(bags.values(), ("Normal", "Anomalous"), strict=True):
        assert re.search(rf">{headline}</span>\s*<h2>{path}</h2>", html)


def test_junit_is_written_without_a_reference(bags, tmp_path):
    junit = tmp_path / "verdicts.xml"
    options = ("--reference", tmp_path / "absent", "--junit", junit)
    oracle_score(bags["usual"], *options, expect=2)
    (error,) = ElementTree.parse(junit).getroot().iter("error")  # noqa: S314 -- ours
    assert "absent" in (error.text or error.get("message", ""))


def test_a_folder_of_bags_is_a_reference_whose_recordings_count_as_normal(bags, tmp_path):
    for nth, name in enumerate("abcd"):
        write_bag(tmp_path / "good" / name, drive(nth))
    (tmp_path / "good" / "broken").mkdir()
    (tmp_path / "good" / "broken" / "metadata.yaml").write_text("{}")
    (tmp_path / "good" / "notes.txt").write_text("recorded on a Tuesday")
    options = ("--reference", tmp_path / "good", "--far", 0.2)
    done = oracle_score(bags["spinning"], *options, expect=1)
    assert "4 reference recordings without a label: taken as normal." in done.stdout
    assert "broken is left out of the reference" in done.stdout
    assert "with 4 normal runs of 4 blocks." in done.stdout


def test_each_robot_of_a_recording_is_judged_by_the_card_of_another(bags, tmp_path):
    for nth, name in enumerate("abcdef"):
        write_bag(tmp_path / "good" / name, drive(nth))
    # One behaves as the normal ones do, the other spins.
    both = [
        (t, f"/{name}{topic}", message)
        for name, recorded in (("usual", drive(2)), ("odd", spinning()))
        for t, topic, message in recorded
        if not topic.startswith("/_")
    ]
    write_bag(tmp_path / "both", sorted(both, key=lambda each: each[0]))
    junit = tmp_path / "verdicts.xml"
    options = ("--reference", tmp_path / "good", "--far", 0.2, "--junit", junit)
    done = oracle_score(tmp_path / "both", *options, "--format", "json", expect=1)
    found = {each["recording"]: each for each in json.loads(done.stdout)["recordings"]}
    one, other = (found[f"{tmp_path / 'both'}#{name}"] for name in ("usual", "odd"))
    assert (one["outcome"], other["outcome"]) == ("normal", "anomalous")
    assert one["contract"] == other["contract"] == []
    cases = list(ElementTree.parse(junit).getroot().iter("testcase"))  # noqa: S314 -- ours
    assert len(cases) == 2


def test_a_root_is_read_by_its_feature_tables(normal, bags, tmp_path):
    for row in range(6):
        write_table(normal.iloc[[row]], tmp_path / f"features/run/patrol/run{row:03d}.parquet")
    read = read_reference([tmp_path], build_manager())
    assert read.table["run_id"].tolist() == normal["run_id"].tolist()[:6]


def test_runs_of_another_kind_of_system_are_left_out(normal, extracted):
    traffic = normal.assign(run_id="atc|" + normal["run_id"], **{"atc.tracks": 3.0})
    driving = [c for c in feature_columns(normal) if c.startswith("contextual.")]
    traffic[driving] = np.nan
    mixed = pd.concat([normal, traffic], ignore_index=True)
    mixed.attrs = normal.attrs
    alone, among = (judged(extracted["usual"], each) for each in (normal, mixed))
    assert among == alone
    card = Cards(Reference(mixed)).card_for(extracted["usual"].run)
    assert any("80 normal runs of the reference are left out" in note for note in card.notes)


def test_an_invalid_reference_is_an_error_of_one_line(bags, normal, extracted, tmp_path):
    write_table(extracted["usual"].windows, tmp_path / "windows.parquet")
    write_table(normal[["run_id", FIRST]], tmp_path / "keyless.parquet")
    (tmp_path / "text.parquet").write_text("no table")
    (tmp_path / "empty").mkdir()
    for name, text in (
        ("windows.parquet", "not a table with one row per run"),
        ("keyless.parquet", "not a table with one row per run"),
        ("text.parquet", "is not a Parquet table"),
        ("empty", "has no recording to compare with"),
        ("absent", "has no recording to compare with"),
    ):
        done = oracle_score(bags["usual"], "--reference", tmp_path / name, expect=2)
        assert text in done.stderr
        assert done.stderr.count("\n") == 1
        assert done.stdout == ""


def test_usage_errors_and_help():
    oracle_score("--reference", "x", expect=2)
    oracle_score("bag", expect=2)
    oracle_score("bag", "--reference", "x", "--far", 1.0, expect=2)
    assert "Example" in oracle_score("--help", expect=0).output


def test_many_notes_on_the_reference_do_not_hide_the_verdict() -> None:
    verdicts = [Verdict("bag", "error", error="broken")]
    notes = [f"note {i}" for i in range(20)]
    lines = as_text(verdicts, 0.05, notes).splitlines()
    assert lines[1:-1] == notes[: len(lines) - 2]
    assert len(lines) <= 10
    assert f"{len(notes) - len(lines) + 2} more notes" in lines[-1]
    assert json.loads(as_json(verdicts, 0.05, notes))["notes"] == notes  # as the last line says
    assert as_text(verdicts, 0.05, notes[:8]).splitlines()[1:] == notes[:8]


@pytest.mark.parametrize("others", [0, 1])
def test_many_notes_on_a_recording_do_not_hide_the_verdict(others) -> None:
    notes = tuple(f"note {i}" for i in range(200))
    verdicts = [Verdict("bag", "normal", p_value=0.5, suite_p_value=0.5, score=0.0, notes=notes)]
    verdicts += [Verdict("other", "normal", p_value=0.5, suite_p_value=0.5, score=0.0)] * others
    text = as_text(verdicts, 0.05, [])
    told = [line for line in text.splitlines() if line.strip().startswith("note ")]
    assert len(told) in (9, 10)
    assert f"and {200 - len(told)} more notes; --format json lists all." in text
