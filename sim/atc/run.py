"""One air traffic run: flights, sensors, fusion and display, from start to run directory.

The recorder starts when the tracks are established. The run ends after the recipe's duration.
"""

from dataclasses import replace
from pathlib import Path

from oracle_pipeline.bags import manifest as schema
from oracle_pipeline.bags.manifest import Manifest
from sim.atc.airspace import AirSpace
from sim.atc.conflict_detection import ConflictDetection
from sim.atc.display import ControllerDisplay
from sim.atc.fusion import Fusion
from sim.atc.recipes import SETTLING_S, AtcRecipe
from sim.atc.sensors import (
    PRIMARY,
    SECONDARY,
    AdsbReceiver,
    AirspaceClock,
    PrimaryRadar,
    SecondaryRadar,
    Transponder,
)
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND, Executor
from sim.testbed_run import TestbedRun

NODE = "/adsb_relay"  # name of the mode's node in every mode


class AtcRun(TestbedRun):
    """The testbed, for one run."""

    _recipe: AtcRecipe

    def __init__(self, recipe: AtcRecipe, folder: Path) -> None:
        super().__init__(recipe, folder)
        activation = self._program.activation
        if activation.after == "goal_accepted" or activation.until_goal is not None:
            raise self._program.scenario.error(
                ("activation",),
                "expected no goal, because air traffic has none; count from the start",
            )
        self._start_ns = round(SETTLING_S * SECOND)
        delay_s = activation.delay_s(recipe.attack_seed())
        self._onset_ns = self._start_ns + round(delay_s * SECOND)
        self._air = AirSpace(recipe.flights, recipe.session.wind)
        self._executor = Executor(on_advance=self._air.advance_to)
        self.domain = Domain(self._executor)
        self._latency_ns = round(recipe.session.latency_ms * MILLISECOND)
        self._add_sensors()
        if activation.before == "forward":
            self._start_node()
        else:
            self._executor.call_at(self._onset_ns, self._start_node)
        Fusion(self.domain, latency_ns=self._latency_ns)
        ConflictDetection(self.domain, latency_ns=self._latency_ns)
        ControllerDisplay(self.domain, latency_ns=self._latency_ns)

    def _start_node(self) -> None:
        self._join(NODE, self._latency_ns).begin(self._onset_ns)

    def _add_sensors(self) -> None:
        recipe, domain, air = self._recipe, self.domain, self._air
        session = recipe.session
        bias = {
            "range_bias_m": session.range_bias_m,
            "azimuth_bias_deg": session.azimuth_bias_deg,
        }
        who = [Transponder(f.icao24, f.callsign, f.squawk) for f in recipe.flights]
        AirspaceClock(domain)
        AdsbReceiver(domain, who, air.state, recipe.generator("/adsb_receiver"))
        PrimaryRadar(
            domain,
            air.in_the_air,
            replace(PRIMARY, **bias),
            recipe.generator("/primary_radar"),
        )
        SecondaryRadar(
            domain,
            who,
            air.in_the_air,
            replace(SECONDARY, **bias),
            recipe.generator("/secondary_radar"),
        )

    def go(self) -> None:
        """Wait until the tracks are established, then record."""
        executor = self._executor
        executor.run_until(self._start_ns)
        with self._recorded():
            executor.run_until(self._start_ns + round(self._recipe.duration_s * SECOND))

    def manifest(self, wall_s: float, software: schema.Software) -> Manifest:
        """Return the facts of the finished run for its manifest."""
        recipe = self._recipe
        onset_s = (self._onset_ns - self._start_ns) / SECOND
        return Manifest(
            **self._facts(wall_s, software),
            session=recipe.session.index,
            world="airspace",
            start=schema.Pose(0.0, 0.0, 0.0),
            goals=(),
            goal_results=(),
            outcome="succeeded",
            onset_s=onset_s if onset_s <= recipe.duration_s else None,
            attack=recipe.parameters,
            recording_s=recipe.duration_s,
            contacts=(),
        )
