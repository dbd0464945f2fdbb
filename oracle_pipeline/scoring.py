"""Verdicts on recordings, by comparison with the right runs of a reference.

The reference is read here, split into runs that the detector is fitted on and runs that calibrate
it, and compared with each recording. Detectors are in ``oracle_pipeline.detectors``, p-values in
``oracle_pipeline.evaluation.conformal``; how a verdict is shown, in
``oracle_pipeline.reporting.verdicts``.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.pipeline import Pipeline
from tqdm import tqdm

from oracle_pipeline.bags import layout
from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.run_directory import MANIFEST_FILE
from oracle_pipeline.datasets import (
    KEYS,
    MISSING,
    WHERE,
    WINDOW_START,
    feature_columns,
    feature_dataset,
    feature_floors,
    field_metadata,
    is_malicious,
    read_table,
)
from oracle_pipeline.detectors import DEFAULT_DETECTOR, Deviation, explain, panel, pipeline
from oracle_pipeline.evaluation.campaign import feature_sets
from oracle_pipeline.evaluation.conformal import adjusted_for_suite, check_support, p_values
from oracle_pipeline.features import FeatureManager, FeatureTables, extract
from oracle_pipeline.runs import open_run

Outcome: TypeAlias = Literal["pass", "anomalous", "error"]

SEED = 0  # of detectors that draw
SHOWN = 5  # features beside a verdict
USUAL = (5.0, 95.0)  # percentiles of the right runs between which a value is usual

_BAG_METADATA = "metadata.yaml"
_BAG_SUFFIXES = (".mcap", ".db3", ".bag")


class ScoringError(OracleError):
    """A recording cannot be judged against this reference."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """One feature beside its usual range; where and when it was attained, if that is known."""

    feature: str
    z: float  # robust, in the scaler's scales
    value: float
    unit: str
    usual_low: float  # 5th and 95th percentile of the right runs
    usual_high: float
    where: str | None = None  # a topic, a pair of topics or an edge
    window_start_s: float | None = None  # of the window that is farthest out in the same direction


@dataclass(frozen=True, slots=True)
class Verdict:
    """What was found of one recording; an error has no numbers."""

    recording: str
    outcome: Outcome
    p_value: float | None = None  # among the calibration runs
    p_value_by_block: float | None = None  # the same, each block counting once
    suite_p_value: float | None = None  # adjusted for the recordings judged together
    detector: str = ""
    score: float | None = None  # the detector's, higher is more anomalous
    features: int = 0
    fit_runs: int = 0
    calibration_runs: int = 0
    calibration_blocks: int = 0
    evidence: tuple[Evidence, ...] = ()  # largest abs(z) first
    notes: tuple[str, ...] = ()
    error: str = ""


@dataclass(frozen=True, eq=False, slots=True)
class Reference:
    """Runs to compare with, a row each, and what is to be said of them."""

    table: pd.DataFrame
    notes: tuple[str, ...] = ()


def read_reference(path: Path, manager: FeatureManager) -> Reference:
    """Read the runs to compare with.

    Parameters
    ----------
    path : Path
        A table of run features, a root with such tables below ``features/run``, or a directory with
        run directories or bags, whose features are computed. Recordings without a label count as
        right runs, each as a block of its own.
    manager : FeatureManager
        The plugins to compute with.

    Raises
    ------
    OracleError
        If there is no such reference, or it is not a row a run.
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
            f"{path} is no table with one row a run (columns {', '.join(KEYS)} and features); name "
            "datasets/features.parquet, which the asset feature_dataset makes."
        )
    return reference


def _extracted(folder: Path, manager: FeatureManager) -> Reference:
    """Compute the features of all recordings below a folder."""
    tables, notes, unlabelled = [], [], 0
    for path in tqdm(list(_recordings(folder)), unit="recording", disable=None, desc="reference"):
        try:
            with open_run(path) as run:
                table = extract(run, manager).run
                if run.manifest is None:
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
        notes.append(f"{unlabelled} reference recordings have no label; they are taken as right.")
    return Reference(feature_dataset(tables), tuple(notes))


def _recordings(folder: Path) -> Iterator[Path]:
    """Find the run directories and bags below a folder, in order."""
    if not folder.is_dir():
        if folder.suffix in _BAG_SUFFIXES:
            yield folder
    elif any((folder / name).is_file() for name in (MANIFEST_FILE, _BAG_METADATA)):
        yield folder
    else:
        for entry in sorted(folder.iterdir()):
            if not entry.name.startswith("."):
                yield from _recordings(entry)


