"""Collects the faults of a scenario, so that all are reported together."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from sim.fuzzing.scenario import ScenarioError, together


class TooMuchError(ScenarioError):
    """The limit of compilation is reached, so the search for faults ends."""


@dataclass(frozen=True, slots=True)
class Faults:
    """Gathers the faults of parts that do not depend on each other.

    Examples
    --------
    >>> faults = Faults()
    >>> for line in ("one", "two"):
    ...     with faults.gathered():
    ...         raise ScenarioError(line)
    >>> faults.end()
    Traceback (most recent call last):
    sim.fuzzing.scenario.ScenarioError: one
    two
    """

    _found: list[ScenarioError] = field(default_factory=list)

    @contextmanager
    def gathered(self) -> Iterator[None]:
        """Store the fault of one part, and continue after it."""
        try:
            yield
        except TooMuchError:
            raise
        except ScenarioError as error:
            self._found.append(error)

    def end(self) -> None:
        """Refuse the scenario if there was a fault; called before a stage that needs all parts.

        Raises
        ------
        ScenarioError
            With a line for each of the first faults.
        """
        if self._found:
            raise together(self._found)
