"""Progress of many runs: how many are done, how fast, and how long it will take."""

import sys
import time

from tqdm import tqdm

from oracle_pipeline.bags.terminal import progress_bar


def pace(simulated_s: float, wall_s: float) -> str:
    """Return the speed of a simulation as text; a slow one with a decimal place."""
    factor = simulated_s / wall_s
    return f"{factor:.{0 if factor >= 2.0 else 1}f}x real time"


class RunProgress:
    """A progress bar on standard error; silent when that is not a terminal. Close it at the end.

    Parameters
    ----------
    total_runs
        Number of runs.
    """

    def __init__(self, total_runs: int) -> None:
        self._bar: tqdm[None] = progress_bar((), total=total_runs, unit="run")
        self._started = time.monotonic()
        self._recorded_s = 0.0

    def done(self, recording_s: float) -> None:
        """Count one run, of ``recording_s`` seconds of simulated time."""
        self._recorded_s += recording_s
        speed = pace(self._recorded_s, time.monotonic() - self._started)
        self._bar.set_postfix_str(speed, refresh=False)
        self._bar.update()

    def write_line(self, text: str) -> None:
        """Print a line to standard output, above the bar."""
        self._bar.write(text, file=sys.stdout)

    def close(self) -> None:
        """Let the bar stay as it is."""
        self._bar.close()
