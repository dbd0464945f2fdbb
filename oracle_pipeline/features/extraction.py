"""Computes the two feature tables of a run: one row for the run, one row for each window.

If a plugin raises an error, only its own columns are lost, and the column ``missing`` has the
reason. Fields of the manifest become key columns, which are not passed to plugins.
"""

import json
import logging
import math
from collections.abc import Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from oracle_pipeline.bags.errors import BagError, OracleError
from oracle_pipeline.bags.limits import MOST_WINDOWS
from oracle_pipeline.bags.manifest import UNKNOWN_WORLD
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.bags.terminal import printable
from oracle_pipeline.datasets import KEYS, MISSING, WHERE, WINDOW_START, write_table
from oracle_pipeline.features.adapters.thesis import MessageTable, ThesisPlugin
from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.engine.kept_messages import NO_GRAPH, Graphs, KeptMessages
from oracle_pipeline.features.engine.kept_rows import Carried
from oracle_pipeline.features.engine.shared import system_of
from oracle_pipeline.features.engine.spans import Span
from oracle_pipeline.features.engine.tables import FeatureTables, RecordingFeatures, Table, together
from oracle_pipeline.features.manager import FeatureManager, build_manager
from oracle_pipeline.features.signals.collector import SignalCollector
from oracle_pipeline.features.signals.statistics import SignalTable
from oracle_pipeline.graphs.intervals import compose, known_in
from oracle_pipeline.opened_run import OpenedRun, open_run
from oracle_pipeline.robots.robot import Robot, find_robots, of_robot
from oracle_pipeline.robots.roles_file import RoleChoices
from oracle_pipeline.windows import windows_ns

if TYPE_CHECKING:
    import pandas as pd

DISTURBED = fp.Missing("messages were lost or late while it was recorded")
_EXPLAINED = fp.Located, fp.Missing  # a tuple, since a union would be made anew for each number

_log = logging.getLogger(__name__)


@dataclass(slots=True)
class _Row:
    """Features of one span, where they were attained, and why some of them are NaN."""

    values: dict[str, float] = field(default_factory=dict)
    where: dict[str, str] = field(default_factory=dict)
    missing: dict[str, str] = field(default_factory=dict)

    def put(self, column: str, value: Any) -> None:
        """Store a finite number; anything else is missing."""
        if isinstance(value, fp.Missing):
            reason = value.reason
        else:
            number = float(value.value if isinstance(value, fp.Located) else value)
            if math.isfinite(number):
                self.values[column] = number
                if isinstance(value, fp.Located):
                    self.where[column] = value.where
                return
            reason = f"the plugin returned {number}"
        self.values[column] = math.nan
        self.missing[column] = reason

    def without_timing(self, features: Mapping[str, fp.Feature]) -> None:
        """Take out the features that say more about the recorder than about the robot."""
        for column in self.values:
            if column in features and features[column].timing:
                self.put(column, DISTURBED)


def compute(
    recording: str | Path,
    manager: FeatureManager | None = None,
    *,
    strict: bool = False,
    choices: RoleChoices | None = None,
) -> RecordingFeatures:
    """Compute all features of all robots of a recording.

    Parameters
    ----------
    recording : path
        As for `open_run`.
    manager : FeatureManager, optional
        By default the built-in and installed plugins.
    strict : bool
        Whether an incomplete recording is an error.
    choices : RoleChoices, optional
        Content of a roles file.
    """
    manager = manager or build_manager()
    with open_run(Path(recording), strict=strict) as run:
        robots = find_robots(run.bag, choices)
        return together([measure(run, manager, robot) for robot in robots])


def extract(run: OpenedRun, manager: FeatureManager, robot: Robot | None = None) -> FeatureTables:
    """Compute all features of one robot of a recording, as DataFrames.

    Like `measure`, including its errors.
    """
    return measure(run, manager, robot).frames()


