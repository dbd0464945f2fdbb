"""One run, from its recipe to its features, in a worker process.

A run that exists and matches its recipe is not touched and reported as ``verified``. With
``refresh`` it is simulated again in a separate directory and replaces the previous run, unless the
messages differ although code, libraries, CPU and recipe are the same. Bags that the storage plan
does not keep are dropped once features are extracted, and re-simulated when features need them. A
run for an object store is written to the local disk and then published: manifest last.
"""

import contextlib
import hashlib
import json
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from assets.worker.feature_tables import ensure_tables, tables_are_current, topics_of_features
from assets.worker.reproduction import Reproduction, judge, refreshed_directory, separate_directory
from assets.worker.versions import feature_code
from oracle_pipeline.bags import layout
from oracle_pipeline.bags.errors import ManifestError
from oracle_pipeline.bags.graph_files import read_gexf
from oracle_pipeline.bags.integrity import require_undamaged
from oracle_pipeline.bags.layout import FEATURES, Table
from oracle_pipeline.bags.manifest import KEPT, Kept, Manifest
from oracle_pipeline.bags.remote import is_local, publish
from oracle_pipeline.bags.retention import retain
from oracle_pipeline.bags.run_directory import GRAPHS_FOLDER, MANIFEST_FILE, RunDirectory
from oracle_pipeline.datasets import MISSING, content_hash, feature_columns, read_table
from sim.campaigns import Campaign
from sim.experiments import can_be_rebuilt, recipe_for, record_run, remake_run
from sim.pairs import judge_pair

RECORDED = ("experiment_runs", "bags", "interval_graphs")  # written by the simulation in one step
# Extracted from the recording in one step.
TABLES: dict[str, Table] = {"window_features": "window", "run_features": "run"}
OF_A_RUN = frozenset({*RECORDED, *TABLES})  # every asset of a run

Figures = dict[str, int | float | str | bytes]  # bytes: a picture, PNG
Status = Literal["made", "remade", "verified"]


@dataclass(frozen=True, slots=True)
class RunJob:
    """The work that is requested for one run."""

    directory: RunDirectory
    campaign: Campaign
    wanted: frozenset[str]  # assets
    refresh: bool  # re-simulate a complete run
    keep: Kept = "full"  # how much of the bag to keep at the end

    def __str__(self) -> str:
        """Return the run's partition key."""
        return self.directory.key


@dataclass(frozen=True, slots=True)
class AssetOfRun:
    """The current state of one asset of one run."""

    path: str  # below the root
    code: str  # version of the code that produced it
    version: str  # hash of the content
    figures: Figures


@dataclass(frozen=True, slots=True)
class RunReport:
    """The result of the work on one run."""

    simulated_s: float  # simulated time; 0 if the run was complete
    assets: dict[str, AssetOfRun]  # those requested
    kept: Kept
    freed_bytes: int
    reproduction: Reproduction | None = None  # if it was complete and was re-simulated


def process_run(job: RunJob) -> RunReport:
    """Produce the requested assets of a run, and what they need.

    Raises
    ------
    OracleError
        If the run cannot be recorded, or its recording cannot be read.
    """
    with job.directory.held():
        to_be_recorded = not job.wanted.isdisjoint(RECORDED)
        if to_be_recorded and job.refresh and (previous := _readable_manifest(job.directory)):
            return _resimulate(job, previous)
        if not job.directory.is_complete() or (to_be_recorded and job.refresh):
            with _local_directory(job.directory) as local:
                local_job = replace(job, directory=local)
                _record(local_job)
                return _finish(local_job, "made")
        if to_be_recorded:
            _record(job)
        previous = job.directory.manifest()
        if _needs_bag(job, previous):
            with _local_directory(job.directory) as local:
                remake_run(previous, local)
                return _finish(replace(job, directory=local), "remade")
        return _finish(job, "verified")


def _readable_manifest(run: RunDirectory) -> Manifest | None:
    try:
        return run.manifest()
    except ManifestError:
        return None


def _resimulate(job: RunJob, previous: Manifest) -> RunReport:
    """Re-simulate a complete run, and replace it unless messages differ for an unknown reason."""
    run = job.directory
    with separate_directory(run) as aside:
        _record(replace(job, directory=aside))
        reproduction = judge(run, previous, aside)
        if reproduction.comparison == "unexplained":
            if not is_local(run.root):
                publish(aside.path, refreshed_directory(run).path, MANIFEST_FILE)
            report = _finish(replace(job, refresh=False), "verified")
        elif is_local(run.root):
            run.replace_with(aside)
            judge_pair(run)
            report = _finish(job, "made")
        else:
            report = _finish(replace(job, directory=aside), "made")
            _publish(aside, run)
    return replace(report, reproduction=reproduction)


