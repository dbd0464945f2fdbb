"""Atomic writes: write to a locked path beside the place, then rename it.

The lock is the kernel's (``flock``) and ends with its process. A scratch path without a lock was
left by a killed process, and the next writer removes it.
"""

import contextlib
import fcntl
import os
import secrets
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path


@contextlib.contextmanager
def scratch_beside(
    place: Path, make: Callable[[Path], object], salvage: Callable[[Path], object] = lambda _: None
) -> Iterator[Path]:
    """Make a scratch path beside a place and hold it; it is removed after the block unless renamed.

    Scratch of killed writers is removed first.

    Parameters
    ----------
    place
        The path to rename it to; its folder is made.
    make
        Makes the scratch: ``Path.mkdir`` or ``Path.touch``.
    salvage
        Called with the scratch of a killed writer before it is removed.
    """
    place.parent.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as held:
        with lock(place.parent):
            remove_left(place, salvage)
            scratch = beside(place)
            make(scratch)
            held.enter_context(lock(scratch))
        try:
            yield scratch
        finally:
            remove(scratch)


@contextlib.contextmanager
def replaced_folder(place: Path) -> Iterator[Path]:
    """Yield an empty folder that atomically replaces another when the block ends."""
    with scratch_beside(place, Path.mkdir) as scratch:
        new, old = scratch / "new", scratch / "old"
        new.mkdir()
        yield new
        with lock(place.parent):  # excludes other writers of the same folder
            if place.exists():
                place.rename(old)
            new.rename(place)


def beside(place: Path) -> Path:
    """Return a unique hidden path beside a place."""
    return place.with_name(f".{place.name}.{secrets.token_hex(4)}")


def remove_left(place: Path, salvage: Callable[[Path], object] = lambda _: None) -> None:
    """Remove the scratch of killed writers beside a place; the caller holds its folder."""
    for leftover in place.parent.glob(f".{place.name}.*"):
        # It may be held, or have been renamed just now.
        held_or_gone = contextlib.suppress(BlockingIOError, FileNotFoundError)
        with held_or_gone, lock(leftover, wait=False):
            salvage(leftover)
            remove(leftover)


def remove(path: Path) -> None:
    """Remove a file or a folder, if it exists."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


@contextlib.contextmanager
def lock(path: Path, *, wait: bool = True) -> Iterator[None]:
    """Lock a file or folder; raises ``BlockingIOError`` if it is locked and ``wait`` is false."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(descriptor)


def sync(path: Path) -> None:
    """Flush a file or folder to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_tree(directory: Path) -> None:
    """Flush a folder and everything in it to the disk."""
    for folder, _, names in os.walk(directory):
        for name in names:
            sync(Path(folder, name))
        sync(Path(folder))
