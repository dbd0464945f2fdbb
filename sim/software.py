"""What a run's bytes depend on besides its recipe: our code, the libraries, the processor.

The same recipe gives the same messages as long as these three stay the same.
"""

import functools
import hashlib
import platform
from collections.abc import Iterable, Iterator
from importlib.metadata import version
from importlib.resources import files
from importlib.resources.abc import Traversable

import llvmlite.binding

from oracle_pipeline.bags.manifest import Software

_SUFFIXES = (".py", ".msg", ".srv", ".action", ".yaml", ".j2")
# Libraries whose arithmetic, random numbers or serialisation end up in messages.
_LIBRARIES = ("geographiclib", "llvmlite", "mujoco", "numba", "numpy", "rosbags", "scipy")


@functools.cache
def software() -> Software:
    """Return what this process makes runs with."""
    libraries = " ".join(f"{name}-{version(name)}" for name in _LIBRARIES)
    return Software(
        code=source_digest([files("sim"), files("oracle_pipeline") / "bags"]),
        dependencies=f"python-{platform.python_version()} {libraries}",
        cpu=f"{platform.machine()} {llvmlite.binding.get_host_cpu_name()}",
    )


def source_digest(folders: Iterable[Traversable], *others: str) -> str:
    """Return a hash over the source files in folders, and over other texts.

    Names and contents count, the folders' own places do not.
    """
    digest = hashlib.sha256()
    for folder in folders:
        for part in _sources(folder):
            digest.update(len(part).to_bytes(8) + part)
    for text in others:
        digest.update(text.encode() + b"\0")
    return digest.hexdigest()[:16]


def _sources(folder: Traversable) -> Iterator[bytes]:
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
        if entry.is_dir():
            yield from _sources(entry)
        elif entry.name.endswith(_SUFFIXES):
            yield entry.name.encode()
            yield entry.read_bytes()
