"""A run for an object store is written to the local disk and then published: manifest last."""

import contextlib
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from oracle_pipeline.bags import layout
from oracle_pipeline.bags.remote import is_local, publish
from oracle_pipeline.bags.run_directory import MANIFEST_FILE, RunDirectory
from sim.pairs import judge_pair


@contextlib.contextmanager
def on_this_machine(run: RunDirectory) -> Iterator[RunDirectory]:
    """Yield a run directory on the local disk: the one given, or a temporary one."""
    if is_local(run.root):
        yield run
        return
    with tempfile.TemporaryDirectory(prefix="oracle-") as root:
        yield replace(run, root=Path(root))


@contextlib.contextmanager
def local_directory(run: RunDirectory) -> Iterator[RunDirectory]:
    """Yield a local directory for a run: its own, or a temporary one that is then published."""
    with on_this_machine(run) as local:
        try:
            yield local
        finally:  # a complete run is kept even if its features failed
            if local != run and local.is_complete():
                publish_run(local, run)


def publish_run(local: RunDirectory, run: RunDirectory) -> None:
    """Publish a run from a local directory, and compare it with its pair."""
    for file in (local.root / layout.FEATURES).rglob("*"):
        if file.is_file():
            (run.root / file.relative_to(local.root).as_posix()).write_bytes(file.read_bytes())
    publish(local.path, run.path, MANIFEST_FILE)
    judge_pair(run)