def score(
    recordings: Sequence[Path],
    reference: Reference,
    manager: FeatureManager,
    far: float,
    detector: str = DEFAULT_DETECTOR,
) -> list[Verdict]:
    """Judge recordings against right runs.

    Several recordings are a suite: `far` is then the share of right runs among those called
    anomalous (Benjamini-Hochberg). A recording that cannot be judged becomes a verdict that says
    why, and costs the others nothing.

    Parameters
    ----------
    recordings : sequence of Path
        Run directories or bags.
    reference : Reference
    manager : FeatureManager
        The plugins to compute the features with.
    far : float
        False-alarm rate, in (0, 1).
    detector : str
        A name in the panel.
    """
    found = [
        _score_one(path, reference, manager, far, detector)
        for path in tqdm(recordings, unit="recording", disable=None)
    ]
    p = np.array([verdict.p_value for verdict in found if verdict.p_value is not None])
    adjusted = iter(adjusted_for_suite(p).tolist() if len(p) else [])
    return [
        verdict if verdict.p_value is None else _settled(verdict, next(adjusted), far)
        for verdict in found
    ]


def _settled(verdict: Verdict, p: float, far: float) -> Verdict:
    return replace(verdict, suite_p_value=p, outcome="anomalous" if p <= far else "pass")


def _score_one(
    path: Path, reference: Reference, manager: FeatureManager, far: float, detector: str
) -> Verdict:
    try:
        with open_run(path) as run:
            tables = extract(run, manager)
        return compare(str(path), tables, reference.table, far, detector)
    except (OracleError, OSError) as error:
        return Verdict(str(path), "error", error=str(error))


def compare(
    recording: str,
    tables: FeatureTables,
    reference: pd.DataFrame,
    far: float,
    detector: str = DEFAULT_DETECTOR,
) -> Verdict:
    """Compare the features of one recording with right runs, on its own.

    The right runs are split by block into those that fit scaler and detector and those that
    calibrate; if the recording is one of the reference, its block takes no part.

    Raises
    ------
    OracleError
        The reference cannot support the false-alarm rate, or shares no feature with the recording.
    """
    row = tables.run
    columns, notes = _comparable(row, reference)
    right = _right_runs(row, reference, columns, notes)
    calibrates = _second_half(right)
    check_support(int(calibrates.sum()), far)

    oracle = pipeline(panel(SEED)[detector], feature_floors(reference))
    oracle.fit(right.loc[~calibrates, columns])
    (own,) = -oracle.score_samples(row[columns])
    calibration = -oracle.score_samples(right.loc[calibrates, columns])
    calibration_blocks = right.loc[calibrates, "block"].to_numpy()
    n_blocks = len(np.unique(calibration_blocks))
    (p,) = p_values(calibration, np.array([own]))
    (p_by_block,) = p_values(calibration, np.array([own]), calibration_blocks)
    if 1.0 / (n_blocks + 1.0) > far:
        notes.append(
            f"The {len(calibration)} calibration runs come from {n_blocks} "
            f"block{'s' if n_blocks > 1 else ''} (same start, goals and nuisance). As far as runs "
            f"of a block are alike, false alarms may reach {1.0 / (n_blocks + 1.0):.0%} instead of "
            f"{far:.0%}; more blocks mend that."
        )
    return Verdict(
        recording,
        "anomalous" if p <= far else "pass",
        p_value=float(p),
        suite_p_value=float(p),
        p_value_by_block=float(p_by_block),
        detector=detector,
        score=float(own),
        features=len(columns),
        fit_runs=int((~calibrates).sum()),
        calibration_runs=len(calibration),
        calibration_blocks=n_blocks,
        evidence=_evidence(oracle, tables, right),
        notes=tuple(notes),
    )


def evidence(tables: FeatureTables, reference: pd.DataFrame) -> tuple[Evidence, ...]:
    """Return what of one recording is farthest from right runs, without a verdict on it.

    If the recording is one of the reference, its block takes no part.

    Raises
    ------
    OracleError
        The reference has no right run of another block, or shares no feature with the recording.
    """
    columns, notes = _comparable(tables.run, reference)
    right = _right_runs(tables.run, reference, columns, notes)
    if right.empty:
        raise ScoringError("There is no right run of another block to compare with; record some.")
    oracle = pipeline(panel(SEED)[DEFAULT_DETECTOR], feature_floors(reference))
    oracle[0].fit(right[columns])
    return _evidence(oracle, tables, right)


