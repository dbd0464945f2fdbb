"""A cache of traces in files: a bag is read again only if the run or this code has changed."""

import functools
import hashlib
from pathlib import Path

import pandas as pd

from oracle_pipeline.bags.remote import fetched
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.bags.sources import code_hash
from oracle_pipeline.datasets import DatasetError, Fields, field_metadata, read_table, write_table
from oracle_pipeline.opened_run import open_run
from oracle_pipeline.oracles.traces import SIGNALS, TIME, read_trace
from oracle_pipeline.robots.robot import find_robots

_READ_BY = ("oracle_pipeline.oracles.traces",)
_INPUTS = "inputs"  # of a trace, in the metadata of its first column


def kept_trace(run: RunDirectory, folder: Path | None) -> pd.DataFrame:
    """Return the trace of a run, from its file if it is current.

    Parameters
    ----------
    run : RunDirectory
        A complete run.
    folder : Path or None
        Cache folder; None always reads the bag.

    Raises
    ------
    OracleError
        There is no current trace, and the bag was dropped or cannot be read.
    """
    if folder is None:
        return _read(run)
    try:
        trace = read_table(_place(run, folder))
        if field_metadata(trace).get(TIME, {}).get(_INPUTS) == _inputs(run):
            return trace
    except DatasetError:
        pass  # missing or damaged: read the bag
    trace = _read(run)
    fields = {name: {"unit": signal.unit} for name, signal in SIGNALS.items()}
    trace.attrs["fields"] = Fields({TIME: {"unit": "s", _INPUTS: _inputs(run)}, **fields})
    write_table(trace, _place(run, folder))
    return trace


def _place(run: RunDirectory, folder: Path) -> Path:
    return folder / run.mode / f"{run.run_id}.parquet"


def _inputs(run: RunDirectory) -> str:
    """Return a hash of the inputs of a trace: the messages and the code."""
    return hashlib.sha256(f"{run.manifest().content_hash} {_code()}".encode()).hexdigest()


@functools.cache
def _code() -> str:
    return code_hash(_READ_BY)


def _read(run: RunDirectory) -> pd.DataFrame:
    with fetched(run.path) as place, open_run(place) as opened:
        return read_trace(find_robots(opened.bag)[0])
