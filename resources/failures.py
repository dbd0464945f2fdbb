"""Turns errors that users can fix into Dagster failures with a remedy."""

import contextlib
import errno
from collections.abc import Iterator

import dagster as dg

from oracle_pipeline.bags.errors import OracleError

_ADVICE = {
    errno.ENOSPC: "the disk is full; free some space, or point ORACLE_HOME to another disk",
    errno.EFBIG: "the file is too large; raise `ulimit -f`, or point ORACLE_HOME elsewhere",
    errno.EDQUOT: "the disk quota is used up; free some space, or point ORACLE_HOME elsewhere",
    errno.EACCES: "permission denied; point ORACLE_HOME to a folder that you can write to",
    errno.EPERM: "permission denied; point ORACLE_HOME to a folder that you can write to",
    errno.EROFS: "it is on a read-only disk; point ORACLE_HOME to a folder that you can write to",
}


@contextlib.contextmanager
def clear_failures() -> Iterator[None]:
    """Turn our own errors and disk errors into a ``dagster.Failure`` with the remedy.

    Other exceptions are bugs; they propagate with their traceback.
    """
    try:
        yield
    except OracleError as error:
        raise dg.Failure(str(error), allow_retries=False) from error
    except OSError as error:
        advice = _ADVICE.get(error.errno or 0)
        if advice is None:
            raise
        place = error.filename or "A file"
        raise dg.Failure(f"{place}: {advice}.", allow_retries=False) from error
