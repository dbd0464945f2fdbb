"""The yardstick that speed is measured against does not change with the testbed."""

import hashlib
import subprocess
import sys

import numpy as np
import pytest

from tools.bench import yardstick

pytestmark = pytest.mark.slow

SHA256 = "10c5e86d1c68ad8b54da0ff8c60f99186390648418da127081db27cb5660e9ee"


def test_its_model_is_unchanged() -> None:
    assert hashlib.sha256(yardstick.MODEL.read_bytes()).hexdigest() == SHA256


def test_it_uses_nothing_of_the_testbed() -> None:
    """Importing it brings in none of ours but ``tools`` itself."""
    code = (
        "import sys, tools.bench.yardstick as _; "
        "print(*(name.partition('.')[0] for name in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"sim", "oracle_pipeline", "assets", "resources"} & set(done.stdout.split())


def test_its_loop_has_contacts_and_scans_the_world_around_it() -> None:
    loop = yardstick.run(2.0)
    assert loop.position == pytest.approx([-2.0, -0.5, 0.00967], abs=1e-4)  # held by the floor
    ahead, left, behind, right = loop.ranges[::90]
    assert (ahead, left, behind, right) == pytest.approx((4.616, 2.116, 0.644, 1.116), abs=1e-3)
    assert np.all((loop.ranges > 0.1) & (loop.ranges < yardstick.RANGE_MAX_M))
