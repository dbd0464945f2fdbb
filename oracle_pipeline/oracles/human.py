"""Human oracle: learns from a person's answers whether a few runs are good or bad.

The scores of the other kinds are a run's coordinates. It asks about the runs of which a model of
the answers is least sure, and that are far from earlier questions (uncertainty and diversity [1]_).
Answers are stored in a small JSON file::

    {"answers": {"fake_object/run003": "bad", "lidar_passthrough/run001": "good"}}

References
----------
.. [1] B. Settles, "Active learning literature survey", University of Wisconsin-Madison, 2009.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sklearn.linear_model import LogisticRegression

from oracle_pipeline.clustering.scaling import MAD_TO_DEVIATION
from oracle_pipeline.datasets import replacing
from oracle_pipeline.features.plugin import hookimpl
from oracle_pipeline.oracles.implicit import Implicit
from oracle_pipeline.oracles.invariants import Invariants
from oracle_pipeline.oracles.kind import (
    Judge,
    KindError,
    Maker,
    Material,
    OracleKind,
    TracedRuns,
)
from oracle_pipeline.oracles.specified import Specified

BAD, GOOD = "bad", "good"
RESAMPLES = 200  # of the answers, for the interval of the threshold


class AnswerError(KindError):
    """A file of answers cannot be used."""


def load_answers(path: Path) -> dict[str, bool]:
    """Return whether each run that was asked about is bad, by run.

    Raises
    ------
    AnswerError
        It is no file of answers.
    """
    try:
        answers = json.loads(path.read_text(encoding="utf-8"))["answers"]
        wrong = [run for run, answer in answers.items() if answer not in (BAD, GOOD)]
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise AnswerError(
            f"{path} is no file of answers ({error}); see `oracle review`."
        ) from error
    if wrong:
        raise AnswerError(
            f"{path}: the answer on {wrong[0]} is {answers[wrong[0]]!r}; write {BAD} or {GOOD}."
        )
    return {str(run): answer == BAD for run, answer in answers.items()}


def save_answers(answers: Mapping[str, bool], path: Path) -> None:
    """Write answers so that a reader sees all of them or the old ones."""
    document = {"answers": {run: BAD if bad else GOOD for run, bad in answers.items()}}
    with replacing(path) as sink:
        sink.write(json.dumps(document, indent=2).encode())


@dataclass(frozen=True, eq=False, slots=True)
class Coordinates:
    """The scores of several kinds for a run, on one scale.

    Attributes
    ----------
    judges : sequence of Judge
    centre, spread : ndarray of shape (n_judges,)
        Of the scores of normal runs.
    """

    judges: Sequence[Judge]
    centre: NDArray[np.float64]
    spread: NDArray[np.float64]

    @classmethod
    def learned(cls, normal: TracedRuns, kinds: Sequence[OracleKind]) -> "Coordinates":
        """Learn all kinds, and what they say of normal runs."""
        judges = [kind.learn(normal) for kind in kinds]
        scores = np.column_stack([judge.score(normal) for judge in judges])
        centre = np.median(scores, axis=0)
        spread = MAD_TO_DEVIATION * np.median(np.abs(scores - centre), axis=0)
        return cls(judges, centre, np.where(spread > 0.0, spread, 1.0))

    def of(self, runs: TracedRuns) -> NDArray[np.float64]:
        """Return shape (n_runs, n_judges); far out, the logarithm counts."""
        scores = np.column_stack([judge.score(runs) for judge in self.judges])
        z = (scores - self.centre) / self.spread
        return np.asarray(np.sign(z) * np.log1p(np.abs(z)), dtype=np.float64)


@dataclass(frozen=True, eq=False, slots=True)
class Opinion:
    """A model of a person's answers.

    Attributes
    ----------
    coordinates : Coordinates
    weights : ndarray of shape (n_judges,)
    threshold : float
        Where bad begins: runs above it are more likely bad than good.
    low, high : float
        95 % of the resampled answers put the threshold between these.
    answers : int
    """

    coordinates: Coordinates
    weights: NDArray[np.float64]
    threshold: float
    low: float
    high: float
    answers: int

    def score(self, runs: TracedRuns) -> NDArray[np.float64]:
        """Return the weighted coordinates of each run; those above the threshold are bad."""
        return np.asarray(self.coordinates.of(runs) @ self.weights, dtype=np.float64)


class Human:
    """Learns from answers which runs a person would call bad.

    Parameters
    ----------
    answers : mapping of str to bool
        Whether a run is bad, by run.
    runs : TracedRuns
        That the answers are about, among others.
    kinds : sequence of kinds
        Whose scores a model of the answers looks at.
    """

    name = "human"
    asks = "answers"

    def __init__(
        self,
        answers: Mapping[str, bool],
        runs: TracedRuns,
        kinds: Sequence[OracleKind],
    ) -> None:
        self._answers = dict(answers)
        self._asked = runs.where(runs.table["run_id"].isin(self._answers).to_numpy())
        self._kinds = kinds

    def learn(self, normal: TracedRuns) -> Opinion:
        """Learn from the answers on runs of the blocks of some normal runs, and of no others.

        Raises
        ------
        AnswerError
            These answers are all alike.
        """
        here = np.isin(self._asked.block, np.unique(normal.block))
        asked = self._asked.where(here)
        bad = np.array([self._answers[run] for run in asked.table["run_id"]], dtype=np.bool_)
        if len(set(bad.tolist())) < 2:
            raise AnswerError(
                "The answers on these runs are all alike; answer for more runs with "
                "`oracle review`, among them good and bad ones."
            )
        coordinates = Coordinates.learned(normal, self._kinds)
        of_asked = coordinates.of(asked)
        weights, threshold = _line(of_asked, bad)
        low, high = _interval(of_asked @ weights, bad)
        return Opinion(coordinates, weights, threshold, low, high, len(bad))

    def written(self) -> int:
        """Return how many answers there are."""
        return len(self._answers)


def questions(
    coordinates: NDArray[np.float64], answers: Mapping[int, bool], passed: Set[int] = frozenset()
) -> int | None:
    """Return the most informative run to ask about next; None if all were asked about.

    It is the one for which doubt times distance is largest: how unsure a model of the answers is
    (of all runs alike, before there is a model), and how far it is from all that were asked about.

    Parameters
    ----------
    coordinates : ndarray of shape (n_runs, n_judges)
    answers : mapping of int to bool
        Whether a run is bad, by row.
    passed : set of int
        Rows to which there was no answer.
    """
    doubt = np.ones(len(coordinates))
    bad = np.array(list(answers.values()), dtype=np.bool_)
    if bad.any() and not bad.all():
        weights, threshold = _line(coordinates[list(answers)], bad)
        doubt = 1.0 / np.cosh((coordinates @ weights - threshold) / 2.0)
    taken = [*answers, *passed]
    known = coordinates[taken] if taken else np.median(coordinates, axis=0, keepdims=True)
    distance = np.linalg.norm(coordinates[:, None] - known, axis=2).min(axis=1)
    gain = (doubt + 1e-9) * (distance + 1e-9)
    gain[taken] = -1.0
    return int(np.argmax(gain)) if len(taken) < len(coordinates) else None


def interview(
    material: Material, ask: Callable[[str], bool | None], count: int
) -> Iterator[tuple[str, bool]]:
    """Ask about the most informative runs, one after the other.

    Parameters
    ----------
    material : Material
        Whose answers are not asked for again.
    ask : callable
        Takes a run and returns whether it is bad; None: the person does not know.
    count : int
        Of questions.

    Yields
    ------
    tuple of str and bool
        A run, and whether it is bad.
    """
    runs = material.runs
    coordinates = Coordinates.learned(runs.where(runs.normal), looked_at(material)).of(runs)
    names = runs.table["run_id"].tolist()
    answers = {row: material.answers[n] for row, n in enumerate(names) if n in material.answers}
    passed: set[int] = set()
    for _ in range(count):
        chosen = questions(coordinates, answers, passed)
        if chosen is None:
            return
        answer = ask(names[chosen])
        if answer is None:
            passed.add(chosen)
        else:
            answers[chosen] = answer
            yield names[chosen], answer


def with_answers(material: Material, answers: Mapping[str, bool]) -> Material:
    """Return the material with other answers."""
    return replace(material, answers=dict(answers))


def answered_by_labels(material: Material, count: int) -> Material:
    """Return the material with so many more answers, given by labels instead of a person.

    Of too few runs, nothing can be asked: there are no more answers.
    """
    runs = material.runs
    bad = dict(zip(runs.table["run_id"], runs.malicious.tolist(), strict=True))
    known = set(runs.table["run_id"][runs.malicious | runs.normal])
    try:
        told = dict(interview(material, lambda run: bad[run] if run in known else None, count))
    except KindError:
        return material
    return with_answers(material, {**material.answers, **told})


def evidence(material: Material, run: str) -> list[str]:
    """Return the score of each kind for a run, a line each, for the person who is asked."""
    runs = material.runs
    asked = runs.where((runs.table["run_id"] == run).to_numpy())
    lines = []
    for kind in looked_at(material):
        judge = kind.learn(runs.where(runs.normal))
        usual = np.quantile(judge.score(runs.where(runs.normal)), 0.95)
        lines.append(
            f"{kind.name}: {judge.score(asked)[0]:.3g}; 95 % of normal runs are below {usual:.3g}"
        )
    return lines


def learned_line(material: Material) -> str:
    """Return a sentence on the threshold between good and bad runs."""
    runs = material.runs
    try:
        opinion = Human(material.answers, runs, looked_at(material)).learn(runs.where(runs.normal))
    except AnswerError as error:
        return f"{len(material.answers)} answers. {error}"
    above = opinion.score(runs) > opinion.threshold
    return (
        f"{opinion.answers} answers put the line at {opinion.threshold:.2f} "
        f"[{opinion.low:.2f}, {opinion.high:.2f}]; {int(above.sum())} of {len(above)} runs are "
        "above it."
    )


def looked_at(material: Material) -> list[OracleKind]:
    """Return the kinds whose scores a person's answers are explained by."""
    kinds: list[OracleKind] = [Implicit(), Invariants()]
    return [*kinds, Specified(material.requirements)] if material.requirements else kinds


