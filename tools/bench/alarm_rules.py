"""Compare rules for alarms on the same windows: today's, and evidence that is valid at any time.

``python -m tools.bench.alarm_rules ROOT`` reads the feature tables of a campaign, learns a card
from two thirds of its blocks, and feeds the windows of the others to each rule. A conformal p-value
of a window is its rank among the card's held-out windows. A martingale multiplies the gains of bets
on small p-values, and is promised to reach 20 in at most 5 % of normal recordings, however long. An
e-detector adds those that began at each window, and is promised to take as long on average until a
false alarm as today's rule. Both promises need windows that do not depend on each other.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.datasets import feature_dataset, read_table, window_dataset
from oracle_pipeline.scoring.alarms import RATE_PER_H, REPEAT_S, AlarmRule, Statistic
from oracle_pipeline.scoring.learning import learn
from oracle_pipeline.scoring.reference import Reference
from oracle_pipeline.windows import HOP_S, WINDOW_S

NORMAL = ("lidar_passthrough", "lidar_passthrough_odom", "delayed_passthrough")
ATTACKS = ("random_noise", "fake_object", "delayed_fakeobject")
_BETS = np.linspace(0.005, 0.995, 100)  # exponents of the power calibrator, mixed evenly
_ENOUGH = 20.0

Floats: TypeAlias = NDArray[np.float64]
Rule: TypeAlias = Callable[[Floats, Floats], NDArray[np.bool_]]  # scores, p-values -> alarms


def scan(rule: AlarmRule) -> Rule:
    """Return today's rule."""

    def raised(scores: Floats, _p: Floats) -> NDArray[np.bool_]:
        statistic = Statistic(rule)
        return np.array([statistic.feed(score) > rule.threshold for score in scores])

    return raised


def martingale(every: int) -> Rule:
    """Return the test martingale, which bets on every n-th window."""

    def raised(_scores: Floats, p: Floats) -> NDArray[np.bool_]:
        used = np.arange(len(p)) % every == 0
        wealth = np.cumsum(used) * np.log(_BETS)[:, None]
        wealth = wealth + (_BETS - 1.0)[:, None] * np.cumsum(np.log(p) * used)
        return np.asarray(np.logaddexp.reduce(wealth) - np.log(len(_BETS)) > np.log(_ENOUGH))

    return raised


def detector(every: int, per_hour: float) -> Rule:
    """Return the e-detector of Shiryaev and Roberts, which bets on every n-th window."""
    limit = 3600.0 / per_hour / (HOP_S * every)

    def raised(_scores: Floats, p: Floats) -> NDArray[np.bool_]:
        evidence, found = np.zeros(len(_BETS)), np.zeros(len(p), bool)
        for n, each in enumerate(p):
            if n % every == 0:
                evidence = np.minimum((1.0 + evidence) * _BETS * each ** (_BETS - 1.0), 1e300)
            found[n] = evidence.mean() > limit
        return found

    return raised


def main() -> None:
    """Print false alarms and delays of each rule."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("root", type=Path, help="of a campaign with features/")
    root = parser.parse_args().root
    modes = (*NORMAL, *ATTACKS)
    folders = [root / "features" / table / mode for table in ("run", "window") for mode in modes]
    runs = sorted(set.intersection(*({p.stem for p in each.glob("*.parquet")} for each in folders)))
    known, others = runs[: len(runs) * 2 // 3], runs[len(runs) * 2 // 3 :]
    tables = [
        [_table(root, table, mode, run) for mode in NORMAL for run in known]
        for table in ("run", "window")
    ]
    scorer = learn(Reference(feature_dataset(tables[0]), window_dataset(tables[1]))).scorer
    normal, rng = scorer.windows_, np.random.default_rng(0)
    assert normal is not None  # noqa: S101 -- it was learned from windows
    per_hour = max(RATE_PER_H, normal.lowest_rate())
    judged = {}
    for mode in modes:
        for run in others:
            windows = _table(root, "window", mode, run)
            columns = dict.fromkeys([*windows.columns, *scorer.design.window_columns])
            scores = scorer.window_scores(windows.reindex(columns=list(columns)))
            higher = (normal.scores[:, None] > scores).sum(axis=0)
            equal = (normal.scores[:, None] == scores).sum(axis=0)
            p = (higher + rng.random(len(scores)) * (equal + 1)) / (len(normal.scores) + 1)
            judged[mode, run] = windows["window_start_s"].to_numpy() + WINDOW_S, scores, p
    rules = {
        "today's rule": scan(normal.rule(per_hour)),
        **{f"martingale, every {n}. window": martingale(n) for n in (1, 2)},
        **{f"e-detector, every {n}. window": detector(n, per_hour) for n in (1, 2)},
    }
    print(f"{len(known)} blocks known, {len(others)} judged, {per_hour:.2g} false alarms per hour")
    for name, rule in rules.items():
        _report(name, rule, judged, root)


def _report(name: str, rule: Rule, judged: dict[tuple[str, str], Any], root: Path) -> None:
    false, hours, delays = 0, 0.0, []
    for (mode, run), (ends_s, scores, p) in judged.items():
        raised = ends_s[rule(scores, p)]
        if mode in NORMAL:
            hours += len(scores) * HOP_S / 3600.0
            last = -np.inf
            for at_s in raised:
                if at_s >= last + REPEAT_S:
                    false, last = false + 1, at_s
            continue
        manifest = root / "runs" / mode / run / "manifest.json"
        onset_s = json.loads(manifest.read_text())["onset_s"] if "delayed" in mode else 0.0
        if onset_s is not None:
            delays.append(min(raised[raised > onset_s] - onset_s, default=np.inf))
    found = np.isfinite(delays).mean()
    print(
        f"{name}: {false} false alarms in {hours:.2f} h; {found:.0%} of {len(delays)} attacks, "
        f"median delay {np.median(delays):.1f} s"
    )


def _table(root: Path, table: str, mode: str, run: str) -> Any:
    return read_table(root / "features" / table / mode / f"{run}.parquet")


if __name__ == "__main__":
    main()
