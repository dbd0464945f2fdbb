"""One run, from its recipe to its features, in a worker process.

A run that exists and matches its recipe is not touched and reported as ``verified``. With
``refresh`` it is simulated again in a separate directory and replaces the previous run, unless the
messages differ although code, libraries, CPU and recipe are the same. Bags that the storage plan
does not keep are dropped once features are extracted, and re-simulated when features need them.
"""

import time
from dataclasses import replace

from assets.worker.description import described_features, described_recording
from assets.worker.feature_tables import ensure_tables, tables_are_current, topics_of_features
from assets.worker.local_run import local_directory, on_this_machine, publish_run
from assets.worker.reproduction import judge, refreshed_directory
from assets.worker.run_job import AssetOfRun, RunJob, RunReport, Status
from oracle_pipeline.bags.manifest import KEPT, Manifest
from oracle_pipeline.bags.remote import is_local, publish
from oracle_pipeline.bags.retention import retain
from oracle_pipeline.bags.run_directory import MANIFEST_FILE, RunDirectory
from sim.experiments import can_be_rebuilt, recipe_for, record_run, remake_run
from sim.pairs import judge_pair


def process_run(job: RunJob) -> RunReport:
    """Produce the requested assets of a run, and what they need.

    Raises
    ------
    OracleError
        If the run cannot be recorded, or its recording cannot be read.
    """
    with job.directory.held():
        renewed = job.refresh and job.wants_recording
        if renewed and (previous := job.directory.readable_manifest()):
            return _resimulate(job, previous)
        if renewed or not job.directory.is_complete():
            return _make(job)
        if job.wants_recording:
            _record(job)
        if _needs_bag(job, manifest := job.directory.manifest()):
            return _remake(job, manifest)
        return _finish(job, "verified")


def _needs_bag(job: RunJob, manifest: Manifest) -> bool:
    """Return whether features must be extracted but the bag was trimmed or dropped."""
    if manifest.measured.kept == "full" or not job.wants_features:
        return False
    return job.refresh or not tables_are_current(job.directory, manifest)


def _make(job: RunJob) -> RunReport:
    """Record a run that is missing or incomplete."""
    with local_directory(job.directory) as local:
        local_job = replace(job, directory=local)
        _record(local_job)
        return _finish(local_job, "made")


def _remake(job: RunJob, manifest: Manifest) -> RunReport:
    """Re-simulate the bag of a run that has been trimmed or dropped."""
    with local_directory(job.directory) as local:
        remake_run(manifest, local)
        return _finish(replace(job, directory=local), "remade")


def _resimulate(job: RunJob, previous: Manifest) -> RunReport:
    """Re-simulate a complete run, and replace it unless messages differ for an unknown reason."""
    run = job.directory
    with on_this_machine(refreshed_directory(run)) as aside:
        _record(replace(job, directory=aside))
        reproduction = judge(previous, aside)
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
            publish_run(aside, run)
    return replace(report, reproduction=reproduction)


def _record(job: RunJob) -> None:
    """Record the run, or verify it if it is complete."""
    recipe = recipe_for(job.directory.mode, job.directory.run, job.campaign)
    record_run(recipe, job.directory, refresh=job.refresh)


def _finish(job: RunJob, status: Status) -> RunReport:
    """Extract the features of a complete run, trim its bag, and describe the result."""
    run, manifest = job.directory, job.directory.manifest()
    picture = _picture(run) if "experiment_runs" in job.wanted else ""
    made: dict[str, AssetOfRun] = {}
    if job.wants_features:
        started = time.perf_counter()
        extracted = ensure_tables(run, manifest, refresh=job.refresh)
        wall_s = time.perf_counter() - started
        made |= described_features(run, "made" if extracted else "verified", wall_s)
    if KEPT.index(job.keep) > KEPT.index(manifest.measured.kept) and can_be_rebuilt(manifest):
        manifest = _retain(job, manifest)
    if job.wants_recording:
        made |= described_recording(run, manifest, status, job.keep, picture)
    return RunReport(
        simulated_s=manifest.recording_s if status != "verified" else 0.0,
        assets={asset: described for asset, described in made.items() if asset in job.wanted},
        kept=manifest.measured.kept,
        freed_bytes=manifest.measured.freed_bytes,
    )


def _picture(run: RunDirectory) -> bytes | str:
    """Return a map of the run, or why there is none; a failure must not fail the run."""
    from oracle_pipeline.replay.picture import kept_picture

    try:
        return kept_picture(run.path)
    except Exception as error:
        return f"not drawn: {error}"


def _retain(job: RunJob, manifest: Manifest) -> Manifest:
    """Trim or drop the bag as planned, after everything that needs all of it."""
    run = job.directory
    if manifest.measured.kept == "full":
        ensure_tables(run, manifest, refresh=False)
        _picture(run)
    retain(run, job.keep, topics_of_features)
    judge_pair(run)  # another worker may have replaced the other run meanwhile
    return run.manifest()
