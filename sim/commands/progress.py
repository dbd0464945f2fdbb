"""Progress of many runs: how many are done, how fast, and how long it will take."""

import sys
import time
from types import TracebackType
from typing import Self

from tqdm import tqdm

from oracle_pipeline.bags.terminal import progress_bar


class RunProgress:
    """A progress bar on standard error; silent when that is not a terminal.

    Parameters
    ----------
    total_runs
        How many runs there are to do.
    """

    def __init__(self, total_runs: int) -> None:
        self._bar: tqdm[None] = progress_bar((), total=total_runs, unit="run")
        self._started = time.monotonic()
        self._recorded_s = 0.0

    def done(self, recording_s: float) -> None:
        """Count one run, of ``recording_s`` seconds of simulated time."""
        self._recorded_s += recording_s
        factor = self._recorded_s / (time.monotonic() - self._started)
        self._bar.set_postfix_str(f"{factor:.0f}x real time", refresh=False)
        self._bar.update()

    def say(self, text: str) -> None:
        """Print a line to standard output, above the bar."""
        self._bar.write(text, file=sys.stdout)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.close()
