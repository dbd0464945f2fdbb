"""The analysis from Python in a few calls; ``oracle_pipeline`` offers these names itself.

Each call does what the command of its name does.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.checks.run import fault_sentences
from oracle_pipeline.comparison.set_comparison import SetComparison, read_sets
from oracle_pipeline.comparison.set_comparison import compare as compare_sets
from oracle_pipeline.datasets import replacing
from oracle_pipeline.features import FeatureManager, build_manager
from oracle_pipeline.replay.picture import pictures
from oracle_pipeline.reporting import verdict_page
from oracle_pipeline.scoring import judging, output
from oracle_pipeline.scoring.card import ReferenceCard
from oracle_pipeline.scoring.conformal import check_rate
from oracle_pipeline.scoring.isolation import DEFAULT_LIMITS
from oracle_pipeline.scoring.junit import as_junit
from oracle_pipeline.scoring.learning import card_source
from oracle_pipeline.scoring.learning import learn as learn_card
from oracle_pipeline.scoring.reference import read_reference
from oracle_pipeline.scoring.verdict import Judgement, Verdict

__all__ = ["ReferenceCard", "SetComparison", "Verdict", "Verdicts", "compare", "learn", "score"]

Recordings: TypeAlias = str | Path | Iterable[str | Path]  # run directories, bags, logs


@dataclass(frozen=True, slots=True)
class Verdicts:
    """The verdicts of one call of `score`; as text, what ``oracle score`` prints.

    Attributes
    ----------
    verdicts : tuple of Verdict
        One for each robot of each recording.
    far : float
        The false positive rate.
    notes : tuple of str
        Remarks on the reference.
    together : bool
        Whether `far` holds for all recordings together.
    """

    verdicts: tuple[Verdict, ...]
    far: float
    notes: tuple[str, ...]
    together: bool
    _manager: FeatureManager

    def __iter__(self) -> Iterator[Verdict]:
        return iter(self.verdicts)

    def __getitem__(self, place: int) -> Verdict:
        return self.verdicts[place]

    def __len__(self) -> int:
        return len(self.verdicts)

    def __str__(self) -> str:
        text = output.as_text(self.verdicts, self.far, self.notes, together=self.together)
        return f"{text}{output.tally(self.verdicts)}"

    @property
    def outcome(self) -> Judgement:
        """The worst outcome."""
        return output.worst(self.verdicts)

    def write_page(self, path: str | Path) -> None:
        """Write a page (HTML) with the verdicts, their evidence and pictures."""
        verdict_page.write(
            Path(path), self.verdicts, self.far, self.notes, self._manager, DEFAULT_LIMITS, pictures
        )

    def write_junit(self, path: str | Path) -> None:
        """Write JUnit XML with a test case for each verdict."""
        with replacing(Path(path)) as sink:
            sink.write(as_junit(self.verdicts))


def learn(good: Recordings, *, plugins: str | Path | None = None) -> ReferenceCard:
    """Learn what is normal; the card has `save`, and `ReferenceCard.load` reads it.

    Parameters
    ----------
    good : path or iterable of path
        Normal recordings, or folders of them.
    plugins : path, optional
        Folder of feature plugins.

    Raises
    ------
    OracleError
        There are too few recordings, or they have no feature.
    """
    return learn_card(read_reference(_paths(good), _manager(plugins)))


def score(
    recordings: Recordings,
    reference: ReferenceCard | str | Path,
    *,
    far: float = 0.05,
    together: bool = False,
    plugins: str | Path | None = None,
) -> Verdicts:
    """Judge recordings by comparison with normal ones.

    Parameters
    ----------
    recordings : path or iterable of path
    reference : ReferenceCard or path
        A card, its file, or what `learn` takes.
    far : float
        False positive rate, in (0, 1).
    together : bool
        Whether `far` holds for all recordings together, not for each.
    plugins : path, optional
        Folder of feature plugins.

    Raises
    ------
    OracleError
        The reference or the rate cannot be used. A recording that cannot be judged has the outcome
        ``error``.
    """
    check_rate(far)
    manager = _manager(plugins)
    cards: judging.CardSource = (
        reference if isinstance(reference, ReferenceCard) else card_source(Path(reference), manager)
    )
    found = judging.score(
        _paths(recordings), cards, manager, far, together=together, check=fault_sentences
    )
    return Verdicts(tuple(found), far, cards.notes, together, manager)


def compare(
    first: str | Path, second: str | Path, *, level: float = 0.05, plugins: str | Path | None = None
) -> SetComparison:
    """Compare two folders of recordings, such as those of two builds.

    Parameters
    ----------
    first, second : path
    level : float
        Probability of reporting a difference between sets that do not differ.
    plugins : path, optional
        Folder of feature plugins.

    Raises
    ------
    OracleError
        A set has fewer than two recordings, or no feature that varies; or the level is invalid.
    """
    check_rate(level)
    return compare_sets(*read_sets(Path(first), Path(second), _manager(plugins)), level)


def _paths(recordings: Recordings) -> list[Path]:
    paths = [recordings] if isinstance(recordings, str | Path) else [*recordings]
    if not paths:
        raise OracleError("No recording is given; name at least one.")
    return [Path(path) for path in paths]


def _manager(plugins: str | Path | None) -> FeatureManager:
    return build_manager(None if plugins is None else Path(plugins))
