"""Measures the oracle and simple baselines on recordings of real robots.

It prints one table::

    python -m tools.robotbench FOLDER              # with crazyflie/, uci_arm/ and so on
    python -m tools.robotbench FOLDER crazyflie    # one set

Normal recordings are split by session where there are at least three, else one by one. Each is
scored by what was learned from the others, and so is each abnormal one. The AUC has an interval of
95 % from a bootstrap over sessions. The false positive rate is that of the exit code's rule on
normal recordings that took no part in learning, where it learns from at most 20. Further columns
count recordings that leak from one part into the other, and give the processor time of learning and
scoring, over that of the Mahalanobis distance. Files other than those of the published figures are
reported first.
"""

import argparse
import itertools
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import binomtest

from oracle_pipeline import features
from oracle_pipeline.datasets import feature_dataset, signal_columns, window_dataset
from oracle_pipeline.features import FeatureTables, build_manager
from oracle_pipeline.opened_run import open_run
from oracle_pipeline.scoring.cross_conformal import CrossConformalScorer
from oracle_pipeline.scoring.learning import learned_scorer
from oracle_pipeline.scoring.measured_runs import MeasuredRuns
from tools.robotbench.manifest import MANIFEST, compared
from tools.robotbench.sets import SETS, Case

BASELINES = ("pca", "mahalanobis", "z_3", "z_10", "isolation_forest")  # as `--detector`
FAR = 0.1  # nominal false positive rate
_HALVES = 10  # random halves for the false positive rate
_BOOTSTRAPS = 2000
_FEWEST_SESSIONS = 3  # so that splitting by session leaves enough to learn from
_NEEDED = 9  # normal recordings for a verdict at 10 %
_MOST = 20  # normal recordings to learn from for the false positive rate
_FOUND = 0.5  # share of the recordings of a dose
_DIGITS = 9  # that equal statistics share

Floats = NDArray[np.float64]


class Measured(NamedTuple):
    """The recordings of a set, with their features."""

    cases: Sequence[Case]
    table: pd.DataFrame
    windows: pd.DataFrame

    def part(self, rows: NDArray[np.intp]) -> MeasuredRuns:
        """Return some recordings."""
        return MeasuredRuns.ordered(self.table.iloc[np.sort(rows)], self.windows)


class Scores(NamedTuple):
    """Scores of the recordings of a set, each by what was learned from others."""

    normal: Floats
    bad: Floats
    p_values: Floats  # of the bad ones
    seconds: float  # of the processor


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.robotbench", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("folder", type=Path, help="folder of the sets")
    parser.add_argument("sets", nargs="*", metavar="SET", help=f"of {', '.join(SETS)}")
    arguments = parser.parse_args()
    if unknown := [name for name in arguments.sets if name not in SETS]:
        parser.error(f"there is no set {unknown[0]}; known are {', '.join(SETS)}")
    heads = ["set", "robot", "normal / abnormal", "signals", "oracle", "false positives"]
    heads += [*BASELINES, "dose", "leaks", "time"]
    chosen = arguments.sets or list(SETS)
    here = set()
    for folder in dict.fromkeys(SETS[name][0] for name in chosen):
        count, difference = compared(arguments.folder / folder, MANIFEST[folder])
        if count:
            here.add(folder)
        if difference:
            print(difference, file=sys.stderr)
    print(f"| {' | '.join(heads)} |")
    print("| --- " * len(heads) + "|")
    for name in chosen:
        folder, robot, load = SETS[name]
        if folder not in here:
            continue
        with tempfile.TemporaryDirectory(prefix="robotbench-") as work:
            measured = _measured(list(load(arguments.folder / folder, Path(work))))
        print(f"| {' | '.join([name, robot, *_row(measured)])} |", flush=True)


