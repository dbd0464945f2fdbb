"""A robot without features of its own is judged by its signals, few recordings or short ones."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from oracle_pipeline.api import learn, score
from oracle_pipeline.cli import main
from oracle_pipeline.scoring.card import ReferenceCard
from oracle_pipeline.scoring.sentences import headline

NORMALS, TESTED = 10, 4
MOTORS = 4


def flight(path, rng, *, weak_motor=0.0, rows=400):
    """Write a flight of a robot with four motors; a weak one has to work harder."""
    time_s = np.arange(rows) * 0.01
    wind = np.convolve(rng.normal(size=rows), np.full(20, 0.05), "same") * rng.uniform(0.8, 1.2)
    columns = {"time": time_s, "battery": rng.uniform(11.5, 12.5) - 0.01 * time_s}
    for motor in range(MOTORS):
        load = 1.0 + (weak_motor if motor == 2 else 0.0)
        columns[f"motor{motor}.thrust"] = load + 0.2 * wind + 0.05 * rng.normal(size=rows)
        columns[f"motor{motor}.current"] = 4.0 * load + wind + 0.2 * rng.normal(size=rows)
    for axis in "xyz":
        columns[f"gyro.{axis}"] = 0.3 * wind + 0.02 * rng.normal(size=rows)
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def verdicts(folder, rows):
    """Return the verdicts on normal flights, and on flights with a weak motor."""
    rng = np.random.default_rng(1)
    for name in ("good", "normal", "weak"):
        (folder / name).mkdir()
    for number in range(NORMALS):
        flight(folder / "good" / f"{number}.csv", rng, rows=rows)
    for number in range(TESTED):
        flight(folder / "normal" / f"{number}.csv", rng, rows=rows)
        flight(folder / "weak" / f"{number}.csv", rng, weak_motor=0.3, rows=rows)
    card = folder / "robot.card"
    learned = CliRunner().invoke(main, ["learn", str(folder / "good"), "--output", str(card)])
    assert learned.exit_code == 0, learned.output
    found = {}
    for name in ("normal", "weak"):
        paths = [str(path) for path in sorted((folder / name).iterdir())]
        done = CliRunner().invoke(
            main, ["score", *paths, "--reference", str(card), "--far", "0.1", "--format", "json"]
        )
        found[name] = json.loads(done.stdout)["recordings"]
    return found


@pytest.fixture(scope="module", params=[400, 32], ids=["4 s", "0.3 s"])
def judged(request, tmp_path_factory):
    return verdicts(tmp_path_factory.mktemp("flights"), request.param)


@pytest.mark.slow(20)
def test_weak_motor_scores_higher_than_normal_flights(judged):
    normal, weak = ([each["score"] for each in judged[name]] for name in ("normal", "weak"))
    assert np.mean(np.subtract.outer(weak, normal) > 0.0) >= 0.95


@pytest.mark.slow
def test_evidence_names_the_signal(judged):
    named = [each["evidence"][0]["feature"] for each in judged["weak"]]
    assert sum("motor2" in feature for feature in named) >= 0.9 * TESTED


@pytest.mark.slow
def test_features_of_motion_do_not_count_where_the_robot_hardly_moved(tmp_path):
    def scored(seconds):
        rng, folder = np.random.default_rng(2), tmp_path / f"{seconds}s"
        folder.mkdir()
        for number in range(NORMALS):
            drive = folder / f"{number}"
            drive.mkdir()
            odometry(drive / "odom.csv", rng, seconds)
        learned = CliRunner().invoke(main, ["learn", str(folder), "--output", f"{folder}.card"])
        assert learned.exit_code == 0, learned.output
        return ReferenceCard.load(Path(f"{folder}.card")).scorer

    short, long = scored(2), scored(12)
    assert len(short.design.run_features) > 20
    assert not {"run", "windows"} & set(short.levels_)
    assert {"run", "windows"} < set(long.levels_)


def test_evidence_begins_with_the_farthest_be_it_a_feature_or_a_signal(tmp_path):
    rng = np.random.default_rng(3)
    for number in range(NORMALS + 1):
        drive = tmp_path / ("tested" if number == NORMALS else f"normal/{number}")
        drive.mkdir(parents=True)
        odometry(drive / "odom.csv", rng, 12)
        time_s = np.arange(120) * 0.1
        nearest = 1.0 + rng.normal(0.0, 0.02, 120) - (0.6 if number == NORMALS else 0.0)
        pd.DataFrame({"time": time_s, "range": nearest}).to_csv(drive / "sonar.csv", index=False)
    (verdict,) = score(tmp_path / "tested", learn(tmp_path / "normal"))
    assert "range on /sonar" in headline(verdict)
    distances = [abs(each.z) for each in verdict.evidence]
    assert distances == sorted(distances, reverse=True)


def odometry(path, rng, seconds):
    """Write the odometry of a robot that turns aside."""
    time_s = np.arange(seconds * 10) * 0.1
    turning = rng.normal(0.5, 0.05) + 0.05 * rng.normal(size=len(time_s))
    yaw = np.cumsum(turning) * 0.1
    forward = 0.8 + 0.02 * rng.normal(size=len(time_s))
    pd.DataFrame(
        {
            "time": time_s,
            "pose.pose.position.x": np.cumsum(forward * np.cos(yaw)) * 0.1,
            "pose.pose.position.y": np.cumsum(forward * np.sin(yaw)) * 0.1,
            "pose.pose.position.z": 0.0,
            "pose.pose.orientation.x": 0.0,
            "pose.pose.orientation.y": 0.0,
            "pose.pose.orientation.z": np.sin(yaw / 2.0),
            "pose.pose.orientation.w": np.cos(yaw / 2.0),
            "twist.twist.linear.x": forward,
            "twist.twist.linear.y": 0.0,
            "twist.twist.linear.z": 0.0,
            "twist.twist.angular.x": 0.0,
            "twist.twist.angular.y": 0.0,
            "twist.twist.angular.z": turning,
        }
    ).to_csv(path, index=False)
