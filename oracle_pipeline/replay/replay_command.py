"""``oracle replay``: a run as a film and as a picture.

Drawing code is imported when needed, so that the help of all commands stays fast.
"""

from pathlib import Path

import click

from oracle_pipeline.bags.run_directory import MANIFEST_FILE, RECORDING_FILE

FASTEST_HZ = 50.0  # highest frame rate of animations in browsers
SUFFIXES = (".gif", ".webp", ".png")


@click.command()
@click.argument("run_or_bag", type=click.Path(path_type=Path))
@click.option(
    "-o", "--out", "places", multiple=True, type=click.Path(path_type=Path, dir_okay=False),
    help="File to write: .gif or .webp (a third smaller, slower) for a film, .png for one "
    "picture; may be given more than once.  [default: replay.gif and picture.png in the run "
    "directory or recording of `oracle watch`, <bag>.gif and <bag>.png here for a bag]",
)  # fmt: skip
@click.option(
    "--frames", default=2.0, show_default=True, type=click.FloatRange(min=0, min_open=True),
    help="Frames for one second of the run.")  # fmt: skip
@click.option(
    "--speed", default=10.0, show_default=True, type=click.FloatRange(min=0, min_open=True),
    help="Seconds of the run in one second of the film.")  # fmt: skip
def replay(run_or_bag: Path, places: tuple[Path, ...], frames: float, speed: float) -> None:
    """Draw a run from above, as a film and as one picture.

    Shows map, local costmap, scans, plan, path, goals, attack and time, as far as the bag has them.
    RUN_OR_BAG is a run directory or any bag with odometry, or with transforms of the robot's base.
    Topics are found by message type, not by name. If there are several robots, the first is drawn.

    \b
    Examples:
        oracle replay data/runs/fake_object/run000
        oracle replay data/runs/fake_object/run000 -o attack.webp --speed 20
        oracle replay my_robot_bag/ -o robot.gif -o robot.png
    """  # noqa: D301 -- click reads the control character
    places = places or _beside(run_or_bag)
    for place in places:
        if place.suffix not in SUFFIXES:
            raise click.UsageError(
                f"{place}: a replay must be one of {', '.join(SUFFIXES)}; choose another suffix."
            )
    if frames * speed > FASTEST_HZ:
        raise click.UsageError(
            f"{frames:g} frames at {speed:g} times the speed are {frames * speed:g} per second; "
            f"browsers show at most {FASTEST_HZ:g}. Lower --speed or --frames."
        )
    _draw(run_or_bag, places, frames, speed)


def _beside(run_or_bag: Path) -> tuple[Path, ...]:
    """Return the default paths of film and picture."""
    from oracle_pipeline.replay.picture import FILM, PICTURE

    if any((run_or_bag / name).is_file() for name in (MANIFEST_FILE, RECORDING_FILE)):
        return run_or_bag / FILM, run_or_bag / PICTURE
    name = run_or_bag.resolve().stem
    return Path(f"{name}.gif"), Path(f"{name}.png")


def _draw(run_or_bag: Path, places: tuple[Path, ...], frames: float, speed: float) -> None:
    from oracle_pipeline.datasets import replacing
    from oracle_pipeline.opened_run import open_run
    from oracle_pipeline.replay.film import save_film
    from oracle_pipeline.replay.scene import top_down
    from oracle_pipeline.replay.story import run_scene

    with open_run(run_or_bag) as run:
        scene = run_scene(run, frames)
        for note in run.bag.losses:
            click.echo(note, err=True)
    for place in places:
        if place.suffix == ".png":
            with replacing(place) as sink:
                sink.write(top_down(scene))
        else:
            save_film(scene, place, speed)
        click.echo(f"{place}: {place.stat().st_size / 1e3:.0f} kB")
