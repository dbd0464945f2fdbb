"""Films and the command that makes them."""

import math
import subprocess
import sys

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from oracle_pipeline.cli import main
from oracle_pipeline.opened_run import open_run
from oracle_pipeline.replay import film as replay
from oracle_pipeline.replay.film import save_film
from oracle_pipeline.replay.picture import kept_picture
from oracle_pipeline.replay.story import run_scene
from tests.oracle_pipeline.reporting.recordings import (
    COSTMAP,
    MAP,
    MAP_TO_ODOM,
    MOUNT,
    at,
    manifest,
    planned,
    scanned,
    seen,
    ticked,
)

STORY = (
    MAP, MAP_TO_ODOM, MOUNT, at(0.0, 0.0), scanned(math.inf, 1.5), seen(1.0, 2.0), COSTMAP,
    planned((10.0, 0.0), (10.0, 2.0)), ticked("RecoveryActions", "IDLE", "RUNNING"),
    at(0.5, 0.0), at(1.0, 0.0), at(2.0, 0.0),
)  # fmt: skip


@pytest.fixture
def attacked(recorded):
    """A run of 1.1 s in which everything happens that a film shows."""
    return recorded(*STORY, manifest_=manifest(onset_s=0.6))


def frames(path):
    """Return the pictures of a film, as they are seen, and how long each is shown [ms]."""
    with Image.open(path) as film:
        shown, seconds = [], []
        for number in range(film.n_frames):
            film.seek(number)
            film.load()
            shown.append(np.asarray(film.convert("RGB")).astype(int))
            seconds.append(film.info["duration"])
    return shown, seconds


def scene_of(path, moments_per_s):
    with open_run(path) as run:
        return run_scene(run, moments_per_s)


@pytest.mark.parametrize("suffix", [".gif", ".webp"])
def test_a_film_shows_each_moment_as_long_as_it_lasted(attacked, tmp_path, suffix):
    scene, film = scene_of(attacked, 10.0), tmp_path / f"film{suffix}"
    save_film(scene, film, speed=2.0)
    shown, duration_ms = frames(film)
    assert len(shown) == len(scene.moments)
    assert duration_ms[:-1] == [50] * (len(shown) - 1)
    assert duration_ms[-1] == replay.LAST_FRAME_MS
    assert all((frame[0, 0] == 255).all() for frame in shown)  # paper is white


@pytest.mark.slow
def test_both_kinds_of_film_show_the_same(attacked, tmp_path):
    scene = scene_of(attacked, 10.0)
    for name in ("film.gif", "film.webp", "again.gif"):
        save_film(scene, tmp_path / name, speed=2.0)
    gif, webp = frames(tmp_path / "film.gif")[0], frames(tmp_path / "film.webp")[0]
    assert all((one == other).all() for one, other in zip(gif, webp, strict=True))
    assert (tmp_path / "film.gif").read_bytes() == (tmp_path / "again.gif").read_bytes()


def pixels(frame, ink):
    """Count the pixels of the world that have about the colour of an ink."""
    wanted = [int(ink[i : i + 2], 16) for i in (1, 3, 5)]
    world = frame[80:-100]  # without words, timeline and legend
    return (np.abs(world - wanted).max(axis=-1) <= 4).sum()


@pytest.mark.parametrize(
    ("ink", "least", "since_s"),
    [
        (replay.DRIVEN, 50, 0.3),
        (replay.SEEN, 4, 0.4),
        (replay.ATTACK, 4, 0.5),
        (replay.COST, 500, 0.6),
    ],
)
def test_an_element_is_in_the_film_from_its_first_message(attacked, tmp_path, ink, least, since_s):
    scene = scene_of(attacked, 10.0)
    save_film(scene, tmp_path / "film.gif", speed=1.0)
    shown, _ = frames(tmp_path / "film.gif")
    seen = [pixels(frame, ink) >= least for frame in shown]
    assert seen == [moment.time_s > since_s - 0.01 for moment in scene.moments]
    assert any(seen)


def command(*words):
    return CliRunner().invoke(main, ["replay", *map(str, words)])


def test_film_and_picture_are_written_beside_the_manifest(attacked):
    picture = kept_picture(attacked)
    (attacked / "picture.png").unlink()
    done = command(attacked, "--frames", "5")
    assert done.exit_code == 0, done.output
    assert len(frames(attacked / "replay.gif")[0]) > 1
    assert (attacked / "picture.png").read_bytes() == picture
    assert str(attacked / "replay.gif") in done.output


def test_film_and_picture_do_not_affect_the_checks_of_a_run(attacked):
    before = {p: p.read_bytes() for p in attacked.rglob("*") if p.is_file()}
    assert command(attacked).exit_code == 0
    after = {p for p in attacked.rglob("*") if p.is_file()}
    assert {p.name for p in after - set(before)} == {"replay.gif", "picture.png"}
    assert {p: p.read_bytes() for p in before} == before


def test_film_and_picture_of_a_foreign_bag_are_written_to_the_current_folder(
    attacked, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert command(attacked / "bag").exit_code == 0
    assert sorted(p.name for p in tmp_path.iterdir() if p.is_file()) == ["bag.gif", "bag.png"]


def test_only_the_given_files_are_written(attacked, tmp_path):
    wanted = [tmp_path / "a.webp", tmp_path / "b.png"]
    assert command(attacked, "-o", wanted[0], "-o", wanted[1]).exit_code == 0
    assert sorted(p for p in tmp_path.iterdir() if p.is_file()) == wanted
    assert not (attacked / "replay.gif").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["-o", "run.mp4"], "run.mp4: a replay must be one of .gif, .webp, .png"),
        (["--speed", "50"], "Lower --speed or --frames"),
    ],
)
def test_invalid_options_are_errors_with_advice(attacked, tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    done = command(attacked, *words)
    assert done.exit_code != 0
    assert said in done.output
    assert "Traceback" not in done.output
    assert not list(tmp_path.glob("*.*"))


def test_a_bag_without_a_robot_is_an_error_of_one_line(recorded):
    done = command(recorded(MAP) / "bag")
    assert (done.exit_code, done.output.count("\n")) == (2, 1)
    assert "neither odometry" in done.output


@pytest.mark.slow
@pytest.mark.parametrize("words", [["--help"], ["replay", "--help"]])
def test_help_does_not_import_drawing_libraries(words):
    code = f"""
import sys
from oracle_pipeline.cli import main
try:
    main({words})
finally:
    sys.exit("matplotlib" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Usage" in done.stdout
