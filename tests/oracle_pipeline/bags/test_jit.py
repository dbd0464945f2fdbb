"""Importing our packages leaves the libraries that others use beside them as they are."""

import subprocess
import sys

import pytest

OURS = "import oracle_pipeline.cli, oracle_pipeline.features.manager, sim.turtlebot3.world"
# Correlations of floats go through BLAS, if numba finds that of SciPy.
OTHERS = """
import gc, sys
import numba, numpy as np

@numba.njit
def correlated(a, b):
    return np.convolve(a, b), np.dot(a, b)

a, b = np.random.default_rng(0).normal(size=(2, 1001))
print([values.tobytes().hex() for values in map(np.asarray, correlated(a, b))])
print([name for name, module in sys.modules.items() if module is None])
print(np.geterr(), np.get_printoptions(), gc.isenabled(), gc.get_threshold(), gc.get_freeze_count())
print({name: getattr(numba.config, name) for name in dir(numba.config) if name.isupper()})
"""


def printed(code):
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout


@pytest.mark.slow(8)
def test_importing_our_packages_changes_no_number_and_no_setting_of_others():
    assert printed(OURS + OTHERS) == printed(OTHERS)