def _measured(cases: Sequence[Case]) -> Measured:
    """Extract the features of all recordings."""
    with ProcessPoolExecutor() as pool:
        found = list(pool.map(_extracted, [case.path for case in cases], chunksize=4))
    runs, windows = [], []
    sessions = list(dict.fromkeys(case.session for case in cases))
    paths = [case.path for case in cases]
    for number, (case, tables) in enumerate(zip(cases, found, strict=True)):
        label, session = "malicious" if case.abnormal else "normal", sessions.index(case.session)
        block = paths.index(case.original or case.path)
        run, of_windows = (
            table.assign(
                run_id=f"{number:05d}", mode="foreign", label=label, block=block, session=session
            )
            for table in tables
        )
        runs.append(run)
        windows.append(of_windows)
    return Measured(cases, feature_dataset(runs), window_dataset(windows))


def _extracted(path: Path) -> FeatureTables:
    with open_run(path) as run:
        return features.extract(run, build_manager(None))


def _row(measured: Measured) -> Iterator[str]:
    """Yield the cells of a set."""
    abnormal = np.array([case.abnormal for case in measured.cases])
    sessions = measured.table["session"].to_numpy()
    normal, bad = np.flatnonzero(~abnormal), np.flatnonzero(abnormal)
    yield f"{len(normal)} / {len(bad)}"
    yield str(len(signal_columns(measured.table)))
    ours = _scored(measured, normal, bad)
    times: dict[str, float] = {}
    yield _auc_text(ours.normal, ours.bad, sessions[normal], sessions[bad])
    yield _false_positives(measured, normal)
    for baseline in BASELINES:
        scores = _scored(measured, normal, bad, baseline)
        times[baseline] = scores.seconds
        yield _auc_text(scores.normal, scores.bad, sessions[normal], sessions[bad])
    dose = np.array([case.dose for case in measured.cases])[bad]
    known = np.isfinite(dose)
    found = ours.p_values <= _nominal(len(normal))
    yield _response(ours.bad[known], found[known], dose[known]) if known.sum() > 2 else ""
    yield _leaks(measured)
    yield f"{ours.seconds / times['mahalanobis']:.1f} times"


def _scored(
    measured: Measured, normal: NDArray[np.intp], bad: NDArray[np.intp], detector: str = ""
) -> Scores:
    """Return scores of normal recordings by what was learned from the others, and of the others."""
    began = time.process_time()
    scorer = learned_scorer(measured.part(normal), detector=detector)
    part = measured.part(bad)
    scores = scorer.scores(_columns(scorer, part))
    own, p = scorer.own_score(scores, part.block), scorer.p_values(scores, part.block)
    return Scores(scorer.held_out_, own, p, time.process_time() - began)


def _columns(scorer: CrossConformalScorer, runs: MeasuredRuns) -> MeasuredRuns:
    """Return recordings with the columns of a scorer; absent ones are missing values."""
    design = scorer.design
    return MeasuredRuns.ordered(
        runs.features.reindex(columns=["run_id", "block", *design.run_columns]),
        runs.windows.reindex(columns=["run_id", "window_start_s", *design.window_columns]),
    )


def _auc(normal: Floats, bad: Floats) -> float:
    return float(np.mean(np.sign(bad[:, None] - normal) / 2.0 + 0.5))


def _auc_text(
    normal: Floats, bad: Floats, of_normal: NDArray[np.int64], of_bad: NDArray[np.int64]
) -> str:
    """Return the AUC with its interval; sessions are drawn with replacement."""
    rng = np.random.default_rng(0)
    draws = []
    for _ in range(_BOOTSTRAPS):
        some = _redrawn(normal, of_normal, rng), _redrawn(bad, of_bad, rng)
        draws.append(_auc(*some))
    low, high = np.quantile(draws, (0.025, 0.975))
    return f"{_auc(normal, bad):.2f} [{low:.2f}, {high:.2f}]"