@np.errstate(all="ignore")  # recordings hold NaN and infinity; features of them are missing
def measure(
    run: OpenedRun,
    manager: FeatureManager,
    robot: Robot | None = None,
    recording: KeptMessages | None = None,
    signals: SignalCollector | None = None,
) -> RecordingFeatures:
    """Compute all features of one robot of a recording.

    Parameters
    ----------
    run : Run
        An open run directory or foreign bag. A foreign bag's keys are mode ``foreign``, label
        ``unknown``, block and session -1.
    manager : FeatureManager
        The plugins to use.
    robot : Robot, optional
        One that ``find_robots`` found; by default the only one of the recording.
    recording : KeptMessages, optional
        The messages of the robot's bag for the plugins, and perhaps for others; by default the bag
        is read.
    signals : SignalCollector, optional
        Has seen the messages of `recording`.

    Raises
    ------
    BagError
        If the bag cannot be read to its end, or has several robots and none is named.
    """
    robot = robot or only_robot(run)
    run = replace(run, bag=robot.bag)
    if recording is None or signals is None:
        signals = SignalCollector(robot)
        recording = KeptMessages.read(robot, manager.plugins, see=signals.see)
    whole = Span(0, recording.clock.duration_ns)
    extraction = _Extraction(run, manager, recording, whole)
    of_run = extraction.row(whole)
    fields = _fields(manager.features())
    if manager.thesis:
        with closing(MessageTable(run.bag)) as messages:
            for plugin in manager.thesis:
                fields |= extraction.add_thesis_columns(of_run, plugin, whole, messages)
    of_run.missing |= manager.broken
    spans = window_spans(recording)  # before the signals take memory
    table = SignalTable(signals.signals(recording.times_ns))
    fields |= _fields(table.features)
    of_run.values |= table.values(whole)  # without reasons for those that are missing
    if run.disturbances.cover(whole.start_s, whole.end_s):
        of_run.without_timing(manager.features() | table.features)
    own = [
        *robot.roles.notes, *robot.roles.ambiguities(), *recording.notes, *signals.notes,
    ]  # fmt: skip
    notes = (
        *run.bag.losses, *run.bag.notes,
        *(f"{robot.name}: {note}" if robot.name else note for note in own),
    )  # fmt: skip
    return RecordingFeatures(
        _table(_keys(run, robot), {}, of_run.values, [of_run], fields),
        extraction.windows(_keys(run, robot), spans, table),
        notes,
    )


class WindowFeatures(NamedTuple):
    """The features of one window of a recording in progress."""

    row: "pd.DataFrame"  # one row, as in the table of windows
    carried: Carried  # state for the next window


@np.errstate(all="ignore")
def extract_window(
    run: OpenedRun, manager: FeatureManager, start_s: float, carried: Carried,
    robot: Robot | None = None, *, signals: bool = False,
) -> WindowFeatures:  # fmt: skip
    """Compute the features of one window of a recording in progress.

    Parameters
    ----------
    run : OpenedRun
        The recording until the end of the window. Its bag has the start of the whole recording,
        but may hold the last messages only.
    manager : FeatureManager
        The plugins to use.
    start_s : float
        When the window begins, since the start of the recording [s].
    carried : mapping
        Of the window before; empty for the first one.
    robot : Robot, optional
        By default the only one of the recording.
    signals : bool
        Whether the row has signals.
    """
    robot = robot or only_robot(run)
    run = replace(run, bag=robot.bag)
    seen = SignalCollector(robot) if signals else None
    recording = KeptMessages.read(robot, manager.plugins, carried, seen.see if seen else None)
    found = seen.signals(recording.times_ns) if seen else []
    extraction = _Extraction(run, manager, recording, Span(0, recording.clock.duration_ns))
    span = Span(round(start_s * 1e9), recording.clock.duration_ns)
    table = extraction.windows(_keys(run, robot), [span], SignalTable(found))
    return WindowFeatures(table.frame(), recording.carried())


def window_spans(recording: KeptMessages) -> list[Span]:
    """Return the windows that have a message; the last one may be shorter."""
    windows = windows_ns(recording.clock.duration_ns, recording.occupied())
    if len(windows) > MOST_WINDOWS:
        raise BagError(
            f"the recording has {len(windows)} windows with messages; the limit is {MOST_WINDOWS} "
            "(MOST_WINDOWS). Cut it into shorter ones."
        )
    return [Span(start_ns, end_ns) for start_ns, end_ns in windows]


