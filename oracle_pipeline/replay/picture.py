"""The picture of a run, and the file names of picture and film."""

from pathlib import Path

from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.bags.remote import fetched
from oracle_pipeline.bags.run_directory import BAG_FOLDER, MANIFEST_FILE
from oracle_pipeline.datasets import replacing
from oracle_pipeline.opened_run import OpenedRun, open_run
from oracle_pipeline.replay.film import frames
from oracle_pipeline.replay.scene import top_down
from oracle_pipeline.replay.story import run_scene

# In the run directory; a re-simulated run starts without them.
FILM, PICTURE = "replay.gif", "picture.png"


def kept_picture(path: Path) -> bytes:
    """Return the picture of a run directory as PNG, cached in a file.

    Raises
    ------
    OracleError
        If there is no file, and the run cannot be read or drawn.
    """
    place = path / PICTURE
    if place.is_file():
        return place.read_bytes()
    manifest = Manifest.load(path / MANIFEST_FILE)
    with (
        fetched(path / BAG_FOLDER) as bag,
        OpenedRun(path, BagReader(bag), manifest, ()) as run,  # graphs are not drawn
    ):
        png = top_down(run_scene(run))
    with replacing(place) as sink:
        sink.write(png)
    return png


def pictures(run_or_bag: Path, number: int = 1) -> list[tuple[float, bytes]]:
    """Return about some number of pictures of a run directory or a bag, with their times.

    Returns
    -------
    list of (float, bytes)
        Seconds since the start, and PNG. One picture shows the whole run, from 0 s.

    Raises
    ------
    OracleError
        If it cannot be read or drawn.
    """
    with open_run(run_or_bag) as run:
        if number == 1:
            return [(0.0, top_down(run_scene(run)))]
        return list(frames(run_scene(run, number / max(run.duration_s, 1.0))))
