"""Peak memory of the process that reads a recording, which imports this module by its name."""

import resource
from contextlib import suppress
from pathlib import Path

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.scoring.isolation import extracted


def peak_mib(path: Path) -> float:
    """Read a recording as `oracle score` does, and return the peak memory of this process [MiB]."""
    with suppress(OracleError):  # a refused recording takes memory, too
        extracted(path)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
