"""Errors that people can act on become failures that say how; defects keep their traceback."""

import errno
import os

import dagster as dg
import pytest

from oracle_pipeline.bags.errors import OracleError
from resources.failures import clear_failures


@pytest.mark.parametrize(
    "code", [errno.ENOSPC, errno.EFBIG, errno.EACCES, errno.EROFS, errno.EDQUOT]
)
def test_a_disk_that_takes_no_more_is_named_with_a_way_out(code: int) -> None:
    with pytest.raises(dg.Failure) as caught, clear_failures():
        raise OSError(code, os.strerror(code), "/somewhere/run003")
    assert "/somewhere/run003" in str(caught.value.description)
    assert "ORACLE_HOME" in str(caught.value.description)


def test_our_own_errors_keep_their_text() -> None:
    with pytest.raises(dg.Failure) as caught, clear_failures():
        raise OracleError("Run 3 is missing; record it.")
    assert caught.value.description == "Run 3 is missing; record it."


def test_a_defect_passes() -> None:
    with pytest.raises(ZeroDivisionError), clear_failures():
        _ = 1 / 0
