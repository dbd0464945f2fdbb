"""Finds recordings that arrive in a folder, and whether they are still being written.

Only names, sizes and the last bytes of MCAP files are read, no messages.
"""

import hashlib
import itertools
import os
import re
import stat
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from oracle_pipeline.bags.mcap import MAGIC
from oracle_pipeline.bags.parts import METADATA, is_recording
from oracle_pipeline.bags.run_directory import MANIFEST_FILE, is_complete_recording
from oracle_pipeline.bags.terminal import printable

_LAST = (METADATA, MANIFEST_FILE)  # written after all other files
MOST_FILES = 10_000  # inspected of one recording; rosbag2 writes far fewer
_PLAIN = re.compile(r"[A-Za-z0-9_](?:\.?[A-Za-z0-9_-])*")
_OTHER = re.compile(r"[^A-Za-z0-9_]+")
_DIGEST = re.compile(r"-[0-9a-f]{12}")
_LONGEST = 100  # characters of a key, without its digest


@dataclass(frozen=True, slots=True)
class Arrival:
    """One recording in the folder, as it is now."""

    path: Path
    key: str  # see `key_of`
    fingerprint: str  # of names, sizes and times of its files
    changed_s: float  # when one of its files last changed [s since 1970]

    def is_finished(self) -> bool:
        """Return whether its files have their ends; never true if the recorder was killed."""
        try:
            if self.path.is_file():
                return _ends(self.path) or self.path.suffix != ".mcap"
            return (
                all(_ends(file) for file in _files(self.path) if is_recording(file))
                or is_complete_recording(self.path)
                or any((self.path / name).is_file() for name in _LAST)
            )
        except OSError:  # removed meanwhile
            return False

    @property
    def name(self) -> str:
        """Name for messages to the user."""
        return printable(self.path.name)


class Arrivals(NamedTuple):
    """The recordings found by one scan of the folder."""

    found: list[Arrival]  # by name
    faults: list[str]  # why some entries could not be inspected


def arrivals(folder: Path, keys: Collection[str] | None = None) -> Arrivals:
    """Return the recordings in a folder.

    Hidden entries are left out, so that a copy can be made under a hidden name and then renamed.

    Parameters
    ----------
    folder : Path
    keys : collection of str, optional
        Only recordings with these keys are inspected; by default all.

    Raises
    ------
    OSError
        If the folder itself cannot be listed.
    """
    result = Arrivals([], [])
    for path in sorted(folder.iterdir(), key=os.fsencode):
        if path.name.startswith(".") or (keys is not None and key_of(path.name) not in keys):
            continue
        try:
            if arrival := _inspected(path):
                result.found.append(arrival)
        except FileNotFoundError:
            continue  # removed meanwhile
        except OSError as error:
            result.faults.append(f"{printable(path.name)} cannot be inspected: {error.strerror}.")
    return result


def key_of(name: str) -> str:
    """Return a short ASCII key of a file name, unique for each name.

    An ordinary name is its own key. For any other name, including one that is not UTF-8, the key
    has the readable part and a digest of its bytes.

    Examples
    --------
    >>> key_of("rosbag2_2026_11_22-10_00_00")
    'rosbag2_2026_11_22-10_00_00'
    >>> key_of("Küche|2...3.mcap")
    'K-che-2-3-mcap-965a50f97fd8'
    """
    plain = _PLAIN.fullmatch(name) and not _DIGEST.fullmatch(name[-13:])
    if plain and len(name) <= _LONGEST:
        return name
    readable = _OTHER.sub("-", name).strip("-")[:_LONGEST] or "recording"
    return f"{readable}-{hashlib.sha256(os.fsencode(name)).hexdigest()[:12]}"


def _inspected(path: Path) -> Arrival | None:
    """Return the recording at a path; None if there is none."""
    status = path.stat()
    if stat.S_ISDIR(status.st_mode):
        files = sorted(_files(path), key=os.fsencode)
        holds_one = any(file.name == MANIFEST_FILE or is_recording(file) for file in files)
    else:
        files = [path]
        holds_one = stat.S_ISREG(status.st_mode) and is_recording(path)
    if not holds_one:
        return None
    states = [(file, file.stat()) for file in files]
    digest = hashlib.sha256()
    for file, state in states:
        digest.update(os.fsencode(file.relative_to(path.parent)))
        digest.update(b"\0%d %d\0" % (state.st_size, state.st_mtime_ns))
    changed_s = max(state.st_mtime for _, state in states)
    return Arrival(path, key_of(path.name), digest.hexdigest()[:16], changed_s)


def _files(folder: Path) -> Iterator[Path]:
    """Yield the files of a recording, without following links to folders."""
    walk = (Path(place, name) for place, _, names in os.walk(folder) for name in names)
    yield from itertools.islice(walk, MOST_FILES)


def _ends(file: Path) -> bool:
    """Return whether a file is a complete MCAP file, by its last bytes."""
    if file.suffix != ".mcap" or not file.is_file():
        return False
    with file.open("rb") as source:
        size = source.seek(0, os.SEEK_END)
        source.seek(max(0, size - len(MAGIC)))
        return size > len(MAGIC) and source.read() == MAGIC
