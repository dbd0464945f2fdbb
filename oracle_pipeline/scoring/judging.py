"""Verdicts by conformal p-values: a detector fitted on normal runs, calibrated on others.

Detectors are in ``oracle_pipeline.detectors``, p-values in
``oracle_pipeline.scoring.conformal``.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from tqdm import tqdm

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.datasets import feature_floors
from oracle_pipeline.detectors import DEFAULT_DETECTOR, by_family, explain, panel, pipeline
from oracle_pipeline.features import FeatureManager, FeatureTables
from oracle_pipeline.scoring.comparable import comparable
from oracle_pipeline.scoring.conformal import adjusted_for_suite, check_support, p_values
from oracle_pipeline.scoring.evidence import farthest_features
from oracle_pipeline.scoring.isolation import DEFAULT_LIMITS, Limits, extract_apart
from oracle_pipeline.scoring.reference import Reference
from oracle_pipeline.scoring.verdict import Judgement, Verdict

SEED = 0  # of detectors that draw


def score(
    recordings: Sequence[Path],
    reference: Reference,
    manager: FeatureManager,
    far: float,
    detector: str = DEFAULT_DETECTOR,
    limits: Limits = DEFAULT_LIMITS,
    *,
    strict: bool = False,
) -> list[Verdict]:
    """Judge recordings by comparison with normal runs.

    Several recordings are a suite: `far` is then the share of normal runs among those called
    anomalous (Benjamini-Hochberg). A recording that cannot be judged gets a verdict with the
    reason, and the others are still judged.

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
    limits : Limits
        Of the process that computes the features of one recording.
    strict : bool
        Do not judge an incomplete recording.
    """
    verdicts = [
        _score_one(path, reference, manager, far, detector, limits, strict=strict)
        for path in tqdm(recordings, unit="recording", disable=None)
    ]
    p = np.array([verdict.p_value for verdict in verdicts if verdict.p_value is not None])
    adjusted = iter(adjusted_for_suite(p).tolist() if len(p) else [])
    return [
        verdict if verdict.p_value is None else _adjusted(verdict, next(adjusted), far)
        for verdict in verdicts
    ]


def _adjusted(verdict: Verdict, p: float, far: float) -> Verdict:
    return replace(verdict, suite_p_value=p, outcome=_judgement(p, far))


def _judgement(p: float, far: float) -> Judgement:
    return "anomalous" if p <= far else "normal"


def _score_one(
    path: Path, reference: Reference, manager: FeatureManager, far: float, detector: str,
    limits: Limits, *, strict: bool,
) -> Verdict:  # fmt: skip
    try:
        tables, _ = extract_apart(path, manager, limits, strict=strict)
        verdict = judge(str(path), tables, reference.table, far, detector)
        return replace(verdict, notes=(*tables.notes, *verdict.notes))
    except (OracleError, OSError) as error:
        return Verdict(str(path), "error", error=str(error))


def judge(
    recording: str,
    tables: FeatureTables,
    reference: pd.DataFrame,
    far: float,
    detector: str = DEFAULT_DETECTOR,
) -> Verdict:
    """Judge one recording on its own, from its features.

    The normal runs are split by block into those that fit scaler and detector and those that
    calibrate; if the recording is one of the reference, its block takes no part.

    Raises
    ------
    OracleError
        The reference cannot support the false-alarm rate, or shares no feature with the recording.
    """
    columns, normal_runs, notes = comparable(tables.run, reference)
    calibrates = _second_half(normal_runs)
    check_support(int(calibrates.sum()), far)

    oracle = pipeline(panel(SEED)[detector], feature_floors(reference))
    oracle.fit(normal_runs.loc[~calibrates, columns])
    (own_score,) = -oracle.score_samples(tables.run[columns])
    calibration = -oracle.score_samples(normal_runs.loc[calibrates, columns])
    calibration_blocks = normal_runs.loc[calibrates, "block"].to_numpy()
    n_blocks = len(np.unique(calibration_blocks))
    (p,) = p_values(calibration, np.array([own_score]))
    (p_by_block,) = p_values(calibration, np.array([own_score]), calibration_blocks)
    if 1.0 / (n_blocks + 1.0) > far:
        notes.append(_note_on_blocks(len(calibration), n_blocks, far))
    deviations = explain(normal_runs, tables.run, columns)
    return Verdict(
        recording,
        _judgement(float(p), far),
        p_value=float(p),
        suite_p_value=float(p),
        p_value_by_block=float(p_by_block),
        detector=detector,
        score=float(own_score),
        features=len(columns),
        fit_runs=int((~calibrates).sum()),
        calibration_runs=len(calibration),
        calibration_blocks=n_blocks,
        evidence=farthest_features(deviations, tables),
        families=tuple(by_family(deviations, columns)),
        notes=tuple(notes),
    )


def _second_half(normal_runs: pd.DataFrame) -> NDArray[np.bool_]:
    """Return True for the runs that calibrate: every other block, so that sessions are in both."""
    _, rank = np.unique(normal_runs["block"].to_numpy(), return_inverse=True)
    return np.asarray(rank % 2 == 1, dtype=np.bool_)


def _note_on_blocks(runs: int, blocks: int, far: float) -> str:
    return (
        f"The {runs} calibration runs come from {blocks} block{'s' if blocks > 1 else ''} (same "
        "start, goals and nuisance). If the runs of a block resemble each other, the false-alarm "
        f"rate may reach {1.0 / (blocks + 1.0):.0%} instead of {far:.0%}; record more blocks."
    )
