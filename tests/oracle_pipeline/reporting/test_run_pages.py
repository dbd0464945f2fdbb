"""The pages of single runs, written into the report's folder and read back."""

import re
from dataclasses import replace

import numpy as np
import pytest

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.manifest import Change, Drive, Manifest, Measured
from oracle_pipeline.evaluation.run_deviations import deviations_of_runs
from oracle_pipeline.reporting.run_pages import ShownRuns, write_run_pages
from oracle_pipeline.reporting.strip_plot import strip_plot
from oracle_pipeline.reporting.templating import run_page
from oracle_pipeline.scoring.measured_runs import MeasuredRuns
from tests.oracle_pipeline.datasets.synthetic import DELAY_S, campaign
from tests.oracle_pipeline.reporting.pages import draw, oracle_report_of
from tests.oracle_pipeline.reporting.recordings import manifest

ATTACKED, NORMAL, DROPPED = "delayed_fakeobject|run001", "benign_noise|run002", "fake_object|run004"
STILL = "fake_object|run003"  # its robot does not drive


def shown_runs(tmp_path):
    features, windows, truth = campaign(5, effect=20.0)
    evaluation = oracle_report_of(features, windows, truth)
    measured = MeasuredRuns.ordered(features, windows)
    labels = dict(zip(features["run_id"], features["label"], strict=True))

    def of_run(run) -> Manifest:
        mode, number = run.split("|run")
        kept = Measured(1.0, {"bag": 1}, kept="recipe" if run == DROPPED else "full")
        original = manifest(label=labels[run], onset_s=DELAY_S, changes=(Change(30.0, 12, 1.0),))
        drive = None if run == STILL else Drive(0.5, 100, 0)
        return replace(
            original, mode=mode, run=int(number), recording_s=90.0, measured=kept, drive=drive
        )

    def picture(run):
        if run in (DROPPED, STILL):
            raise OracleError("<no bag>")
        return draw(ATTACKED)

    (tmp_path / "runs" / "benign_noise" / "run002").mkdir(parents=True)
    (tmp_path / "runs" / "benign_noise" / "run002" / "replay.gif").write_bytes(b"GIF89a")
    return ShownRuns(
        measured=measured,
        evaluation=evaluation,
        deviations=deviations_of_runs(features),
        path=lambda run: tmp_path / "runs" / run.replace("|", "/"),
        film="replay.gif",
        manifest=of_run,
        picture=picture,
    )


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return tmp_path_factory.mktemp("root")


@pytest.fixture(scope="module")
def shown(root):
    return shown_runs(root)


@pytest.fixture(scope="module")
def report(root, shown):
    (root / "report" / "runs" / "stale").mkdir(parents=True)
    assert write_run_pages(shown, root / "report" / "runs") == 55
    return root / "report"


def page(report, run):
    return (report / run_page(run)).read_text(encoding="utf-8")


def test_there_is_exactly_one_page_per_run(report):
    pages = sorted(path.relative_to(report) for path in (report / "runs").rglob("*.html"))
    assert len(pages) == 55 + 1
    assert not (report / "runs" / "stale").exists()


def test_every_link_is_relative_and_valid(report):
    for path in (report / "runs").rglob("*.html"):
        links = re.findall(r'href="([^"]+)"', path.read_text(encoding="utf-8"))
        assert links
        for link in links:
            assert not link.startswith(("/", "http", "file:"))
            target = (path.parent / link).resolve()
            assert target.is_file() or target == (report / "index.html").resolve()


def test_a_page_loads_nothing_and_stays_small(report):
    text = page(report, ATTACKED)
    assert "<script" not in text
    assert all(uri.startswith("data:") for uri in re.findall(r'src="([^"]+)"', text))
    assert len(text.encode()) < 100_000


def test_an_attacked_run_is_shown_with_verdict_evidence_and_onset(report):
    text = page(report, ATTACKED)
    assert "attacked" in text
    assert re.search(r"Score [\d.]+, rank \d+ of 55", text)
    assert "at 30.0 s; messages changed: 12" in text
    assert re.search(r'<th scope="row">(structural.entropy|contextual.yaw_variance)</th>', text)


def test_the_page_of_a_normal_run_has_no_attack_and_links_its_film(report):
    text = page(report, NORMAL)
    assert "attack began" not in text
    assert 'href="../../../runs/benign_noise/run002/replay.gif"' in text
    assert "oracle replay" not in text


def test_a_run_without_a_bag_or_picture_has_a_page_with_a_note(report):
    text = page(report, DROPPED)
    assert "is not drawn: &lt;no bag&gt;" in text
    assert "dropped to save space" in text
    assert "oracle replay" in text
    assert "oracle replay" not in page(report, STILL)


def test_runs_of_one_block_link_to_each_other(report):
    others = re.findall(r'href="\.\./\.\./runs/(\w+)/run001.html"', page(report, ATTACKED))
    assert len(set(others)) == 10


def test_the_list_has_every_run_the_highest_score_first(report):
    text = (report / "runs" / "index.html").read_text(encoding="utf-8")
    rows = re.findall(r'<a href="(\w+/run\d{3}).html">([^<]+)</a></th>\s*<td[^>]*>(\w+)', text)
    assert len(rows) == 55
    assert {label for _, _, label in rows[:15]} == {"malicious"}


def test_the_page_of_a_run_has_both_scores_and_the_ground_truth(report):
    text = page(report, ATTACKED)
    assert "Tampering: do its messages agree with each other?" in text
    assert "tampered: the attack altered 12 messages" in text
    assert re.search(r"misbehaved: driven \+\d\.\d+ m", text)
    assert "did not misbehave" in page(report, NORMAL)
    assert "not tampered" in page(report, NORMAL)


def test_scores_keep_their_order_on_the_line_and_the_highest_normal_run_is_marked(shown):
    judged = shown.evaluation.tables["runs"]
    standing = judged.groupby("mode", sort=False).first().reset_index()
    standing = standing.assign(runs=5, judged=0, called=0)
    plot = strip_plot(judged, standing, run_page)
    marks = {mark.page: mark.x for each in plot.strips for mark in each.marks}
    ordered = judged.sort_values("score")["run_id"].map(lambda run: marks[run_page(run)])
    assert ordered.is_monotonic_increasing
    assert ordered.between(0.0, 100.0).all()
    normal = judged.loc[judged["label"] != "malicious"].nlargest(1, "score")["run_id"].iloc[0]
    assert plot.highest_normal == marks[run_page(normal)]
    assert plot.ticks[0][1] == "0"


def test_without_scores_there_is_no_plot(shown):
    judged = shown.evaluation.tables["runs"].assign(score=np.nan)
    assert strip_plot(judged, judged, run_page) is None
