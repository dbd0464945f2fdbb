"""Runs the commands of a page in its folder, or checks those that take too long."""

import contextlib
import importlib.metadata
import importlib.util
import io
import itertools
import json
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from unittest import mock

import click
import dagster as dg
import yaml
from click.testing import CliRunner

from assets.oracle_sim import main as oracle_sim
from oracle_pipeline.cli import main as oracle
from oracle_pipeline.definitions import defs
from sim.modes import modes
from tests.docs.pages import REPOSITORY

COMMANDS: dict[str, click.Group] = {"oracle": oracle, "oracle-sim": oracle_sim}
DAGSTER = {"dagster", "dg"}  # their arguments are checked; tests/assets runs assets and jobs
SHELL = {"cp", "for", "mkdir"}  # simple enough to be run by the shell
REPEATED = {"compare", "learn"}  # twice on a page, these give the same again: run once

# Simulations that take minutes, and what ends with Ctrl-C. Their options are checked here;
# tests/sim and tests/oracle_pipeline/live run them.
SIMULATIONS = {"grid", "record", "search", "serve", "watch"}
RECORDED_HERE = ["--goals", "1"]  # but what tutorials record: one goal is a matter of seconds

# Commands that need a network, a server, or hours.
NOT_RUN = {
    "source": "activates the environment, which runs already",
    "pip": "needs a package index",
    "dask": "starts servers that do not end; tests/assets/test_engines.py starts them",
    "oracle-ui": "starts a server that does not end; tests/resources/test_guard.py starts it",
    "pre-commit": "needs a checkout with a git directory",
}

_EXIT = re.compile(r"\s+#(?: exit (\d)\b)?[^'\"]*$")
_ASSIGNMENT = re.compile(r"(\w+)=(.*)", re.S)
_KEY = re.compile(r"([a-z0-9_]+)\|run\d{3,}(-\d{3,})?")


class PageError(AssertionError):
    """A command of a page does not behave as documented."""


@dataclass
class Shell:
    """The folder in which the commands of one page run, one after the other."""

    folder: Path
    tutorial: bool  # everything is run; on other pages, simulations are checked only
    lab: Path  # normal runs of one goal, recorded once for all pages
    environment: dict[str, str] = field(default_factory=dict)
    answers: dict[str, tuple[int, str]] = field(default_factory=dict)  # of commands in REPEATED

    def run(self, text: str) -> None:
        """Run a block of commands, each with the documented exit code."""
        for line in text.replace("\\\n", " ").splitlines():
            if line.strip() and not line.startswith("#"):
                self._line(line)

    def _line(self, line: str) -> None:
        stated = _EXIT.search(line)
        expected = int(stated[1] or 0) if stated else 0
        command = line[: stated.start()] if stated else line
        words = shlex.split(command)
        assigned = {}
        while words and (match := _ASSIGNMENT.fullmatch(words[0])):
            assigned[match[1]] = match[2]
            words = words[1:]
        if words[0] == "export":
            self.environment |= dict(word.split("=", 1) for word in words[1:])
            return
        code, output = self.answers.get(command) or self._command(
            words, command, self.environment | assigned
        )
        if words[1:] and words[1] in REPEATED:
            self.answers[command] = code, output
        if code != expected:
            raise PageError(f"{line}\nends with {code}, not {expected}:\n{output}")

    def _command(self, words: list[str], line: str, variables: dict[str, str]) -> tuple[int, str]:
        if words[0] in COMMANDS:
            return self._ours(words, variables)
        if words[0] in DAGSTER:
            check_dagster(words, self.folder)
        elif words[0] == "make":
            check_make(words)
        elif words[0] == "python" and words[1].endswith(".py"):
            return self._script(words[1:], variables)
        elif words[:2] == ["python", "-m"]:
            check_module(words[2])
        elif words[0] == "python":
            return self._process([sys.executable, *words[1:]], variables)
        elif words[0] in SHELL:
            return self._process(["bash", "-euc", line], variables)
        elif words[0] not in NOT_RUN:
            raise PageError(f"{line}\nNothing runs {words[0]}: see tests/docs/shell.py.")
        return 0, ""

    def _process(self, words: list[str], variables: dict[str, str]) -> tuple[int, str]:
        self.answers.clear()  # it may change what they were computed from
        done = subprocess.run(
            words,
            cwd=self.folder,
            env=os.environ | variables,
            capture_output=True,
            text=True,
            check=False,
        )
        return done.returncode, done.stdout + done.stderr

    def _script(self, words: list[str], variables: dict[str, str]) -> tuple[int, str]:
        """Run a Python file in this process, which has imported what it needs."""
        self.answers.clear()
        with (
            contextlib.redirect_stdout(io.StringIO()) as said,
            mock.patch.dict(os.environ, variables),
            mock.patch.object(sys, "argv", words),
        ):
            runpy.run_path(str(self.folder / words[0]), run_name="__main__")
        return 0, said.getvalue()

    def _ours(self, words: list[str], variables: dict[str, str]) -> tuple[int, str]:
        target = None
        if ">" in words:
            words, target = words[: words.index(">")], words[words.index(">") + 1]
        group, arguments = COMMANDS[words[0]], words[1:]
        if arguments[0] in SIMULATIONS and not self._quick(arguments):
            command = group.get_command(click.Context(group), arguments[0])
            assert command is not None, arguments[0]
            command.make_context(arguments[0], arguments[1:])
            return 0, ""
        if words[0] == "oracle-sim":
            self.answers.clear()
        done = CliRunner().invoke(group, self._expanded(arguments), env=variables)
        if target:
            (self.folder / target).write_text(done.stdout, "utf-8")
        return done.exit_code, done.output

    def _expanded(self, words: list[str]) -> list[str]:
        """Replace patterns by files, as a shell does."""
        expanded = []
        for word in words:
            found = sorted(self.folder.glob(word)) if "*" in word else []
            expanded += [str(path.relative_to(self.folder)) for path in found] or [word]
        return expanded

    def _quick(self, arguments: list[str]) -> bool:
        if not (self.tutorial and arguments[0] == "record" and "--goals" in arguments):
            return False
        place = arguments.index("--goals")
        if arguments[place : place + 2] != RECORDED_HERE:
            return False
        if "--scenario" not in arguments:  # the runs are there: the command verifies them
            place = self.folder / arguments[arguments.index("--out") + 1]
            shutil.copytree(self.lab, place, dirs_exist_ok=True, copy_function=os.link)
        return True


