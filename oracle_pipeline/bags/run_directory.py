"""The directory of one run, and its atomic publication.

``<root>/runs/<mode>/run003`` holds ``manifest.json``, ``bag/`` and ``graphs/``. A run is written in
a scratch directory beside its place (``.run003.<token>``), which its writer keeps locked, and
renamed into place (``scratch``). So an incomplete run is never at its place, even if a process
dies.
"""

import contextlib
import dataclasses
import fcntl
import json
import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from oracle_pipeline.bags.errors import ManifestError, RunDirectoryError
from oracle_pipeline.bags.layout import RUNS, TableName, feature_table, run_folder
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.protocol import run_key
from oracle_pipeline.bags.remote import is_local
from oracle_pipeline.bags.scratch import beside, lock, remove_left, scratch_beside, sync, sync_tree

MANIFEST_FILE = "manifest.json"
BAG_FOLDER = "bag"
GRAPHS_FOLDER = "graphs"
RECORDING_FILE = "recording.json"  # of what `oracle watch` recorded, in place of a manifest

_MODE = re.compile(r"[a-z0-9_]+")
_RUN = re.compile(r"run(\d{3,})")


def is_complete_recording(folder: Path) -> bool:
    """Return whether a folder holds a recording of ``oracle watch`` that has ended."""
    summary = recording_summary(folder)
    return summary is not None and bool(summary.get("complete", True))


def recording_summary(folder: Path) -> dict[str, Any] | None:
    """Return ``recording.json`` of a recording of ``oracle watch``; None if it cannot be read."""
    try:
        summary = json.loads((folder / RECORDING_FILE).read_bytes())
    except (OSError, ValueError):
        return None
    return summary if isinstance(summary, dict) else None


