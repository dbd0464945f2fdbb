"""Registers the processes that execute Dagster runs, and finds runs whose process has died.

A killed process cannot report its end: Dagster would show its run as started indefinitely, and the
queue would count it. So each process locks a file (``flock``) while it executes a run. The kernel
releases the lock when the process ends for any reason, so neither a reused process id nor a changed
clock matters. The files are below the local folder of the Dagster instance. Runs of other machines
have no file here, and are ignored.
"""

import fcntl
import os
import socket
from datetime import UTC, datetime
from pathlib import Path

import dagster as dg

from oracle_pipeline.bags.scratch import lock

# Open files by run, closed when this process ends or starts another run.
_held: dict[str, int] = {}


def hold(instance: dg.DagsterInstance, run_id: str) -> None:
    """Register this process as the executor of a run, until the process ends."""
    for ended in [held for held in _held if _has_ended(instance, held)]:
        os.close(_held.pop(ended))
    folder = _folder(instance)
    folder.mkdir(parents=True, exist_ok=True)
    since = datetime.now(UTC).isoformat(timespec="seconds")
    with lock(folder):  # no process may check the file before it is locked
        descriptor = os.open(folder / run_id, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o600)
        fcntl.flock(descriptor, fcntl.LOCK_EX)
    os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}, since {since}".encode())
    _held[run_id] = descriptor


def fail_lost_runs(instance: dg.DagsterInstance) -> list[str]:
    """Mark runs whose process is gone as failed, with the reason; return their ids."""
    folder = _folder(instance)
    if not folder.is_dir():
        return []
    lost = []
    with lock(folder):  # two commands may check at the same time
        for run_id in sorted(file.name for file in folder.iterdir()):
            run, reason = instance.get_run_by_id(run_id), reason_of_loss(instance, run_id)
            if reason and run is not None and run.status == dg.DagsterRunStatus.STARTED:
                instance.report_run_failed(run, reason)
                lost.append(run_id)
            if reason and _has_ended(instance, run_id):
                (folder / run_id).unlink()
    return lost


def reason_of_loss(instance: dg.DagsterInstance, run_id: str) -> str | None:
    """Return why the process of a run is gone; None if it is alive, or on another machine."""
    file = _folder(instance) / run_id
    try:
        with lock(file, wait=False):
            process = file.read_text(encoding="utf-8")
    except (BlockingIOError, FileNotFoundError):
        return None
    return (
        f"The process of this run is gone ({process}): it was killed, ran out of memory, or the "
        "machine was restarted. Finished work is kept; start the same run again to complete it."
    )


def _has_ended(instance: dg.DagsterInstance, run_id: str) -> bool:
    run = instance.get_run_by_id(run_id)
    return run is None or run.is_finished


def _folder(instance: dg.DagsterInstance) -> Path:
    return Path(instance.root_directory) / "run_processes"
