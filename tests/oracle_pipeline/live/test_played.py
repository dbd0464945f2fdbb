"""A watch of recorded messages does what a live one does: the time around an alarm is kept."""

import json
from itertools import islice

import pytest

from oracle_pipeline.live.black_box import Keep
from oracle_pipeline.live.events import Note, WindowVerdict
from oracle_pipeline.live.watch import Watch
from oracle_pipeline.live.watch_command import _begin_film
from oracle_pipeline.opened_run import open_run
from oracle_pipeline.replay.picture import FILM
from tools.bench.black_box import Played

PER_HOUR = 200.0  # false alarms; five short runs support no lower rate
SECONDS = 8
SECOND_NS = 10**9


class Restarted(Played):
    """The first seconds of a run, and the same again: its simulation is restarted."""

    def seconds(self, path):
        yield from islice(super().seconds(path), SECONDS)
        self._passed_ns += SECONDS * SECOND_NS


@pytest.mark.slow(5)
def test_an_alarm_before_a_step_of_the_clock_is_kept_in_its_own_recording_with_a_film(
    normal_card, recorded_run, tmp_path
):
    source, kept, alarms = Restarted([recorded_run("random_noise", 5).path] * 2), [], 0
    with Watch(
        source, card=normal_card, folder=tmp_path, keep=Keep(5.0, 5.0), alarms_per_h=PER_HOUR
    ) as watch:
        source.stop = watch.stop
        for event in watch:
            if isinstance(event, WindowVerdict):
                alarms += event.alarm
                source.judged(event)
            kept += [event.kept] if isinstance(event, Note) and event.kept else []
    assert kept == watch.recordings == [tmp_path / "recording", tmp_path / "recording_2"]
    for path in kept:
        (alarm,) = json.loads((path / "recording.json").read_text())["alarms"]
        assert alarm["at_s"] == alarm["end_s"] < SECONDS
        assert alarm["evidence"]
        with open_run(path, strict=True) as piece:
            assert piece.duration_s > alarm["at_s"]
            assert piece.intervals
    assert alarms == 2
    assert _begin_film(kept[0]).wait() == 0
    assert (kept[0] / FILM).stat().st_size > 10_000
