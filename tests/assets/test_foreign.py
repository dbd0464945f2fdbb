"""Recordings that arrive in a folder are judged once each, in batches, by a real instance."""

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dagster as dg
import pytest

from assets import arrival_sensor
from assets.arrival_sensor import QUIET_S
from assets.foreign_recordings import ARRIVALS, IS_NORMAL
from oracle_pipeline.bags.arrivals import key_of
from oracle_pipeline.bags.mcap import MAGIC
from oracle_pipeline.datasets import read_table
from oracle_pipeline.features import build_manager
from oracle_pipeline.scoring.learning import learn
from oracle_pipeline.scoring.reference import read_reference
from resources.inbox import Inbox
from tests.assets.laboratory import Laboratory, dagster_home
from tests.oracle_pipeline.features.conftest import drive, write_bag
from tests.oracle_pipeline.scoring.test_score_command import spinning

pytestmark = pytest.mark.slow
FAR = 0.3  # four normal recordings, or three others, support no lower rate


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A card of four good bags, and three recordings to judge."""
    root = tmp_path_factory.mktemp("recordings")
    for nth, name in enumerate("abcd"):
        write_bag(root / "good" / name, drive(nth))
    write_bag(root / "usual", drive(2))
    write_bag(root / "spinning", spinning())
    (root / "broken.mcap").write_bytes(MAGIC + b"\0" * 64 + MAGIC)
    learn(read_reference([root / "good"], build_manager())).save(root / "robot.card")
    return root


class Watched:
    """An inbox beside an instance: ticks of the sensor, and the runs that it requested."""

    def __init__(self, laboratory: Laboratory, inbox: Path, card: Path) -> None:
        self.laboratory = laboratory
        self.folder = inbox
        self.configure(Inbox(folder=str(inbox), card=str(card)))
        self.cursor: str | None = None

    def configure(self, inbox: Inbox) -> None:
        self.defs = self.laboratory.defs(inbox=inbox)

    def tick(self) -> Any:
        """Evaluate the sensor as the code server does, and add partitions as the daemon does."""
        sensor = self.defs.resolve_sensor_def("arrived_recordings")
        repository = self.defs.get_repository_def()
        with dg.SensorEvaluationContext(
            instance_ref=self.laboratory.instance.get_ref(),
            cursor=self.cursor,
            repository_def=repository,
            sensor_name=sensor.name,
            resources=dict(self.defs.get_repository_def().get_top_level_resources()),
        ) as context:
            seen = sensor.evaluate_tick(context)
        self.cursor = seen.cursor
        for request in seen.dynamic_partitions_requests or []:
            self.laboratory.instance.add_dynamic_partitions(
                request.partitions_def_name, list(request.partition_keys)
            )
        return seen

    def arrive(self, source: Path, name: str) -> str:
        """Copy a recording into the inbox; return its key."""
        target = self.folder / name
        if source.is_dir():
            shutil.copytree(source, target)
        else:
            shutil.copy(source, target)
        return key_of(name)

    def judge(self, *keys: str, batch: str = "now", far: float = FAR) -> dg.ExecuteInProcessResult:
        """Judge recordings as a batch, as the sensor requests it; none: those it had before."""
        self.laboratory.instance.add_dynamic_partitions(str(ARRIVALS.name), [batch])
        config = {"far": far, "recordings": list(keys)}
        return self.defs.resolve_job_def("judge_arrivals").execute_in_process(
            partition_key=batch,
            instance=self.laboratory.instance,
            run_config={"ops": {"judge_recordings": {"config": config}}},
            raise_on_error=False,
        )

    def check(self, batch: str = "now") -> Any:
        """Return the stored result of the check for one partition."""
        storage = self.laboratory.instance.event_log_storage
        history = storage.get_asset_check_execution_history(IS_NORMAL.key, limit=20)
        evaluations = [
            record.event.dagster_event.asset_check_evaluation_data
            for record in history
            if record.event and record.event.dagster_event
        ]
        return next(each for each in evaluations if each.partition == batch)

    def page(self) -> str:
        return (self.laboratory.root / "report" / "foreign.html").read_text(encoding="utf-8")


@pytest.fixture
def watched(tmp_path: Path, place: Path) -> Iterator[Watched]:
    (tmp_path / "inbox").mkdir()
    with dagster_home(tmp_path / "home") as instance:
        laboratory = Laboratory(tmp_path / "data", instance)
        yield Watched(laboratory, tmp_path / "inbox", place / "robot.card")


def keys(seen: Any) -> list[str]:
    """Return the recordings that a tick requests; all are in one batch."""
    requests = seen.run_requests or []
    assert len(requests) <= 1
    return [
        key
        for request in requests
        for key in request.run_config["ops"]["judge_recordings"]["config"]["recordings"]
    ]


def test_a_recording_is_requested_once_it_is_stable_and_once_for_each_change(
    watched: Watched, place: Path
) -> None:
    key = watched.arrive(place / "usual", "one")
    first = watched.tick()
    assert not keys(first)
    assert "one" in first.skip_message
    second = watched.tick()
    assert keys(second) == [key]
    (batch,) = watched.laboratory.instance.get_dynamic_partitions(str(ARRIVALS.name))
    assert second.run_requests[0].partition_key == batch
    assert not keys(watched.tick())
    assert watched.judge(key, batch=batch).success
    (mcap,) = (watched.folder / "one").glob("*.mcap")
    os.utime(mcap, (1.0, 1.0))
    assert not keys(watched.tick())
    again = watched.tick()
    assert keys(again) == [key]


def test_while_a_batch_is_judged_the_next_one_gathers(
    watched: Watched, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(arrival_sensor, "BATCH", 3)
    first = watched.arrive(place / "usual", "first")
    watched.tick()
    assert keys(watched.tick()) == [first]
    job = watched.defs.resolve_job_def("judge_arrivals")
    instance = watched.laboratory.instance
    run = instance.create_run_for_job(job, status=dg.DagsterRunStatus.STARTED)
    others = [watched.arrive(place / "usual", f"other{n}") for n in range(4)]
    watched.tick()
    waits = watched.tick()
    assert not keys(waits)
    assert "A batch is being judged; 5 recordings wait" in waits.skip_message
    instance.report_run_failed(run)
    assert keys(watched.tick()) == others[:3]
    assert keys(watched.tick()) == [first, others[3]]  # the first batch has left no verdict


def test_what_a_tick_remembers_is_bounded(
    watched: Watched, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(arrival_sensor, "WAITING", 2)
    arrived = [watched.arrive(place / "broken.mcap", f"{n}.mcap") for n in range(5)]
    judged = []
    for batch in ("a", "b", "c"):
        watched.tick()
        some = keys(watched.tick())
        assert watched.judge(*some, batch=batch).success
        judged += some
    assert judged == arrived
    watched.tick()
    assert not json.loads(watched.cursor or "")["seen"]


def test_the_cursor_of_an_older_release_is_no_error(watched: Watched, place: Path) -> None:
    key = watched.arrive(place / "usual", "one")
    watched.cursor = json.dumps({"seen": {key: "0"}, "requested": {}, "names": {}})
    watched.tick()
    assert keys(watched.tick()) == [key]


def test_a_recording_that_grows_is_not_requested(watched: Watched, place: Path) -> None:
    key = watched.arrive(place / "usual", "growing")
    metadata = watched.folder / "growing" / "metadata.yaml"
    (mcap,) = (watched.folder / "growing").glob("*.mcap")
    end, whole = metadata.read_bytes(), mcap.read_bytes()
    metadata.unlink()
    for share in (0.2, 0.5, 0.9):
        mcap.write_bytes(whole[: int(len(whole) * share)])
        assert not keys(watched.tick())
    assert not keys(watched.tick())  # at rest, but it has no end
    mcap.write_bytes(whole)
    metadata.write_bytes(end)
    assert not keys(watched.tick())
    assert keys(watched.tick()) == [key]


def test_a_recording_that_was_cut_off_is_requested_after_a_while(
    watched: Watched, place: Path
) -> None:
    key = watched.arrive(place / "usual", "cut")
    (watched.folder / "cut" / "metadata.yaml").unlink()
    (mcap,) = (watched.folder / "cut").glob("*.mcap")
    mcap.write_bytes(mcap.read_bytes()[:-100])
    watched.tick()
    assert not keys(watched.tick())
    before = mcap.stat().st_mtime - QUIET_S - 1.0
    os.utime(mcap, (before, before))
    watched.tick()
    assert keys(watched.tick()) == [key]


def test_a_removed_recording_is_reported_and_its_verdict_kept(
    watched: Watched, place: Path
) -> None:
    key = watched.arrive(place / "usual", "gone")
    watched.tick()
    watched.tick()
    assert watched.judge(key).success
    shutil.rmtree(watched.folder / "gone")
    seen = watched.tick()
    assert "1 of those judged were removed; their verdicts are kept." in seen.skip_message
    assert "gone" in watched.page()


@pytest.mark.parametrize("lacking", ["folder", "card"])
def test_without_inbox_or_card_a_tick_states_the_remedy(
    watched: Watched, tmp_path: Path, lacking: str
) -> None:
    settings = {"folder": str(watched.folder), "card": __file__}
    for wrong in ("", str(tmp_path / "nowhere")):
        watched.configure(Inbox(**{**settings, lacking: wrong}))
        seen = watched.tick()
        assert not keys(seen)
        assert (f"set ORACLE_{'INBOX' if lacking == 'folder' else 'CARD'}" if not wrong
                else "nowhere") in seen.skip_message  # fmt: skip


def test_each_recording_gets_its_verdict_and_a_bad_one_does_not_block_others(
    watched: Watched, place: Path
) -> None:
    odd = os.fsdecode(b"spinning \xff|...\x1b[2J")
    found = {
        "broken": watched.arrive(place / "broken.mcap", "broken.mcap"),
        "odd": watched.arrive(place / "spinning", odd),
        "usual": watched.arrive(place / "usual", "usual"),
    }
    watched.tick()
    assert sorted(keys(watched.tick())) == sorted(found.values())
    assert watched.judge(*found.values()).success
    check = watched.check()
    assert not check.passed
    assert check.severity == dg.AssetCheckSeverity.ERROR
    of_broken, of_odd = check.description.split("ANOMALOUS")
    assert of_broken.startswith("COULD NOT JUDGE  broken.mcap")
    assert check.description.count("COULD NOT JUDGE") == 1
    assert r"spinning \udcff|...\x1b[2J" in of_odd
    assert "usual (5-95 %)" in of_odd
    assert check.metadata["not_normal"].value == 2
    assert watched.laboratory.materialized("foreign_features") == {"now"}
    assert watched.laboratory.figures("foreign_features", "now")["dagster/row_count"] == 2
    figures = watched.laboratory.figures("foreign_verdicts", "now")
    assert {name: figures[name] for name in ("anomalous", "error", "normal")} == {
        "anomalous": 1, "error": 1, "normal": 1
    }  # fmt: skip
    assert figures["verdicts"].records[0].data["outcome"] == "anomalous"
    rows = read_table(watched.laboratory.root / "report" / "foreign.parquet")
    assert set(rows["key"]) == set(found.values())
    folder = watched.laboratory.root / "foreign" / found["odd"]
    assert len(read_table(folder / "run.parquet")) == 1
    assert len(read_table(folder / "window.parquet")) > 1
    assert json.loads((folder / "verdict.json").read_text())["verdict"]["outcome"] == "anomalous"
    page = watched.page()
    assert "3 recordings: 1 anomalous, 1 could not be judged, 1 normal." in page
    assert "\x1b" not in page
    assert "contextual." in page
    shown = watched.laboratory.figures("foreign_report")
    assert shown["recordings"] == 3
    assert shown["picture"].startswith("![](data:image/png;base64,")  # two of them have a score


def test_too_few_normal_recordings_are_a_warning(watched: Watched, place: Path) -> None:
    key = watched.arrive(place / "usual", "usual")
    assert watched.judge(key, far=0.05).success
    check = watched.check()
    assert not check.passed
    assert check.severity is dg.AssetCheckSeverity.WARN
    assert "19 are needed" in check.description
    again = watched.judge()  # those that the batch had
    assert again.success
    assert watched.check().passed


def test_a_recording_removed_before_its_run_is_an_error(watched: Watched) -> None:
    failed = watched.judge("gone")
    assert not failed.success
    data = failed.failure_data_for_node("judge_recordings")
    assert data is not None
    assert data.user_failure_data is not None
    assert "were removed or renamed" in str(data.user_failure_data.description)


def test_the_check_can_run_again_without_judging(watched: Watched, place: Path) -> None:
    key = watched.arrive(place / "spinning", "spinning")
    assert watched.judge(key).success
    shutil.rmtree(watched.folder / "spinning")
    job = dg.define_asset_job("again", selection=dg.AssetSelection.checks(IS_NORMAL.key))
    defs = dg.Definitions.merge(watched.defs, dg.Definitions(jobs=[job]))
    shown = defs.resolve_job_def("again").execute_in_process(instance=watched.laboratory.instance)
    (evaluation,) = shown.get_asset_check_evaluations()
    assert not evaluation.passed
    assert evaluation.partition == "now"
