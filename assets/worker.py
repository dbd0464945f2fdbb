"""One run, from its recipe to its features, in a worker process.

No Dagster here: a fresh interpreter imports this module before it can start. What is there
already and still right is left as it is and called verified.
"""

import hashlib
import json
import time
from dataclasses import dataclass
from pathlib import Path

from assets.feature_tables import Table, ensure_tables, feature_table
from assets.versions import feature_code
from oracle_pipeline.bags.graph_files import read_gexf
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.datasets import MISSING, content_hash, feature_columns, read_table
from sim.experiments import record_run
from sim.recipes import Campaign, recipe_for

RECORDED = ("experiment_runs", "bags", "interval_graphs")  # made together, by the simulation
# Made together, from the recording.
TABLES: dict[str, Table] = {"window_features": "window", "run_features": "run"}

Figures = dict[str, int | float | str | bytes]  # bytes: a picture, PNG


@dataclass(frozen=True, slots=True)
class RunJob:
    """What is wanted of one run."""

    directory: RunDirectory
    campaign: Campaign
    wanted: frozenset[str]  # assets
    refresh: bool  # make again what is there already


@dataclass(frozen=True, slots=True)
class Made:
    """One asset of one run, as it is now."""

    path: Path
    code: str  # version of the code that made it
    version: str  # hash of the content
    figures: Figures


@dataclass(frozen=True, slots=True)
class RunReport:
    """What became of one run."""

    simulated_s: float  # of simulated time; 0 if the run was there already
    assets: dict[str, Made]  # those that were wanted


def process_run(job: RunJob) -> RunReport:
    """Make what is wanted of a run, and what that needs.

    Raises
    ------
    OracleError
        If the run cannot be recorded, or what was recorded cannot be read.
    """
    made: dict[str, Made] = {}
    recorded = _record(job)
    manifest = job.directory.manifest()
    if not job.wanted.isdisjoint(RECORDED):
        made |= _recording(job.directory, manifest, _status(recorded))
    if "experiment_runs" in job.wanted:
        made["experiment_runs"].figures["picture"] = _picture(job.directory)
    if not job.wanted.isdisjoint(TABLES):
        made |= _features(job, manifest)
    return RunReport(
        simulated_s=manifest.recording_s if recorded else 0.0,
        assets={asset: described for asset, described in made.items() if asset in job.wanted},
    )


def _record(job: RunJob) -> bool:
    """Record the run unless it is there; tell whether it was recorded."""
    complete = job.directory.is_complete()
    if complete and job.wanted.isdisjoint(RECORDED):
        return False
    recipe = recipe_for(job.directory.mode, job.directory.run, job.campaign)
    record_run(recipe, job.directory, refresh=job.refresh)
    return job.refresh or not complete


def _recording(directory: RunDirectory, manifest: Manifest, status: str) -> dict[str, Made]:
    measured = manifest.measured
    run: Figures = {
        "status": status,
        "outcome": manifest.outcome,
        "label": manifest.label,
        "block": manifest.block,
        "session": manifest.session,
        "goals": len(manifest.goals),
        "goals_reached": sum(goal.outcome == "succeeded" for goal in manifest.goal_results),
        "contacts": len(manifest.contacts),
        "recording_s": manifest.recording_s,
        "wall_s": measured.wall_s,
        "real_time_factor": manifest.recording_s / measured.wall_s,
        "bytes": sum(measured.bytes.values()),
        "content_hash": manifest.content_hash,
    }
    bag: Figures = {
        "status": status,
        "bytes": measured.bytes["bag"],
        "messages": sum(topic.messages for topic in manifest.topics.values()),
        "topics": len(manifest.topics),
        "content_hash": manifest.content_hash,
    }
    graph = read_gexf(directory.graphs / "run.gexf")
    files = sorted(directory.graphs.iterdir())
    kinds = [vertex["kind"] for _, vertex in graph.nodes(data=True)]
    graphs: Figures = {
        "status": status,
        "intervals": sum(file.stem.isdecimal() for file in files),
        "nodes": kinds.count("node"),
        "topics": kinds.count("topic"),
        "edges": graph.number_of_edges(),
        "bytes": measured.bytes["graphs"],
        "content_hash": hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest(),
    }
    described = ((directory.path, run), (directory.bag, bag), (directory.graphs, graphs))
    return {
        asset: Made(path, manifest.software.code, str(figures["content_hash"]), figures)
        for asset, (path, figures) in zip(RECORDED, described, strict=True)
    }


def _picture(directory: RunDirectory) -> bytes | str:
    """Return the run from above, or why it could not be drawn: a run is not lost for a picture."""
    from oracle_pipeline.reporting.run_picture import kept_picture

    try:
        return kept_picture(directory.path)
    except Exception as error:
        return f"not drawn: {error}"


def _features(job: RunJob, manifest: Manifest) -> dict[str, Made]:
    started = time.perf_counter()
    extracted = ensure_tables(job.directory, manifest, refresh=job.refresh)
    wall_s = time.perf_counter() - started
    made = {}
    for asset, table in TABLES.items():
        place = feature_table(job.directory, table)
        df = read_table(place)
        reasons = [json.loads(row) for row in df[MISSING]]
        absent = sorted({name for row in reasons for name in row})
        version = content_hash(df)
        figures: Figures = {
            "status": _status(extracted),
            "rows": len(df),
            "features": len(feature_columns(df)),
            "missing": sum(len(row) for row in reasons),
            "missing_features": ", ".join(absent),
            "bytes": place.stat().st_size,
            "wall_s": wall_s,
            "content_hash": version,
        }
        made[asset] = Made(place, feature_code(), version, figures)
    return made


def _status(made_now: bool) -> str:
    return "made" if made_now else "verified"
