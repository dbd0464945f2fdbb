"""Finds the files of one recording: a single file, or the parts in a folder.

Files are recognised by their names and first bytes. ``metadata.yaml`` is used only to find missing
and renamed parts. Nothing outside the folder is read, whatever its files refer to.
"""

import re
import stat
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from oracle_pipeline.bags import bounded_yaml, mcap, rosbag1, sqlite
from oracle_pipeline.bags.compression import ZSTD_MAGIC, unpacked_file
from oracle_pipeline.bags.errors import BagError, one_line, refuse_pointer
from oracle_pipeline.bags.limits import LARGEST_YAML
from oracle_pipeline.bags.part import Part, ros2_name
from oracle_pipeline.bags.terminal import join_first

METADATA = "metadata.yaml"
NO_CHECKSUM = "This format has no checksum: a changed byte in a message cannot be noticed."
_MAGIC_BYTES = 16  # by which a format is known
_TOLERANCE_NS = 1_000_000_000  # between times of the metadata and of messages

_FORMATS: tuple[tuple[bytes, Callable[[Path, Path], Part]], ...] = (
    (mcap.MAGIC, mcap.McapPart),
    (sqlite.MAGIC, sqlite.SqlitePart),
    (rosbag1.MAGIC, rosbag1.Rosbag1Part),
)
_NAME = re.compile(
    r"(?P<stem>.*?)(?:_(?P<number>\d+))?(?P<suffix>\.mcap|\.db3|\.bag)(?:\.active)?(?:\.zstd|\.zst)?",
    re.DOTALL,
)


@dataclass(slots=True)
class Parts:
    """The open files of a recording, in order of time."""

    parts: list[Part] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    losses: list[str] = field(default_factory=list)  # what is missing or could not be read
    qos: dict[str, str] = field(default_factory=dict)  # by topic, where only metadata.yaml has it
    type_hashes: dict[str, str] = field(default_factory=dict)  # by message type, likewise
    folders: list[tempfile.TemporaryDirectory[str]] = field(default_factory=list)

    def close(self) -> None:
        """Close all files."""
        for part in self.parts:
            part.close()
        for folder in self.folders:
            folder.cleanup()


def open_parts(path: Path) -> Parts:
    """Open a file, or the parts in a folder.

    Raises
    ------
    BagError
        If there is nothing, no part of it can be read, or a folder holds several recordings.
    """
    found = Parts()
    try:
        if path.is_dir():
            _open_folder(path, found)
        else:
            found.parts.append(_open_file(path, path, found))
    except BaseException:
        found.close()
        raise
    if any(not isinstance(part, mcap.McapPart) for part in found.parts):
        found.notes.append(NO_CHECKSUM)
    return found


def is_recording(path: Path) -> bool:
    """Return whether a path looks like one recording: a file, or a folder of its parts."""
    if not path.is_dir():
        return _NAME.fullmatch(path.name) is not None
    files = [entry for entry in path.iterdir() if _NAME.fullmatch(entry.name)]
    return (path / METADATA).is_file() or (len(files) > 1 and len(_groups(files)) == 1)


def _open_folder(folder: Path, found: Parts) -> None:
    metadata = _Metadata(folder)
    found.notes += metadata.notes
    found.qos, found.type_hashes = metadata.qos, metadata.type_hashes
    files = [entry for entry in sorted(folder.iterdir()) if _NAME.fullmatch(entry.name)]
    files = _without_duplicates(files)
    listed = {name: folder / name for name in metadata.files}
    absent = [
        name
        for name, file in listed.items()
        if not any(each.name in (name, name.removesuffix(".zstd")) for each in files)
        and not file.exists()
    ]
    groups = _groups(files)
    if len(groups) > 1:
        named = [group for group in groups.values() if any(each.name in listed for each in group)]
        if len(named) != 1:
            raise BagError(
                f"{folder} holds several recordings: {join_first([each.name for each in files])}. "
                "Name one of them."
            )
        strangers = [each.name for each in files if each not in named[0]]
        found.notes.append(f"{', '.join(strangers)}: of another recording; not read.")
        files = named[0]
    if not files and absent:
        raise BagError(
            f"{folder} is not a bag: {METADATA} names {absent[0]}, which does not exist. Copy the "
            "recording's files into the folder."
        )
    if not files:
        raise BagError(
            f"{folder} is not a bag: it holds no .mcap, .db3 or .bag file. Name the bag's own "
            "folder or file."
        )
    errors = []
    for file in files:
        if file.resolve().parent != folder.resolve():
            raise BagError(
                f"{file} is a link out of the bag's folder; such a bag is not read. Name the "
                "linked file."
            )
        try:
            found.parts.append(_open_file(file, file, found))
        except (BagError, OSError) as error:
            errors.append(f"Part {file.name} cannot be read: {error}")
    if not found.parts:
        raise BagError(" ".join(errors))
    if absent and len(files) == len(listed) and metadata.counts == _counts(found.parts):
        found.notes.append(
            f"{METADATA} names {', '.join(absent)} instead of {', '.join(f.name for f in files)}, "
            "with the same topics and numbers of messages: the recording was renamed."
        )
    else:
        found.losses += [
            f"{METADATA} names {name}, which does not exist: its messages are missing."
            for name in absent
        ]
        found.losses += _differing_counts(metadata.counts, _counts(found.parts))
    found.notes += metadata.disagreements(found.parts)
    found.losses += errors
    found.parts.sort(key=lambda part: (part.extent.start_ns is None, part.extent.start_ns or 0))


