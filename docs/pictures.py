"""Draws the pictures of the docs: ``make pictures``.

Records the two runs of the README's picture below a root of their own, joins their pictures, and
makes the film. With a campaign's root as argument, it also takes a screenshot of that report; this
needs a Chromium.
"""

import shutil
import sys
from pathlib import Path

from click.testing import CliRunner
from PIL import Image

from oracle_pipeline.cli import main as oracle
from resources.cli import main as oracle_sim

IMAGES = Path(__file__).parent / "images"
ROOT = Path("data/pictures")
CONTROL, ATTACK = "lidar_passthrough_odom", "fake_object"
CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
WINDOW = {"width": 1200, "height": 900}


def run(group: object, *words: object) -> None:
    """Run a command of ours, or end with what it says."""
    done = CliRunner().invoke(group, [str(word) for word in words])  # type: ignore[arg-type]
    if done.exit_code:
        sys.exit(done.output)


def draw_runs() -> None:
    """Draw the control beside the attack, and the attack as a film."""
    pictures = []
    for mode in (CONTROL, ATTACK):
        run(oracle_sim, "record", "-m", mode, "-n", 1, "--goals", 8, "--out", ROOT)
        recorded = ROOT / "runs" / mode / "run000"
        picture = ROOT / f"{mode}.png"
        run(oracle, "replay", recorded, "-o", picture)
        pictures.append(Image.open(picture).convert("RGBA"))
    width, height = (max(sizes) for sizes in zip(*(each.size for each in pictures), strict=True))
    joined = Image.new("RGBA", (len(pictures) * width, height), "white")
    for place, each in enumerate(pictures):
        joined.alpha_composite(each, (place * width, 0))
    joined.convert("RGB").quantize(128).save(IMAGES / "runs.png", optimize=True)
    film = IMAGES / "fake_object.webp"
    attacked = ROOT / "runs" / ATTACK / "run000"
    run(oracle, "replay", attacked, "-o", film, "--speed", 20, "--frames", 0.5)


def take_report(campaign: Path) -> None:
    """Take a screenshot of the first screen of a report."""
    from playwright.sync_api import sync_playwright

    browser = next(filter(None, map(shutil.which, CHROMIUM)), None)
    if browser is None:
        sys.exit(f"There is none of {', '.join(CHROMIUM)}; install one to take screenshots.")
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=browser)
        page = chromium.new_page(viewport=WINDOW)
        page.goto((campaign / "report" / "index.html").resolve().as_uri())
        page.screenshot(path=IMAGES / "report.png")
        chromium.close()


if __name__ == "__main__":
    draw_runs()
    for argument in sys.argv[1:]:
        take_report(Path(argument))
