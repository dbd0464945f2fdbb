"""One flight: Crazyflie, motion capture, server and commander, from start to run directory.

The recorder starts before the take-off. The run ends shortly after the landing, or at its time
limit. Only this module combines world, nodes and event loop.
"""

from pathlib import Path

import numpy as np

from oracle_pipeline.bags import manifest as schema
from oracle_pipeline.bags.manifest import Manifest
from sim.crazyflie.commander import FlightCommander, LegProgress
from sim.crazyflie.conditions import declare
from sim.crazyflie.firmware import Firmware
from sim.crazyflie.recipes import CrazyflieRecipe
from sim.crazyflie.server import CrazyflieServer
from sim.crazyflie.tracking import MotionCapture, SimulatorClock
from sim.crazyflie.world import START_Z, World
from sim.middleware.delays import Delays, Load
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND, Executor
from sim.testbed_run import TestbedRun

NODE = "/pose_relay"  # name of the mode's node, if it has one
START_NS = 1 * SECOND  # of the recording
TAKE_OFF_NS = 2 * SECOND  # after that
AFTER_NS = 1 * SECOND  # from the landing to the end


class CrazyflieRun(TestbedRun):
    """The testbed, for one flight."""

    _recipe: CrazyflieRecipe

    def __init__(self, recipe: CrazyflieRecipe, folder: Path) -> None:
        super().__init__(recipe, folder)
        session = recipe.session
        self._latency_ns = round(session.latency_ms * MILLISECOND)
        upright = np.array([1.0, 0.0, 0.0, 0.0])
        firmware = Firmware(np.array([0.0, 0.0, START_Z]), upright, session.gains)
        self._world = world = World(session.craft, firmware.step, recipe.generator("/world"))
        self._executor = Executor(on_advance=world.advance_to)
        self.domain = Domain(self._executor, self._delays)
        SimulatorClock(self.domain)
        MotionCapture(
            self.domain, lambda: (world.position, world.quaternion), session.tracking_m,
            session.tracking_rad, session.lost, recipe.generator("/motion_capture_tracking"),
        )  # fmt: skip
        CrazyflieServer(
            self.domain, firmware, lambda: world.volts, recipe.generator("/crazyflie_server"),
            self._latency_ns,
        )  # fmt: skip
        self._commander = FlightCommander(self.domain, self._latency_ns)
        declare(self.domain, world.change)
        self._is_over = False
        self._start_ns = START_NS
        self._end_ns = 0
        self._onset_ns: int | None = None
        self._flown_m: list[float] = []  # of each leg

    def go(self) -> None:
        """Record the flight, and write bag and graphs."""
        run, activation = self._executor, self._program.activation
        if activation.before == "forward":
            self._join(NODE, self._latency_ns)
        run.run_until(START_NS)
        if activation.after == "start":
            self._set_onset()
        with self._recorded():
            run.run_until(START_NS + TAKE_OFF_NS)
            self._commander.fly(self._recipe.legs, self._on_leg, self._on_end)
            self._measure(self._world.position)
            limit_ns = START_NS + round(self._recipe.timeout_s * SECOND)
            run.run_until(limit_ns, stop=lambda: self._is_over)
            if self._is_over:
                run.run_until(run.now_ns + AFTER_NS)
            self._end_ns = run.now_ns

    def manifest(self, wall_s: float, software: schema.Software) -> Manifest:
        """Return the facts of the finished run for its manifest."""
        recipe, onset_ns = self._recipe, self._onset_ns
        results = tuple(map(self._goal_result, self._commander.results, self._flown_m))
        # The worst of the legs; a flight that ended without one has none.
        worst: schema.Outcome = "aborted" if not results else "succeeded"
        for result in results:
            worst = worst if result.outcome == "succeeded" else result.outcome
        joined = self.node is not None and onset_ns is not None and onset_ns <= self._end_ns
        return Manifest(
            **self._facts(wall_s, software),
            session=recipe.session.index,
            world="room",
            start=schema.Pose(0.0, 0.0, 0.0),
            goals=tuple(schema.Pose(leg.x, leg.y, leg.yaw) for leg in recipe.legs),
            goal_results=results,
            outcome=worst,
            onset_s=self._seconds(onset_ns) if joined and onset_ns is not None else None,
            attack=recipe.parameters,
            drive=schema.Drive(None, 0, 0),
            recording_s=self._seconds(self._end_ns),
            contacts=tuple(
                schema.Contact(self._seconds(touch.stamp_ns), "floor")
                for touch in self._world.touches
            ),
        )

    def _on_leg(self, number: int) -> None:
        self._flown_m.append(0.0)
        activation = self._program.activation
        if activation.after == "goal_accepted" and number == activation.goal:
            self._set_onset()
        if number == activation.until_goal and self.node is not None:
            self.node.end(self._executor.now_ns)

    def _on_end(self) -> None:
        self._is_over = True

    def _set_onset(self) -> None:
        """Activate the scenario after its delay from now."""
        delay_s = self._program.activation.delay_s(self._recipe.attack_seed())
        self._onset_ns = self._executor.now_ns + round(delay_s * SECOND)
        if self.node is None:
            self._executor.call_at(self._onset_ns, self._start_node)
        else:
            self.node.begin(self._onset_ns)

    def _start_node(self) -> None:
        self._join(NODE, self._latency_ns).begin(self._executor.now_ns)

    def _measure(self, before: np.ndarray) -> None:
        """Sum up the distance flown, ten times a second."""
        here = self._world.position
        if self._flown_m:
            self._flown_m[-1] += float(np.linalg.norm(here - before))
        self._executor.call_at(self._executor.now_ns + 100 * MILLISECOND, self._measure, here)

    def _delays(self, node: str) -> Delays | None:
        if node == NODE:  # it needs the times at which its messages were sent
            return None
        load = Load(self._recipe.session.jitter_ms)
        return Delays(load, self._recipe.generator(f"{node} delays"))

    def _goal_result(self, leg: LegProgress, flown_m: float) -> schema.GoalResult:
        ended_s = None if leg.ended_ns is None else self._seconds(leg.ended_ns)
        return schema.GoalResult(
            self._seconds(leg.accepted_ns), ended_s, leg.outcome or "timeout", flown_m, 0
        )

    def _seconds(self, time_ns: int) -> float:
        """Return a time in seconds of the recording; times before its beginning become 0."""
        return max(time_ns - self._start_ns, 0) / SECOND