def _record(job: RunJob) -> None:
    """Record the run, or verify it if it is complete."""
    recipe = recipe_for(job.directory.mode, job.directory.run, job.campaign)
    record_run(recipe, job.directory, refresh=job.refresh)


def _needs_bag(job: RunJob, manifest: Manifest) -> bool:
    """Return whether features must be extracted but the bag was trimmed or dropped."""
    if manifest.measured.kept == "full" or job.wanted.isdisjoint(TABLES):
        return False
    return job.refresh or not tables_are_current(job.directory, manifest)


@contextlib.contextmanager
def _local_directory(run: RunDirectory) -> Iterator[RunDirectory]:
    """Yield a local directory for a run: its own, or a temporary one that is then published."""
    if is_local(run.root):
        yield run
        return
    with tempfile.TemporaryDirectory(prefix="oracle-") as root:
        local = replace(run, root=Path(root))
        try:
            yield local
        finally:  # a complete run is kept even if its features failed
            if local.is_complete():
                _publish(local, run)


def _publish(local: RunDirectory, run: RunDirectory) -> None:
    """Publish a run from a local directory, and compare it with its pair."""
    for folder in (local.root / FEATURES, layout.traces(local.root)):
        for file in folder.rglob("*"):
            if file.is_file():
                (run.root / file.relative_to(local.root).as_posix()).write_bytes(file.read_bytes())
    publish(local.path, run.path, MANIFEST_FILE)
    judge_pair(run)


def _finish(job: RunJob, status: Status) -> RunReport:
    """Extract the features of a complete run, trim its bag, and describe the result."""
    made: dict[str, AssetOfRun] = {}
    manifest = job.directory.manifest()
    picture = _picture(job.directory) if "experiment_runs" in job.wanted else ""
    if not job.wanted.isdisjoint(TABLES):
        made |= _features(job, manifest)
    if KEPT.index(job.keep) > KEPT.index(manifest.measured.kept) and can_be_rebuilt(manifest):
        manifest = _retain(job, manifest)
    if not job.wanted.isdisjoint(RECORDED):
        made |= _recording(job.directory, manifest, status)
        made["experiment_runs"].figures["picture"] = picture
        made["bags"].figures["planned"] = job.keep
    return RunReport(
        simulated_s=manifest.recording_s if status != "verified" else 0.0,
        assets={asset: described for asset, described in made.items() if asset in job.wanted},
        kept=manifest.measured.kept,
        freed_bytes=manifest.measured.freed_bytes,
    )


def _retain(job: RunJob, manifest: Manifest) -> Manifest:
    """Trim or drop the bag as planned, after everything that needs all of it."""
    run = job.directory
    if manifest.measured.kept == "full":
        ensure_tables(run, manifest, refresh=False)
        _picture(run)
    retain(run, job.keep, topics_of_features)
    judge_pair(run)  # another worker may have replaced the other run meanwhile
    return run.manifest()


def _recording(
    directory: RunDirectory, manifest: Manifest, status: Status
) -> dict[str, AssetOfRun]:
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
        "kept": measured.kept,
        "freed_bytes": measured.freed_bytes,
        "content_hash": manifest.content_hash,
    }
    require_undamaged(directory.path, manifest, GRAPHS_FOLDER)
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
        asset: AssetOfRun(
            path.relative_to(directory.root).as_posix(),
            manifest.software.code,
            str(figures["content_hash"]),
            figures,
        )
        for asset, (path, figures) in zip(RECORDED, described, strict=True)
    }


def _picture(directory: RunDirectory) -> bytes | str:
    """Return a map of the run, or why there is none; a failure must not fail the run."""
    from oracle_pipeline.replay.picture import kept_picture

    try:
        return kept_picture(directory.path)
    except Exception as error:
        return f"not drawn: {error}"


def _features(job: RunJob, manifest: Manifest) -> dict[str, AssetOfRun]:
    started = time.perf_counter()
    extracted = ensure_tables(job.directory, manifest, refresh=job.refresh)
    wall_s = time.perf_counter() - started
    made = {}
    for asset, table in TABLES.items():
        place = job.directory.feature_table(table)
        df = read_table(place)
        reasons = [json.loads(row) for row in df[MISSING]]
        absent = sorted({name for row in reasons for name in row})
        version = content_hash(df)
        figures: Figures = {
            "status": "made" if extracted else "verified",
            "dagster/row_count": len(df),
            "features": len(feature_columns(df)),
            "missing": sum(len(row) for row in reasons),
            "missing_features": ", ".join(absent),
            "bytes": place.stat().st_size,
            "wall_s": wall_s,
            "content_hash": version,
        }
        path = place.relative_to(job.directory.root).as_posix()
        made[asset] = AssetOfRun(path, feature_code(), version, figures)
    return made
