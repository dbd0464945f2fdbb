"""Draws the pictures of the docs: ``make pictures``.

It records the two runs of the README's picture below a separate root, joins their pictures, makes
the film, simulates a small campaign, and takes screenshots of it in the Dagster UI. With the root
of a campaign as argument, it also takes a screenshot of that report. Screenshots need Chromium.
"""

import os
import shutil
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from click.testing import CliRunner
from PIL import Image

from assets.oracle_sim import main as oracle_sim
from oracle_pipeline.cli import main as oracle
from oracle_pipeline.opened_run import open_run
from oracle_pipeline.replay.scene import top_down
from oracle_pipeline.replay.story import run_scene

if TYPE_CHECKING:
    from playwright.sync_api import Browser

IMAGES = Path(__file__).parent / "images"
ROOT = Path("data/pictures")
CONTROL, ATTACK = "lidar_passthrough_odom", "fake_object"
TITLES = {CONTROL: "A normal patrol", ATTACK: "The same patrol, with an object that is not there"}
CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
WINDOW = {"width": 1280, "height": 800}
PORT, PATIENCE_S = 3977, 120
SMALL = "lidar_passthrough|run000...delayed_fakeobject|run002"
CHECKOUT = (ROOT / "checkout").resolve()
SETTINGS = {
    **os.environ, "PWD": str(CHECKOUT), "ORACLE_HOME": str(CHECKOUT / "data"),
    "ORACLE_GOALS_PER_RUN": "2", "ORACLE_MODES": "turtlebot3",
    "ORACLE_DAGSTER_HOME": str(CHECKOUT / ".dagster_home"),
}  # fmt: skip
LINEAGE = {"x": 570, "y": 355, "width": 985, "height": 130}  # the graph, in a window of WIDE
WIDE = {"width": 1600, "height": 800}


def run(group: object, *words: object) -> None:
    """Run a command of this project; if it fails, exit with its output."""
    done = CliRunner().invoke(group, [str(word) for word in words])  # type: ignore[arg-type]
    if done.exit_code:
        sys.exit(done.output)


def draw_runs() -> None:
    """Draw the control beside the attack, and make a film of the attack."""
    pictures = []
    for mode, title in TITLES.items():
        run(oracle_sim, "record", "-m", mode, "-n", 1, "--goals", 8, "--out", ROOT)
        with open_run(ROOT / "runs" / mode / "run000") as recorded:
            scene = replace(run_scene(recorded), title=title)
        pictures.append(Image.open(BytesIO(top_down(scene))).convert("RGBA"))
    width, height = (max(sizes) for sizes in zip(*(each.size for each in pictures), strict=True))
    joined = Image.new("RGBA", (len(pictures) * width, height), "white")
    for place, each in enumerate(pictures):
        joined.alpha_composite(each, (place * width, 0))
    joined.convert("RGB").quantize(128).save(IMAGES / "runs.png", optimize=True)
    film = IMAGES / "fake_object.webp"
    attacked = ROOT / "runs" / ATTACK / "run000"
    run(oracle, "replay", attacked, "-o", film, "--speed", 20, "--frames", 0.5)


def simulate_campaign() -> None:
    """Simulate the campaign of `make run` in a separate checkout, for the UI to show."""
    for file in (".env", "workspace.yaml", ".dagster_home/dagster.yaml"):
        (CHECKOUT / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(file, CHECKOUT / file)
    subprocess.run(
        [sys.executable, "-m", "dagster", "asset", "materialize",
         "-m", "oracle_pipeline.definitions", "--select", "*", "--partition-range", SMALL],
        cwd=CHECKOUT, env=SETTINGS, check=True,
    )  # fmt: skip


@contextmanager
def dagster_ui() -> Iterator[str]:
    """Start the UI in that checkout; yield its address."""
    address = f"http://127.0.0.1:{PORT}"
    command = [sys.executable, "-m", "assets.webserver", "-p", str(PORT)]
    with subprocess.Popen(command, cwd=CHECKOUT, env=SETTINGS) as server:
        try:
            for _ in range(PATIENCE_S):
                time.sleep(1)
                try:
                    urllib.request.urlopen(f"{address}/server_info").close()  # noqa: S310
                    break
                except urllib.error.URLError:
                    continue
            yield address
        finally:
            server.send_signal(signal.SIGINT)  # ends its daemon and code server, too


@contextmanager
def browser() -> Iterator["Browser"]:
    """Start a Chromium."""
    from playwright.sync_api import sync_playwright

    program = next(filter(None, map(shutil.which, CHROMIUM)), None)
    if program is None:
        sys.exit(f"There is none of {', '.join(CHROMIUM)}; install one to take screenshots.")
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=program)
        yield chromium
        chromium.close()


def take_ui() -> None:
    """Take screenshots of the groups of assets and of the grid of runs in the Dagster UI."""
    with dagster_ui() as address, browser() as chromium:
        page = chromium.new_page(viewport=WIDE)
        page.set_default_timeout(1000 * PATIENCE_S)
        page.goto(f"{address}/asset-groups")
        page.get_by_text("thesis_method").first.wait_for()
        page.wait_for_timeout(5000)  # until the graph stands still
        page.screenshot(path=IMAGES / "lineage.png", clip=LINEAGE)
        page.goto(f"{address}/assets/experiment_runs?view=partitions")
        for key in (ATTACK, "run002"):
            page.get_by_text(key, exact=True).first.click()
        page.get_by_text("goals_reached").wait_for()
        page.get_by_role("button", name="Hide navigation").click()
        page.wait_for_timeout(2000)
        page.screenshot(path=IMAGES / "partitions.png")
    with Image.open(IMAGES / "partitions.png") as png:
        png.convert("RGB").quantize(64).save(IMAGES / "partitions.png", optimize=True)


def take_report(campaign: Path) -> None:
    """Take a screenshot of the first screen of a report."""
    with browser() as chromium:
        page = chromium.new_page(viewport=WINDOW)
        page.goto((campaign / "report" / "index.html").resolve().as_uri())
        page.screenshot(path=IMAGES / "report.png")


if __name__ == "__main__":
    draw_runs()
    simulate_campaign()
    take_ui()
    for argument in sys.argv[1:]:
        take_report(Path(argument))
