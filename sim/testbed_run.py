"""What the runs of all testbeds have in common: the scenario's node, the recording, the facts."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from oracle_pipeline.bags.integrity import hashes_of_files
from oracle_pipeline.bags.manifest import Manifest, Measured, Pose, Software, TopicCount
from oracle_pipeline.bags.run_directory import BAG_FOLDER, GRAPHS_FOLDER, bytes_on_disk
from oracle_pipeline.bags.writer import BagWriter
from sim.fuzzing.compilation import compile_document
from sim.fuzzing.execution import execute
from sim.fuzzing.scenario_node import ScenarioNode
from sim.middleware.domain import Domain
from sim.recording import GraphRecorder, Recorder
from sim.testbed import Recipe


class TestbedRun(ABC):
    """A testbed that has started, and its one run.

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

    domain: Domain
    _recipe: Recipe
    _bag: BagWriter  # from the start of the recording on

    def __init__(self, recipe: Recipe, folder: Path) -> None:
        self._recipe = recipe
        self._program = compile_document(recipe.mode, recipe.scenario)
        self._folder = folder
        self._start_ns = 0  # of the recording
        self.node: ScenarioNode | None = None

    @abstractmethod
    def go(self) -> None:
        """Execute the run; write bag and graphs."""

    def manifest(self, wall_s: float, software: Software) -> Manifest:
        """Return the facts of the finished run for its manifest."""
        return Manifest(**{**self._facts(wall_s, software), **self._results()})

    @abstractmethod
    def _results(self) -> dict[str, Any]:
        """Return the fields of the manifest that depend on the testbed and on how the run went."""

    def _join(self, name: str, latency_ns: int) -> ScenarioNode:
        """Add the mode's node to the graph."""
        recipe = self._recipe
        execution = execute(self._program, recipe.attack_seed(), recipe.parameters)
        self.node = ScenarioNode(self.domain, name, execution, latency_ns=latency_ns)
        return self.node

    def _recorder_options(self) -> dict[str, Any]:
        """Return the options of `Recorder`, when the recording begins."""
        return {}

    @contextmanager
    def _recorded(self) -> Iterator[None]:
        """Record bag and graphs."""
        graphs = self._folder / GRAPHS_FOLDER
        graphs.mkdir()
        with BagWriter(self._folder / BAG_FOLDER, self._recipe.storage) as self._bag:
            recorder = Recorder(self.domain, self._bag, **self._recorder_options())
            graph = GraphRecorder(self.domain, graphs)
            yield
            recorder.store()
            graph.finish()

    def _contents(self) -> tuple[Mapping[str, TopicCount], str]:
        """Return the topics of the bag, and the hash of its messages."""
        return self._bag.topics, self._bag.content_hash

    def _facts(self, wall_s: float, software: Software) -> dict[str, Any]:
        """Return the fields of the manifest that follow from recipe, scenario and recording."""
        recipe, scenario = self._recipe, self._program.scenario
        topics, content_hash = self._contents()
        return {
            "mode": recipe.mode,
            "label": scenario.label,
            "run": recipe.run,
            "block": recipe.block,
            "seed": recipe.seed,
            "attack_seed": recipe.attack_seed(),
            "scenario": scenario.id,
            "scenario_hash": scenario.digest,
            "start": Pose(0.0, 0.0, 0.0),
            "goals": (),
            "goal_results": (),
            "outcome": "succeeded",
            "attack": recipe.parameters,
            "contacts": (),
            "task_effect": None,  # until both the run and its control exist
            "changes": () if self.node is None else self.node.changes(self._start_ns),
            "topics": topics,
            "content_hash": content_hash,
            "recipe": recipe.to_dict(),
            "software": software,
            "measured": Measured(
                wall_s=wall_s,
                bytes=bytes_on_disk(self._folder),
                files=hashes_of_files(self._folder),
            ),
        }
