"""The sensor that judges recordings as they arrive in a folder.

A tick only compares names and sizes. The job that it requests is in ``assets.foreign_recordings``.
"""

import json
import time
from collections.abc import Collection, Iterable
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Self

import dagster as dg

from assets.foreign_recordings import ARRIVALS, FOREIGN_VERDICTS, judge_arrivals
from oracle_pipeline.bags.errors import OracleError
from resources.inbox import Inbox

if TYPE_CHECKING:
    from oracle_pipeline.bags.arrivals import Arrival

AT_ONCE = 100  # most runs that one tick requests; the others follow with the next ticks
QUIET_S = 600.0  # without a change, after which an unfinished recording counts as cut off


@dataclass(slots=True)
class _Cursor:
    """The state of recordings at earlier ticks, by key of the recording."""

    seen: dict[str, str] = field(default_factory=dict)  # fingerprint at the last tick
    requested: dict[str, str] = field(default_factory=dict)  # fingerprint when it was requested
    names: dict[str, str] = field(default_factory=dict)  # of those that were requested

    @classmethod
    def of(cls, text: str | None) -> Self:
        return cls(**json.loads(text or "{}"))


@dg.sensor(
    job=judge_arrivals,
    minimum_interval_seconds=30,
    default_status=dg.DefaultSensorStatus.STOPPED,
    description="When a recording in the folder of ORACLE_INBOX is finished: judge it by the "
    "reference card of ORACLE_CARD. Each recording is a partition and a Dagster run of its own.",
)
def arrived_recordings(context: dg.SensorEvaluationContext, inbox: Inbox) -> dg.SensorResult:
    """Request the recordings that are new or have changed, and report those that were removed."""
    from oracle_pipeline.bags.arrivals import arrivals

    previous = _Cursor.of(context.cursor)
    try:
        folder, _ = inbox.path, inbox.card_path
        now = arrivals(folder)
    except (OracleError, OSError) as error:
        return dg.SensorResult(skip_reason=str(error), cursor=context.cursor)
    present = {arrival.key: arrival for arrival in now.found}
    ready = [arrival for arrival in now.found if _is_ready(arrival, previous)][:AT_ONCE]
    removed = {key: name for key, name in previous.names.items() if key not in present}
    for fault in now.faults:
        context.log.warning(fault)
    for name in removed.values():
        context.log.warning(f"{name} was removed from the inbox; its verdict is kept.")
    requested = [key for key in previous.names if key in present] + [
        arrival.key for arrival in ready
    ]
    fresh = {arrival.key: arrival.fingerprint for arrival in ready}
    cursor = _Cursor(
        seen={key: arrival.fingerprint for key, arrival in present.items()},
        requested={key: fresh.get(key) or previous.requested[key] for key in requested},
        names={key: present[key].name for key in requested},
    )
    return dg.SensorResult(
        run_requests=[_request(arrival) for arrival in ready],
        skip_reason=None if ready else _nothing(now.found, previous, removed.values()),
        cursor=json.dumps(asdict(cursor)),
        dynamic_partitions_requests=[ARRIVALS.build_add_request(list(fresh))] if fresh else [],
        asset_events=[_removal(key, name) for key, name in removed.items()],
    )


def _is_ready(arrival: "Arrival", previous: _Cursor) -> bool:
    """Return whether a recording is finished, and was not requested in its present state."""
    unchanged = previous.seen.get(arrival.key) == arrival.fingerprint
    cut_off = time.time() - arrival.changed_s > QUIET_S
    is_new = previous.requested.get(arrival.key) != arrival.fingerprint
    return is_new and unchanged and (arrival.finished or cut_off)


def _request(arrival: "Arrival") -> dg.RunRequest:
    """Request one recording, once for each state of its files."""
    return dg.RunRequest(partition_key=arrival.key, run_key=f"{arrival.key} {arrival.fingerprint}")


def _removal(key: str, name: str) -> dg.AssetObservation:
    return dg.AssetObservation(
        FOREIGN_VERDICTS.key,
        partition=key,
        description=f"{name} was removed from the inbox; its verdict is kept.",
    )


def _nothing(found: Iterable["Arrival"], previous: _Cursor, removed: Collection[str]) -> str:
    """Return the reason why nothing is requested."""
    waiting = [
        arrival.name
        for arrival in found
        if previous.requested.get(arrival.key) != arrival.fingerprint
    ]
    reasons = [f"Removed: {', '.join(sorted(removed))}."] if removed else []
    if waiting:
        reasons.append(f"Still being written: {', '.join(waiting)}.")
    return " ".join(reasons) or "There are no new recordings."
