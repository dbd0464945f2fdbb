"""The sensor that judges recordings as they arrive in a folder.

A tick only looks at names and sizes. The job that it requests is in ``assets.foreign``.
"""

import json
import time
from collections.abc import Collection, Iterable
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Self

import dagster as dg

from assets.foreign import ARRIVALS, FOREIGN_VERDICTS, judge_arrivals
from oracle_pipeline.bags.errors import OracleError
from resources.inbox import Inbox

if TYPE_CHECKING:
    from oracle_pipeline.bags.arrivals import Arrival

AT_ONCE = 100  # runs that one tick requests; the others follow with the next ticks
QUIET_S = 600.0  # after which a recording without an end is one that was cut off


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

    former = _Cursor.of(context.cursor)
    try:
        folder, _ = inbox.path, inbox.card_path
        now = arrivals(folder)
    except (OracleError, OSError) as error:
        return dg.SensorResult(skip_reason=str(error), cursor=context.cursor)
    there = {arrival.key: arrival for arrival in now.found}
    ready = [arrival for arrival in now.found if _is_ready(arrival, former)][:AT_ONCE]
    removed = {key: name for key, name in former.names.items() if key not in there}
    for fault in now.faults:
        context.log.warning(fault)
    for name in removed.values():
        context.log.warning(f"{name} was removed from the inbox; its verdict is kept.")
    asked = [key for key in former.names if key in there] + [arrival.key for arrival in ready]
    fresh = {arrival.key: arrival.fingerprint for arrival in ready}
    cursor = _Cursor(
        seen={key: arrival.fingerprint for key, arrival in there.items()},
        requested={key: fresh.get(key) or former.requested[key] for key in asked},
        names={key: there[key].name for key in asked},
    )
    return dg.SensorResult(
        run_requests=[_request(arrival) for arrival in ready],
        skip_reason=None if ready else _nothing(now.found, former, removed.values()),
        cursor=json.dumps(asdict(cursor)),
        dynamic_partitions_requests=[ARRIVALS.build_add_request(list(fresh))] if fresh else [],
        asset_events=[_removal(key, name) for key, name in removed.items()],
    )


def _is_ready(arrival: "Arrival", former: _Cursor) -> bool:
    """Tell whether a recording is finished, and was not requested in its present state."""
    at_rest = former.seen.get(arrival.key) == arrival.fingerprint
    cut_off = time.time() - arrival.changed_s > QUIET_S
    is_new = former.requested.get(arrival.key) != arrival.fingerprint
    return is_new and at_rest and (arrival.finished or cut_off)


def _request(arrival: "Arrival") -> dg.RunRequest:
    """Request one recording, once for each state of its files."""
    return dg.RunRequest(partition_key=arrival.key, run_key=f"{arrival.key} {arrival.fingerprint}")


def _removal(key: str, name: str) -> dg.AssetObservation:
    return dg.AssetObservation(
        FOREIGN_VERDICTS.key,
        partition=key,
        description=f"{name} was removed from the inbox; its verdict is kept.",
    )


def _nothing(found: Iterable["Arrival"], former: _Cursor, removed: Collection[str]) -> str:
    """Return the reason why nothing is requested."""
    waiting = [
        arrival.name
        for arrival in found
        if former.requested.get(arrival.key) != arrival.fingerprint
    ]
    reasons = [f"Removed: {', '.join(sorted(removed))}."] if removed else []
    if waiting:
        reasons.append(f"Waiting until these are no longer being written: {', '.join(waiting)}.")
    return " ".join(reasons) or "No recording is new."
