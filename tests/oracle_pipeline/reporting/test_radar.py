import io

import numpy as np
import pytest
from PIL import Image

from oracle_pipeline.opened_run import open_run
from oracle_pipeline.replay.picture import kept_picture
from oracle_pipeline.replay.radar import INSTANT, has_tracks, plan_view, radar_display
from oracle_pipeline.reporting.figures import COLORS
from oracle_pipeline.reporting.stored_report import ReportError
from tests.oracle_pipeline.features.conftest import drive, write_bag
from tests.oracle_pipeline.features.test_atc_features import (
    AIRCRAFT,
    SECONDS,
    SPEED,
    flown,
    place,
    track,
    tracks,
)

BOTH, ALONE, RADARS = 7, 1, 6  # sources


def shown(time_s):
    """Tracks of the first three aircraft, each with other sources."""
    messages = zip(AIRCRAFT, (BOTH, ALONE, RADARS), strict=False)
    return tracks(
        time_s,
        *(moving(number, address, time_s, s) for number, (address, s) in enumerate(messages)),
    )


def moving(number, address, time_s, sources):
    latitude, longitude, course = place(address, time_s)
    message = track(number, sources, latitude, AIRCRAFT[address][3], SPEED, address)
    message.longitude, message.track_deg = longitude, course
    return message


def recording(ghosts=True):
    messages = [shown(t) if ghosts else tracks(t) for t in np.arange(0.0, SECONDS).tolist()]
    return sorted([*flown(), *messages], key=lambda each: each[0])


@pytest.fixture
def display_of(tmp_path):
    def read(recorded):
        write_bag(tmp_path / "bag", recorded)
        with open_run(tmp_path / "bag") as run:
            assert has_tracks(run)
            return radar_display(run)

    return read


def test_tracks_are_drawn_relative_to_their_middle(display_of):
    display = display_of(recording())
    instant_s = np.floor(INSTANT * (SECONDS - 0.5))
    offsets = []
    for shown_track, address in zip(display.tracks, AIRCRAFT, strict=False):
        azimuth, distance, course, altitude_m = AIRCRAFT[address]
        start, step = (
            metres * np.exp(1j * np.radians(degrees))
            for metres, degrees in ((distance, azimuth), (SPEED * instant_s, course))
        )
        farther = 1.0 + altitude_m / 6_371_000.0  # plumb lines diverge
        expected = farther * (start + step) / 1e3
        offsets.append(shown_track.trail[-1] - expected)
        assert abs(shown_track.ahead) == pytest.approx(SPEED * 60.0 / 1e3)
        assert len(shown_track.trail) == instant_s + 1
    assert np.abs(np.diff(offsets)).max() < 0.2  # all are moved alike
    middle = np.array([each.trail[-1] for each in display.tracks])
    assert abs(np.median(middle.real)) + abs(np.median(middle.imag)) < 0.5


def test_sources_of_tracks_are_distinguished(display_of):
    display = display_of(recording())
    assert [each.seen_by for each in display.tracks] == [
        "seen by both", "ADS-B alone", "radar alone",
    ]  # fmt: skip
    assert display.tracks[0].label == "A00001 098"  # 3000 m


def test_an_empty_display_is_an_error(display_of):
    with pytest.raises(ReportError, match="there is no track"):
        display_of(recording(ghosts=False))


def test_a_track_that_only_adsb_reports_is_drawn_in_the_ink_of_attacks(display_of):
    wanted = np.array([int(COLORS["malicious"][i : i + 2], 16) for i in (1, 3, 5)])

    def red(display):
        with Image.open(io.BytesIO(plan_view(display))) as png:
            pixels = np.asarray(png.convert("RGBA"), dtype=int)
        near = np.abs(pixels[..., :3] - wanted).max(axis=-1) < 20
        return int((near & (pixels[..., 3] > 200)).sum())

    display = display_of(recording())
    lone = [each for each in display.tracks if each.seen_by == "ADS-B alone"]
    display.tracks[:] = [each for each in display.tracks if each not in lone]
    without = red(display)
    display.tracks.extend(lone)
    assert red(display) > without + 100


def test_a_run_of_a_robot_has_no_tracks(tmp_path):
    write_bag(tmp_path / "bag", drive())
    with open_run(tmp_path / "bag") as run:
        assert not has_tracks(run)


def test_the_kept_picture_of_an_air_traffic_run_is_its_radar_display(recorded, tmp_path):
    messages = [(topic, m.__msgtype__, m) for _, topic, m in recording()]
    run = recorded(*messages)
    assert kept_picture(run) == (run / "picture.png").read_bytes()
    with open_run(run) as opened:
        assert kept_picture(run) == plan_view(radar_display(opened))
