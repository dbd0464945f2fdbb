"""Errors that users can fix become failures with a remedy; bugs keep their traceback."""

import errno
import os

import dagster as dg
import pytest

from oracle_pipeline.bags.errors import OracleError
from resources.failures import clear_failures


@pytest.mark.parametrize(
    "code", [errno.ENOSPC, errno.EFBIG, errno.EACCES, errno.EROFS, errno.EDQUOT]
)
def test_the_error_for_a_full_disk_states_a_remedy(code: int) -> None:
    with pytest.raises(dg.Failure) as caught, clear_failures():
        raise OSError(code, os.strerror(code), "/somewhere/run003")
    assert "/somewhere/run003" in str(caught.value.description)
    assert "ORACLE_HOME" in str(caught.value.description)


def test_our_own_errors_keep_their_text() -> None:
    with pytest.raises(dg.Failure) as caught, clear_failures():
        raise OracleError("Run 3 is missing; record it.")
    assert caught.value.description == "Run 3 is missing; record it."


def test_other_exceptions_propagate() -> None:
    with pytest.raises(ZeroDivisionError), clear_failures():
        _ = 1 / 0
