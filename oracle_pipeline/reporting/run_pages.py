"""A page for each run, ``runs/<mode>/<run>.html``, and a list of all runs.

Pages are written from manifest, picture and tables of a run, without its bag. Each page is one
self-contained file.
"""

import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.scratch import replaced_folder
from oracle_pipeline.detectors import Deviation, by_family
from oracle_pipeline.evaluation.comparisons import RATES
from oracle_pipeline.evaluation.unusual_windows import UnusualWindows
from oracle_pipeline.features import FeatureTables
from oracle_pipeline.reporting import page_tables
from oracle_pipeline.reporting.first_screen import run_page
from oracle_pipeline.reporting.heat_strip import HeatStrip, heat_strip
from oracle_pipeline.reporting.page import Picture, run_picture, template
from oracle_pipeline.reporting.page_tables import PageTable
from oracle_pipeline.reporting.report import Report
from oracle_pipeline.reporting.two_scores import scores_table, task_table
from oracle_pipeline.scoring.evidence import farthest_features
from oracle_pipeline.scoring.feature_sets import feature_sets
from oracle_pipeline.scoring.measured_runs import MeasuredRuns

UP = "../../"  # from a run's page to the folder of the report
BAGS = {
    "full": "whole",
    "trimmed": "trimmed to the topics that features need",
    "recipe": "dropped to save space; it can be simulated again from the recipe",
}


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ShownRuns:
    """The data behind the pages of runs."""

    measured: MeasuredRuns
    evaluation: Report  # of `oracle_pipeline.reporting.evaluation_report`
    deviations: Mapping[str, Sequence[Deviation]]  # by run
    unusual: UnusualWindows | None  # of the windows of `measured`; None: too few blocks
    path: Callable[[str], Path]  # of a run's folder
    film: str  # file name of the film in that folder, if there is one
    manifest: Callable[[str], Manifest]
    picture: Callable[[str], bytes]  # PNG; raises `OracleError` if there is none


class JudgedTables(NamedTuple):
    """Results of the evaluation for single runs."""

    runs: pd.DataFrame  # by run, with the rank of its score
    scored: int
    differences: pd.DataFrame  # from unaltered runs, by run
    uncertainty: Mapping[str, float]  # of the differences, by quantity
    raised: pd.DataFrame  # alarms

    @classmethod
    def of(cls, evaluation: Report) -> "JudgedTables":
        """Return the tables of an evaluation, indexed by run."""
        tables = evaluation.tables
        runs, usual = tables["runs"], tables["task_uncertainty"]
        ranks = runs.assign(rank=runs["score"].rank(ascending=False))
        return cls(
            runs=ranks.set_index("run_id"),
            scored=int(runs["score"].notna().sum()),
            differences=tables["task_differences"].set_index("run_id"),
            uncertainty=dict(zip(usual["quantity"], usual["uncertainty"], strict=True)),
            raised=tables["raised"],
        )


class RunLine(NamedTuple):
    """A run in the list of all runs."""

    run: str
    page: str  # relative to the list
    label: str
    cells: Sequence[str]


LIST = ("score", "p", "p tampered", "p misbehaved", "block", "session", "ended", "recorded")


def write_run_pages(shown: ShownRuns, folder: Path) -> int:
    """Write the pages of all runs, replacing existing ones; return the number of runs.

    Parameters
    ----------
    shown : ShownRuns
    folder : Path
        The folder ``runs`` of the report, on this machine.
    """
    with replaced_folder(folder) as new:
        for run, page in _pages(shown):
            place = new / run_page(run).removeprefix("runs/")
            place.parent.mkdir(exist_ok=True)
            place.write_text(page, encoding="utf-8")
        listing = template("runs.html.j2").render(
            heads=LIST, lines=_lines(shown.evaluation.tables["runs"])
        )
        (new / "index.html").write_text(listing, encoding="utf-8")
    return len(shown.measured.features)


def _lines(judged: pd.DataFrame) -> list[RunLine]:
    """Return the runs by descending score."""
    return [
        RunLine(
            run["run_id"],
            run_page(run["run_id"]).removeprefix("runs/"),
            run["label"],
            (
                _number(run["score"]),
                _number(run["p"]),
                _number(run["tampering_p"]),
                _number(run["misbehaviour_p"]),
                str(run["block"]),
                str(run["session"]),
                run["outcome"],
                f"{run['recording_s']:.0f} s",
            ),
        )
        for _, run in judged.sort_values("score", ascending=False).iterrows()
    ]


def _number(value: float) -> str:
    return page_tables.NO_FIGURE if np.isnan(value) else f"{value:.3g}"


