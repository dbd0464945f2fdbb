"""Windows are judged as they end, as the finished recording would be."""

import numpy as np
import pytest

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.writer import BagWriter
from oracle_pipeline.datasets import feature_columns
from oracle_pipeline.features import build_manager, extract
from oracle_pipeline.features.extraction import extract_window
from oracle_pipeline.graphs.intervals import Interval
from oracle_pipeline.live.judge import Judge
from oracle_pipeline.live.recent import RecentMessages, Stamped
from oracle_pipeline.opened_run import OpenedRun, open_run
from oracle_pipeline.scoring.learning import learn
from oracle_pipeline.scoring.reference import read_reference
from oracle_pipeline.windows import HOP_S, WINDOW_S
from tests.oracle_pipeline.live.robots import STRING

pytestmark = pytest.mark.slow

NORMAL = "lidar_passthrough"
PER_HOUR = 200.0  # false alarms; four short runs support no lower rate
SECOND_NS = 10**9


@pytest.fixture(scope="module")
def card(recorded_run, tmp_path_factory):
    paths = [recorded_run(NORMAL, number).path for number in range(4)]
    path = tmp_path_factory.mktemp("card") / "robot.card"
    learn(read_reference(paths, build_manager(None))).save(path)
    return path


def judged(card, run):
    """Return the verdicts on the windows of a run whose messages come one after the other."""
    judge = Judge(card, PER_HOUR)
    for topic in run.bag.topics.values():
        judge.add_topic(topic.name, topic.msgtype, topic.qos)
    start_ns, window, verdicts = run.bag.start_ns, 0, []
    graphs = list(run.intervals)
    for message in run.bag.messages():
        end_ns = start_ns + round((window * HOP_S + WINDOW_S) * SECOND_NS)
        if message.stamp_ns >= end_ns:
            if window % 2 == 0:
                judge.add_graph(graphs.pop(0))
            judge.end_window(start_ns, end_ns - round(WINDOW_S * SECOND_NS), end_ns, None)
            window += 1
            verdicts.append(next(judge.verdicts(600.0)))  # as slowly as a robot
        judge.add([Stamped(*message)])
    assert not judge.close()
    return verdicts, window


def test_every_window_gets_its_verdict_and_an_attack_raises_an_alarm(card, recorded_run):
    with open_run(recorded_run("random_noise", 4).path) as run:
        attacked, windows = judged(card, run)
    assert [verdict.end_s for verdict in attacked] == [10.0 + 5.0 * n for n in range(windows)]
    with open_run(recorded_run(NORMAL, 4).path) as run:
        normal, _ = judged(card, run)
    assert any(verdict.alarm for verdict in attacked)
    assert attacked[-1].evidence
    assert np.median([v.score for v in attacked]) > 3 * np.median([v.score for v in normal])


def test_features_of_the_newest_window_are_those_of_a_recording_that_ends_with_it(
    recorded_run, tmp_path
):
    manager, start_s, end_s = build_manager(None), 10.0, 20.0
    with open_run(recorded_run(NORMAL).path) as run:
        begin_ns = run.bag.start_ns
        end_ns = begin_ns + round(end_s * SECOND_NS)
        messages = [Stamped(*m) for m in run.bag.messages() if m.stamp_ns < end_ns]
        recent = RecentMessages(end_s)
        with BagWriter(tmp_path / "cut") as bag:
            for topic in run.bag.topics.values():
                recent.add_topic(topic.name, topic.msgtype, topic.qos)
                bag.add_topic(topic.name, topic.msgtype, topic.qos)
            for message in messages:
                bag.write(*message)
        intervals = run.intervals[:2]
    recent.add(messages)
    for interval in intervals:
        recent.add_graph(interval)
    with open_run(tmp_path / "cut") as cut:
        table = extract(OpenedRun(cut.path, cut.bag, None, intervals), manager).windows
    (expected,) = table[table["window_start_s"] == start_s].to_dict("records")
    live = extract_window(recent.until(begin_ns, end_ns, None), manager, start_s)
    for column in feature_columns(table):
        np.testing.assert_allclose(live[column].iloc[0], expected[column], err_msg=column)


def test_what_was_said_once_on_a_latched_topic_is_kept_however_old_it_is(recorded_run):
    with open_run(recorded_run(NORMAL).path) as run:
        topics, messages = run.bag.topics, [Stamped(*m) for m in run.bag.messages()]
        start_ns, end_ns = run.bag.start_ns, run.bag.end_ns
    recent = RecentMessages(5.0)
    for topic in topics.values():
        recent.add_topic(topic.name, topic.msgtype, topic.qos)
    recent.add(messages)
    kept = recent.until(start_ns, end_ns, None).bag
    assert kept.topics["/map"].count == topics["/map"].count
    assert 0 < kept.topics["/scan"].count < topics["/scan"].count / 3
    assert kept.end_ns - kept.start_ns <= 5 * SECOND_NS


def test_graphs_older_than_what_is_kept_are_forgotten(recorded_run):
    with open_run(recorded_run(NORMAL).path) as run:
        graph = run.intervals[0].graph
    recent = RecentMessages(20.0)
    recent.add_topic("/words", STRING, ())
    for number in range(100):
        recent.add_graph(Interval(10.0 * number, graph))
    recent.add([Stamped("/words", 1000 * SECOND_NS, b"\0\1\0\0")])
    assert len(recent.until(0, 1001 * SECOND_NS, None).intervals) == 3


def test_a_card_that_is_not_there_is_told_at_once(tmp_path):
    with pytest.raises(OracleError, match="oracle learn"):
        Judge(tmp_path / "none.card", None)


def test_the_death_of_the_process_that_judges_is_told(card, eventually):
    judge = Judge(card, PER_HOUR)
    judge._process.kill()
    judge._process.join()

    def told():
        judge.add([Stamped("/words", 0, b"\0\1\0\0")])
        with pytest.raises(OracleError, match="died"):
            list(judge.verdicts(1.0))
        return True

    assert eventually(told)
    judge.close()


def test_windows_that_come_too_fast_are_left_out_and_the_newest_are_judged(card, recorded_run):
    with open_run(recorded_run(NORMAL, 4).path) as run:
        start_ns, messages = run.bag.start_ns, [Stamped(*m) for m in run.bag.messages()]
        topics = run.bag.topics
    judge = Judge(card, PER_HOUR)
    for topic in topics.values():
        judge.add_topic(topic.name, topic.msgtype, topic.qos)
    judge.add(messages)
    for number in range(20):
        end_ns = start_ns + round((10.0 + number) * SECOND_NS)
        judge.end_window(start_ns, end_ns - 10 * SECOND_NS, end_ns, None)
    verdicts = []
    while not verdicts or verdicts[-1].end_s < 29.0:
        verdicts += judge.verdicts(1.0)
    assert 0 < judge.left_out == 20 - len(verdicts)
    judge.close()
