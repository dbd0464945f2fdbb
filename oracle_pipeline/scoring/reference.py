"""Reads the runs that recordings are compared with, from a table, a root or a folder of bags."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.bags import layout
from oracle_pipeline.bags.parts import NO_CHECKSUM, is_recording
from oracle_pipeline.bags.terminal import count_of, join_first, printable
from oracle_pipeline.datasets import KEYS, feature_dataset, read_table, window_dataset
from oracle_pipeline.features import FeatureManager, FeatureTables
from oracle_pipeline.logs.formats import recordings_below
from oracle_pipeline.robots.robot import recording_of
from oracle_pipeline.robots.roles_file import RoleChoices
from oracle_pipeline.scoring.blocks import Origin, blocks
from oracle_pipeline.scoring.contract import Observation
from oracle_pipeline.scoring.isolation import Reading, extract_each
from oracle_pipeline.scoring.verdict import ScoringError
from oracle_pipeline.windows import SHORTEST_S

WINDOWS_FILE = "windows.parquet"  # beside the table of the runs, as feature_dataset writes both


@dataclass(frozen=True, eq=False, slots=True)
class Reference:
    """Runs to learn from, and notes on how they were read.

    Attributes
    ----------
    table : DataFrame
        Features of the runs, one row each.
    windows : DataFrame or None
        Features of their windows, if known.
    observations : tuple of Observation
        Interfaces of the recordings, in the order of `table`; empty if only tables were read.
    notes : tuple of str
    roles : RoleChoices or None
        Robots and topics that a roles file named; None without one.
    """

    table: pd.DataFrame
    windows: pd.DataFrame | None = None
    observations: tuple[Observation, ...] = ()
    notes: tuple[str, ...] = ()
    roles: RoleChoices | None = None

    @property
    def recordings(self) -> NDArray[np.intp]:
        """Number of each row's recording, from 0: robots of one recording share it."""
        names = self.table["run_id"].map(recording_of)
        numbers = self.table[["block"]].groupby([names, "block"], sort=False).ngroup()
        return np.asarray(numbers, dtype=np.intp)


@np.errstate(all="ignore")  # features may be as large as numbers can be
def read_reference(
    paths: Sequence[Path], manager: FeatureManager, choices: RoleChoices | None = None
) -> Reference:
    """Read the runs to compare with.

    Parameters
    ----------
    paths : sequence of Path
        One table of run features, or one root with such tables below ``features/run``; or run
        directories, bags and folders of these, whose features are computed. Recordings without a
        label count as normal runs.
    manager : FeatureManager
        The plugins that compute the features.
    choices : RoleChoices, optional
        Robots and topics that a roles file names.

    Raises
    ------
    OracleError
        If there is no such reference, or the table does not have one row for each run.
    """
    path = paths[0]
    if len(paths) > 1:
        reference = _extracted(paths, manager, choices)
    elif path.is_file() and not is_recording(path):
        windows = path.with_name(WINDOWS_FILE)
        known = windows.is_file() and windows != path
        reference = Reference(read_table(path), read_table(windows) if known else None)
    elif tables := layout.feature_tables(path, "run"):
        of_windows = layout.feature_tables(path, "window")
        reference = Reference(
            feature_dataset(read_table(table) for table in tables),
            window_dataset(read_table(table) for table in of_windows) if of_windows else None,
        )
    else:
        reference = _extracted(paths, manager, choices)
    absent = [key for key in KEYS if key not in reference.table.columns]
    if absent or reference.table["run_id"].duplicated().any():
        raise ScoringError(
            f"{path} is not a table with one row per run (columns {', '.join(KEYS)} and "
            "features); use datasets/features.parquet, which the asset feature_dataset writes."
        )
    return reference


def _extracted(
    paths: Sequence[Path], manager: FeatureManager, choices: RoleChoices | None
) -> Reference:
    """Compute the features of recordings, and of all recordings below folders."""
    tables, windows, observations, seeds, notes, origins = [], [], [], [], [], []
    below = {path: list(recordings_below(path)) for path in paths}
    notes += [f"{path} holds no recording; it is left out." for path in below if not below[path]]
    recordings = list(dict.fromkeys(each for found in below.values() for each in found))
    reading, said = Reading(choices=choices, paced=True), dict[str, list[Path]]()
    for path, robots in extract_each(recordings, manager, reading=reading, desc="reference"):
        if isinstance(robots, Exception):
            notes.append(f"{path} is left out of the reference: {robots}")
            continue
        robots = [each for each in robots if len(each.tables.windows)]
        if not robots:
            notes.append(
                f"{path} is left out of the reference: it is shorter than {SHORTEST_S:g} s, and "
                "has no window."
            )
            continue
        origins.append(robots[0].origin)
        for recording, both, observation, origin, _ in robots:
            for note in both.notes:
                said.setdefault(note, []).append(path)
            if not origin.has_manifest:
                own = {"run_id": printable(recording), "label": "normal"}
                both = FeatureTables(*(table.assign(**own) for table in both))
            tables.append(both.run.assign(block=len(origins) - 1))
            windows.append(both.windows.assign(block=len(origins) - 1))
            observations.append(observation)
            seeds.append(str(origin.seed))
    if not tables:
        raise ScoringError(
            f"{join_first([str(path) for path in paths])} has no recording to compare with; check "
            f"the path. {' '.join(notes)}".rstrip()
        )
    notes = [*_about(origins), *notes, *_together(said)]
    block = np.array(blocks(origins))  # the robots of one recording are one block
    tables, windows = (
        [table.assign(block=block[table["block"]]) for table in each] for each in (tables, windows)
    )
    table = feature_dataset(tables)
    row = {run_id: number for number, run_id in enumerate(table["run_id"])}
    order = np.argsort([row[each["run_id"].iloc[0]] for each in tables])
    table["seed"] = [seeds[number] for number in order]
    in_order = tuple(observations[number] for number in order)
    return Reference(table, window_dataset(windows), in_order, tuple(notes), choices)


def _together(said: Mapping[str, Sequence[Path]]) -> Iterator[str]:
    """Yield each note once, with the recordings that it is on."""
    for note, paths in said.items():
        more = f" and {len(paths) - 1} more" if len(paths) > 1 else ""
        if note != NO_CHECKSUM:
            yield f"{paths[0]}{more}: {note}"


def _about(origins: Sequence[Origin]) -> Iterator[str]:
    """Yield notes on recordings without a label, and on those that are one block."""
    if unlabelled := sum(not origin.has_manifest for origin in origins):
        yield f"{count_of(unlabelled, 'reference recording')} without a label: taken as normal."
    if (count := len(set(blocks(origins)))) < len(origins):
        yield (
            f"{len(origins)} reference recordings count as {count} blocks: the others share the "
            "start, on one day, or the world of one of these."
        )
