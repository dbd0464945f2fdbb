"""Print the Python that `make setup` should use: the given one, or a faster one of its version.

A simulated run is mostly Python code. A Python that was built without optimisation takes a sixth to
a half longer for it. Builds do not reliably state how they were made, so each is timed. Only the
standard library is used, because this runs before anything is installed.
"""

import argparse
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

ROUNDS = 3
WORTH_IT = 1.1  # times faster, from which on another one is used

# Attributes, calls and a dictionary, as in a simulation. A Python without one of the imported
# modules cannot make an environment, or cannot run the project.
PROBE = """
import bz2, ctypes, ensurepip, lzma, sqlite3, ssl, time, venv
class Point:
    __slots__ = ("x",)
    def __init__(self, x): self.x = x
def work(known):
    for i in range(300_000):
        point = Point(i)
        known[i & 255] = point.x + len(known)
started = time.process_time()
work({})
print(time.process_time() - started)
"""


def seconds(python: str) -> float | None:
    """Return the processor time of some Python code; None if this Python cannot be used."""
    try:
        done = subprocess.run(
            [python, "-c", PROBE], capture_output=True, text=True, check=True, timeout=60
        )
        return float(done.stdout)
    except (OSError, subprocess.SubprocessError, ValueError):
        return None


def candidates() -> list[str]:
    """Return this Python, then others of its version on the path or in the system's folders."""
    name = f"python{sys.version_info.major}.{sys.version_info.minor}"
    found = [sys.executable, shutil.which(name), f"/usr/bin/{name}", f"/usr/local/bin/{name}"]
    by_place = {str(Path(path).resolve()): path for path in reversed(found) if path}
    return [path for path in found if path and path in by_place.values() and Path(path).exists()]


def fastest(pythons: list[str]) -> tuple[str, float]:
    """Return the Python to use, and how many times faster than the first it is.

    They are timed in turn, so that other load on the machine affects all of them.
    """
    times: dict[str, list[float]] = {}
    for _ in range(ROUNDS):
        for python in pythons:
            taken = seconds(python)
            if taken is not None:
                times.setdefault(python, []).append(taken)
    first = pythons[0]
    if first not in times:
        return first, 1.0  # `make setup` will say what is wrong with it
    best = min(times, key=lambda python: min(times[python]))
    ratio = min(times[first]) / min(times[best])
    return (best, ratio) if ratio >= WORTH_IT else (first, 1.0)


def is_optimised() -> bool:
    """Return whether this Python was built with optimisation, as far as it states so.

    A distribution's own Python counts as optimised.
    """
    arguments = sysconfig.get_config_var("CONFIG_ARGS")
    return arguments is None or "--enable-optimizations" in arguments or sys.prefix == "/usr"


def main() -> None:
    """Print the path; remarks about it go to standard error."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", action="store_true", help="use this one, and only warn")
    only = parser.parse_args().only
    python, ratio = (sys.executable, 1.0) if only else fastest(candidates())
    if python != sys.executable:
        print(
            f"Using {python}: it runs Python code {ratio:.1f} times as fast as {sys.executable}. "
            f"To use that one: make setup PYTHON={sys.executable}",
            file=sys.stderr,
        )
    elif not is_optimised():
        print(
            f"Warning: {python} was built without optimisation (--enable-optimizations), so "
            "simulated runs take a sixth to a half longer. To use another one: "
            "make setup PYTHON=/path/to/python",
            file=sys.stderr,
        )
    print(python)


if __name__ == "__main__":
    main()
