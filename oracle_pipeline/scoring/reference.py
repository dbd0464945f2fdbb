"""The runs that recordings are compared with: read from a table, a root or a folder of bags."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from tqdm import tqdm

from oracle_pipeline.bags import layout
from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.parts import is_recording
from oracle_pipeline.bags.run_directory import MANIFEST_FILE
from oracle_pipeline.datasets import KEYS, feature_dataset, read_table
from oracle_pipeline.features import FeatureManager
from oracle_pipeline.scoring.isolation import extract_apart
from oracle_pipeline.scoring.verdict import ScoringError


@dataclass(frozen=True, eq=False, slots=True)
class Reference:
    """Runs to compare with, a row each, and notes on how they were read."""

    table: pd.DataFrame
    notes: tuple[str, ...] = ()


def read_reference(path: Path, manager: FeatureManager) -> Reference:
    """Read the runs to compare with.

    Parameters
    ----------
    path : Path
        A table of run features, a root with such tables below ``features/run``, or a directory with
        run directories or bags, whose features are computed. Recordings without a label count as
        normal runs, each as a block of its own.
    manager : FeatureManager
        The plugins to compute with.

    Raises
    ------
    OracleError
        If there is no such reference, or the table does not have one row for each run.
    """
    if path.is_file():
        reference = Reference(read_table(path))
    elif tables := layout.feature_tables(path, "run"):
        reference = Reference(feature_dataset(read_table(table) for table in tables))
    else:
        reference = _extracted(path, manager)
    absent = [key for key in KEYS if key not in reference.table.columns]
    if absent or reference.table["run_id"].duplicated().any():
        raise ScoringError(
            f"{path} is no table with one row for each run (columns {', '.join(KEYS)} and "
            "features); name datasets/features.parquet, which the asset feature_dataset makes."
        )
    return reference


def _extracted(folder: Path, manager: FeatureManager) -> Reference:
    """Compute the features of all recordings below a folder."""
    tables, notes, unlabelled = [], [], 0
    for path in tqdm(list(_recordings(folder)), unit="recording", disable=None, desc="reference"):
        try:
            tables_of_run, has_manifest = extract_apart(path, manager)
            table = tables_of_run.run
            notes += [f"{path}: {note}" for note in tables_of_run.notes]
            if not has_manifest:
                unlabelled += 1
                name = str(path.relative_to(folder))
                table = table.assign(run_id=name, label="normal", block=-unlabelled)
        except (OracleError, OSError) as error:
            notes.append(f"{path} is left out of the reference: {error}")
        else:
            tables.append(table)
    if not tables:
        raise ScoringError(
            f"{folder} holds no recording to compare with; name another. {' '.join(notes)}".rstrip()
        )
    if unlabelled:
        notes.append(f"{unlabelled} reference recordings have no label; they are taken as normal.")
    return Reference(feature_dataset(tables), tuple(notes))


def _recordings(folder: Path) -> Iterator[Path]:
    """Find the run directories and bags below a folder, in order."""
    if (folder / MANIFEST_FILE).is_file() or is_recording(folder):
        yield folder
    elif folder.is_dir():
        for entry in sorted(folder.iterdir()):
            if not entry.name.startswith("."):
                yield from _recordings(entry)