def check_module(name: str) -> None:
    """Check that there is a program to run as a module, most of which take minutes."""
    if importlib.util.find_spec(name) is None:
        raise PageError(f"There is no module {name}.")


def check_make(words: list[str]) -> None:
    """Check that the Makefile has a target, with a line of help."""
    makefile = (REPOSITORY / "Makefile").read_text("utf-8")
    if not re.search(rf"^{words[1]}:.*## ", makefile, re.M):
        raise PageError(f"make has no target {words[1]}.")


def check_dagster(words: list[str], folder: Path) -> None:
    """Check options, partitions, selection and configuration of a command of Dagster."""
    options = dict(itertools.pairwise(words))
    (script,) = importlib.metadata.entry_points(group="console_scripts", name=words[0])
    command = script.load().__globals__["cli"]
    rest = words[1:]
    while isinstance(command, click.Group):
        context, (step, rest) = click.Context(command), (rest[0], rest[1:])
        found = command.get_command(context, step)
        if found is None:
            raise PageError(f"{words[0]} has no command {step}.")
        command = found
    command.make_context(words[0], list(rest))
    if "--partition" in options or "--partition-range" in options:
        keys = options.get("--partition") or options["--partition-range"]
        for key in keys.split("..."):
            match = _KEY.fullmatch(key)
            if match is None or match[1] not in modes():
                raise PageError(f"{key} is no partition.")
    if selected := options.get("--select") or options.get("--assets"):
        selection = dg.AssetSelection.from_coercible(selected.split(","))
        if not selection.resolve(defs.resolve_asset_graph()):
            raise PageError(f"{selected} selects nothing.")
    if "--job" in options:
        defs.resolve_job_def(options["--job"])  # or an error
    config = None
    if "--config" in options:
        config = yaml.safe_load((folder / options["--config"]).read_text("utf-8"))
    elif "--config-json" in options:
        config = json.loads(options["--config-json"])
    if config:
        job = defs.resolve_implicit_global_asset_job_def()
        dg.validate_run_config(job, config)
