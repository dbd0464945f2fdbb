"""Score the attacks that searches found, again: `make found-attacks`.

Each file in ``examples/found_attacks`` is an attack that the oracle missed when it was found. Here
each runs in the block and seed that its first line names, and is judged by a card that is learned
anew. One that is not missed any more moves to ``caught/``, with the revision that caught it.
"""

import argparse
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import yaml

from assets.search.closed_loop import ClosedLoop, Finding, Proposal
from assets.search.search import SearchSettings
from oracle_pipeline.bags.terminal import progress_bar
from sim.campaigns import Campaign, Options

ROOT = Path(__file__).parents[2]
FOUND = ROOT / "examples" / "found_attacks"
CAUGHT = FOUND / "caught"
NORMALS = 40  # of the card
SEED = 7  # of the searches that found those without one; the card's runs have another
MODE = "lidar_passthrough_odom"
PLAIN = ("--goals", "1", "--wiring", "absent")  # as in docs/how-to/search.md
_PLACE = re.compile(r"# Block (\d+)(?: of seed (\d+))?: ")


def main() -> None:
    """Score the files, move those that are caught, and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("data/found_attacks"), help="Work folder.")
    out: Path = parser.parse_args().out
    for file, finding in scored(plain_card(out), out / "controls"):
        state = "missed" if finding.is_miss else "caught" if finding.has_effect else "no effect"
        print(f"{file.stem}: {state}, p = {finding.p_value:.3g}, effect {finding.effect:.2g}")
        if not finding.is_miss:
            move(file, finding)


def plain_card(out: Path) -> Path:
    """Return a card of normal runs without the mode's node; runs that exist are verified."""
    card = out / "plain.card"
    record = ["oracle-sim", "record", "-m", MODE, "-n", str(NORMALS), *PLAIN]
    subprocess.run([*record, "--out", str(out / "good_bags")], check=True)
    learn = ["oracle", "learn", str(out / "good_bags"), "--output", str(card)]
    subprocess.run(learn, check=True)
    return card


def scored(card: Path, controls: Path) -> Iterator[tuple[Path, Finding]]:
    """Yield each file with what its attack does and what the oracle says of it."""
    places = {file: place_of(file) for file in sorted(FOUND.glob("*.yaml"))}
    found = [(file, place) for file, place in places.items() if place is not None]
    for number, (file, (seed, block)) in enumerate(progress_bar(found, unit="attack")):
        loop = closed_loop(card, controls / str(seed), seed)
        loop.run_control(block)
        document = yaml.safe_load(file.read_text("utf-8"))
        yield file, loop.run_trial(Proposal(number, block, document, {}))


def closed_loop(card: Path, controls: Path, seed: int) -> ClosedLoop:
    """Return what runs and judges an attack, as the searches did."""
    campaign = Campaign(seed=seed, options=Options(wiring="absent"))
    settings = SearchSettings(str(card), campaign, goals=1, time_limit=60.0, screen=False)
    return settings.closed_loop(controls)


def place_of(file: Path) -> tuple[int, int] | None:
    """Return seed and block of a found attack; None for another file."""
    named = _PLACE.match(file.read_text("utf-8"))
    return (int(named[2] or SEED), int(named[1])) if named else None


def move(file: Path, finding: Finding) -> None:
    """Move a file to the caught ones, with the revision and its p-value."""
    describe = ["git", "-C", str(ROOT), "describe", "--always", "--dirty"]
    revision = subprocess.run(describe, check=True, capture_output=True, text=True).stdout.strip()
    note = f"# Caught at revision {revision}: p = {finding.p_value:.3g}.\n"
    CAUGHT.mkdir(exist_ok=True)
    (CAUGHT / file.name).write_text(file.read_text("utf-8") + note, "utf-8")
    file.unlink()


if __name__ == "__main__":
    main()
