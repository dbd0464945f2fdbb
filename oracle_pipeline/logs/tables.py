"""CSV and Parquet: a file, or a folder of files, each with the messages of one topic."""

import codecs
import re
import warnings
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
from numpy.typing import NDArray

from oracle_pipeline.logs.files import tables_in
from oracle_pipeline.logs.layout import (
    LAYOUT_FILE,
    SECONDS,
    Layout,
    TopicLayout,
    factor,
    find_layout,
)
from oracle_pipeline.logs.log import LATEST_NS, Log, LogError, LogTopic, grouped, reading
from oracle_pipeline.logs.recording import echoed_columns, guessed_type

_TIMES = re.compile(
    r"[%_]*(?:time|timestamp|stamp|t|elapsed|seconds|sec|secs|date|date[ _/-]?time)"
    r"(?:[_ .\[(]*[mun]?s(?:ec(?:ond)?s?)?[\])]*)?",
    re.IGNORECASE,
)
_LIKE_TIMES = re.compile(r"time|stamp|epoch|clock", re.IGNORECASE)  # if they never fall
_UNIT = re.compile(
    r"(?:[_ .\[(]|time|stamp|^t)([mun]?s)(?:ec(?:ond)?s?)?[\])]*$", re.IGNORECASE
)  # of a time, at the end of its name
_NANOSECONDS = re.compile(r"n(?:ano)?(secs?|seconds)$")  # beside seconds of the same name
_ROS2_ECHO = re.compile(r"\d+,\d{1,9},(?:[A-Za-z/][\w/]*)?,")  # seconds, nanoseconds and a frame
_COUNTERS = re.compile(r"unnamed: 0|index|idx|row|seq|frame|sample|id", re.IGNORECASE)
_ABOVE = re.compile(r"#|sep=|\s*$")  # begins lines above the names of columns
_NUMBERED = re.compile(r"(?:run|rec|flight|drive|episode|trial|test|log|session)?[\W\d_]+", re.I)
_SHARED = 0.5  # least share of columns that recordings have in common; topics have the time
_COMMA = re.compile(r'(?:^|[;\t ])"?-?\d+,\d+(?:e[+-]?\d+)?"?(?=[;\t ]|$)', re.I | re.M)
_NUMBERS = re.compile(r"[\[(]?\s*-?[\d.].*[\d.]\s*[\])]?")
_STEPS = (("ns", 2e6), ("us", 2e3), ("ms", 2.0))  # a robot logs more than a row in two seconds
_FRAMES = {"header.frame_id", "child_frame_id"}  # names, though they may be numbers or blank
_LABELS = {"label", "labels", "class", "target", "anomaly", "is_anomaly"}  # answers, not signals
_MOSTLY = 0.9  # of the cells of a column must be numbers, or it counts as text


def is_folder_of_topics(folder: Path) -> bool:
    """Return whether the tables in a folder are the topics of one recording.

    The layout file says so. Without it, they are if most have other columns than the others and
    few are common to all, or if a folder beside this one has files of the same names, which are
    not the numbers of recordings.
    """
    tables = tables_in(folder)
    if not tables:
        return False
    if recording := find_layout(folder).recording:
        return recording == "folder"
    names = {table.name for table in tables}
    is_numbered = all(_NUMBERED.fullmatch(table.stem) for table in tables)
    if len(names) > 1 and not is_numbered and any(
        {table.name for table in tables_in(other)} == names
        for other in folder.parent.iterdir()
        if other.is_dir() and not other.samefile(folder)
    ):  # fmt: skip
        return True
    headers = [frozenset(_header(table)) for table in tables]
    shared = len(frozenset.intersection(*headers)) / np.mean([len(header) for header in headers])
    return 2 * len(set(headers)) > len(tables) > 1 and bool(shared < _SHARED)


def read_tables(path: Path, layout: Layout | None = None) -> Log:
    """Read a file, or all tables of a folder, as one recording.

    Parameters
    ----------
    path : Path
    layout : Layout, optional
        By default that of the file beside it, if there is one.

    Raises
    ------
    LogError
        If a file is damaged, empty or has no time.
    """
    layout = layout or find_layout(path)
    log = Log([])
    if path.is_dir() and not layout.recording:
        log.notes.append("Its tables are taken as the topics of one recording.")
    noted: dict[str, list[str]] = {}  # topics by note
    for file, name in _topics(path).items():
        topic, _, notes = _topic(file, layout.of_file(file.name), name)
        log.topics.append(topic)
        for note in notes:
            noted.setdefault(note, []).append(topic.name)
    for note, topics in noted.items():
        where = f"{topics[0]}: " if len(topics) == 1 else f"{len(topics)} tables: "
        log.notes.append(f"{where if path.is_dir() else ''}{note}")
    names = [topic.name for topic in log.topics]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise LogError(f"{path} has several files for {twice[0]}; name one topic for each file.")
    return log


