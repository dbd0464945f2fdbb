"""What a run's bytes depend on besides its recipe: our code, the libraries, the processor.

The same recipe gives the same messages as long as these three stay the same.
"""

import functools
import hashlib
import platform
from importlib.metadata import version
from importlib.resources import files
from importlib.resources.abc import Traversable

import llvmlite.binding

from oracle_pipeline.bags.manifest import Software

# Libraries whose arithmetic, random numbers or serialisation end up in messages.
_LIBRARIES = ("llvmlite", "mujoco", "numba", "numpy", "rosbags", "scipy")


@functools.cache
def software() -> Software:
    """Return what this process makes runs with."""
    libraries = " ".join(f"{name}-{version(name)}" for name in _LIBRARIES)
    return Software(
        code=_digest(["sim", "oracle_pipeline.bags"]),
        dependencies=f"python-{platform.python_version()} {libraries}",
        cpu=f"{platform.machine()} {llvmlite.binding.get_host_cpu_name()}",
    )


def _digest(packages: list[str]) -> str:
    """Return a hash over the source files of our packages."""
    digest = hashlib.sha256()
    for package in packages:
        for path, content in sorted(_sources(files(package), package)):
            digest.update(path.encode() + b"\0" + content)
    return digest.hexdigest()[:16]


def _sources(folder: Traversable, path: str) -> list[tuple[str, bytes]]:
    found = []
    for entry in folder.iterdir():
        if entry.is_dir() and entry.name != "__pycache__":
            found += _sources(entry, f"{path}/{entry.name}")
        elif entry.name.endswith((".py", ".msg", ".srv", ".action", ".yaml")):
            found.append((f"{path}/{entry.name}", entry.read_bytes()))
    return found
