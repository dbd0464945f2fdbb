"""A run of a fixed duration without goals, which needs no more than the nodes of its system."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from sim.middleware.domain import Domain
from sim.middleware.executor import SECOND, Executor
from sim.testbed import Recipe
from sim.testbed_run import TestbedRun


class TimedRun(TestbedRun):
    """A testbed whose system starts, settles, and is recorded for a while.

    A derived class adds its nodes to ``domain``, and the mode's node with `add_mode`.

    Parameters
    ----------
    recipe, folder
        As for `TestbedRun`.
    advance
        Called with the new time [ns] whenever time goes on: the physics advances here.
    duration_s
        Length of the recording [s].
    settling_s
        Time before the recording begins [s].
    session
        Number of the session.
    world
        Identifier of the world.
    """

    def __init__(
        self, recipe: Recipe, folder: Path, advance: Callable[[int], None] = lambda _: None, *,
        duration_s: float, settling_s: float = 0.0, session: int, world: str,
    ) -> None:  # fmt: skip
        super().__init__(recipe, folder)
        activation = self._program.activation
        if activation.after == "goal_accepted" or activation.until_goal is not None:
            raise self._program.scenario.error(
                ("activation",),
                "expected no goal, because this testbed has none; count from the start",
            )
        self._duration_s, self._session, self._world = duration_s, session, world
        self._start_ns = round(settling_s * SECOND)
        delay_s = activation.delay_s(recipe.attack_seed())
        self._onset_ns = self._start_ns + round(delay_s * SECOND)
        self._executor = Executor(on_advance=advance)
        self.domain = Domain(self._executor)

    def add_mode(self, name: str, latency_ns: int = 0) -> None:
        """Add the mode's node, now or at the onset; the topics that it reads exist by then."""

        def join() -> None:
            self._join(name, latency_ns).begin(self._onset_ns)

        if self._program.activation.before == "forward":
            join()
        else:
            self._executor.call_at(self._onset_ns, join)

    def go(self) -> None:
        """Let the system settle, then record."""
        self._executor.run_until(self._start_ns)
        with self._recorded():
            self._executor.run_until(self._start_ns + round(self._duration_s * SECOND))

    def _results(self) -> dict[str, Any]:
        onset_s = (self._onset_ns - self._start_ns) / SECOND
        return {
            "session": self._session,
            "world": self._world,
            "onset_s": onset_s if onset_s <= self._duration_s else None,
            "recording_s": self._duration_s,
        }
