"""The sensor that judges recordings as they arrive in a folder.

A tick only compares names and sizes. The job that it requests is in ``assets.foreign_recordings``.
While a batch of recordings is judged, the next one gathers: so batches are as large as the
recordings come fast.
"""

import json
import time
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Self

import dagster as dg

from assets.foreign_recordings import ARRIVALS, judge_arrivals
from oracle_pipeline.bags.errors import OracleError
from resources.inbox import Inbox
from resources.store import RunStore

if TYPE_CHECKING:
    from oracle_pipeline.bags.arrivals import Arrival

BATCH = 250  # most recordings of a Dagster run
WAITING = 1000  # most recordings that a tick remembers; others follow once these are judged
QUIET_S = 600.0  # without a change, after which an unfinished recording counts as cut off
AGAIN_S = 3600.0  # after which a batch that has left no verdicts is requested again
_ENDED = {dg.DagsterRunStatus.SUCCESS, dg.DagsterRunStatus.FAILURE, dg.DagsterRunStatus.CANCELED}


@dataclass(slots=True)
class _Cursor:
    """What a tick knows of recordings without a verdict, by key: a bounded number."""

    seen: dict[str, str] = field(default_factory=dict)  # fingerprint at the last tick
    batch: dict[str, str] = field(default_factory=dict)  # of those that were requested last
    requested_s: float = 0.0  # when that was [s since 1970]

    @classmethod
    def of(cls, text: str | None) -> Self:
        known = json.loads(text or "{}")
        return cls(**known) if known.keys() <= set(cls.__slots__) else cls()  # of a former release


@dg.sensor(
    job=judge_arrivals,
    minimum_interval_seconds=30,
    default_status=dg.DefaultSensorStatus.STOPPED,
    description="When recordings in the folder of ORACLE_INBOX are finished: judge them by the "
    "reference card of ORACLE_CARD, as one partition and one Dagster run.",
)
def arrived_recordings(
    context: dg.SensorEvaluationContext, inbox: Inbox, store: RunStore
) -> dg.SensorResult:
    """Request the recordings that are new or have changed, once no batch is in progress."""
    from oracle_pipeline.bags.arrivals import arrivals
    from oracle_pipeline.scoring.kept_verdicts import verdict_rows

    previous = _Cursor.of(context.cursor)
    try:
        folder, _ = inbox.path, inbox.card_path
        now, rows = arrivals(folder), verdict_rows(store.path)
    except (OracleError, OSError) as error:
        return dg.SensorResult(skip_reason=str(error), cursor=context.cursor)
    for fault in now.faults:
        context.log.warning(fault)
    judged = dict(zip(rows["key"], rows["fingerprint"], strict=True))
    waiting = [each for each in now.found if judged.get(each.key) != each.fingerprint][:WAITING]
    in_progress = _in_progress(context.instance)
    ready = [] if in_progress else [each for each in waiting if _is_ready(each, previous)][:BATCH]
    removed = len(judged.keys() - {arrival.key for arrival in now.found})
    cursor = _Cursor(
        {arrival.key: arrival.fingerprint for arrival in waiting},
        previous.batch,
        previous.requested_s,
    )
    if not ready:
        reason = _nothing([each.name for each in waiting], removed, in_progress=in_progress)
        return dg.SensorResult(skip_reason=reason, cursor=json.dumps(asdict(cursor)))
    cursor.batch = {arrival.key: arrival.fingerprint for arrival in ready}
    cursor.requested_s = time.time()
    batch = f"{datetime.now(UTC):%Y-%m-%dT%H-%M-%S}"
    config = {"ops": {"judge_recordings": {"config": {"recordings": list(cursor.batch)}}}}
    return dg.SensorResult(
        run_requests=[dg.RunRequest(batch, config, partition_key=batch)],
        cursor=json.dumps(asdict(cursor)),
        dynamic_partitions_requests=[ARRIVALS.build_add_request([batch])],
    )


def _is_ready(arrival: "Arrival", previous: _Cursor) -> bool:
    """Return whether a recording is finished, and was not requested in its present state."""
    unchanged = previous.seen.get(arrival.key) == arrival.fingerprint
    cut_off = time.time() - arrival.changed_s > QUIET_S
    is_new = previous.batch.get(arrival.key) != arrival.fingerprint
    may_be = is_new or time.time() - previous.requested_s > AGAIN_S
    return unchanged and may_be and (cut_off or arrival.is_finished())


def _in_progress(instance: dg.DagsterInstance) -> bool:
    """Return whether a batch is being judged, or will be."""
    unfinished = [status for status in dg.DagsterRunStatus if status not in _ENDED]
    of_job = dg.RunsFilter(job_name=judge_arrivals.name, statuses=unfinished)
    return bool(instance.get_run_ids(of_job, limit=1))


def _nothing(waiting: list[str], removed: int, *, in_progress: bool) -> str:
    """Return the reason why nothing is requested."""
    reasons = []
    if in_progress:
        reasons.append(f"A batch is being judged; {len(waiting)} recordings wait for the next one.")
    elif waiting:
        names = ", ".join(waiting[:10]) + (", ..." if len(waiting) > 10 else "")
        reasons.append(f"Still being written, or requested before: {names}.")
    if removed:
        reasons.append(f"{removed} of those judged were removed; their verdicts are kept.")
    return " ".join(reasons) or "There are no new recordings."