def _pages(shown: ShownRuns) -> Iterator[tuple[str, str]]:
    """Yield each run and its page."""
    measured, tables_of_runs = shown.measured, JudgedTables.of(shown.evaluation)
    features = measured.features
    blocks = features.groupby("block")["run_id"].agg(list)
    windows_of = np.split(np.arange(len(measured.run)), np.cumsum(measured.counts)[:-1])
    columns = feature_sets(features).get("all", [])
    for number, run in enumerate(features["run_id"]):
        row, of_run = features.iloc[[number]], windows_of[number]
        manifest = shown.manifest(run)
        deviations = shown.deviations.get(run, ())
        tables = FeatureTables(row, measured.windows.iloc[of_run])
        picture, why_not = _picture(shown, run)
        judged = _judged(tables_of_runs, run, manifest)
        yield (
            run,
            template("run.html.j2").render(
                run=run,
                up=UP,
                manifest=manifest,
                verdict=judged.verdict,
                scores=judged.scores,
                task=judged.task,
                facts=_facts(manifest),
                goals=_goals(manifest),
                picture=picture,
                why_not=why_not,
                strip=_strip(shown, of_run, manifest, judged.alarms_s),
                evidence=page_tables.of_evidence(
                    f"What is unusual in {run}", farthest_features(deviations, tables)
                ),
                families=page_tables.of_families(by_family(deviations, columns)),
                film=_film(shown.path(run), shown.film),
                replay=f"oracle replay {shlex.quote(str(shown.path(run)))}",
                beside=[
                    (other, UP + run_page(other))
                    for other in blocks[row["block"].iloc[0]]
                    if other != run
                ],
            ),
        )


class JudgedRun(NamedTuple):
    """Results of the evaluation for one run."""

    verdict: str
    scores: PageTable | None  # None: the run was not judged
    task: PageTable
    alarms_s: Sequence[float]


def _judged(tables: JudgedTables, run: str, manifest: Manifest) -> JudgedRun:
    if run not in tables.runs.index:
        unknown = pd.Series(dtype=float)
        return JudgedRun(_verdict(None, 0), None, task_table(manifest, unknown, {}), [])
    row, differences = tables.runs.loc[[run]].iloc[0], tables.differences.loc[[run]].iloc[0]
    return JudgedRun(
        _verdict(row, tables.scored),
        scores_table(row, manifest, differences, tables.uncertainty),
        task_table(manifest, differences, tables.uncertainty),
        tables.raised.loc[tables.raised["run_id"] == run, "at_s"].tolist(),
    )


def _picture(shown: ShownRuns, run: str) -> tuple[Picture | None, str]:
    """Return the picture of a run, or why there is none."""
    try:
        return run_picture(run, shown.picture(run)), ""
    except (OracleError, OSError) as error:
        return None, f"It is not drawn: {error}"


def _verdict(judged: pd.Series | None, scored: int) -> str:
    """Return the verdict on a run and its rank."""
    if judged is None:
        return "Not judged: it ended before its attack began."
    if np.isnan(judged["score"]):
        return "Not judged: a score needs normal runs of three blocks."
    where = f"Score {judged['score']:.3g}, rank {judged['rank']:.0f} of {scored}."
    if np.isnan(judged["p"]):
        return f"{where} No verdict: there are too few normal blocks for one at {RATES[0]:.0%}."
    called = "Anomalous" if judged["p"] <= RATES[0] else "Not anomalous"
    return f"{called} at a false positive rate of {RATES[0]:.0%}: p = {judged['p']:.3g}. {where}"


def _facts(manifest: Manifest) -> dict[str, str]:
    """Return facts about a run, by name."""
    reached = sum(goal.outcome == "succeeded" for goal in manifest.goal_results)
    changed = sum(change.messages for change in manifest.changes)
    facts = {
        "outcome": f"{manifest.outcome}; {reached} of {len(manifest.goals)} goals reached",
        "recorded": f"{manifest.recording_s:.1f} s",
        "block, session, world": f"{manifest.block}, {manifest.session}, {manifest.world}",
        "contacts": ", ".join(dict.fromkeys(c.piece for c in manifest.contacts)) or "none",
    }
    if manifest.label == "malicious":
        began = "never" if manifest.onset_s is None else f"at {manifest.onset_s:.1f} s"
        facts["attack began"] = f"{began}; {changed} messages changed"
    if manifest.attack:
        facts["attack"] = ", ".join(f"{k} {_value(v)}" for k, v in manifest.attack.items())
    facts["bag"] = BAGS[manifest.measured.kept]
    return facts


def _value(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _goals(manifest: Manifest) -> PageTable:
    """Return the result of each goal."""
    table = pd.DataFrame(
        [
            (
                number,
                goal.outcome,
                f"{goal.accepted_s:.1f}",
                page_tables.NO_FIGURE if goal.ended_s is None else f"{goal.ended_s:.1f}",
                f"{goal.driven_m:.1f}",
                goal.recoveries,
            )
            for number, goal in enumerate(manifest.goal_results, start=1)
        ],
        columns=["goal", "outcome", "accepted [s]", "ended [s]", "driven [m]", "recoveries"],
    )
    return page_tables.of_any("Goals", table)


def _strip(
    shown: ShownRuns, windows: NDArray[np.intp], manifest: Manifest, alarms_s: Sequence[float]
) -> HeatStrip | None:
    if shown.unusual is None or not len(windows):
        return None
    return heat_strip(
        shown.unusual.where(windows),
        manifest.recording_s,
        manifest.onset_s if manifest.label == "malicious" else None,
        [goal.ended_s for goal in manifest.goal_results if goal.ended_s is not None],
        alarms_s,
    )


def _film(path: Path, name: str) -> str:
    """Return the film of a run, relative to its page; empty if none was made."""
    if not (path / name).is_file():
        return ""
    return f"{UP}../runs/{path.parent.name}/{path.name}/{name}"
