"""What ten thousand earlier recordings add to the judgement of some new ones from the inbox.

The earlier ones are files and verdicts, made without simulating or judging any; the new ones are
copies of the demo's recording, and are judged by its card, through sensor and job.
"""

import json
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import cast

from tools.bench.figures import Row, median, spread

DEMO = Path(__file__).parents[2] / "examples" / "demo"
EARLIER = 10_000
NEW = 8  # recordings of a batch
ROUNDS = 3


def rows() -> Iterator[Row]:
    """Yield the figures."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        os.environ |= {"DAGSTER_HOME": folder, "ORACLE_HOME": str(place / "data"),
                       "ORACLE_INBOX": str(place / "inbox"),
                       "ORACLE_CARD": str(DEMO / "normal.card")}  # fmt: skip
        (place / "inbox").mkdir()
        _batch(place, "warm")  # what a process loads once
        few = [_batch(place, f"few{n}") for n in range(ROUNDS)]
        _fill(place)
        many = [_batch(place, f"many{n}") for n in range(ROUNDS)]
        judged = [b[0] / a[0] for a, b in zip(few, many, strict=True)]
        yield Row(f"a batch of {NEW} after {EARLIER} recordings against the first ones",
                  median(judged), "times as long", 1.2, True, spread(judged))  # fmt: skip
        ticks = [1000.0 * tick_s for _, tick_s, _ in many]
        yield Row("a tick of the sensor then", median(ticks), "ms", None, True, spread(ticks))
        yield Row("its cursor then", max(size for *_, size in many), "characters")
        page = place / "data" / "report" / "foreign.html"
        yield Row("the page then", page.stat().st_size / 1e6, "MB")


def _fill(place: Path) -> None:
    """Put files into the inbox, and a verdict on each below the root."""
    from oracle_pipeline.bags import layout
    from oracle_pipeline.bags.arrivals import arrivals
    from oracle_pipeline.bags.mcap import MAGIC
    from oracle_pipeline.scoring.kept_verdicts import KeptVerdict, add_verdicts
    from oracle_pipeline.scoring.verdict import Verdict

    for number in range(EARLIER):
        (place / "inbox" / f"a{number:05}.mcap").write_bytes(MAGIC + MAGIC)
    verdicts = [
        KeptVerdict(
            each.key, each.fingerprint, Verdict(each.name, "normal", score=0.1 * (number % 7)),
            0.1, "", f"2026-01-01T00:00:{number % 60:02}+00:00", "earlier",
        )
        for number, each in enumerate(arrivals(place / "inbox").found) if each.key[0] == "a"
    ]  # fmt: skip
    for kept in verdicts:
        kept.save(layout.foreign(place / "data", kept.key) / layout.VERDICT)
    add_verdicts(place / "data", verdicts)


def _batch(place: Path, name: str) -> tuple[float, float, int]:
    """Judge new recordings; return the time of the job and of a tick [s], and the cursor's size."""
    import dagster as dg

    from assets.arrival_sensor import arrived_recordings
    from oracle_pipeline.definitions import defs
    from resources.inbox import Inbox
    from resources.store import RunStore

    for number in range(NEW):
        shutil.copytree(DEMO / "short", place / "inbox" / f"{name}-{number}")
    resources = {"inbox": Inbox.from_environment(), "store": RunStore(root=str(place / "data"))}
    with dg.DagsterInstance.get() as instance:
        cursor = ""
        for _ in range(2):  # the first sees them, the second requests them
            with dg.build_sensor_context(instance, cursor, resources=resources) as context:
                started = time.perf_counter()
                seen = cast(dg.SensorResult, arrived_recordings(context))
                tick_s = time.perf_counter() - started
            cursor = seen.cursor or ""
        (request,) = seen.run_requests or []
        instance.add_dynamic_partitions("arrivals", [str(request.partition_key)])
        started = time.perf_counter()
        defs.resolve_job_def("judge_arrivals").execute_in_process(
            run_config=request.run_config, partition_key=request.partition_key, instance=instance
        )
        job_s = time.perf_counter() - started
    assert len(json.loads(cursor)["batch"]) == NEW  # noqa: S101
    return job_s, tick_s, len(cursor)
