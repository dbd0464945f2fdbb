"""Checks the scorers of a reference card that was read: finite numbers, and parts that fit.

A card may come from any source. ``card.schema.json`` describes its facts. Here its arrays are
compared with each other, and the scorers are tried: they have to score the normal recordings as
they did when they were learned, and to notice a recording that is far from normal in everything.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.pipeline import Pipeline

from oracle_pipeline import detectors
from oracle_pipeline.scoring.alarms import RATE_PER_H, NormalWindows
from oracle_pipeline.scoring.cross_conformal import CrossConformalScorer
from oracle_pipeline.scoring.evidence import ranked_deviations, usual_ranges
from oracle_pipeline.scoring.measured_runs import MeasuredRuns
from oracle_pipeline.scoring.run_scorer import BEYOND, OF_WINDOWS

TOLERANCE = 1e-3  # of a score that another processor computes, relative
_FAR = 1e30  # beyond the clip of any scaler


def check_scorer(scorer: CrossConformalScorer, runs: pd.DataFrame) -> None:
    """Check one scorer of a card.

    Parameters
    ----------
    scorer : CrossConformalScorer
    runs : DataFrame
        Features of the card's recordings, one row each.

    Raises
    ------
    ValueError
        With the first fault.
    """
    design, folds = scorer.design, len(scorer.scorers_)
    _require(set(design.run_columns) <= set(runs.columns), "it scores features without values")
    _require(all(design.columns(level) for level in design.levels), "a level has no columns")
    _require(np.array_equal(scorer.block_, runs["block"]), "block does not fit the recordings")
    _check_numbers("fold", scorer.fold_, len(runs))
    _require(set(scorer.fold_.tolist()) == set(range(folds)), "fold does not fit the models")
    _check_numbers("held_out", scorer.held_out_, len(runs))
    _check_numbers("centre", scorer.centre_, len(design.levels))
    _check_numbers("spread", scorer.spread_, len(design.levels), above=0.0)
    levels = {*design.levels, *design.alarm_levels}
    for of_fold in [] if design.named else scorer.scorers_:  # a named detector was fitted here
        _require(of_fold.models_.keys() == levels, "a fold has not the models of all levels")
        for level, model in of_fold.models_.items():
            _check_model(level, model, design.columns(level))
        # Earlier releases know no alarms by signals.
        fits = set(of_fold.reach_) in (set(design.alarm_levels), {"windows"} & levels)
        _require(fits, "reach is not that of the levels for alarms")
        for level, reach in of_fold.reach_.items():
            width = len(of_fold.models_[level][1].location_)
            _check_numbers("reach", reach, width, above=0.0)
    if scorer.windows_ is not None:
        _check_windows(scorer.windows_)
    _check_scores(scorer, runs)
    # Evidence comes from the declarations of the columns, too.
    usual = usual_ranges(runs, design.run_features, design.run_signals, design.floors)
    ranked_deviations(usual, runs.iloc[:1])


def _require(fits: bool, fault: str) -> None:
    if not fits:
        raise ValueError(fault)


def _check_numbers(name: str, values: NDArray[Any], count: int, above: float = -np.inf) -> None:
    """Check shape, finiteness and lower bound of an array; `name` is that in the card."""
    _require(values.shape == (count,), f"{name} has shape {values.shape} instead of ({count},)")
    _require(bool(np.isfinite(values).all()), f"{name} has a value that is not finite")
    _require(bool((values > above).all()), f"{name} has a value that is not above {above:g}")


def _check_model(level: str, model: Pipeline, columns: Sequence[str]) -> None:
    """Check the scaler and the detector of a level."""
    scaler, detector = model[0], model[1]
    kept, indicated = scaler.kept_, scaler.indicated_
    for names, known in ((kept, columns), (indicated, kept)):
        distinct = len(set(names)) == len(names) and set(names) <= set(known)
        _require(distinct, f"the columns of level {level} do not fit the features")
    width = len(kept) + len(indicated)
    _check_numbers("center", scaler.center_, len(kept))
    _check_numbers("scale", scaler.scale_, len(kept), above=0.0)
    if isinstance(detector, detectors.BeyondRange):
        _check_numbers("low", detector.low_, width)
        _check_numbers("high above low", detector.high_ - detector.low_, width, above=-1e-300)
        return
    _check_numbers("location", detector.location_, width)
    if not isinstance(detector, detectors.LargestGroup):
        precision = detector.precision_
        _check_numbers("precision", precision.ravel(), width * width)
        _check_numbers("the diagonal of precision", np.diag(precision), width, above=0.0)
        return
    _check_numbers("constant", scaler.is_constant_, len(kept))
    for name, arrays, least in (
        ("noise", [detector.noise_], 0.0),
        ("typical", [detector.typical_], 0.0),
        ("variances", detector.variances_, 0.0),
        ("components", [own.ravel() for own in detector.components_], -np.inf),
    ):
        for array in arrays:
            _check_numbers(name, array, len(array), above=least)
    groups = len(detector.sizes(width))
    sizes = {len(detector.noise_), len(detector.typical_), len(detector.variances_)}
    _require(sizes == {groups}, f"the groups of level {level} do not fit its columns")


def _check_windows(windows: NormalWindows) -> None:
    """Check the scores of the normal windows, and that they give a rule for alarms."""
    count = len(windows.run)
    _check_numbers("scores", windows.scores, count)
    _check_numbers("start_s", windows.start_s, count, above=-1.0)
    fits = np.array_equal(np.unique(windows.run), np.arange(len(windows.block)))
    _require(fits, "the windows do not fit the recordings")
    later = np.diff(windows.start_s) > 0.0
    _require(bool(later[np.diff(windows.run) == 0].all()), "windows are not in order of time")
    rule = windows.rule(max(RATE_PER_H, windows.lowest_rate()))
    _require(bool(np.isfinite(rule.threshold)), "the windows give no threshold for alarms")


def _check_scores(scorer: CrossConformalScorer, runs: pd.DataFrame) -> None:
    """Let the models score the normal recordings, and some that are far from all of these."""
    design, row = scorer.design, np.arange(len(runs))
    table = pd.concat([runs[["run_id", *design.run_columns]], _far(design.run_columns)])
    windows = _far(design.window_columns).assign(window_start_s=0.0)
    of_runs = pd.DataFrame({"run_id": runs["run_id"]})  # the card has no features of their windows
    seen = MeasuredRuns.ordered(table, pd.concat([of_runs, windows], ignore_index=True))
    seen = seen.with_columns(design.run_columns, design.window_columns)
    with detectors.single_threaded():
        scores = np.stack([of_fold.score(seen) for of_fold in scorer.scorers_])
        alarms = scorer.window_scores(windows) if scorer.windows_ is not None else np.empty(0)
    _require(bool(np.isfinite(scores).all()), "a score is not a finite number")
    standard = (scores - scorer.centre_) / scorer.spread_
    _check_held_out(scorer, standard[scorer.fold_, row])
    far = standard[:, len(runs) :]
    sees = np.array([level not in BEYOND for level in scorer.levels_])  # blind with few recordings
    notices = (np.median(far, axis=0).max(axis=0)[sees] > 0.0).all()
    notices &= scorer.p_values(far.max(axis=2)).min() <= 0.5
    notices &= scorer.windows_ is None or alarms.max() > np.median(scorer.windows_.scores)
    _require(bool(notices), "a recording far from all normal ones would be normal")


def _check_held_out(scorer: CrossConformalScorer, standard: NDArray[np.float64]) -> None:
    """Compare held-out scores with those of the models, as far as the card has features."""
    of_windows = np.isin(scorer.levels_, OF_WINDOWS)
    known = standard[:, ~of_windows].max(axis=1, initial=-np.inf)
    beyond = (scorer.held_out_ - known) / (1.0 + np.abs(known))
    highest = np.inf if of_windows.any() else TOLERANCE  # windows may have raised a score
    fits = beyond.min() >= -TOLERANCE and beyond.max() <= highest
    _require(fits, "held_out does not fit the models and the recordings")


def _far(columns: Sequence[str]) -> pd.DataFrame:
    """Return rows that are far above, below, and above or below in every column."""
    ones = np.ones(len(columns))
    values = _FAR * np.stack([ones, -ones, np.resize([1.0, -1.0], len(columns))])
    names = [f"\U0010ffff{number}" for number in range(len(values))]  # after all others
    return pd.DataFrame(values, columns=list(columns)).assign(run_id=names)
