"""The software that a run's bytes depend on: this code, the libraries, the processor.

The same recipe gives the same messages as long as these three stay the same.
"""

import functools
import platform
from importlib.metadata import version
from pathlib import Path

import llvmlite.binding

from oracle_pipeline.bags.manifest import Software
from oracle_pipeline.bags.sources import ROOT, code_hash
from sim.testbeds import TESTBEDS

# Libraries whose arithmetic, random numbers or serialisation end up in messages.
_LIBRARIES = ("geographiclib", "llvmlite", "mujoco", "numba", "numpy", "rosbags", "scipy")


@functools.cache
def software() -> Software:
    """Return the software of this process."""
    libraries = " ".join(f"{name}-{version(name)}" for name in _LIBRARIES)
    return Software(
        code=run_code(),
        dependencies=f"python-{platform.python_version()} {libraries}",
        cpu=f"{platform.machine()} {llvmlite.binding.get_host_cpu_name()}",
    )


def run_code(root: Path = ROOT) -> str:
    """Return the version of this project's code that turns a recipe into messages.

    Parameters
    ----------
    root
        The folder of this project's packages.
    """
    return code_hash([testbed.made_by for testbed in TESTBEDS.values()], root=root)
