"""The programs of a run: each in a process group and with a log of its own."""

import contextlib
import ctypes
import os
import shlex
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Self

from oracle_pipeline.bags.errors import OracleError

LAST_LINES = 10  # of a log, in an error
_LIBC = ctypes.CDLL(None)
_PR_SET_PDEATHSIG = 1
_FORCED_S = 5.0  # from one signal to the next, after the first


class StepError(OracleError):
    """A step of a run failed."""

    @classmethod
    def of(cls, step: str, reason: str, log: str = "") -> Self:
        """Return an error with its text.

        Parameters
        ----------
        step
            Of the testbed's file, such as ``ready``.
        reason
            In a sentence without its end.
        log
            Last lines of the log.
        """
        shown = f"{log}\n" if log else ""
        return cls(f"{shown}Step `{step}` failed: {reason}.")


class Program:
    """A command that runs.

    Parameters
    ----------
    command
        Its arguments; no shell reads them.
    log
        File for all that it prints.
    at
        Folder in which it runs.
    environment
        Variables that are added to ours.

    Raises
    ------
    OSError
        If there is no such program.
    """

    def __init__(
        self, command: Sequence[str], log: Path, at: Path, environment: Mapping[str, str]
    ) -> None:
        self.name = shlex.join(command)
        self._log = log
        with log.open("wb") as sink:
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=sink, stderr=subprocess.STDOUT, cwd=at,
                env={**os.environ, **environment}, start_new_session=True,
                preexec_fn=_end_with_parent,
            )  # fmt: skip

    @property
    def code(self) -> int | None:
        """Exit code; None while it runs."""
        return self._process.poll()

    @property
    def last_lines(self) -> str:
        """What it printed last."""
        lines = self._log.read_text("utf-8", "replace").splitlines()[-LAST_LINES:]
        return "\n".join([f"The last lines of `{self.name}`:", *lines])

    def stop(self, within_s: float) -> None:
        """End it and all that it started: ask, then force."""
        for how, wait_s in (
            (signal.SIGINT, within_s),
            (signal.SIGTERM, _FORCED_S),
            (signal.SIGKILL, _FORCED_S),
        ):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, how)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    self._process.wait(wait_s)
                if not self._has_members(wait_s if self.code is None else 1.0):
                    return

    def _has_members(self, wait_s: float) -> bool:
        """Return whether a process of the group is left after a while."""
        until = time.monotonic() + wait_s
        while time.monotonic() < until:
            try:
                os.killpg(self._process.pid, 0)
            except ProcessLookupError:
                return False
            time.sleep(0.05)
        return True


def _end_with_parent() -> None:
    """Let the kernel end this process if its worker is killed, and let it be interrupted."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # a shell's background jobs ignore it
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