def _comparable(row: pd.DataFrame, reference: pd.DataFrame) -> tuple[list[str], list[str]]:
    """Return the features to compare by, and what is to be said of the others."""
    fields, own = field_metadata(reference), field_metadata(row)
    candidates = feature_sets(reference).get("all", [])
    columns = [c for c in candidates if c in row.columns and np.isfinite(row[c]).all()]
    for column in columns:
        units = [meta[column].get("unit") for meta in (fields, own) if column in meta]
        if len(set(units)) > 1:
            raise ScoringError(
                f"{column} is in {units[0]} in the reference and in {units[1]} in the recording; "
                "extract the features of both with the same plugins."
            )
    if not columns:
        raise ScoringError(
            "The recording has none of the features of the reference; extract both with the same "
            "plugins, and compare recordings of the same kind of system."
        )
    absent = [column for column in candidates if column not in columns]
    if not absent:
        return columns, []
    reasons = json.loads(row[MISSING].iloc[0])
    why = list(dict.fromkeys(reasons.get(column, "not extracted") for column in absent))
    return columns, [
        f"Left out, as this recording does not give them, are {len(absent)} of the features of "
        f"the reference: {_listed(absent)} ({_listed(why)})."
    ]


def _listed(words: Sequence[str]) -> str:
    return ", ".join([*words[:SHOWN], *(["..."] if len(words) > SHOWN else [])])


def _right_runs(
    row: pd.DataFrame, reference: pd.DataFrame, columns: list[str], notes: list[str]
) -> pd.DataFrame:
    """Return the runs to compare with; why some right ones are not among them goes to `notes`."""
    right = reference[~is_malicious(reference)]
    alike = _same_kind(right, columns)
    if not alike.all():
        notes.append(
            f"{np.sum(~alike)} right runs of the reference are of another kind of system: they "
            "lack all features of a family that this recording has. They are left out."
        )
    own_block = right["block"].isin(reference.loc[_same_recording(reference, row), "block"])
    if own_block.any():
        notes.append("It is one of the reference runs: all runs of its block are left out.")
    return right[alike & ~own_block.to_numpy()]


def _same_kind(table: pd.DataFrame, columns: Sequence[str]) -> NDArray[np.bool_]:
    """Tell which runs have a value in each family of the features compared."""
    given = table[list(columns)].notna()
    families = [column.split(".", 1)[0] for column in columns]
    return np.asarray(given.T.groupby(families).any().all(), dtype=np.bool_)


def _same_recording(reference: pd.DataFrame, row: pd.DataFrame) -> NDArray[np.bool_]:
    """Tell which reference runs have the very features of this recording."""
    columns = [column for column in feature_columns(reference) if column in row.columns]
    theirs, own = reference[columns].to_numpy(), row[columns].to_numpy()
    same = (theirs == own) | (np.isnan(theirs) & np.isnan(own))
    return np.asarray(same.all(axis=1), dtype=np.bool_)


def _second_half(right: pd.DataFrame) -> NDArray[np.bool_]:
    """Tell which runs calibrate: those of every other block, so that sessions are in both."""
    _, rank = np.unique(right["block"].to_numpy(), return_inverse=True)
    return np.asarray(rank % 2 == 1, dtype=np.bool_)


def _evidence(oracle: Pipeline, tables: FeatureTables, right: pd.DataFrame) -> tuple[Evidence, ...]:
    deviations = explain(oracle, tables.run)[:SHOWN]
    where = json.loads(tables.run[WHERE].iloc[0])
    return tuple(
        Evidence(
            feature=deviation.feature,
            z=deviation.z,
            value=deviation.value,
            unit=deviation.unit,
            usual_low=float(low),
            usual_high=float(high),
            where=where.get(deviation.feature),
            window_start_s=_farthest_window(deviation, tables.windows),
        )
        for deviation in deviations
        for low, high in [np.nanpercentile(right[deviation.feature], USUAL)]
    )


def _farthest_window(deviation: Deviation, windows: pd.DataFrame) -> float | None:
    """Return the start of the window that is farthest out in the direction of the whole run [s].

    None if the feature has no values by window, or they are all the same.
    """
    if deviation.feature not in windows.columns or windows[deviation.feature].nunique() < 2:
        return None
    farthest = np.nanargmax(np.sign(deviation.z) * windows[deviation.feature].to_numpy())
    return float(windows[WINDOW_START].to_numpy()[farthest])
