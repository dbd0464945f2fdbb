"""One run of a system that commands start: steps that may fail, recorded by ``oracle watch``.

This module uses the wall clock, because its systems do. No two runs are alike.
"""

import contextlib
import json
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from oracle_pipeline.bags.dds_names import DOMAIN_VARIABLE
from oracle_pipeline.bags.manifest import Outcome, TopicCount
from oracle_pipeline.bags.reader import BagReader, content_hash
from oracle_pipeline.bags.run_directory import BAG_FOLDER, GRAPHS_FOLDER, RECORDING_FILE
from oracle_pipeline.bags.types import serialize
from sim.fuzzing.execution import execute
from sim.fuzzing.value_types import message_type, zero
from sim.middleware.executor import SECOND
from sim.outside.domains import a_free_domain
from sim.outside.live_node import LiveNode
from sim.outside.processes import Program, StepError
from sim.outside.testbed import OutsideRecipe, filled
from sim.testbed_run import TestbedRun

DOMAINS = (90, 91, 92, 93)  # by default; ROS 2 advises against those above 101
_RECORDER = "from oracle_pipeline.cli import main; main()"
_RECORDER_S = 60.0  # until it records, and until it has ended
_STOP_S = 10.0  # until a program has to end, by default
_SILENT_S = 5.0  # without a message, a system hangs
_POLL_S = 0.5
_RECORDED = "recorded"  # folder of the recorder, while it records


