"""A page for each run, ``runs/<mode>/<run>.html``, and a list of all runs.

Pages are written from manifest, picture and tables of a run, without its bag. Each page is one
self-contained file.
"""

import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.scratch import replaced_folder
from oracle_pipeline.detectors import Deviation
from oracle_pipeline.evaluation.card_verdicts import RATE
from oracle_pipeline.features import FeatureTables
from oracle_pipeline.reporting.stored_report import Report
from oracle_pipeline.reporting.tables import PageTable, evidence_table, table
from oracle_pipeline.reporting.templating import Picture, run_page, run_picture, template
from oracle_pipeline.reporting.two_scores import scores_table, task_table
from oracle_pipeline.scoring.evidence import farthest_features
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
    path: Callable[[str], Path]  # of a run's folder
    film: str  # file name of the film in that folder, if there is one
    manifest: Callable[[str], Manifest]
    picture: Callable[[str], bytes]  # PNG; raises `OracleError` if there is none


def write_run_pages(shown: ShownRuns, folder: Path) -> int:
    """Write the pages of all runs, replacing existing ones; return the number of runs.

    Parameters
    ----------
    shown : ShownRuns
    folder : Path
        The folder ``runs`` of the report, on this machine.
    """
    runs = shown.evaluation.tables["runs"].sort_values("score", ascending=False)
    links = [_place(run) for run in runs["run_id"]]
    with replaced_folder(folder) as new:
        for run, page in _pages(shown):
            place = new / _place(run)
            place.parent.mkdir(exist_ok=True)
            place.write_text(page, encoding="utf-8")
        listing = template("runs.html.j2").render(listed=table("runs", runs, links=links))
        (new / "index.html").write_text(listing, encoding="utf-8")
    return len(shown.measured.features)


def _place(run: str) -> str:
    """Return the page of a run, relative to the list of all runs."""
    return run_page(run).removeprefix("runs/")


def _pages(shown: ShownRuns) -> Iterator[tuple[str, str]]:
    """Yield each run and its page."""
    measured, results = shown.measured, shown.evaluation.tables
    features = measured.features
    blocks = features.groupby("block")["run_id"].agg(list)
    windows_of = np.split(np.arange(len(measured.run)), np.cumsum(measured.counts)[:-1])
    judged = results["runs"].merge(results["task_differences"], on="run_id").set_index("run_id")
    judged["rank"] = judged["score"].rank(ascending=False)
    scored = int(judged["score"].notna().sum())
    usual = dict(results["task_uncertainty"][["quantity", "uncertainty"]].to_numpy())
    raised = results["raised"]
    for number, run in enumerate(features["run_id"]):
        row = features.iloc[[number]]
        manifest = shown.manifest(run)
        deviations = shown.deviations.get(run, ())
        tables = FeatureTables(row, measured.windows.iloc[windows_of[number]])
        pictures, undrawn = _drawn(run, shown.picture)
        of_judged = judged.loc[run] if run in judged.index else None
        yield (
            run,
            template("run.html.j2").render(
                run=run,
                up=UP,
                manifest=manifest,
                bag=BAGS[manifest.measured.kept],
                verdict=_verdict(of_judged, scored),
                scores=None if of_judged is None else scores_table(of_judged, manifest, usual),
                task=task_table(of_judged, manifest, usual),
                goals=_goals(manifest),
                pictures=pictures,
                undrawn=undrawn,
                alarms_s=raised.loc[raised["run_id"] == run, "at_s"].tolist(),
                evidence=evidence_table(
                    f"What is unusual in {run}", farthest_features(deviations, tables)
                ),
                film=_film(shown.path(run), shown.film),
                replay=f"oracle replay {shlex.quote(str(shown.path(run)))}",
                beside=[other for other in blocks[row["block"].iloc[0]] if other != run],
            ),
        )


def _drawn(run: str, draw: Callable[[str], bytes]) -> tuple[list[Picture], list[str]]:
    """Return the picture of a run, or the reason why there is none."""
    try:
        return [run_picture(run, draw(run))], []
    except (OracleError, OSError) as error:
        return [], [f"{run} is not drawn: {error}"]


def _verdict(judged: pd.Series | None, scored: int) -> str:
    """Return the verdict on a run and its rank."""
    if judged is None:
        return "Not judged: it ended before its attack began."
    if np.isnan(judged["score"]):
        return "Not judged: a score needs normal runs of three blocks."
    where = f"Score {judged['score']:.3g}, rank {judged['rank']:.0f} of {scored}."
    if np.isnan(judged["p"]):
        return f"{where} No verdict: there are too few normal blocks for one at {RATE:.0%}."
    called = "Anomalous" if judged["p"] <= RATE else "Not anomalous"
    return f"{called} at a false positive rate of {RATE:.0%}: p = {judged['p']:.3g}. {where}"


def _goals(manifest: Manifest) -> PageTable:
    """Return the result of each goal."""
    results = pd.DataFrame(manifest.goal_results)
    return table("goals", results.assign(goal=np.arange(1, len(results) + 1)))


def _film(path: Path, name: str) -> str:
    """Return the film of a run, relative to its page; empty if none was made."""
    if not (path / name).is_file():
        return ""
    return f"{UP}../runs/{path.parent.name}/{path.name}/{name}"