def write(tables: FeatureTables, directory: RunDirectory) -> tuple[Path, Path]:
    """Write the tables to ``<root>/features/{run,window}/<mode>/<run>.parquet``, each atomically.

    Returns
    -------
    tuple of Path
        Of the table of the run, and of that of its windows.
    """
    of_run, of_windows = directory.feature_table("run"), directory.feature_table("window")
    write_table(tables.windows, of_windows)
    write_table(tables.run, of_run)
    return of_run, of_windows


class _Extraction:
    """Calls the plugins on spans of one recording."""

    def __init__(
        self, run: OpenedRun, manager: FeatureManager, recording: KeptMessages, whole: Span
    ) -> None:
        self._run = run
        self._plugins = manager.plugins
        self._features = manager.features()
        self._recording = recording
        self._failed: set[str] = set()  # plugins whose failure is in the log
        self._whole = whole
        self._graphs: dict[tuple[float, ...], Graphs] = {(): NO_GRAPH}  # by starts of intervals
        self._columns = {  # name of the feature by column, for a window and for the run
            (plugin.name, per_window): {
                plugin.column(feature): feature.name
                for feature in plugin.features
                if feature.per_window or not per_window
            }
            for plugin in manager.plugins
            for per_window in (False, True)
        }
        common = self._common(whole)
        self._prepared = {
            plugin.name: self._prepare(plugin, recording.window(plugin, whole, common))
            for plugin in manager.plugins
        }

    def row(self, span: Span, *, per_window: bool = False) -> _Row:
        """Return all features of a span, or only those that make sense for a window."""
        row = _Row()
        common = self._common(span)
        for plugin in self._plugins:
            columns = self._columns[plugin.name, per_window]
            if not columns:
                continue
            prepared = self._prepared[plugin.name]
            window = self._recording.window(plugin, span, common, prepared)
            values = self._compute(plugin, window, prepared)
            for column, name in columns.items():
                row.put(column, values[name])
        return row

    def windows(self, keys: Mapping[str, Any], spans: list[Span], signals: SignalTable) -> Table:
        """Return the features of windows, one row per window."""
        rows = [self.row(span, per_window=True) for span in spans]
        for span, row in zip(spans, rows, strict=True):
            row.values |= signals.values(span, per_window=True)
            if self._run.disturbances.cover(span.start_s, span.end_s):
                row.without_timing(self._features | signals.features)
        windowed = {c: f for c, f in self._features.items() if f.per_window} | signals.of_windows
        fields = {WINDOW_START: {"unit": "s"}, **_fields(windowed)}
        starts = {WINDOW_START: [span.start_s for span in spans]}
        return _table(keys, starts, windowed, rows, fields)

    def add_thesis_columns(
        self, row: _Row, plugin: ThesisPlugin, span: Span, messages: MessageTable
    ) -> dict[str, dict[str, str]]:
        """Add the result of a plugin in the thesis's form, and return the metadata of its columns.

        The number of columns is known only on success; a failure is stored under the plugin's name.
        """
        import networkx as nx

        graph = self._graphs_of(span).graph
        try:
            with messages.cursor() as cursor:
                numbers = plugin.extract(nx.DiGraph() if graph is None else graph, cursor)
        except Exception as error:  # foreign code
            row.missing[plugin.column] = self._failure(plugin.column, error).reason
            return {}
        features = {f"{plugin.column}_{i}": plugin.feature(i) for i in range(len(numbers))}
        for column, number in zip(features, numbers, strict=True):
            row.put(column, number)
        return _fields(features)

    def _graphs_of(self, span: Span) -> Graphs:
        """Return the graph of a span; spans with equal graphs share it."""
        known = known_in(self._run.intervals, span.start_s, span.end_s, self._whole.end_s)
        starts = tuple(interval.start_s for interval in known)
        if starts not in self._graphs:
            import networkx as nx

            whole = known[0].graph if len(known) == 1 else compose(each.graph for each in known)
            system = system_of(whole, self._recording.shared)
            self._graphs[starts] = Graphs(nx.freeze(whole), system, known)
        return self._graphs[starts]

    def _common(self, span: Span) -> fp.Window:
        return self._recording.span(span, self._graphs_of(span))

    def _prepare(self, plugin: fp.FeaturePlugin, window: fp.Window | fp.Missing) -> Any:
        """Return what a plugin prepares from the whole recording, or why it cannot."""
        if plugin.prepare is None or isinstance(window, fp.Missing):
            return None
        try:
            return plugin.prepare(window)
        except Exception as error:  # foreign code
            return self._failure(plugin.name, error)

    def _compute(
        self, plugin: fp.FeaturePlugin, window: fp.Window | fp.Missing, prepared: Any
    ) -> fp.Values:
        """Call a plugin; the result has an entry for each of its features, even after an error."""
        names = [feature.name for feature in plugin.features]
        for obstacle in (window, prepared):
            if isinstance(obstacle, fp.Missing):
                return dict.fromkeys(names, obstacle)
        assert isinstance(window, fp.Window)  # noqa: S101 -- the loop returned otherwise
        try:
            values = plugin.compute(window)
            if isinstance(values, fp.Missing):
                return dict.fromkeys(names, values)
            if values.keys() != set(names):
                raise KeyError(f"returned {sorted(values)} instead of {sorted(names)}")
            return {n: v if isinstance(v, _EXPLAINED) else float(v) for n, v in values.items()}
        except Exception as error:  # foreign code
            return dict.fromkeys(names, self._failure(plugin.name, error))

    def _failure(self, plugin: str, error: Exception) -> fp.Missing:
        """Log a plugin's first failure; call it from the exception handler."""
        if plugin not in self._failed:
            self._failed.add(plugin)
            is_expected = isinstance(error, OracleError)  # needs no traceback
            _log.error(
                "Plugin %s failed on %s: %s", plugin, self._run.path, error,
                exc_info=None if is_expected else error,
            )  # fmt: skip
        return fp.Missing(f"{type(error).__name__}: {error}")


