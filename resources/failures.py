"""Turns errors that a user can fix into a failure that Dagster shows with its remedy."""

import contextlib
import errno
from collections.abc import Iterator

import dagster as dg

from oracle_pipeline.bags.errors import OracleError

_ADVICE = {
    errno.ENOSPC: "the disk is full; free some space, or point ORACLE_HOME to another disk",
    errno.EFBIG: "a file may not grow so large; raise `ulimit -f`, or point ORACLE_HOME elsewhere",
    errno.EDQUOT: "the disk quota is used up; free some space, or point ORACLE_HOME elsewhere",
    errno.EACCES: "it may not be written; point ORACLE_HOME to a folder that is yours",
    errno.EPERM: "it may not be written; point ORACLE_HOME to a folder that is yours",
    errno.EROFS: "it is on a read-only disk; point ORACLE_HOME to a folder that can be written",
}


@contextlib.contextmanager
def clear_failures() -> Iterator[None]:
    """Turn our own errors and disk errors into a ``dagster.Failure`` with the remedy.

    Anything else passes: it is a bug, and its traceback helps more.
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
