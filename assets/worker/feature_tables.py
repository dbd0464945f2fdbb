"""The feature tables of one run: extracted again only if something has changed.

``assets.worker.kept_tables`` says where the tables are and what they were made of. Heavy imports
are inside the functions, so that verifying a run is fast.
"""

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from assets.worker.kept_tables import keep_tables, kept_tables
from assets.worker.run_job import Figures
from assets.worker.versions import feature_code
from oracle_pipeline.bags.layout import TABLES, TableName
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.remote import fetched, is_local
from oracle_pipeline.bags.run_directory import RunDirectory

if TYPE_CHECKING:
    import pandas as pd

    from oracle_pipeline.bags.reader import BagReader


def ensure_tables(run: RunDirectory, manifest: Manifest, *, refresh: bool) -> bool:
    """Extract the features of a run unless its tables are current; return whether it extracted.

    Parameters
    ----------
    run, manifest
        A complete run and its manifest.
    refresh
        Always extract.
    """
    from oracle_pipeline.features import build_manager, extract, write
    from oracle_pipeline.opened_run import open_run

    if not refresh and tables_are_current(run, manifest):
        return False
    _remove_leftovers(run)
    with fetched(run.path) as folder, open_run(folder) as opened:
        tables = extract(opened, build_manager())
        of_run, of_windows = write(tables, run)
        figures: dict[TableName, Figures] = {
            "run": _figures(tables.run, of_run),
            "window": _figures(tables.windows, of_windows),
        }
    keep_tables(run, _inputs(manifest), figures)
    return True


def require_tables(run: RunDirectory) -> bool:
    """Call `ensure_tables` for a complete run, without refresh."""
    return ensure_tables(run, run.manifest(), refresh=False)


def tables_are_current(run: RunDirectory, manifest: Manifest) -> bool:
    """Return whether extracting the features of a run now would give the same tables."""
    kept = kept_tables(run)
    if kept is None or kept.runs[run.run_id]["inputs"] != _inputs(manifest):
        return False
    return kept.is_intact()


def topics_of_features(bag: "BagReader") -> frozenset[str]:
    """Return the topics of a bag that plugins request decoded."""
    from oracle_pipeline.features import build_manager
    from oracle_pipeline.features.engine.kept_messages import decoded_topics

    return decoded_topics(bag, build_manager().plugins)


def _remove_leftovers(run: RunDirectory) -> None:
    """Remove half-written tables of a killed worker; the caller holds the lock of the run."""
    if is_local(run.root):
        for table in TABLES:
            for leftover in run.feature_table(table).parent.glob(f".{run.run_id}.*"):
                leftover.unlink(missing_ok=True)


def _inputs(manifest: Manifest) -> str:
    """Return a hash of the inputs of features: the code, and the run without its measurements."""
    not_inputs = {"measured": None, "task_effect": None}
    sources = {**asdict(manifest), **not_inputs, "code": feature_code()}
    return hashlib.sha256(json.dumps(sources, sort_keys=True).encode()).hexdigest()


def _figures(df: "pd.DataFrame", place: Path) -> Figures:
    """Return the figures of a table, which do not change until it is computed again."""
    from oracle_pipeline.datasets import MISSING, content_hash, feature_columns

    reasons = [json.loads(row) for row in df[MISSING]]
    return {
        "dagster/row_count": len(df),
        "features": len(feature_columns(df)),
        "missing": sum(len(row) for row in reasons),
        "missing_features": ", ".join(sorted({name for row in reasons for name in row})),
        "bytes": place.stat().st_size,
        "content_hash": content_hash(df),
    }