def _redrawn(scores: Floats, sessions: NDArray[np.int64], rng: np.random.Generator) -> Floats:
    """Return the scores of sessions drawn with replacement; of recordings if there are few."""
    units = np.unique(sessions)
    if len(units) < _FEWEST_SESSIONS:
        return scores[rng.integers(len(scores), size=len(scores))]
    drawn = rng.choice(units, size=len(units))
    return np.concatenate([scores[sessions == unit] for unit in drawn])


def _false_positives(measured: Measured, normal: NDArray[np.intp]) -> str:
    """Return the rate of false positives on normal recordings that took no part in learning.

    The nominal rate is `FAR`, or the lowest that the recordings support. The interval of 95 % is
    that of as many trials as there are recordings.
    """
    splits = list(_splits(normal))
    nominal, called = _nominal(len(splits[0][0])), []
    for fit, held in splits:
        scorer = learned_scorer(measured.part(fit))
        p = scorer.p_values(scorer.scores(_columns(scorer, measured.part(held))))
        called += (p <= nominal).tolist()
    rate = float(np.mean(called))
    interval = binomtest(round(rate * len(normal)), len(normal)).proportion_ci()
    return f"{rate:.2f} [{interval.low:.2f}, {interval.high:.2f}] at {nominal:.0%}"


def _splits(normal: NDArray[np.intp]) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Yield recordings to learn from, at most `_MOST`, and others; one by one if there are few."""
    fit = min(_MOST, len(normal) // 2)
    if fit < _NEEDED:
        yield from ((np.delete(normal, row), normal[[row]]) for row in range(len(normal)))
        return
    rng = np.random.default_rng(0)
    for _ in range(_HALVES):
        drawn = rng.permutation(normal)
        yield drawn[:fit], drawn[fit:]


def _nominal(recordings: int) -> float:
    """Return the rate of verdicts that so many normal recordings support, at least `FAR`."""
    return max(FAR, 1.0 / (recordings + 1.0))


def _leaks(measured: Measured) -> str:
    """Return how many recordings are as another one: all of it, mirrored, or from its start on.

    Copies that the bench altered do not count.
    """
    own = np.array([case.original is None for case in measured.cases])
    runs, windows = measured.table[own], measured.windows
    starts = windows[(windows["window_start_s"] == 0.0) & windows["run_id"].isin(runs["run_id"])]
    starts = starts[starts["run_id"].isin(windows.loc[windows["window_start_s"] > 0.0, "run_id"])]
    signals = runs[signal_columns(runs)].round(_DIGITS)
    magnitudes = signals[
        [c for c in signals if str(c).endswith((".mean", ".std", ".change"))]
    ].abs()
    equal = int(signals.duplicated(keep=False).sum())
    mirrored = int(magnitudes.duplicated(keep=False).sum()) - equal
    begun = int(starts[signal_columns(starts)].round(_DIGITS).duplicated(keep=False).sum())
    return f"{equal} equal, {mirrored} mirrored, {max(begun - equal, 0)} with equal starts"


def _response(scores: Floats, found: NDArray[np.bool_], dose: Floats) -> str:
    """Return how score and share of found recordings rise with the dose.

    That is the rank correlation, median scores by quarter of the dose, and the least dose from
    which on at least half of the recordings of each dose are found.
    """
    rank = pd.Series(scores).corr(pd.Series(dose), method="spearman")
    edges = np.unique(np.quantile(dose, (0.0, 0.25, 0.5, 0.75, 1.0)))
    medians = [
        np.median(scores[(dose >= low) & (dose <= high)]) for low, high in itertools.pairwise(edges)
    ]
    doses = np.unique(dose)
    missed = [each for each in doses if found[dose == each].mean() < _FOUND]
    beyond = doses[doses > max(missed, default=-np.inf)]
    return (
        f"rank correlation {rank:.2f}; scores {', '.join(f'{each:.1f}' for each in medians)}; "
        f"least found {f'{beyond[0]:g}' if len(beyond) else 'none'}"
    )


if __name__ == "__main__":
    main()
