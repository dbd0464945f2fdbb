"""The signals of one run, stored beside its features, for the kinds of oracle that need them."""

from typing import TYPE_CHECKING

from oracle_pipeline.bags import layout
from oracle_pipeline.bags.run_directory import RunDirectory

if TYPE_CHECKING:
    import pandas as pd


def require_trace(run: RunDirectory) -> "pd.DataFrame":
    """Return the signals of a complete run; its bag is read if they are not stored."""
    from oracle_pipeline.oracles.kept_traces import kept_trace

    return kept_trace(run, layout.traces(run.root))
