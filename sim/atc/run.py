"""One air traffic run: flights, sensors, fusion and display, from start to run directory.

The recorder starts when the tracks are established. The run ends after the recipe's duration.
"""

from dataclasses import replace
from pathlib import Path

from sim.atc import sensors
from sim.atc.airspace import AirSpace
from sim.atc.conflict_detection import ConflictDetection
from sim.atc.display import ControllerDisplay
from sim.atc.fusion import Fusion
from sim.atc.recipes import SETTLING_S, AtcRecipe
from sim.middleware.executor import MILLISECOND
from sim.timed_run import TimedRun

NODE = "/adsb_relay"  # name of the mode's node in every mode


class AtcRun(TimedRun):
    """The testbed, for one run."""

    _recipe: AtcRecipe

    def __init__(self, recipe: AtcRecipe, folder: Path) -> None:
        self._air = AirSpace(recipe.flights, recipe.session.wind)
        super().__init__(
            recipe, folder, self._air.advance_to, duration_s=recipe.duration_s,
            settling_s=SETTLING_S, session=recipe.session.index, world="airspace",
        )  # fmt: skip
        latency_ns = round(recipe.session.latency_ms * MILLISECOND)
        self._add_sensors()
        self.add_mode(NODE, latency_ns)
        Fusion(self.domain, latency_ns=latency_ns)
        ConflictDetection(self.domain, latency_ns=latency_ns)
        ControllerDisplay(self.domain, latency_ns=latency_ns)

    def _add_sensors(self) -> None:
        recipe, domain, air = self._recipe, self.domain, self._air
        session = recipe.session
        bias = {"range_bias_m": session.range_bias_m, "azimuth_bias_deg": session.azimuth_bias_deg}
        who = [sensors.Transponder(f.icao24, f.callsign, f.squawk) for f in recipe.flights]
        sensors.AirspaceClock(domain)
        sensors.AdsbReceiver(domain, who, air.state, recipe.generator("/adsb_receiver"))
        sensors.PrimaryRadar(
            domain,
            air.in_the_air,
            replace(sensors.PRIMARY, **bias),
            recipe.generator("/primary_radar"),
        )
        sensors.SecondaryRadar(
            domain,
            who,
            air.in_the_air,
            replace(sensors.SECONDARY, **bias),
            recipe.generator("/secondary_radar"),
        )
