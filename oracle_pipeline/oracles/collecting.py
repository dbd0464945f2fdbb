"""Collects the recordings below some folders: labels from manifests, signals from bags."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TypeAlias

import pandas as pd

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.manifest import UNKNOWN_WORLD, Manifest
from oracle_pipeline.bags.remote import fetched
from oracle_pipeline.bags.run_directory import MANIFEST_FILE, RunDirectory
from oracle_pipeline.bags.terminal import printable, progress_bar
from oracle_pipeline.datasets import KEYS
from oracle_pipeline.logs.formats import recordings_below
from oracle_pipeline.opened_run import open_run
from oracle_pipeline.oracles.kind import RELATION, SAME, KindError, TracedRuns
from oracle_pipeline.oracles.traces import NO_NUMBERS, all_numbers, read_trace
from oracle_pipeline.robots.robot import find_robots, of_robot
from oracle_pipeline.robots.roles import COMMAND, ODOMETRY
from oracle_pipeline.scoring.isolation import WIDE_LIMITS, isolated_each, run_isolated

_Traced: TypeAlias = tuple[dict[str, object], pd.DataFrame]

_NO_BLOCK = -1  # for a bag without a manifest, which becomes its own block and session


def traced_runs(
    recordings: Sequence[Path], normal: Sequence[Path] = (), numbers: Mapping[str, str] = NO_NUMBERS
) -> TracedRuns:
    """Read the traces of all recordings below some folders.

    Parameters
    ----------
    recordings : sequence of Path
        Run directories, bags, and folders of these. A bag without a manifest has no label.
    normal : sequence of Path
        The same; a bag without a manifest counts as normal, and as its own block.
    numbers : mapping of str to str
        Further signals, as of `read_trace`.

    An attacked run that ended before its attack is left out.

    Returns
    -------
    TracedRuns
        The table has a column `RELATION` besides the keys.

    Raises
    ------
    OracleError
        There is no recording, some cannot be read, which it names, or none has a further signal.
    """
    found = {path: "normal" for top in normal for path in recordings_below(top)}
    found |= {path: "unknown" for top in recordings for path in recordings_below(top)}
    if not found:
        raise KindError("There is no recording; give run directories, bags or folders of these.")
    rows: list[dict[str, object]] = []
    traces: list[pd.DataFrame] = []
    errors: list[str] = []
    work = partial(_traced, numbers=dict(numbers))
    jobs = [(partial(work, label=label), path) for path, label in found.items()]
    answers = isolated_each(jobs, WIDE_LIMITS)
    for answer in progress_bar(answers, unit="recording", total=len(found), desc="signals"):
        if isinstance(answer, OracleError):
            errors.append(str(answer))
            continue
        for row, trace in answer:
            own_block = {"block": -2 - len(rows)} if row["block"] == _NO_BLOCK else {}
            rows.append(row | own_block)
            traces.append(trace)
    if errors:
        raise KindError("\n".join(errors))
    for name, number in numbers.items():
        if all(trace[name].isna().all() for trace in traces):
            raise KindError(
                f"No recording has {number}, which the requirements call {name}. `oracle features "
                "RECORDING` lists numbers, such as signals./battery_state/voltage.mean."
            )
    table = pd.DataFrame(rows, columns=[*KEYS, RELATION])
    alone = table["session"] < 0
    return TracedRuns(
        table.assign(session=table["session"].mask(alone, table["block"])), tuple(traces)
    )


def numbers_to_learn(recordings: Sequence[Path]) -> dict[str, str]:
    """Return all numbers of the first recording, if its robot has no odometry and no commands.

    A recording that cannot be read has none; `traced_runs` names it with all others.
    """
    first = next((each for top in recordings for each in recordings_below(top)), None)
    with suppress(OracleError):
        return run_isolated(_numbers_of, first, WIDE_LIMITS) if first else {}
    return {}


def _numbers_of(path: Path) -> dict[str, str]:
    with open_run(path) as opened:
        robot = find_robots(opened.bag)[0]
        drives = any(robot.roles.found[role].topics for role in (ODOMETRY, COMMAND))
        return {} if drives else all_numbers(robot)


def _traced(path: Path, label: str, numbers: Mapping[str, str]) -> list[_Traced]:
    """Return the traces of a recording's robots; none of an attacked run without its attack."""
    if (path / MANIFEST_FILE).is_file():
        run = RunDirectory.at(path)
        manifest = run.manifest()
        too_short = manifest.label == "malicious" and manifest.onset_s is None
        return [] if too_short else [_of_run(run, manifest, numbers)]
    traced = []
    with open_run(path) as opened:
        for robot in find_robots(opened.bag):
            name = of_robot(printable(path.resolve().name), robot.name)
            keys = (name, "foreign", label, _NO_BLOCK, _NO_BLOCK, UNKNOWN_WORLD)
            row = dict(zip(KEYS, keys, strict=True)) | {RELATION: SAME}
            traced.append((row, read_trace(robot, numbers)))
    return traced


def traced_run(run: RunDirectory, numbers: Mapping[str, str] = NO_NUMBERS) -> TracedRuns:
    """Read the trace of one run, whether or not its attack began."""
    row, trace = _of_run(run, run.manifest(), numbers)
    return TracedRuns(pd.DataFrame([row]), (trace,))


def _of_run(run: RunDirectory, manifest: Manifest, numbers: Mapping[str, str]) -> _Traced:
    keys = (manifest.key, *(getattr(manifest, key) for key in KEYS[1:]))
    relation = manifest.recipe.get("options", {}).get(RELATION, SAME)
    with fetched(run.path) as place, open_run(place) as opened:
        trace = read_trace(find_robots(opened.bag)[0], numbers)
    return dict(zip(KEYS, keys, strict=True)) | {RELATION: relation}, trace