def guess_layout(path: Path) -> Layout:
    """Return the layout that is used without a layout file, to be written and corrected."""
    guesses = (_topic(file, TopicLayout(file.name), name) for file, name in _topics(path).items())
    return Layout("folder" if path.is_dir() else "file", tuple(about for _, about, _ in guesses))


def _topic(file: Path, about: TopicLayout, name: str) -> tuple[LogTopic, TopicLayout, list[str]]:
    """Return the messages of a table, how it was read, and remarks."""
    notes: list[str] = []
    frame = _read(file)
    about = _with_time(file, frame, about, notes)
    times_ns = _times_ns(file, frame, about)
    columns, texts = _columns(file, frame, about, notes)
    msgtype = about.msgtype or ("" if about.columns else guessed_type(columns))
    if msgtype and not about.msgtype:
        notes.append(f"It is read as {msgtype}, whose fields its columns are.")
    columns = _of_type(columns, msgtype)
    if not columns:
        raise LogError(f"{file} has no column of numbers beside the time.")
    kept = ~pd.isna(times_ns)
    if dropped := int((~kept).sum()):
        notes.append(f"{dropped} rows without a time are not used.")
    kept_columns = {name: values[kept] for name, values in columns.items()}
    units = {} if msgtype else about.units
    stamps = times_ns[kept].astype(np.int64)
    about = replace(about, topic=about.topic or name, msgtype=msgtype)
    texts = texts if msgtype else {}
    return LogTopic(about.topic, stamps, kept_columns, msgtype, texts, units), about, notes


def _of_type(columns: dict[str, NDArray[Any]], msgtype: str) -> dict[str, NDArray[Any]]:
    """Return the columns with the names of ROS 2: those of ROS 1's stamps differ."""
    if not msgtype:  # one is made for them, without a header
        return {name: each for name, each in columns.items() if not name.startswith("header.")}
    stamp = "header.stamp"
    renamed = {f"{stamp}.secs": f"{stamp}.sec", f"{stamp}.nsecs": f"{stamp}.nanosec"}
    return {
        renamed.get(name, name): values for name, values in columns.items() if name != "header.seq"
    }


def _topics(path: Path) -> dict[Path, str]:
    """Return the topic of each table of a recording.

    What the names of all tables begin with is the name of the recording, and left out, if there is
    a number in it, or the name of the folder.
    """
    if not path.is_dir():
        return {path: "/log"}
    tables = tables_in(path)
    parts = (re.split(r"(?<=[^A-Za-z0-9])", table.stem) for table in tables)
    same = takewhile(lambda each: len(set(each)) == 1, zip(*parts, strict=False))
    shared = "".join(each[0] for each in same) if len(tables) > 1 else ""
    if not re.search(r"\d", shared) and path.name not in shared:
        shared = ""
    names = (re.sub(r"[^A-Za-z0-9]+", "_", table.stem[len(shared) :]) for table in tables)
    return {table: "/" + name.strip("_") for table, name in zip(tables, names, strict=True)}


def _header(file: Path) -> tuple[str, ...]:
    with reading(file, "a table"):
        if file.suffix.lower() == ".parquet":
            return tuple(pq.read_schema(file).names)
        return tuple(pd.read_csv(file, **_dialect(file), nrows=0).columns)


def _read(file: Path) -> pd.DataFrame:
    with reading(file, "a table"):
        if file.suffix.lower() == ".parquet":
            frame = pd.read_parquet(file)
            if frame.index.name or frame.index.dtype.kind in "mM":
                frame = frame.reset_index(names=frame.index.name or "time")
        else:
            frame = pd.read_csv(file, **_dialect(file), skipinitialspace=True)
        if frame.empty:
            raise ValueError("it has no rows")
        frame = frame.dropna(axis=1, how="all").rename(columns=lambda name: str(name).strip())
        frame = _with_whole_seconds_joined(frame)
        names = {name.lower(): name for name in frame.columns}
        if names.keys() >= {"date", "time"} and frame[names["date"]].dtype.kind not in "biufM":
            time = frame[names["time"]].astype(str)
            frame[names["time"]] = frame.pop(names["date"]).str.cat(time, sep=" ")
        echoed = frame.columns[1:].str.startswith("field.")
        return _of_echo(frame) if len(echoed) and echoed.all() else frame


