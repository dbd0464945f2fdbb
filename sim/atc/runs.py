"""One air traffic run: flights, sensors, fusion and display, from start to run directory.

The system runs for a while until its tracks stand, then the recorder starts; the run ends after
the recipe's duration.
"""

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

from oracle_pipeline.bags import manifest as schema
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.run_directory import (
    BAG_FOLDER,
    GRAPHS_FOLDER,
    RunDirectory,
    bytes_on_disk,
)
from oracle_pipeline.bags.writer import BagWriter
from sim.atc.airspace import AirSpace
from sim.atc.conflict_detection import ConflictDetection
from sim.atc.display import ControllerDisplay
from sim.atc.fusion import Fusion
from sim.atc.recipes import SETTLING_S, AtcRecipe
from sim.atc.relay import PASSTHROUGH, AdsbRelay, Attack
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
from sim.protocol import make
from sim.recording import GraphRecorder, Recorder
from sim.software import software


@dataclass(frozen=True, slots=True)
class AtcMode:
    """One experiment on the air traffic testbed."""

    id: str
    label: schema.Label
    attack: Attack = PASSTHROUGH
    onset_s: float = 0.0  # when it begins, in seconds of the recording
    shadow: bool = False  # the relay works the attack out and hands reports on unchanged


ATC_NORMAL = AtcMode("atc_normal", "normal")


def record_atc_run(mode: AtcMode, recipe: AtcRecipe, directory: RunDirectory) -> Manifest:
    """Make one run, whole or not at all; it takes the place of one that is there.

    Raises
    ------
    OracleError
        If the run cannot be written; its place is left as it was.
    """
    make(directory, lambda folder: AtcRun(mode, recipe, folder))
    return directory.manifest()


class AtcRun:
    """The testbed, and the one run that is made in it.

    Parameters
    ----------
    mode, recipe
        What to make.
    folder
        Existing and empty; gets ``bag`` and ``graphs``.

    Attributes
    ----------
    domain : Domain
        The system's graph.
    """

    def __init__(self, mode: AtcMode, recipe: AtcRecipe, folder: Path) -> None:
        self._mode = mode
        self._recipe = recipe
        self._folder = folder
        self._air = AirSpace(recipe.flights, recipe.session.wind)
        self._executor = Executor(on_advance=self._air.advance_to)
        self.domain = Domain(self._executor)
        self._latency_ns = round(recipe.session.latency_ms * MILLISECOND)
        self._add_sensors()
        AdsbRelay(
            self.domain,
            mode.attack,
            onset_ns=round((SETTLING_S + mode.onset_s) * SECOND),
            latency_ns=self._latency_ns,
            shadow=mode.shadow,
        )
        Fusion(self.domain, latency_ns=self._latency_ns)
        ConflictDetection(self.domain, latency_ns=self._latency_ns)
        ControllerDisplay(self.domain, latency_ns=self._latency_ns)

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
        """Let the tracks settle, then record."""
        executor, start_ns = self._executor, round(SETTLING_S * SECOND)
        executor.run_until(start_ns)
        graphs = self._folder / GRAPHS_FOLDER
        graphs.mkdir()
        with BagWriter(self._folder / BAG_FOLDER, self._recipe.storage) as self._bag:
            Recorder(self.domain, self._bag)
            graph = GraphRecorder(self.domain, graphs)
            executor.run_until(start_ns + round(self._recipe.duration_s * SECOND))
            graph.finish()

    def manifest(self, wall_s: float) -> Manifest:
        """Return what the finished run was."""
        recipe, mode = self._recipe, self._mode
        return Manifest(
            mode=mode.id,
            label=mode.label,
            run=recipe.run,
            block=recipe.block,
            session=recipe.session.index,
            seed=recipe.seed,
            start=schema.Pose(0.0, 0.0, 0.0),
            goals=(),
            goal_results=(),
            outcome="succeeded",
            onset_s=mode.onset_s,
            attack={},
            scenario=mode.id,
            scenario_hash=hashlib.sha256(mode.id.encode()).hexdigest(),
            task_effect=None,
            recording_s=recipe.duration_s,
            contacts=(),
            topics=self._bag.topics,
            content_hash=self._bag.content_hash,
            recipe=recipe.to_dict(),
            software=software(),
            measured=schema.Measured(wall_s=wall_s, bytes=bytes_on_disk(self._folder)),
        )
