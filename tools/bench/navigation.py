"""How well the robot drives without an attack, and how a fake object changes that.

Blocks 0 to 99, a third of them in each normal mode. The first 30 blocks also have a run with the
fake object and a run without any mode's node. Bags are read for the poses of AMCL, and then
deleted.
"""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from oracle_pipeline.bags.manifest import GoalResult, Manifest
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.bags.run_directory import RunDirectory
from sim.campaigns import Campaign, Options, Wiring
from sim.commands.progress import RunProgress
from sim.experiments import recipe_for, record_run
from sim.fan_out import fan_out, process_pool
from sim.middleware.geometry import Pose2D, quaternion_yaw
from sim.middleware.stamps import stamp_ns
from sim.nav2.navfn import plan
from sim.testbed import from_json
from sim.turtlebot3.arena import Arena
from sim.turtlebot3.drawing import path_length, planning_grid
from sim.turtlebot3.map import WORLD_IN_MAP
from tools.bench.figures import Row, median

BLOCKS, ATTACKED_BLOCKS = 100, 30
CONTROL, ATTACK = "lidar_passthrough_odom", "fake_object"
LONGER = 1.15  # a path this much longer than the control's counts as an effect
OTHERS = ("lidar_passthrough", "delayed_passthrough")


@dataclass(frozen=True)
class _Job:
    mode: str
    block: int
    wiring: Wiring = "additive"


@dataclass(frozen=True)
class _Drive:
    manifest: Manifest
    amcl_errors_m: list[float]
    detours: list[float]  # driven over shortest, of goals that were reached


def rows() -> Iterator[Row]:
    """Yield the figures."""
    normal = [_Job(CONTROL, block) for block in range(ATTACKED_BLOCKS)]
    normal += [_Job(OTHERS[b % 2], b) for b in range(ATTACKED_BLOCKS, BLOCKS)]
    attacked = [_Job(ATTACK, block) for block in range(ATTACKED_BLOCKS)]
    absent = [_Job(CONTROL, block, "absent") for block in range(ATTACKED_BLOCKS)]
    drives = _drive([*normal, *attacked, *absent])

    runs = [drives[job] for job in normal]
    goals = [goal for run in runs for goal in _goals(run.manifest)]
    reached = sum(goal is not None and goal.outcome == "succeeded" for goal in goals)
    yield Row(f"goals reached, of {len(goals)} in {BLOCKS} blocks", 100.0 * reached / len(goals),
              "%", 97, False)  # fmt: skip
    yield Row("runs with a contact", sum(bool(r.manifest.contacts) for r in runs), "", 0)
    errors = [error for run in runs for error in run.amcl_errors_m]
    yield Row("AMCL position error, median", median(errors), "m", 0.10)
    yield Row("path driven over the shortest, median", median([d for r in runs for d in r.detours]),
              "", 1.25)  # fmt: skip
    recoveries = [sum(goal.recoveries for goal in run.manifest.goal_results) for run in runs]
    yield Row("runs with a recovery", 100.0 * sum(map(bool, recoveries)) / len(runs), "%")
    blocks = range(ATTACKED_BLOCKS)
    controls = [drives[job].manifest for job in normal[:ATTACKED_BLOCKS]]
    for name, jobs, goal, at_most in (
        ("fake object against passthrough: task effect", attacked, 80, False),
        ("passthrough against no node: task effect", absent, 5, True),
    ):
        effects = [_behaved_differently(drives[jobs[b]].manifest, controls[b]) for b in blocks]
        yield Row(name, 100.0 * sum(effects) / len(effects), "%", goal, at_most)


def _behaved_differently(run: Manifest, control: Manifest) -> bool:
    """Return whether a goal had another outcome, a longer path or an additional recovery."""
    return any(
        ours is None
        or theirs is None
        or ours.outcome != theirs.outcome
        or ours.driven_m > LONGER * theirs.driven_m
        or ours.recoveries > theirs.recoveries
        for ours, theirs in zip(_goals(run), _goals(control), strict=True)
    )


def _goals(manifest: Manifest) -> list[GoalResult | None]:
    """Return the result of each goal; None for goals that were never sent."""
    results: list[GoalResult | None] = list(manifest.goal_results)
    return results + [None] * (len(manifest.goals) - len(results))


def _drive(jobs: list[_Job]) -> dict[_Job, _Drive]:
    drives = {}
    with closing(RunProgress(len(jobs))) as progress:
        for outcome in fan_out(_drive_one, jobs, lambda: process_pool(os.cpu_count() or 1)):
            if outcome.result is None:
                raise RuntimeError(f"{outcome.job}: {outcome.error}")
            drives[outcome.job] = outcome.result
            progress.done(outcome.result.manifest.recording_s)
    return drives


def _drive_one(job: _Job) -> _Drive:
    recipe = recipe_for(job.mode, job.block, Campaign(options=Options(wiring=job.wiring)))
    root = Path(tempfile.mkdtemp())
    try:
        directory = RunDirectory(root, job.mode, job.block)
        manifest = record_run(recipe, directory)
        errors = _amcl_errors_m(directory)
    finally:
        shutil.rmtree(root)
    stops = [manifest.start, *manifest.goals]
    grid = planning_grid(from_json(Arena, manifest.recipe["arena"]))
    detours = []
    for result, begin, end in zip(manifest.goal_results, stops, stops[1:], strict=False):
        path = plan(grid, (begin.x, begin.y), (end.x, end.y))
        if result.outcome == "succeeded" and path is not None:
            detours.append(result.driven_m / path_length(path))
    return _Drive(manifest, errors, detours)


def _amcl_errors_m(directory: RunDirectory) -> list[float]:
    """Return how far each pose of AMCL is from the odometry, which is ground truth here."""
    times, truth, believed = [], [], []
    with BagReader(directory.bag) as bag:
        for raw in bag.messages(["/odom", "/amcl_pose"]):
            message = bag.deserialize(raw)
            pose, time_ns = message.pose.pose, stamp_ns(message.header.stamp)
            x, y, q = pose.position.x, pose.position.y, pose.orientation
            if raw.topic == "/odom":
                robot = WORLD_IN_MAP.compose(Pose2D(x, y, quaternion_yaw(q.x, q.y, q.z, q.w)))
                times.append(time_ns)
                truth.append((robot.x, robot.y))
            else:
                believed.append((time_ns, x, y))
    errors = []
    times_ns, positions = np.array(times), np.array(truth)
    for time_ns, x, y in believed:
        if times_ns[0] <= time_ns <= times_ns[-1]:
            where = [np.interp(time_ns, times_ns, positions[:, axis]) for axis in (0, 1)]
            errors.append(float(np.hypot(x - where[0], y - where[1])))
    return errors
