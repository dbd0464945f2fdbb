"""A plug-in for pytest: ``assert behaviour.normal(bag)``, and a marker for its rate.

pytest loads it through an entry point, so nothing heavy is imported before a test uses it.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from oracle_pipeline.bags.errors import OracleError

if TYPE_CHECKING:
    from oracle_pipeline import ReferenceCard

_INI = "behaviour_reference"
_FAR = 0.05
_NO_VERDICT = 2  # exit code
_MARKER = (
    "behaviour(far=0.05, reference=None): false positive rate of the fixture behaviour, and the "
    "card or folder of normal recordings to compare with"
)
_learned = pytest.StashKey[dict[Path, "ReferenceCard"]]()


@dataclass(frozen=True, slots=True)
class Answer:
    """Whether recordings are normal, and if not, why."""

    is_normal: bool
    reasons: str

    def __bool__(self) -> bool:
        return self.is_normal

    def __repr__(self) -> str:
        return self.reasons or "normal"


class Behaviour:
    """Compares recordings with normal ones, by the card of a test.

    Parameters
    ----------
    item : Item
        The test.
    """

    def __init__(self, item: pytest.Item) -> None:
        self._item = item

    def normal(self, *recordings: str | Path) -> Answer:
        """Return whether recordings are like normal ones; false says why.

        Raises
        ------
        OracleError
            A recording cannot be judged, or there are too few normal ones for the rate.
        """
        from oracle_pipeline import score
        from oracle_pipeline.scoring.output import EXIT_CODES, in_brief

        verdicts = score(recordings, self._reference(), far=self._setting("far", _FAR))
        reasons = in_brief(verdicts.verdicts).strip()
        if EXIT_CODES[verdicts.outcome] == _NO_VERDICT:
            raise OracleError(reasons)
        if reasons:
            self._item.add_report_section("call", "behaviour", str(verdicts))
        return Answer(not reasons, reasons)

    def _reference(self) -> "ReferenceCard":
        """Return the card, which is read or learned once in a session."""
        from oracle_pipeline import ReferenceCard, learn
        from oracle_pipeline.scoring.card import is_card

        config = self._item.config
        named = self._setting("reference", config.getini(_INI))
        if not named:
            raise pytest.UsageError(
                f"The fixture behaviour needs normal recordings: set {_INI} in the configuration "
                "of pytest, or mark the test with behaviour(reference=...)."
            )
        path = config.rootpath / named
        cards = config.stash.setdefault(_learned, {})
        if path not in cards:
            cards[path] = ReferenceCard.load(path) if is_card(path) else learn(path)
        return cards[path]

    def _setting(self, name: str, default: Any) -> Any:
        """Return a setting of the closest marker that has it."""
        markers = self._item.iter_markers("behaviour")
        return next((each.kwargs[name] for each in markers if name in each.kwargs), default)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the setting of the reference."""
    parser.addini(_INI, "Reference card, or folder of normal recordings, for behaviour.normal")


def pytest_configure(config: pytest.Config) -> None:
    """Declare the marker."""
    config.addinivalue_line("markers", _MARKER)


@pytest.fixture
def behaviour(request: pytest.FixtureRequest) -> Behaviour:
    """Compare recordings with normal ones: ``assert behaviour.normal(bag)``."""
    return Behaviour(request.node)
