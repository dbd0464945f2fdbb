from dataclasses import replace

import pytest

from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC, GROUND_TRUTH_TYPE, serialize
from sim.atc.relay import AdsbRelay, Attack
from tests.sim.atc.tower import Tower, adsb


def higher(report, _since_ns):
    return (replace(report, altitude_m=report.altitude_m + 1.0),)


def nothing(_report, _since_ns):
    return ()


def relayed(*reports, **options):
    """What a relay makes of reports one second apart, and the truth about it."""
    tower = Tower()
    AdsbRelay(tower.domain, **options)
    heard, truth = tower.hear("/adsb_fuzzed", "AdsbReport"), []
    tower.create_subscription(GROUND_TRUTH_TYPE, GROUND_TRUTH_TOPIC, truth.append)
    recorded = []
    tower.create_subscription(GROUND_TRUTH_TYPE, GROUND_TRUTH_TOPIC, recorded.append, raw=True)
    for second, report in enumerate(reports):
        tower.run_until(second)
        tower.say("/adsb", report)
    tower.run_until(len(reports))
    assert [serialize(message, GROUND_TRUTH_TYPE) for message in truth] == recorded
    return heard, truth


REPORTS = tuple(adsb(second, 1_000.0 * second, 0.0) for second in range(4))


def test_passthrough_hands_on_the_very_same_reports_and_says_so():
    heard, truth = relayed(*REPORTS)
    assert all(ours is theirs for ours, theirs in zip(heard, REPORTS, strict=True))
    assert [message.magnitude for message in truth] == [0.0] * 4
    assert [message.index for message in truth] == [0, 1, 2, 3]


@pytest.mark.parametrize("make", [higher, nothing])
def test_a_shadow_hands_on_what_it_heard_whatever_it_worked_out(make):
    asked = []

    def noted(report, since_ns):
        asked.append(report)
        return make(report, since_ns)

    heard, truth = relayed(*REPORTS, attack=Attack("test", noted), shadow=True)
    assert heard == list(REPORTS) == asked
    assert [message.magnitude for message in truth] == [0.0] * 4


def test_an_attack_begins_at_its_onset_and_counts_time_from_there():
    since = []

    def from_then_on(report, since_ns):
        since.append(since_ns)
        return higher(report, since_ns)

    attack = Attack("set", from_then_on)
    heard, truth = relayed(*REPORTS, attack=attack, onset_ns=2_000_000_000)
    assert heard[:2] == list(REPORTS[:2])
    assert [report.altitude_m for report in heard[2:]] == [5_001.0, 5_001.0]
    assert since == [0, 1_000_000_000]
    assert [message.magnitude for message in truth] == [0.0, 0.0, 1.0, 1.0]
    assert {message.operation for message in truth} == {"set"}


def test_a_dropped_report_is_told_in_the_truth_and_nowhere_else():
    heard, truth = relayed(*REPORTS, attack=Attack("drop", nothing))
    assert heard == []
    assert [(message.magnitude, message.detail) for message in truth] == [(1.0, "1 in, 0 out")] * 4


def test_a_timer_sends_what_nobody_sent_from_the_onset_on():
    ghost = adsb(0.0, 5_000.0, 5_000.0, icao24="GHOST1")
    since = []

    def on_timer(since_ns):
        since.append(since_ns)
        return (ghost,)

    attack = Attack("emit", on_timer=on_timer, period_s=0.5)
    heard, truth = relayed(*REPORTS, attack=attack, onset_ns=3_000_000_000)
    assert since == [0, 500_000_000, 1_000_000_000]
    assert [report.icao24 for report in heard].count("GHOST1") == 3
    assert [m.magnitude for m in truth if m.detail == "0 in, 1 out"] == [1.0] * 3