def _open_file(file: Path, path: Path, found: Parts) -> Part:
    """Open a file by its first bytes."""
    try:
        mode = file.stat().st_mode
    except OSError as error:
        raise BagError(f"There is no bag {path}; check the path ({error.strerror}).") from error
    if not stat.S_ISREG(mode):
        raise BagError(f"{path} is a device, a pipe or a socket; only files and folders are read.")
    with file.open("rb") as source:
        begin = source.read(_MAGIC_BYTES)
    if not begin:
        raise BagError(f"{path} is empty; the recorder wrote nothing, or the copy failed.")
    if begin.startswith(ZSTD_MAGIC):
        folder = tempfile.TemporaryDirectory(prefix="oracle-")
        found.folders.append(folder)
        return _open_file(unpacked_file(file, Path(folder.name)), path, found)
    for magic, opened in _FORMATS:
        if begin.startswith(magic):
            return opened(file, path)
    refuse_pointer(file)
    hint = "For a table, end its name in .csv, .tsv or .parquet."
    if not any(begin):
        hint = "It begins with zeros: the disk was full, or the copy failed."
    raise BagError(
        f"{path} is not a bag: it begins neither as MCAP, nor as SQLite, nor as a ROS 1 bag of "
        f"format 2.0. {hint}"
    )


def _groups(files: list[Path]) -> dict[tuple[str, str], list[Path]]:
    """Group the parts of each recording: one stem, one format, numbered."""
    groups: dict[tuple[str, str], list[Path]] = {}
    for file in files:
        match = _NAME.fullmatch(file.name)
        assert match is not None  # noqa: S101 -- checked before
        groups.setdefault((match["stem"], match["suffix"]), []).append(file)
    return groups


def _without_duplicates(files: list[Path]) -> list[Path]:
    """Leave out a compressed file whose original exists: its compression was interrupted."""
    names = {file.name for file in files}
    return [
        file
        for file in files
        if not (file.suffix in (".zstd", ".zst") and file.name.rpartition(".")[0] in names)
    ]


def _counts(parts: list[Part]) -> Counter[str]:
    """Return the number of messages of each topic."""
    counts: Counter[str] = Counter()
    for part in parts:
        for number, channel in part.channels.items():
            counts[channel.topic] += part.extent.counts[number]
    return counts


def _differing_counts(claimed: Counter[str], read: Counter[str]) -> list[str]:
    """Return a sentence on topics whose messages are not as many as the metadata claim."""
    differing = sorted(name for name in claimed | read if claimed[name] != read[name])
    if not claimed or not differing:
        return []
    named = [f"{name} {read[name]} of {claimed[name]}" for name in differing]
    return [
        f"{METADATA} claims {claimed.total()} messages, and the files have {read.total()}: "
        f"{join_first(named)}."
    ]


class _Metadata:
    """Content of ``metadata.yaml``: names of parts, numbers of messages, and old bags' QoS."""

    def __init__(self, folder: Path) -> None:
        self.files: list[str] = []
        self.counts: Counter[str] = Counter()  # messages by topic
        self._types: dict[str, str] = {}  # by topic
        self._times_ns: tuple[int, int] | None = None  # of the first and the last message
        self.notes: list[str] = []
        self.qos: dict[str, str] = {}
        self.type_hashes: dict[str, str] = {}
        file = folder / METADATA
        if not file.is_file():
            self.notes.append(
                f"There is no {METADATA}: the recorder did not end properly, or the file was lost."
            )
            return
        try:
            with file.open("rb") as source:
                text = source.read(LARGEST_YAML + 1).decode("utf-8", "replace")
            self._read(bounded_yaml.load(text)["rosbag2_bagfile_information"])
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            self.notes.append(f"{METADATA} is not used: {one_line(error)}.")

    def _read(self, information: Any) -> None:
        # Only the last part of a name is used, so that it cannot leave the folder.
        names = [PurePosixPath(str(each)).name for each in information["relative_file_paths"]]
        self.files = [name for name in names if name]
        for topic in information.get("topics_with_message_count") or ():
            about = topic["topic_metadata"]
            self.counts[str(about["name"])] += int(topic["message_count"])
            if msgtype := about.get("type"):
                self._types[str(about["name"])] = ros2_name(str(msgtype))
            profiles = about.get("offered_qos_profiles")
            if isinstance(profiles, str):
                self.qos[str(about["name"])] = profiles
            if type_hash := about.get("type_description_hash"):
                self.type_hashes[str(about["type"])] = str(type_hash)
        if self.counts.total() and {"starting_time", "duration"} <= information.keys():
            start_ns = int(information["starting_time"]["nanoseconds_since_epoch"])
            end_ns = start_ns + int(information["duration"]["nanoseconds"])
            self._times_ns = start_ns, end_ns

    def disagreements(self, parts: list[Part]) -> Iterator[str]:
        """Yield a note on each type or time that is not that of the files."""
        for channel in (each for part in parts for each in part.channels.values()):
            claimed = self._types.get(channel.topic, channel.msgtype)
            if claimed != channel.msgtype:
                yield (
                    f"{METADATA} says that {channel.topic} has type {claimed}; it has "
                    f"{channel.msgtype}."
                )
        starts = [part.extent.start_ns for part in parts if part.extent.start_ns is not None]
        ends = [part.extent.end_ns for part in parts if part.extent.end_ns is not None]
        if self._times_ns is None or not starts:
            return
        read = min(starts), max(ends)
        for name, own, claimed_ns in zip(("first", "last"), read, self._times_ns, strict=True):
            if abs(own - claimed_ns) > _TOLERANCE_NS:
                yield (
                    f"The {name} message is {abs(own - claimed_ns) / 1e9:.1f} s "
                    f"{'later' if own > claimed_ns else 'earlier'} than {METADATA} says."
                )
