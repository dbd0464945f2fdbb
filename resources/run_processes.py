"""Keeps account of the processes that execute Dagster runs, and finds runs whose process died.

A killed process cannot report its end: Dagster would show its run as started indefinitely, and the
queue would count it. So each process locks a file of its own (``flock``) while it executes a run.
The kernel releases the lock when the process ends, however it ends. Therefore neither a reused
process number nor a changed clock matters. The files are below the folder of the Dagster instance
on this machine. Runs of other machines have no file here, and are left alone.
"""

import fcntl
import os
import socket
from datetime import UTC, datetime
from pathlib import Path

import dagster as dg

from oracle_pipeline.bags.scratch import lock

# Held until this process ends, or its run has ended and another one starts in it.
_held: dict[str, int] = {}


def hold(instance: dg.DagsterInstance, run_id: str) -> None:
    """Record that this process executes a run, until the process ends."""
    for former in [known for known in _held if _has_ended(instance, known)]:
        os.close(_held.pop(former))
    folder = _folder(instance)
    folder.mkdir(parents=True, exist_ok=True)
    since = datetime.now(UTC).isoformat(timespec="seconds")
    with lock(folder):  # nobody may look at the file before it is held
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
    with lock(folder):  # two commands may look at a time
        for run_id in sorted(file.name for file in folder.iterdir()):
            run, reason = instance.get_run_by_id(run_id), reason_of_loss(instance, run_id)
            if reason and run is not None and run.status == dg.DagsterRunStatus.STARTED:
                instance.report_run_failed(run, reason)
                lost.append(run_id)
            if reason and _has_ended(instance, run_id):
                (folder / run_id).unlink()
    return lost


def reason_of_loss(instance: dg.DagsterInstance, run_id: str) -> str | None:
    """Return why the process of a run is gone; None if it lives, or is not of this machine."""
    file = _folder(instance) / run_id
    try:
        with lock(file, wait=False):
            process = file.read_text(encoding="utf-8")
    except (BlockingIOError, FileNotFoundError):
        return None
    return (
        f"The process of this run is gone ({process}): it was killed, memory was short, or the "
        "machine was restarted. What is finished is kept; ask for the same again to complete it."
    )


def _has_ended(instance: dg.DagsterInstance, run_id: str) -> bool:
    run = instance.get_run_by_id(run_id)
    return run is None or run.is_finished


def _folder(instance: dg.DagsterInstance) -> Path:
    return Path(instance.root_directory) / "run_processes"
