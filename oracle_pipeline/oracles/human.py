"""Human oracle: learns from a person's answers whether a few runs are good or bad.

The scores of the other kinds are a run's coordinates. It asks about runs for which a model of the
answers is uncertain, and that are far from earlier questions (uncertainty and diversity [1]_).
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
from oracle_pipeline.features.engine.plugin import hookimpl
from oracle_pipeline.oracles.implicit import Implicit
from oracle_pipeline.oracles.invariants import Invariants
from oracle_pipeline.oracles.kind import (
    FittedOracle,
    KindError,
    Maker,
    Material,
    OracleKind,
    TracedRuns,
)
from oracle_pipeline.oracles.specified import Specified

BAD, GOOD = "bad", "good"


class AnswerError(KindError):
    """A file of answers cannot be used."""


def load_answers(path: Path) -> dict[str, bool]:
    """Return the answers by run; True means bad.

    Raises
    ------
    AnswerError
        The file is invalid.
    """
    try:
        answers = json.loads(path.read_text(encoding="utf-8"))["answers"]
        wrong = [run for run, answer in answers.items() if answer not in (BAD, GOOD)]
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise AnswerError(
            f"{path} is not a file of answers ({error}); see `oracle review`."
        ) from error
    if wrong:
        raise AnswerError(
            f"{path}: the answer for {wrong[0]} is {answers[wrong[0]]!r}; write {BAD} or {GOOD}."
        )
    return {str(run): answer == BAD for run, answer in answers.items()}


def save_answers(answers: Mapping[str, bool], path: Path) -> None:
    """Write answers atomically."""
    document = {"answers": {run: BAD if bad else GOOD for run, bad in answers.items()}}
    with replacing(path) as sink:
        sink.write(json.dumps(document, indent=2).encode())


@dataclass(frozen=True, eq=False, slots=True)
class _Coordinates:
    """The scores of several kinds for a run, on one scale.

    Attributes
    ----------
    judges : sequence of FittedOracle
    centre, spread : ndarray of shape (n_judges,)
        Of the scores of normal runs.
    """

    judges: Sequence[FittedOracle]
    centre: NDArray[np.float64]
    spread: NDArray[np.float64]

    @classmethod
    def learned(cls, normal: TracedRuns, kinds: Sequence[OracleKind]) -> "_Coordinates":
        """Fit all kinds, and the scale of their scores on normal runs."""
        judges = [kind.learn(normal) for kind in kinds]
        scores = np.column_stack([judge.score(normal) for judge in judges])
        centre = np.median(scores, axis=0)
        spread = MAD_TO_DEVIATION * np.median(np.abs(scores - centre), axis=0)
        return cls(judges, centre, np.where(spread > 0.0, spread, 1.0))

    def of(self, runs: TracedRuns) -> NDArray[np.float64]:
        """Return the coordinates, shape (n_runs, n_judges): linear near 0, logarithmic far out."""
        scores = np.column_stack([judge.score(runs) for judge in self.judges])
        z = (scores - self.centre) / self.spread
        return np.asarray(np.sign(z) * np.log1p(np.abs(z)), dtype=np.float64)


@dataclass(frozen=True, eq=False, slots=True)
class _Opinion:
    """A model of a person's answers.

    Attributes
    ----------
    coordinates : _Coordinates
    weights : ndarray of shape (n_judges,)
    threshold : float
        Runs above it are more likely bad than good.
    """

    coordinates: _Coordinates
    weights: NDArray[np.float64]
    threshold: float

    def score(self, runs: TracedRuns) -> NDArray[np.float64]:
        """Return the weighted coordinates of each run; those above the threshold are bad."""
        return np.asarray(self.coordinates.of(runs) @ self.weights, dtype=np.float64)


class Human:
    """Learns from answers which runs a person considers bad.

    Parameters
    ----------
    answers : mapping of str to bool
        Whether a run is bad, by run.
    runs : TracedRuns
        All runs, including those with answers.
    kinds : sequence of kinds
        The kinds whose scores are the inputs of the model.
    """

    name = "human"
    asks = "answers"

    def __init__(
        self, answers: Mapping[str, bool], runs: TracedRuns, kinds: Sequence[OracleKind]
    ) -> None:
        self._answers = dict(answers)
        self._answered = runs.where(runs.table["run_id"].isin(self._answers).to_numpy())
        self._kinds = kinds

    def learn(self, normal: TracedRuns) -> _Opinion:
        """Learn from the answers on runs of the blocks of some normal runs only.

        Raises
        ------
        AnswerError
            These answers are all equal.
        """
        in_blocks = np.isin(self._answered.block, np.unique(normal.block))
        answered = self._answered.where(in_blocks)
        bad = np.array([self._answers[run] for run in answered.table["run_id"]], dtype=np.bool_)
        if len(set(bad.tolist())) < 2:
            raise AnswerError(
                "The answers on these runs are all equal; answer for more runs with "
                "`oracle review`, both good and bad ones."
            )
        coordinates = _Coordinates.learned(normal, self._kinds)
        return _Opinion(coordinates, *_line(coordinates.of(answered), bad))


def _next_question(
    coordinates: NDArray[np.float64], answers: Mapping[int, bool], passed: Set[int] = frozenset()
) -> int | None:
    """Return the most informative run to ask about next; None if there are no more.

    This is the run with the largest product of the uncertainty of a model of the answers (constant
    before there is a model) and the distance from all earlier questions.

    Parameters
    ----------
    coordinates : ndarray of shape (n_runs, n_judges)
    answers : mapping of int to bool
        Whether a run is bad, by row.
    passed : set of int
        Rows that the person could not answer.
    """
    uncertainty = np.ones(len(coordinates))
    bad = np.array(list(answers.values()), dtype=np.bool_)
    if bad.any() and not bad.all():
        weights, threshold = _line(coordinates[list(answers)], bad)
        uncertainty = 1.0 / np.cosh((coordinates @ weights - threshold) / 2.0)
    taken = [*answers, *passed]
    known = coordinates[taken] if taken else np.median(coordinates, axis=0, keepdims=True)
    distance = np.linalg.norm(coordinates[:, None] - known, axis=2).min(axis=1)
    gain = (uncertainty + 1e-9) * (distance + 1e-9)
    gain[taken] = -1.0
    return int(np.argmax(gain)) if len(taken) < len(coordinates) else None


def interview(
    material: Material, ask: Callable[[str], bool | None], count: int
) -> Iterator[tuple[str, bool]]:
    """Ask about the most informative runs, one after the other.

    Parameters
    ----------
    material : Material
        Runs with an answer in it are skipped.
    ask : callable
        Takes a run and returns whether it is bad; None if the person does not know.
    count : int
        Number of questions.

    Yields
    ------
    tuple of str and bool
        A run, and whether it is bad.
    """
    runs = material.runs
    coordinates = _Coordinates.learned(runs.where(runs.normal), input_kinds(material)).of(runs)
    names = runs.table["run_id"].tolist()
    answers = {row: material.answers[n] for row, n in enumerate(names) if n in material.answers}
    passed: set[int] = set()
    for _ in range(count):
        chosen = _next_question(coordinates, answers, passed)
        if chosen is None:
            return
        answer = ask(names[chosen])
        if answer is None:
            passed.add(chosen)
        else:
            answers[chosen] = answer
            yield names[chosen], answer


def answered_by_labels(material: Material, count: int) -> Material:
    """Return the material with `count` more answers, taken from labels instead of a person.

    With too few runs to ask about, no answers are added.
    """
    runs = material.runs
    bad = dict(zip(runs.table["run_id"], runs.malicious.tolist(), strict=True))
    known = set(runs.table["run_id"][runs.malicious | runs.normal])
    try:
        answers = dict(interview(material, lambda run: bad[run] if run in known else None, count))
    except KindError:
        return material
    return replace(material, answers={**material.answers, **answers})


def evidence(material: Material, run: str) -> list[str]:
    """Return one line per kind with its score for a run, as help for the person."""
    runs = material.runs
    chosen = runs.where((runs.table["run_id"] == run).to_numpy())
    lines = []
    for kind in input_kinds(material):
        judge = kind.learn(runs.where(runs.normal))
        usual = np.quantile(judge.score(runs.where(runs.normal)), 0.95)
        score = judge.score(chosen)[0]
        lines.append(f"{kind.name}: {score:z.3g}; 95 % of normal runs have at most {usual:z.3g}")
    return lines


def learned_line(material: Material) -> str:
    """Return a sentence on the threshold between good and bad runs."""
    runs = material.runs
    try:
        opinion = Human(material.answers, runs, input_kinds(material)).learn(
            runs.where(runs.normal)
        )
    except AnswerError as error:
        return f"{len(material.answers)} answers. {error}"
    above = opinion.score(runs) > opinion.threshold
    return (
        f"{len(material.answers)} answers: {int(above.sum())} of {len(above)} runs are more likely "
        "bad than good."
    )


def input_kinds(material: Material) -> list[OracleKind]:
    """Return the kinds whose scores are the inputs of the model of answers."""
    kinds: list[OracleKind] = [Implicit(), Invariants()]
    return [*kinds, Specified(material.requirements)] if material.requirements else kinds


@hookimpl
def register_oracles() -> list[Maker]:
    """Register the oracle that learns from answers, if there are answers."""
    return [_make]


def _make(material: Material) -> Human | None:
    if not material.answers:
        return None
    return Human(material.answers, material.runs, input_kinds(material))


def _line(
    coordinates: NDArray[np.float64], bad: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], float]:
    """Return non-negative weights and the threshold that separate bad from good answers."""
    model = LogisticRegression(class_weight="balanced").fit(coordinates, bad)
    weights = np.maximum(model.coef_[0], 0.0)  # a higher score of any kind is never better
    if not weights.any():
        weights = np.ones(coordinates.shape[1])
    return weights, _threshold(coordinates @ weights, bad)


def _threshold(scores: NDArray[np.float64], bad: NDArray[np.bool_]) -> float:
    """Return the threshold with the best balanced accuracy on the answers.

    Candidates lie midway between neighbouring scores; the middle one of equally good ones wins.
    """
    known = np.unique(scores)
    places = np.concatenate([[known[0] - 1.0], (known[1:] + known[:-1]) / 2.0, [known[-1] + 1.0]])
    found = (scores[bad, None] > places).mean(axis=0) + (scores[~bad, None] <= places).mean(axis=0)
    best = np.flatnonzero(found >= found.max() - 1e-12)
    return float(places[best[len(best) // 2]])
