"""The feature tables of one run, extracted once: again only for another run, code or content.

Beside a run's table stands a small JSON file with hashes of what it was made from and of what was
written then. No Dagster here, workers import this; and it is light until something is extracted.
"""

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Literal

from assets.versions import feature_code
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.run_directory import RunDirectory

Table = Literal["run", "window"]
TABLES: tuple[Table, ...] = ("run", "window")


def feature_table(run: RunDirectory, table: Table) -> Path:
    """Return the place of the features of a run, or of its windows."""
    return run.root / "features" / table / run.mode / f"{run.run_id}.parquet"


def ensure_tables(run: RunDirectory, manifest: Manifest, *, refresh: bool) -> bool:
    """Extract the features of a complete run unless its tables are right; tell whether it did.

    Parameters
    ----------
    run, manifest
        The run and what is known of it.
    refresh
        Extract in any case.
    """
    from oracle_pipeline.datasets import replacing
    from oracle_pipeline.features import build_manager, extract, write
    from oracle_pipeline.runs import open_run

    record = feature_table(run, "run").with_suffix(".json")
    inputs = _inputs(manifest)
    if not refresh and _read(record) == {"inputs": inputs, "tables": _hashes(run)}:
        return False
    with open_run(run.path) as opened:
        write(extract(opened, build_manager()), run)
    with replacing(record) as sink:
        sink.write(json.dumps({"inputs": inputs, "tables": _hashes(run)}).encode())
    return True


def _inputs(manifest: Manifest) -> str:
    """Hash what features are a function of: the run, without what its making cost, and our code."""
    sources = {**asdict(manifest), "measured": None, "code": feature_code()}
    return hashlib.sha256(json.dumps(sources, sort_keys=True).encode()).hexdigest()


def _hashes(run: RunDirectory) -> dict[str, str]:
    places = {table: feature_table(run, table) for table in TABLES}
    return {
        table: hashlib.sha256(place.read_bytes()).hexdigest()
        for table, place in places.items()
        if place.is_file()
    }


def _read(record: Path) -> object:
    try:
        return json.loads(record.read_bytes())
    except (FileNotFoundError, ValueError):
        return None
