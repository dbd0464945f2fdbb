"""`make setup` does not choose a slow Python if there is a faster one of its version."""

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent.parent / "tools" / "scripts" / "choose_python.py"


def stand_in(path: Path, times_slower: float) -> str:
    """Return a Python that reports a multiple of the probe's time."""
    path.write_text(
        f"#!/bin/sh\n{sys.executable} \"$@\" | awk '{{print $1 * {times_slower}}}'\n", "utf8"
    )
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


@pytest.mark.parametrize(
    ("times_slower", "is_taken"), [(0.2, True), (5.0, False)], ids=["faster", "slower"]
)
def test_another_python_is_taken_only_if_it_is_faster(
    tmp_path: Path, times_slower: float, is_taken: bool
) -> None:
    name = f"python{sys.version_info.major}.{sys.version_info.minor}"
    other = stand_in(tmp_path / name, times_slower)
    code = (
        f"import runpy; m = runpy.run_path({str(SCRIPT)!r})\n"
        f"print(m['fastest']([{sys.executable!r}, {other!r}, '/no/such/python'])[0])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == (other if is_taken else sys.executable)


def test_the_requested_python_is_used(tmp_path: Path) -> None:
    name = f"python{sys.version_info.major}.{sys.version_info.minor}"
    stand_in(tmp_path / name, 0.2)
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "--only"],
        env={**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.strip() == sys.executable
