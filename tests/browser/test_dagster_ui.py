"""The pipeline in Dagster's UI, as people use it: backfill, re-execution, schedule, report."""

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import dagster as dg
import pytest
from playwright.sync_api import Page, expect, sync_playwright

from assets.webserver.report import REPORT_PATH
from oracle_pipeline.bags.layout import report_page
from tests.browser.chromium import CHROMIUM
from tests.ui import WebServer, pipeline_ui

pytestmark = pytest.mark.slow(50)

MODE, FINE, DAMAGED = "random_noise", "run000", "run001"
PATIENCE_MS = 120_000  # until what happens elsewhere shows on a page of a busy machine


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("pipeline")


@pytest.fixture(scope="module")
def server(root: Path) -> Iterator[WebServer]:
    """The pipeline with two partitions, whose runs are as short as runs get."""
    few = {"ORACLE_MODES": MODE, "ORACLE_RUNS": "2", "ORACLE_GOALS_PER_RUN": "1"}
    with pipeline_ui(root, ORACLE_HOME=str(root / "data"), **few) as started:
        yield started


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    expect.set_options(timeout=PATIENCE_MS)
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM)
        page = chromium.new_page(viewport={"width": 1400, "height": 1000})
        page.set_default_timeout(PATIENCE_MS)
        yield page
        chromium.close()
    expect.set_options(timeout=5_000)


def test_a_backfill_shows_what_failed_and_a_re_execution_completes_it(
    page: Page, server: WebServer, root: Path
) -> None:
    damaged = root / "data" / "runs" / MODE / DAMAGED
    damaged.mkdir(parents=True)
    (damaged / "manifest.json").write_text("{}")
    partitions = f"{server.origin}/assets/experiment_runs?view=partitions"

    page.goto(partitions)
    page.get_by_role("button", name="Materialize").first.click()
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("0 partitions")
    while "0 partitions" in dialog.inner_text():  # what has not arrived yet is not selected
        for dimension in range(2):
            dialog.get_by_role("button", name="All", exact=True).nth(dimension).click()
        page.wait_for_timeout(500)
    expect(dialog).to_contain_text("2 partitions")
    page.get_by_role("button", name="Launch backfill").click()
    expect(page.get_by_text("Failed (1)")).to_be_visible()
    expect(page.get_by_text("Materialized (1)")).to_be_visible()

    shutil.rmtree(damaged)
    (failed,) = server.instance.get_runs(dg.RunsFilter(statuses=[dg.DagsterRunStatus.FAILURE]))
    page.goto(f"{server.origin}/runs/{failed.run_id}")
    expect(page.get_by_text("1 of 2 runs failed").first).to_be_visible()
    # Dagster only asks back if it takes the definitions for others than those of the failed run.
    confirm = page.get_by_role("button", name="Confirm")
    page.add_locator_handler(confirm, lambda button: button.click())
    page.get_by_role("button", name="Re-execute all").click()
    expect(page).not_to_have_url(re.compile(failed.run_id))
    expect(page.get_by_text("Success", exact=True).first).to_be_visible()
    page.goto(partitions)
    expect(page.get_by_text("Materialized (2)")).to_be_visible()


def test_a_schedule_that_is_turned_on_ticks_and_can_be_turned_off(
    page: Page, server: WebServer
) -> None:
    page.goto(f"{server.origin}/locations/here/schedules/every_minute")
    switch = page.get_by_role("row", name="Running").get_by_role("checkbox")
    expect(switch).not_to_be_checked()
    switch.press("Space")
    expect(switch).to_be_checked()
    expect(page.get_by_role("row", name="Latest tick")).to_contain_text("1 run requested")
    switch.press("Space")
    expect(switch).not_to_be_checked()
    job = dg.RunsFilter(job_name="nothing")
    assert server.instance.get_runs_count(job) >= 1


def test_the_nightly_schedule_lists_the_runs_it_would_start(page: Page, server: WebServer) -> None:
    page.goto(f"{server.origin}/locations/here/schedules/nightly")
    expect(page.get_by_text("one run of every mode").first).to_be_visible()
    expect(page.get_by_role("row", name="Running").get_by_role("checkbox")).not_to_be_checked()


def test_the_report_opens_by_the_link_of_its_asset(
    page: Page, server: WebServer, root: Path
) -> None:
    place = report_page(root / "data")
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text("<title>Behavioural oracle: report</title><h1>All runs are normal</h1>")
    made = dg.AssetMaterialization(
        "oracle_report", metadata={"url": dg.MetadataValue.url(f"{REPORT_PATH}/")}
    )
    server.instance.report_runless_asset_event(made)
    page.goto(f"{server.origin}/assets/oracle_report")
    with page.expect_popup() as opened:
        page.get_by_role("link", name=f"{REPORT_PATH}/").first.click()
    report = opened.value
    expect(report.get_by_role("heading")).to_have_text("All runs are normal")
    assert report.url == f"{server.origin}{REPORT_PATH}/"
    report.close()
