"""The software that a run's bytes depend on: this code, the libraries, the processor.

The same recipe gives the same messages as long as these three stay the same.
"""

import functools
import platform
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path

import llvmlite.binding

from oracle_pipeline.bags.manifest import Software
from oracle_pipeline.bags.sources import ROOT, code_hash
from sim.testbed import Testbed

# Libraries whose arithmetic, random numbers or serialisation end up in messages.
_LIBRARIES = ("geographiclib", "llvmlite", "mujoco", "numba", "numpy", "rosbags", "scipy")


def software(testbed: Testbed) -> Software:
    """Return the software of this process that makes the runs of a testbed."""
    return _software(testbed.made_by, testbed.libraries)


@functools.cache
def _software(made_by: str, further: tuple[str, ...]) -> Software:
    libraries = " ".join(f"{name}-{version(name)}" for name in (*_LIBRARIES, *further))
    return Software(
        code=run_code([made_by]),
        dependencies=f"python-{platform.python_version()} {libraries}",
        cpu=f"{platform.machine()} {llvmlite.binding.get_host_cpu_name()}",
    )


def run_code(made_by: Iterable[str], root: Path = ROOT) -> str:
    """Return the version of this project's code that turns a recipe into messages.

    Parameters
    ----------
    made_by
        Modules with the classes of runs, of one testbed or more.
    root
        The folder of this project's packages.
    """
    return code_hash(made_by, root=root)
