"""A verdict on a recording that arrived is read as it was stored."""

import json

import pytest

from oracle_pipeline.bags import layout
from oracle_pipeline.detectors import FamilyDeviation
from oracle_pipeline.scoring.alarms import Alarm
from oracle_pipeline.scoring.kept_verdicts import (
    KeptVerdict,
    KeptVerdictError,
    add_verdicts,
    verdict_rows,
)
from oracle_pipeline.scoring.verdict import AspectScore, Evidence, Verdict, WindowSeries

WHOLE = Verdict(
    "a recording", "anomalous", ("Topic /scan is gone.",), 0.01, 0.02, 7.5,
    {"behaviour": AspectScore(0.1, 0.2, 3.0)}, (Alarm(15.0, 4.0, 3.0),), 0.5, 12, 20, 19,
    (Evidence("scan.noise", 9.0, True, 1.5, "m", 0.0, 1.0, "/scan", 5.0),),
    (FamilyDeviation("scan", 3, 12, "scan.noise", 9.0, True),), ("a note",),
    series=(WindowSeries("scan.noise", "m", (0.0, 2.5), (1.5, None), 0.0, 1.0),),
)  # fmt: skip


def kept(key: str, verdict: Verdict, judged_at: str = "2026-11-22T10:00:00+00:00") -> KeptVerdict:
    return KeptVerdict(key, "0123", verdict, 0.05, "robot.card", judged_at)


@pytest.mark.parametrize("verdict", [WHOLE, Verdict("b", "error", error="cut off")], ids=str)
def test_a_verdict_is_read_as_it_was_kept(tmp_path, verdict):
    written = kept("a", verdict)
    written.save(tmp_path / "verdict.json")
    assert KeptVerdict.load(tmp_path / "verdict.json") == written


def test_the_table_of_a_root_has_the_last_verdict_on_each_recording(tmp_path):
    add_verdicts(tmp_path, [kept("a", WHOLE), kept("b", Verdict("b", "normal"))])
    add_verdicts(tmp_path, [kept("a", Verdict("a", "error", error="cut off"))])
    rows = verdict_rows(tmp_path)
    assert rows["key"].tolist() == ["b", "a"]
    assert rows["outcome"].tolist() == ["normal", "error"]
    assert rows["score"].isna().all()
    assert rows["sentence"].iloc[-1] == "cut off"


@pytest.mark.parametrize("damaged", [False, True])
def test_a_table_that_is_missing_or_damaged_is_made_again_from_the_files(tmp_path, damaged):
    for number, key in enumerate("abc"):
        kept(key, WHOLE, f"2026-11-2{number}T10:00:00+00:00").save(
            layout.foreign(tmp_path, key) / layout.VERDICT
        )
    (layout.foreign(tmp_path, "b") / layout.VERDICT).write_text("{}")
    if damaged:
        layout.foreign_rows(tmp_path).parent.mkdir()
        layout.foreign_rows(tmp_path).write_bytes(b"PAR1")
    assert verdict_rows(tmp_path)["key"].tolist() == ["b", "a", "c"]
    assert verdict_rows(tmp_path)["outcome"].iloc[0] == "error"
    assert not len(verdict_rows(tmp_path / "none"))


@pytest.mark.parametrize("text", ["", "{}", "[]", json.dumps({"version": 99})])
def test_another_file_is_refused_with_its_name(tmp_path, text):
    path = tmp_path / "verdict.json"
    path.write_text(text)
    with pytest.raises(KeptVerdictError, match="judge the recording again"):
        KeptVerdict.load(path)
