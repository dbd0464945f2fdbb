"""Which features of a flight move with a damage, in recordings of a Crazyflie and in its twin.

``python -m tools.bench.twin FOLDER`` takes a folder of recordings of CrazyPAD: one Parquet file a
flight with the log group ``controller``, and ``labels.csv`` with kind, dose and airframe. The twin
flies with the same doses, on one airframe. A feature is mean, standard deviation or standard
deviation of the differences of a logged variable while the craft is in the air. It moves if the
rank correlation with the dose is at least 0.5 either way.
"""

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
from scipy.stats import spearmanr

from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.bags.run_directory import RunDirectory
from sim.campaigns import Campaign
from sim.crazyflie.firmware import LOG
from sim.experiments import recipe_for, record_run
from sim.fuzzing.scenario import parse_scenarios
from sim.testbed import Mode

MOVES = 0.5
# Cuts of both blades of a propeller, as uneven as in the recordings.
CUTS_MM = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (2.0, 1.5), (2.0, 2.0), (3.0, 2.5), (4.0, 4.0))
FLIGHTS = 3  # for each dose
# Kind of damage, the airframe that has most of its recordings, and the motors.
KINDS = (("cut_one", "E8", (3,)), ("cut_two", "E9", (1, 2)))
_FLIES = 10_000.0  # thrust above which it is in the air
_SCENARIO = """
schema: mutant/v1
id: cut
label: malicious
main:
  type: motion_capture_tracking_interfaces/msg/NamedPoseArray
  input: /poses
  output: /poses
parameters:
  a: {type: float, default: 0.0, unit: mm}
  b: {type: float, default: 0.0, unit: mm}
set_parameters:
"""


def features(flight: pd.DataFrame) -> dict[str, float]:
    """Return the features of a flight, from columns as in the log group."""
    air = flight[flight["cmd_thrust"] > _FLIES]
    air = air.iloc[len(air) // 6 : -len(air) // 6]  # without take-off and landing
    reductions = {"mean": air.mean(), "sd": air.std(), "steps": air.diff().std()}
    return {
        f"{name} {how}": value for how, row in reductions.items() for name, value in row.items()
    }


def recorded(folder: Path) -> pd.DataFrame:
    """Return the features of all recordings, with kind, dose and airframe."""
    labels = pd.read_csv(folder / "labels.csv")
    flights = (
        pd.read_parquet(folder / file).rename(columns=lambda name: name.removeprefix("controller."))
        for file in labels["file"]
    )
    return pd.concat([labels, pd.DataFrame([features(one[[*LOG]]) for one in flights])], axis=1)


def flown(motors: tuple[int, ...], root: Path) -> Iterator[dict[str, float]]:
    """Yield the features of the twin's flights with their dose."""
    cuts = "".join(
        f"  - {{node: /world, name: m{motor}.cut_{blade}_mm, value: p.{blade}}}\n"
        for motor in motors
        for blade in "ab"
    )
    (scenario,) = parse_scenarios((_SCENARIO + cuts).encode(), "twin")
    campaign = Campaign(goals_per_run=3, session=0)
    for a, b in CUTS_MM:
        for block in range(FLIGHTS):
            run = RunDirectory(root / f"{len(motors)} {a} {b}", "cut", block)
            record_run(recipe_for(Mode(scenario), block, campaign, {"a": a, "b": b}), run)
            with BagReader(run.bag) as bag:
                log = [bag.deserialize(m).values for m in bag.messages(["/cf231/controller"])]
            yield {"cut_mm": len(motors) * (a + b), **features(pd.DataFrame(log, columns=[*LOG]))}


def correlations(table: pd.DataFrame) -> pd.Series:
    """Return the rank correlation of each feature with the dose; no dose is none."""
    table = table.fillna({"cut_mm": 0.0})
    names = [name for name in map(str, table) if name.endswith((" mean", " sd", " steps"))]
    return pd.Series({name: spearmanr(table["cut_mm"], table[name]).statistic for name in names})


def verdict(recording: float, twin: float) -> str:
    """Return in words whether a feature moves in both, and alike."""
    if max(abs(recording), abs(twin)) < MOVES:
        return "in neither"
    if min(abs(recording), abs(twin)) < MOVES:
        return "in recordings only" if abs(recording) >= MOVES else "in the twin only"
    return "alike" if recording * twin > 0 else "opposite"


def main() -> None:
    """Print a table for each kind of damage."""
    recordings = recorded(Path(sys.argv[1]))
    with tempfile.TemporaryDirectory() as root:
        for kind, airframe, motors in KINDS:
            of_it = recordings["kind"].isin(["normal", kind]) & (recordings["airframe"] == airframe)
            twin = correlations(pd.DataFrame(flown(motors, Path(root))))
            found = pd.DataFrame({"recordings": correlations(recordings[of_it]), "twin": twin})
            found["moves"] = [verdict(*row) for row in found.itertuples(index=False)]
            print(f"\n{kind}, motors {motors}, {of_it.sum()} recordings of {airframe}")
            print(found.round(2).to_string())
            print(found["moves"].value_counts().to_string())


if __name__ == "__main__":
    main()
