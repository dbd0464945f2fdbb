"""One air traffic run: flights, sensors, fusion and display, from start to run directory.

The recorder starts when the tracks are established. The run ends after the recipe's duration.
"""

from dataclasses import replace
from pathlib import Path

from oracle_pipeline.bags import manifest as schema
from oracle_pipeline.bags.integrity import hashes_of_files
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.run_directory import BAG_FOLDER, GRAPHS_FOLDER, bytes_on_disk
from oracle_pipeline.bags.writer import BagWriter
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
from sim.fuzzing.compilation import compile_document
from sim.fuzzing.execution import execute
from sim.fuzzing.node import ScenarioNode
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND, Executor
from sim.recording import GraphRecorder, Recorder

NODE = "/adsb_relay"  # name of the mode's node in every mode


class AtcRun:
    """The testbed, for one run.

    Parameters
    ----------
    recipe
        Recipe of the run.
    folder
        Existing and empty; gets ``bag`` and ``graphs``.

    Attributes
    ----------
    domain : Domain
        The system's graph.
    node : ScenarioNode or None
        The mode's node; None until it joins.
    """

    def __init__(self, recipe: AtcRecipe, folder: Path) -> None:
        self._recipe = recipe
        self._program = compile_document(recipe.mode, recipe.scenario)
        activation = self._program.activation
        if activation.after == "goal_accepted" or activation.until_goal is not None:
            raise self._program.scenario.error(
                ("activation",),
                "expected no goal, because air traffic has none; count from the start",
            )
        self._start_ns = round(SETTLING_S * SECOND)  # of the recording
        delay_s = activation.delay_s(recipe.attack_seed())
        self._onset_ns = self._start_ns + round(delay_s * SECOND)
        self.node: ScenarioNode | None = None
        self._folder = folder
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
        """Add the mode's node to the graph."""
        execution = execute(self._program, self._recipe.attack_seed(), self._recipe.parameters)
        self.node = ScenarioNode(self.domain, NODE, execution, latency_ns=self._latency_ns)
        self.node.begin(self._onset_ns)

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
        graphs = self._folder / GRAPHS_FOLDER
        graphs.mkdir()
        with BagWriter(self._folder / BAG_FOLDER, self._recipe.storage) as self._bag:
            recorder = Recorder(self.domain, self._bag)
            graph = GraphRecorder(self.domain, graphs)
            executor.run_until(self._start_ns + round(self._recipe.duration_s * SECOND))
            recorder.store()
            graph.finish()

    def manifest(self, wall_s: float, software: schema.Software) -> Manifest:
        """Return the facts of the finished run for its manifest."""
        recipe, scenario = self._recipe, self._program.scenario
        onset_s = (self._onset_ns - self._start_ns) / SECOND
        return Manifest(
            mode=recipe.mode,
            label=scenario.label,
            run=recipe.run,
            block=recipe.block,
            session=recipe.session.index,
            world="airspace",
            seed=recipe.seed,
            start=schema.Pose(0.0, 0.0, 0.0),
            goals=(),
            goal_results=(),
            outcome="succeeded",
            onset_s=onset_s if onset_s <= recipe.duration_s else None,
            attack=recipe.parameters,
            attack_seed=recipe.attack_seed(),
            scenario=scenario.id,
            scenario_hash=scenario.digest,
            task_effect=None,  # there is no task that could fail
            changes=() if self.node is None else self.node.changes(self._start_ns),
            recording_s=recipe.duration_s,
            contacts=(),
            topics=self._bag.topics,
            content_hash=self._bag.content_hash,
            recipe=recipe.to_dict(),
            software=software,
            measured=schema.Measured(
                wall_s=wall_s,
                bytes=bytes_on_disk(self._folder),
                files=hashes_of_files(self._folder),
            ),
        )