def only_robot(run: OpenedRun) -> Robot:
    """Return the robot of a recording; `BagError` if there are several."""
    robots = find_robots(run.bag)
    if len(robots) > 1:
        raise BagError(
            f"{run.path} has several robots: {', '.join(robot.name for robot in robots)}; compute "
            "the features of one of them."
        )
    return robots[0]


def _keys(run: OpenedRun, robot: Robot) -> dict[str, Any]:
    manifest = run.manifest
    if manifest is None:
        run_id = of_robot(printable(run.path.resolve().name), robot.name)
        values: tuple[Any, ...] = (run_id, "foreign", "unknown", -1, -1, UNKNOWN_WORLD)
    else:
        values = (
            manifest.key, manifest.mode, manifest.label, manifest.block, manifest.session,
            manifest.world,
        )  # fmt: skip
    return dict(zip(KEYS, values, strict=True))


def _table(
    keys: Mapping[str, Any],
    more_keys: Mapping[str, list[float]],
    columns: Iterable[str],
    rows: list[_Row],
    fields: dict[str, dict[str, str]],
) -> Table:
    """Return rows as a table: keys, features as float64, and as JSON their places and reasons."""
    data: dict[str, Any] = {key: [value] * len(rows) for key, value in keys.items()}
    data |= {key: np.array(values, dtype=np.float64) for key, values in more_keys.items()}
    data |= {c: np.array([row.values[c] for row in rows], dtype=np.float64) for c in columns}
    data[WHERE] = [json.dumps(row.where, sort_keys=True) for row in rows]
    data[MISSING] = [json.dumps(row.missing, sort_keys=True) for row in rows]
    return Table(data, fields)


def _fields(features: Mapping[str, fp.Feature]) -> dict[str, dict[str, str]]:
    """Return the metadata of each column for the Parquet schema."""
    return {
        column: {
            "unit": feature.unit,
            "floor": str(feature.floor),
            "share": str(feature.share),
            "origin": feature.origin,
            "shortcut": str(feature.shortcut).lower(),
            "behaviour": str(feature.behaviour).lower(),
            "extensive": str(feature.extensive).lower(),
            "description": feature.description,
        }
        for column, feature in features.items()
    }