def _with_whole_seconds_joined(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a table whose time has its seconds and nanoseconds in one column, if it has no other.

    Stamps of headers stay, since they are fields of a type of ROS.
    """
    times = set(filter(_TIMES.fullmatch, frame.columns))
    for name in frame.columns:
        whole = _NANOSECONDS.sub(r"\1", name)
        if whole != name and whole in frame and times <= {whole}:
            kept = frame if name.startswith("header.") else frame.drop(columns=[whole, name])
            return kept.assign(time=frame[whole] * 10**9 + frame[name])
    return frame


def _of_echo(frame: pd.DataFrame) -> pd.DataFrame:
    """Return what ``rostopic echo -p`` wrote with the names of fields; its stamps are in ns."""
    fields = (str(name).removeprefix("field.") for name in frame)
    frame = frame.set_axis([re.sub(r"(?<=\D)(\d+)$", r"_\1", name) for name in fields], axis=1)
    if "header.stamp" in frame:
        seconds, rest = frame.pop("header.stamp").divmod(10**9)
        stamps = pd.DataFrame({"header.stamp.secs": seconds, "header.stamp.nsecs": rest})
        frame = pd.concat([frame, stamps], axis=1)
    return frame


def _dialect(file: Path) -> dict[str, Any]:
    """Return how a CSV is written, as arguments of pandas, by its first lines."""
    with file.open("rb") as source:
        begin = source.read(65536)
    encoding = "utf-16" if begin[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) else "utf-8"
    try:
        text = codecs.getincrementaldecoder(encoding)().decode(begin)
    except UnicodeDecodeError:
        encoding, text = "cp1252", begin.decode("cp1252", "replace")
    lines = text.removeprefix("\ufeff").splitlines()
    first = next((n for n, line in enumerate(lines) if not _ABOVE.match(line)), 0)
    above, row, below = ["", *lines, "", ""][first : first + 3]
    if _ROS2_ECHO.match(row):
        return {"header": None, "names": echoed_columns(row.count(",") + 1)}
    mark = max(",;\t", key=row.count)
    mark = mark if mark in row else r"\s+"
    decimal = "," if mark != "," and _COMMA.search(text) else "."
    found = {"sep": mark, "skiprows": first, "encoding": encoding, "decimal": decimal}
    if below.endswith(mark) and not row.endswith(mark):
        found["index_col"] = False  # each row ends with a mark, and the names do not
    cells, names = (re.split(mark, line.strip("# ")) for line in (row, above))
    numbers = pd.to_numeric(pd.Series(cells), errors="coerce").notna()
    if above and len(names) == len(cells) and numbers.any():  # as `numpy.savetxt` writes its header
        found |= {"header": None, "names": names}
    elif "." in row and numbers.all():
        found |= {"header": None, "names": [f"column_{n + 1}" for n in range(len(cells))]}
    return found


def _with_time(
    file: Path, frame: pd.DataFrame, about: TopicLayout, notes: list[str]
) -> TopicLayout:
    """Complete column and unit of the time."""
    if about.rate_hz:
        return about
    column = about.time_column
    if not column:
        named = list(filter(_TIMES.fullmatch, frame.columns))
        like = [name for name in frame.columns if _LIKE_TIMES.search(name)]
        rising = [c for c in like if frame[c].is_monotonic_increasing and frame[c].nunique() > 1]
        column = [*named, *rising, ""][0]
    if column not in frame.columns:
        raise LogError(
            f"{file} has no column {column}." if column else
            f"{file} has no column of time, but {', '.join(frame.columns[:8])}. Name one in "
            f"{LAYOUT_FILE} beside it: "
            f"`topics: [{{file: {file.name}, time: {{column: NAME, unit: s}}}}]`, or give "
            "`time: {rate: ROWS_A_SECOND}`."
        )  # fmt: skip
    unit = about.time_unit
    numbers = _numbers(frame[column])
    if not unit and numbers is not None:
        unit = _guessed_unit(column, numbers.ravel().astype(np.float64))
        notes.append(f"{column} is taken as the time in {unit}.")
    return replace(about, time_column=column, time_unit=unit)


def _guessed_unit(column: str, values: NDArray[np.float64]) -> str:
    """Return the unit of a time, by its name, its size since 1970, or its steps."""
    if match := _UNIT.search(column):
        return match[1].lower()
    sizes = np.abs(values[np.isfinite(values)])
    usual = float(np.median(sizes)) if len(sizes) else 0.0  # a damaged time may have any size
    for unit, since_1970 in (("ns", 1e17), ("us", 1e14), ("ms", 1e11)):
        if usual > since_1970:
            return unit
    steps = np.diff(np.sort(values))
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    return next((unit for unit, least in _STEPS if step >= least), "s")


def _times_ns(file: Path, frame: pd.DataFrame, about: TopicLayout) -> NDArray[np.float64]:
    """Return the times [ns], NaN where there is none."""
    if about.rate_hz:
        return np.round(np.arange(len(frame)) * (1e9 / about.rate_hz))
    column = frame[about.time_column]
    times = _numbers(column)
    if times is not None and times.ndim == 1:
        times = times * (SECONDS[about.time_unit or "s"] * 1e9)
    else:
        times = _clock_ns(file, column)
    times = np.where(np.abs(times) < LATEST_NS, times, np.nan)
    if not np.isfinite(times).any():
        raise LogError(f"{file}: {about.time_column} holds no time.")
    return np.asarray(times - min(0.0, np.nanmin(times)))  # bags begin in 1970


def _clock_ns(file: Path, column: pd.Series) -> NDArray[np.float64]:
    """Return times of day, or else dates [ns]."""
    found: Any = pd.to_timedelta(column.astype(str), errors="coerce")
    with reading(file, "a table"), warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # dates in a form of their own
        if found.notna().mean() < _MOSTLY:
            found = pd.to_datetime(column, errors="coerce", utc=True)
        times = np.array(found.dt.as_unit("ns").astype(np.int64), dtype=np.float64)
    return np.where(found.isna(), np.nan, times)


def _columns(
    file: Path, frame: pd.DataFrame, about: TopicLayout, notes: list[str]
) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    """Return the columns of numbers by field, and the texts that do not change."""
    source = {name: name for name in frame.columns if name != about.time_column}
    if about.columns:
        source = dict(about.columns)
        if absent := [name for name in source.values() if name not in frame.columns]:
            raise LogError(f"{file} has no column {absent[0]}, which its layout names.")
    columns: dict[str, NDArray[Any]] = {}
    texts: dict[str, str] = {}
    unused = []
    for field, name in source.items():
        if name in about.ignore:
            continue
        if field.lower() in _LABELS:
            notes.append(f"{name} looks like a label and is not used.")
            continue
        values = None if field in _FRAMES else _numbers(frame[name])
        counts = not about.columns and _COUNTERS.fullmatch(name)
        if values is not None and counts and (np.diff(values) == 1).all():
            unused.append(name)
        elif values is not None:
            scale = factor(about.units[field]) if about.msgtype and field in about.units else 1.0
            columns[field] = values * scale if scale != 1.0 else values
        elif frame[name].nunique() == 1:
            texts[field] = str(frame[name].iloc[0])
        elif field not in _FRAMES:
            unused.append(name)
    if unused:
        notes.append(f"Not used, as text or numbers of rows: {', '.join(unused[:8])}.")
    return grouped(columns), texts


def _numbers(column: pd.Series) -> NDArray[Any] | None:
    """Return a column as numbers, one row or several in each cell; None if it is text."""
    if column.dtype.kind in "biuf":
        return column.to_numpy()
    cells = column.to_numpy()
    first = next((cell for cell in cells if cell is not None), None)
    if isinstance(first, str):
        numbers = pd.to_numeric(column, errors="coerce")
        if numbers.notna().mean() >= _MOSTLY:
            return numbers.to_numpy(np.float64)
        if not _NUMBERS.fullmatch(first) or "," not in first:
            return None
        cells = np.array([_listed(cell) for cell in cells], dtype=object)
    if isinstance(first, str | list | tuple | np.ndarray):
        sizes = {np.size(cell) for cell in cells}
        if len(sizes) == 1:
            try:
                return np.stack([np.ravel(np.asarray(cell, np.float64)) for cell in cells])
            except (TypeError, ValueError):
                return None
    return None


def _listed(cell: object) -> NDArray[np.float64]:
    """Return the numbers in ``(0.0, 1.0)``; none if it is no list."""
    try:
        return np.array([float(word) for word in str(cell).strip("[]() ").split(",")])
    except ValueError:
        return np.empty(0)
