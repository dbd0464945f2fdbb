"""A run with goals: its onset may wait for one, and its manifest has the way to each."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from oracle_pipeline.bags.manifest import GoalResult, Outcome
from sim.arrays import Floats
from sim.goal_progress import Commander, GoalProgress
from sim.middleware.executor import MILLISECOND, SECOND, Executor
from sim.testbed import Recipe
from sim.testbed_run import TestbedRun

BEFORE_RECORDING_NS = 1 * SECOND
BEFORE_PROGRAM_NS = 2 * SECOND  # from the recorder's start
_PERIOD_NS = 100 * MILLISECOND  # a tenth of a second at 0.26 m/s is 3 cm of a smooth arc


class Odometer:
    """Records the true path of a robot, and sums up its length in parts; no node has access to it.

    Parameters
    ----------
    executor
        Its clock.
    place
        Ground truth of the robot's position [m].
    """

    def __init__(self, executor: Executor, place: Callable[[], Sequence[float]]) -> None:
        self._executor = executor
        self._place = place
        self._last = place()
        self._places: list[Sequence[float]] = []
        self._total_m = 0.0
        self._marks: list[float] = []
        self._measure()

    def mark(self) -> None:
        """Begin a new part of the path."""
        self._marks.append(self._total_m)

    def distances(self) -> list[float]:
        """Return the length of each part so far [m]."""
        ends = [*self._marks, self._total_m][1:]
        return [end - begin for begin, end in zip(self._marks, ends, strict=True)]

    def places(self) -> Floats:
        """Return the positions since the first part began, shape (n, 2) or (n, 3) [m]."""
        return np.array(self._places).reshape(-1, len(self._last))

    def _measure(self) -> None:
        here = self._place()
        if self._marks:
            self._places.append(here)
        self._total_m += math.dist(here, self._last)
        self._last = here
        self._executor.call_at(self._executor.now_ns + _PERIOD_NS, self._measure)


class GoalRun(TestbedRun):
    """A testbed with goals, for one run.

    A derived class has a name for the mode's node, sets the attributes below, and calls `_conduct`
    once the system has started.
    """

    NODE: ClassVar[str]  # name of the mode's node in every mode
    AFTER_NS: ClassVar[int] = 1 * SECOND  # from the end of the program to that of the recording
    _executor: Executor
    _latency_ns: int
    _odometer: Odometer
    _commander: Commander

    def __init__(self, recipe: Recipe, folder: Path) -> None:
        super().__init__(recipe, folder)
        self._end_ns = 0
        self._onset_ns: int | None = None
        self._attack_end_ns: int | None = None

    def _conduct(self, start: Callable[[], None], timeout_s: float) -> None:
        """Record a program, from shortly before its start until shortly after its end.

        Parameters
        ----------
        start
            Starts the program, which calls `_on_goal` for each goal.
        timeout_s
            Longest recording [s].
        """
        run = self._executor
        self._prepare()
        run.run_until(run.now_ns + BEFORE_RECORDING_NS)
        self._begin()
        with self._recorded():
            run.run_until(self._start_ns + BEFORE_PROGRAM_NS)
            start()
            timeout_ns = self._start_ns + round(timeout_s * SECOND)
            run.run_until(timeout_ns, stop=lambda: self._commander.is_over)
            if self._commander.is_over:
                run.run_until(run.now_ns + self.AFTER_NS)
            self._end_ns = run.now_ns

    def _prepare(self) -> None:
        """Add the mode's node, unless it is absent until the onset."""
        if self._program.activation.before == "forward":
            self._start_node()

    def _begin(self) -> None:
        """Begin the recording now."""
        self._start_ns = self._executor.now_ns
        if self._program.activation.after == "start":
            self._set_onset(self._start_ns)

    def _on_goal(self, number: int) -> None:
        """Take the number of a goal that was accepted, from 1."""
        self._odometer.mark()
        activation, now_ns = self._program.activation, self._executor.now_ns
        if activation.after == "goal_accepted" and number == activation.goal:
            self._set_onset(now_ns)
        if number == activation.until_goal:
            self._attack_end_ns = now_ns
            if self.node is not None:
                self.node.end(now_ns)

    def _set_onset(self, after_ns: int) -> None:
        """Activate the scenario, after its delay from ``after_ns``."""
        activation = self._program.activation
        self._onset_ns = after_ns + round(activation.delay_s(self._recipe.attack_seed()) * SECOND)
        if activation.before == "absent":
            self._executor.call_at(self._onset_ns, self._start_node)
        elif self.node is not None:
            self.node.begin(self._onset_ns)

    def _start_node(self) -> None:
        """Add the mode's node to the graph."""
        node = self._join(self.NODE, self._latency_ns)
        if self._onset_ns is not None:
            node.begin(self._onset_ns)
        if self._attack_end_ns is not None:
            node.end(self._attack_end_ns)

    def _onset_s(self) -> float | None:
        """Return when the node had joined and its scenario began to act; None if it never did."""
        if self.node is None or self._onset_ns is None or self._onset_ns > self._end_ns:
            return None
        return self._seconds(self._onset_ns)

    def _seconds(self, time_ns: int) -> float:
        """Return a time in seconds of the recording; times before its beginning become 0."""
        return max(time_ns - self._start_ns, 0) / SECOND

    def _results(self) -> dict[str, Any]:
        results = tuple(map(self._goal_result, self._commander.results, self._odometer.distances()))
        # The worst of the goals; one that was never reached stands for those never sent.
        failed = [result.outcome for result in results if result.outcome != "succeeded"]
        return {
            "goal_results": results,
            "outcome": failed[0] if failed else "succeeded" if results else "aborted",
            "onset_s": self._onset_s(),
            "recording_s": self._seconds(self._end_ns),
        }

    def _goal_result(self, goal: GoalProgress, way_m: float) -> GoalResult:
        ended_s = None if goal.ended_ns is None else self._seconds(goal.ended_ns)
        outcome: Outcome = "timeout"  # the run ended before the goal did
        if goal.outcome is not None:
            outcome = "succeeded" if goal.outcome == "succeeded" else "aborted"
        accepted_s = self._seconds(goal.accepted_ns)
        return GoalResult(accepted_s, ended_s, outcome, way_m, goal.number_of_recoveries)