@hookimpl
def register_oracles() -> list[Maker]:
    """Offer the oracle that learns from answers, if there are answers."""
    return [_made]


def _made(material: Material) -> Human | None:
    if not material.answers:
        return None
    return Human(material.answers, material.runs, looked_at(material))


def _line(
    coordinates: NDArray[np.float64], bad: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], float]:
    """Return weights, none below 0, and the threshold that tell bad from good answers."""
    model = LogisticRegression(class_weight="balanced").fit(coordinates, bad)
    weights = np.maximum(model.coef_[0], 0.0)  # a higher score of any kind is worse, never better
    if not weights.any():
        weights = np.ones(coordinates.shape[1])
    return weights, _threshold(coordinates @ weights, bad)


def _threshold(scores: NDArray[np.float64], bad: NDArray[np.bool_]) -> float:
    """Return the threshold that separates good from bad answers best, both weighted equally.

    Between the neighbouring scores of answers; of several places the middle one.
    """
    known = np.unique(scores)
    places = np.concatenate([[known[0] - 1.0], (known[1:] + known[:-1]) / 2.0, [known[-1] + 1.0]])
    found = (scores[bad, None] > places).mean(axis=0) + (scores[~bad, None] <= places).mean(axis=0)
    best = np.flatnonzero(found >= found.max() - 1e-12)
    return float(places[best[len(best) // 2]])


def _interval(scores: NDArray[np.float64], bad: NDArray[np.bool_]) -> tuple[float, float]:
    rng = np.random.default_rng(0)
    good_rows, bad_rows = np.flatnonzero(~bad), np.flatnonzero(bad)
    drawn = []
    for _ in range(RESAMPLES):
        rows = np.concatenate([rng.choice(of, len(of)) for of in (good_rows, bad_rows)])
        drawn.append(_threshold(scores[rows], bad[rows]))
    low, high = np.quantile(drawn, [0.025, 0.975])
    return float(low), float(high)
