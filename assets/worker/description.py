"""The figures of the assets of one run, as the UI shows them."""

import hashlib

from assets.worker.kept_tables import kept_tables
from assets.worker.run_job import RECORDED, TABLES, AssetOfRun, Figures, Status
from assets.worker.versions import feature_code
from oracle_pipeline.bags.errors import RunDirectoryError
from oracle_pipeline.bags.graph_files import read_gexf
from oracle_pipeline.bags.integrity import require_undamaged
from oracle_pipeline.bags.layout import TableName
from oracle_pipeline.bags.manifest import Kept, Manifest
from oracle_pipeline.bags.run_directory import GRAPHS_FOLDER, RunDirectory


def described_recording(
    run: RunDirectory, manifest: Manifest, status: Status, planned: Kept, picture: bytes | str
) -> dict[str, AssetOfRun]:
    """Return the assets that the simulation has written.

    Parameters
    ----------
    run, manifest
        A complete run and its manifest.
    status
        What was done.
    planned
        How much of the bag the storage plan keeps.
    picture
        Its map, or why there is none.
    """
    contents = (
        (run.path, _of_run(manifest) | {"picture": picture}),
        (run.bag, _of_bag(manifest) | {"planned": planned}),
        (run.graphs, _of_graphs(run, manifest)),
    )
    return {
        asset: AssetOfRun(
            path.relative_to(run.root).as_posix(),
            manifest.software.code,
            str(figures["content_hash"]),
            {"status": status, **figures},
        )
        for asset, (path, figures) in zip(RECORDED, contents, strict=True)
    }


def _of_run(manifest: Manifest) -> Figures:
    measured = manifest.measured
    return {
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


def _of_bag(manifest: Manifest) -> Figures:
    measured = manifest.measured
    return {
        "bytes": measured.bytes["bag"],
        "messages": sum(topic.messages for topic in manifest.topics.values()),
        "topics": len(manifest.topics),
        "kept": measured.kept,
        "freed_bytes": measured.freed_bytes,
        "content_hash": manifest.content_hash,
    }


def _of_graphs(run: RunDirectory, manifest: Manifest) -> Figures:
    require_undamaged(run.path, manifest, GRAPHS_FOLDER)
    graph = read_gexf(run.graphs / "run.gexf")
    files = sorted(run.graphs.iterdir())
    kinds = [vertex["kind"] for _, vertex in graph.nodes(data=True)]
    return {
        "intervals": sum(file.stem.isdecimal() for file in files),
        "nodes": kinds.count("node"),
        "topics": kinds.count("topic"),
        "edges": graph.number_of_edges(),
        "bytes": manifest.measured.bytes["graphs"],
        "content_hash": hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest(),
    }


def described_features(run: RunDirectory, status: Status, wall_s: float) -> dict[str, AssetOfRun]:
    """Return the assets that were extracted from the recording, in so many seconds."""
    return {asset: _of_table(run, table, status, wall_s) for asset, table in TABLES.items()}


def _of_table(run: RunDirectory, table: TableName, status: Status, wall_s: float) -> AssetOfRun:
    if (kept := kept_tables(run)) is None:
        raise RunDirectoryError(f"{run.key} has no feature tables; materialize them again.")
    figures: Figures = {
        "status": status,
        **kept.runs[run.run_id]["figures"][table],
        "wall_s": wall_s,
    }
    place = kept.place(table).relative_to(run.root).as_posix()
    return AssetOfRun(place, feature_code(), str(figures["content_hash"]), figures)