@dataclass(frozen=True, slots=True, order=True)
class RunDirectory:
    """The place of one run of one mode below a root.

    Raises
    ------
    RunDirectoryError
        If mode or run cannot be part of a path.
    """

    root: Path
    mode: str
    run: int

    def __post_init__(self) -> None:
        if not _MODE.fullmatch(self.mode):
            raise RunDirectoryError(
                f"Mode {self.mode!r} is not a name; use small letters, digits and underscores."
            )
        if self.run < 0:
            raise RunDirectoryError(
                f"Run {self.run} of mode {self.mode} is negative; count from 0."
            )

    @classmethod
    def of_key(cls, root: Path, key: str) -> Self:
        """Return the directory of a run, by its name below a root: ``fake_object|run003``."""
        mode, run_id = key.split("|")
        return cls(root, mode, int(run_id.removeprefix("run")))

    @classmethod
    def at(cls, path: Path) -> Self:
        """Return the run directory at a path, ``<root>/runs/<mode>/run003``."""
        place = path.resolve()
        match = _RUN.fullmatch(place.name)
        if match is None or len(place.parts) < 4 or place.parts[-3] != RUNS:
            raise RunDirectoryError(
                f"{path} is not the place of a run; name one such as data/runs/fake_object/run003."
            )
        return cls(place.parents[2], place.parent.name, int(match[1]))

    @property
    def run_id(self) -> str:
        """``run003``."""
        return f"run{self.run:03d}"

    @property
    def key(self) -> str:
        """``fake_object|run003``, the run's partition key."""
        return run_key(self.mode, self.run)

    @property
    def path(self) -> Path:
        """The run's own directory."""
        return run_folder(self.root, self.mode, self.run_id)

    @property
    def manifest_path(self) -> Path:
        """Its manifest, which is written last."""
        return self.path / MANIFEST_FILE

    @property
    def bag(self) -> Path:
        """Folder of its rosbag2."""
        return self.path / BAG_FOLDER

    @property
    def graphs(self) -> Path:
        """Folder of its graphs: one per 10 s interval, ``run.gexf`` and ``run.graphml``."""
        return self.path / GRAPHS_FOLDER

    def feature_table(self, table: TableName) -> Path:
        """Return the place of the features of the run, or of its windows."""
        return feature_table(self.root, table, self.mode, self.run_id)

    def is_complete(self) -> bool:
        """Return whether the run exists and is complete."""
        return self.manifest_path.is_file()

    def manifest(self) -> Manifest:
        """Read its manifest; raises ``ManifestError``."""
        return Manifest.load(self.manifest_path)

    def readable_manifest(self) -> Manifest | None:
        """Return its manifest; None if unreadable, which the run's verification reports."""
        try:
            return self.manifest()
        except ManifestError:
            return None

    def amend(self, **found: Any) -> None:
        """Change fields of the manifest of a complete run, atomically.

        Raises
        ------
        RunDirectoryError
            If the run does not exist, or the manifest cannot be written; the former one stays.
        """
        if not is_local(self.path):  # an object is always replaced atomically
            dataclasses.replace(self.manifest(), **found).save(self.manifest_path)
            return
        scratch = beside(self.manifest_path)
        try:
            with lock(self.path.parent):  # excludes other writers of this run
                dataclasses.replace(self.manifest(), **found).save(scratch)
                sync(scratch)
                scratch.replace(self.manifest_path)
                sync(self.path)
        except OSError as error:
            scratch.unlink(missing_ok=True)
            raise RunDirectoryError(
                f"Could not amend the manifest of {self.path}: {error}. Check free space and "
                "permissions, then record it again."
            ) from error

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Lock this run, so that other workers wait; leftovers of killed workers are removed.

        In an object store there is no lock. Two workers may then publish the same run, with equal
        messages.
        """
        if not is_local(self.path):
            yield
            return
        parent, name = self.path.parent, f".lock-{self.run_id}"
        try:
            parent.mkdir(parents=True, exist_ok=True)
            descriptor = _hold_file(parent / name)
        except OSError as error:
            raise self._unwritable(error) from error
        try:
            with lock(parent):
                self._tidy()
            yield
        finally:
            (parent / name).unlink(missing_ok=True)
            os.close(descriptor)

    @contextlib.contextmanager
    def staged(self) -> Iterator[Path]:
        """Yield a scratch directory that becomes the run when the block ends.

        It replaces an existing run. If the block raises, the scratch directory is removed and the
        place is left unchanged. Leftovers of killed writers of this run are removed first.

        Yields
        ------
        Path
            An empty directory; the block writes ``bag``, ``graphs`` and, last, the manifest there.

        Raises
        ------
        RunDirectoryError
            If the directory cannot be made, or the block wrote no manifest.
        """
        with contextlib.ExitStack() as locks:
            try:
                held = scratch_beside(self.path, Path.mkdir, self._salvage)
                scratch = locks.enter_context(held)
            except OSError as error:
                raise self._unwritable(error) from error
            yield scratch
            self._put_in_place(scratch)

    def replace_with(self, made: Self) -> None:
        """Replace this run with a complete one from elsewhere on this disk, atomically.

        Raises
        ------
        RunDirectoryError
            If it cannot be moved; both are left in place then.
        """
        self._put_in_place(made.path)

    def _tidy(self) -> None:
        """Remove leftovers of killed writers; the caller holds the parent."""
        remove_left(self.path, self._salvage)
        for leftover in self.path.glob(f".{MANIFEST_FILE}.*"):
            leftover.unlink(missing_ok=True)

    def _salvage(self, leftover: Path) -> None:
        """Restore a complete run whose writer died while moving it."""
        if not self.path.exists() and (leftover / MANIFEST_FILE).is_file():
            leftover.rename(self.path)

    def _put_in_place(self, scratch: Path) -> None:
        """Rename; a former run is moved aside first, so that it is complete or absent."""
        if not (scratch / MANIFEST_FILE).is_file():
            raise RunDirectoryError(f"{self.key} was written without its {MANIFEST_FILE}.")
        former = beside(self.path)
        try:
            sync_tree(scratch)
            with lock(self.path.parent):
                if self.path.exists():
                    self.path.rename(former)
                try:
                    scratch.rename(self.path)
                except BaseException:
                    if former.exists():
                        former.rename(self.path)
                    raise
                sync(self.path.parent)
        except OSError as error:
            raise RunDirectoryError(
                f"Could not put {self.key} into {self.path}: {error}. Check free space and "
                "permissions, then record it again."
            ) from error
        shutil.rmtree(former, ignore_errors=True)

    def _unwritable(self, error: OSError) -> RunDirectoryError:
        return RunDirectoryError(
            f"Could not make a directory for {self.key} below {self.root}: {error}. "
            "Choose a root that can be written to."
        )


def bytes_on_disk(path: Path) -> dict[str, int]:
    """Return the size of each part of a run directory, for the manifest."""
    return {
        part: sum(file.stat().st_size for file in (path / part).rglob("*") if file.is_file())
        for part in (BAG_FOLDER, GRAPHS_FOLDER)
    }


def find_runs(root: Path) -> list[RunDirectory]:
    """Return the complete runs below ``root``, sorted by mode and number."""
    return sorted(
        directory
        for path in root.glob(f"{RUNS}/*/run*")
        if _MODE.fullmatch(path.parent.name) and (match := _RUN.fullmatch(path.name))
        if (directory := RunDirectory(root, path.parent.name, int(match[1]))).is_complete()
    )


def _hold_file(path: Path) -> int:
    """Create and lock a file that its holder removes at the end; return its descriptor."""
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(descriptor), path.stat()):
                return descriptor
        os.close(descriptor)  # its former holder has removed this one