class OutsideRun(TestbedRun):
    """A system of commands, for one run.

    Parameters
    ----------
    recipe, folder
        As for `TestbedRun`.
    at
        Folder in which the commands run.
    """

    _recipe: OutsideRecipe

    def __init__(self, recipe: OutsideRecipe, folder: Path, at: Path) -> None:
        super().__init__(recipe, folder)
        scenario, activation = self._program.scenario, self._program.activation
        if scenario.needs_simulator or activation.until_goal is not None or activation.goal > 1:
            raise scenario.error(
                ("id",),
                "expected what a node can do to a live system: no parameters, QoS, single links "
                "or goals after the first",
            )
        self._at, self._system = at, recipe.system
        self._programs: list[Program] = []
        self._recorder: Program | None = None
        self._ending: Program | None = None  # which may end with any code
        self._onset_ns: int | None = None  # None: it is not known yet
        self._outcome: Outcome = "succeeded"
        self._recorded_s = 0.0

    def go(self) -> None:
        """Start the system, record its task, and stop it, whatever happens."""
        recipe = self._recipe
        with contextlib.ExitStack() as stack:
            number = stack.enter_context(a_free_domain(self._system.get("domains", DOMAINS)))
            known = {"domain": number, "run": recipe.run, "block": recipe.block}
            self._system = filled(self._system, {**recipe.values, **known, "mode": recipe.mode})
            self._variables = {**self._system.get("environment", {}), DOMAIN_VARIABLE: str(number)}
            self._logs = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            execution = execute(self._program, recipe.attack_seed(), recipe.parameters)
            self._live = LiveNode(number, execution)
            stack.callback(self._live.close)
            stack.callback(self._stop)
            self._bring_up()
            recorder = self._record(number)
            self._give_task()
            self._await_end()
            self.node = self._live.node
            recorder.stop(_RECORDER_S)
            self._keep(recorder)

    def _bring_up(self) -> None:
        """Start the programs, and wait until what they need is there."""
        if self._program.activation.before == "forward":
            self._live.join()
        for command in self._system["start"]:
            self._started("start", command)
        ready = self._system["ready"]

        def missing() -> list[str]:
            there = self._live.discovery
            known = {
                "topics": set(there.topics()),
                "nodes": set(there.node_names()),
                "services": set(there.services()),
            }
            return [
                f"{kind[:-1]} {name}"
                for kind, names in known.items()
                for name in ready.get(kind, ())
                if name not in names
            ]

        if not self._wait("ready", lambda: not missing(), ready["within_s"]):
            raise self._late("ready", f"there is no {', no '.join(missing())}", ready)

    def _record(self, number: int) -> Program:
        """Start the recorder, and wait until it records."""
        command = [sys.executable, "-c", _RECORDER, "watch", "--domain", str(number)]
        folder = self._folder / _RECORDED
        recorder = Program(
            [*command, "--out", str(folder)], self._logs / "recorder", self._at, self._variables
        )
        self._recorder = recorder
        within_s = self._system["ready"]["within_s"] + _RECORDER_S
        if not self._wait("record", lambda: any(folder.glob(f"*/{RECORDING_FILE}")), within_s):
            reason = f"no message came within {within_s:g} s"
            raise StepError.of("record", reason, recorder.last_lines)
        self._start_ns = int(self._summary()["start_ns"])
        if self._program.activation.after == "start":
            self._set_onset(self._start_ns)
        return recorder

    def _give_task(self) -> None:
        """Give the system its task."""
        task = self._system.get("task", {})
        command, sent = task.get("command"), task.get("topic")
        if action := task.get("action"):
            goal = json.dumps(action["goal"])
            command = ["ros2", "action", "send_goal", action["name"], action["type"], goal]
        if sent:
            self._live.publish(sent["name"], sent["type"], _message(sent["type"], sent["message"]))
        if self._program.activation.after == "goal_accepted":
            self._set_onset(self._live.now_ns)
        if command is None:
            return
        program = self._started("task", command)
        if self._system["ends"].get("exit") == "task":
            self._ending = program
        elif not self._wait("task", lambda: program.code is not None, task["within_s"]):
            raise self._late("task", f"`{program.name}` still runs", task)

    def _await_end(self) -> None:
        """Wait until the run has ended, and find out how."""
        ends = self._system["ends"]
        begin_ns, ending = self._live.now_ns, self._ending or self._programs[0]
        if awaited := ends.get("message"):
            self._live.await_message(awaited["topic"], awaited["type"])

        def is_over() -> bool:
            if awaited:
                return self._live.is_awaited_here
            if "exit" in ends:
                return ending.code is not None
            return self._live.now_ns >= begin_ns + round(float(ends["after_s"]) * SECOND)

        if not self._wait("ends", is_over, ends["within_s"]):
            if self._silent_s() > _SILENT_S:
                raise self._late("ends", f"nothing was sent for {_SILENT_S:g} s", ends)
            self._outcome = "timeout"
        elif self._ending is not None and self._ending.code:
            self._outcome = "aborted"

    def _stop(self) -> None:
        """Run the commands that stop the system, and end what is left of it."""
        stop = self._system.get("stop", {})
        within_s = stop.get("within_s", _STOP_S)
        for command in stop.get("commands", ()):
            program = self._started("stop", command)
            until = time.monotonic() + within_s
            while program.code is None and time.monotonic() < until:
                time.sleep(_POLL_S)
        for program in reversed([*self._programs, *filter(None, [self._recorder])]):
            program.stop(within_s)

    def _keep(self, recorder: Program) -> None:
        """Move what was recorded to its place in the run directory."""
        summary = self._summary()
        if summary["ended"] or not summary["complete"]:
            reason = f"the recording is incomplete: {summary['ended']}"
            raise StepError.of("record", reason, recorder.last_lines)
        self._recorded_s = summary["recording_s"]
        (place,) = (self._folder / _RECORDED).iterdir()
        for part in (BAG_FOLDER, GRAPHS_FOLDER, RECORDING_FILE):
            (place / part).rename(self._folder / part)
        shutil.rmtree(self._folder / _RECORDED)

    def _contents(self) -> tuple[Mapping[str, TopicCount], str]:
        bag = self._folder / BAG_FOLDER
        with BagReader(bag) as reader:
            topics = {
                name: TopicCount(topic.msgtype, topic.count)
                for name, topic in reader.topics.items()
            }
        return topics, content_hash(bag)

    def _results(self) -> dict[str, Any]:
        onset_ns = self._onset_ns
        return {
            "session": self._recipe.session,
            "world": "outside",
            "outcome": self._outcome,
            "onset_s": None if onset_ns is None else max(0.0, (onset_ns - self._start_ns) / SECOND),
            "recording_s": self._recorded_s,
        }

    # Helpers of the steps.

    def _started(self, step: str, command: list[Any]) -> Program:
        log = self._logs / f"{len(self._programs)}"
        try:
            program = Program([*map(str, command)], log, self._at, self._variables)
        except OSError as error:
            raise StepError.of(step, f"`{command[0]}` does not start: {error}") from error
        self._programs.append(program)
        return program

    def _wait(self, step: str, condition: Callable[[], bool], within_s: float) -> bool:
        """Let the node work until a condition holds; return whether it did in time."""
        until = time.monotonic() + within_s
        while not condition():
            if time.monotonic() > until:
                return False
            self._live.work()
            for program in filter(None, [*self._programs, self._recorder]):
                if program.code and program is not self._ending:
                    reason = f"`{program.name}` has ended with code {program.code}"
                    raise StepError.of(step, reason, program.last_lines)
        return True

    def _late(self, step: str, reason: str, spec: Mapping[str, Any]) -> StepError:
        logs = "\n".join(program.last_lines for program in self._programs)
        return StepError.of(step, f"after {spec['within_s']:g} s, {reason}", logs)

    def _set_onset(self, start_ns: int) -> None:
        delay_s = self._program.activation.delay_s(self._recipe.attack_seed())
        self._onset_ns = start_ns + round(delay_s * SECOND)
        self._live.begin(self._onset_ns)

    def _summary(self) -> dict[str, Any]:
        """Return the summary of the recording."""
        found = [*(self._folder / _RECORDED).glob(f"*/{RECORDING_FILE}")]
        if len(found) != 1:
            raise StepError.of("record", "the clock was set, so there are several recordings")
        summary: dict[str, Any] = json.loads(found[0].read_bytes())
        return summary

    def _silent_s(self) -> float:
        """Return how long ago a message was recorded."""
        bag = (self._folder / _RECORDED).glob(f"*/{BAG_FOLDER}/*")
        return time.time() - max(file.stat().st_mtime for file in bag)


def _message(msgtype: str, values: Mapping[str, Any]) -> bytes:
    """Return a message with some values, the others 0 or empty, as CDR bytes."""
    message = zero(message_type(msgtype))
    try:
        _fill(message, values)
    except (AttributeError, TypeError, ValueError) as error:
        raise StepError.of("task", f"{msgtype} cannot hold these values: {error}") from error
    return serialize(message, msgtype)


def _fill(message: Any, values: Mapping[str, Any]) -> None:
    for name, value in values.items():
        if isinstance(value, Mapping):
            _fill(getattr(message, name), value)
        else:
            former = getattr(message, name)
            is_array = isinstance(former, np.ndarray)
            filled_in = np.asarray(value, former.dtype) if is_array else type(former)(value)
            setattr(message, name, filled_in)
