"""Windows are judged as they end, as the finished recording would be."""

import json
import multiprocessing
import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.protocol import INTERVAL_S
from oracle_pipeline.bags.reader import RawMessage
from oracle_pipeline.datasets import WINDOW_START, feature_columns, is_lag, signal_columns
from oracle_pipeline.features import build_manager, extract
from oracle_pipeline.features.extraction import extract_window
from oracle_pipeline.graphs.intervals import Interval
from oracle_pipeline.live.judge_process import JudgeProcess
from oracle_pipeline.live.recent import CONTEXT_S, RecentMessages
from oracle_pipeline.opened_run import open_run
from oracle_pipeline.robots.robot import find_robots
from oracle_pipeline.robots.roles_file import RoleChoices
from oracle_pipeline.windows import HOP_S, WINDOW_S
from sim.campaigns import Campaign
from tests.oracle_pipeline.live.robots import STRING

pytestmark = pytest.mark.slow(3)

NORMAL = "lidar_passthrough"
PER_HOUR = 200.0  # false alarms; five short runs support no lower rate
SECOND_NS = 10**9


def judges():
    return [each for each in multiprocessing.active_children() if each.name == "judge"]


def test_an_interrupt_of_the_whole_terminal_does_not_end_the_judge_while_it_starts(
    normal_card, eventually
):
    with ThreadPoolExecutor() as pool:
        starting = pool.submit(JudgeProcess, normal_card, PER_HOUR)
        assert eventually(judges)
        (process,) = judges()
        os.kill(process.pid, signal.SIGINT)
        judge = starting.result()
    assert process.is_alive()
    assert not judge.close()


def test_an_interrupt_of_the_watch_while_the_judge_starts_ends_both(normal_card):
    """Otherwise, the watch would never end."""
    code = (
        "import signal, sys; from pathlib import Path\n"
        "from oracle_pipeline.live.judge_process import JudgeProcess\n"
        "signal.signal(signal.SIGALRM, signal.default_int_handler)\n"
        "signal.setitimer(signal.ITIMER_REAL, 0.3)\n"
        f"JudgeProcess(Path(sys.argv[1]), {PER_HOUR})"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, normal_card],
        capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert "KeyboardInterrupt" in done.stderr


def test_the_process_that_records_has_no_library_that_only_the_judge_needs(
    normal_card, recorded_run
):
    """On a robot, they take a second of its start, and 150 MB."""
    code = (
        "import sys; from pathlib import Path\n"
        "from oracle_pipeline.live import page_server, watch, watch_command\n"
        "from oracle_pipeline.live.events import WindowAlarm\n"
        "from oracle_pipeline.live.judge_process import JudgeProcess\n"
        "from oracle_pipeline.opened_run import open_run\n"
        "from oracle_pipeline.windows import WINDOW_S\n"
        f"judge = JudgeProcess(Path(sys.argv[1]), {PER_HOUR})\n"
        "with open_run(Path(sys.argv[2])) as run:\n"
        "    for topic in run.bag.topics.values():\n"
        "        judge.add_topic(topic.name, topic.msgtype, topic.qos)\n"
        "    judge.add(list(run.bag.messages()))\n"
        "    begin = run.bag.start_ns\n"
        "    judge.end_window(begin, begin, begin + round(WINDOW_S * 10**9))\n"
        "(verdict,) = judge.close()\n"
        "print(*watch_command.lines_of(WindowAlarm(verdict), None, 'text'), sep='\\n')\n"
        "learning = {'pandas', 'pyarrow', 'sklearn', 'scipy.stats'}\n"
        "sys.exit(', '.join(learning & sys.modules.keys()) or 0)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, normal_card, recorded_run(NORMAL, 5).path],
        capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("ALARM in the window from 0 s to 5 s:")


def judged(judge, run, spaces=("",)):
    """Return the verdicts on the windows of a run whose messages come one after the other.

    In each of some namespaces, there is a robot that does the same.
    """
    judge.begin()
    for topic in run.bag.topics.values():
        for space in spaces:
            judge.add_topic(f"{space}{topic.name}", topic.msgtype, topic.qos)
    start_ns, window, verdicts = run.bag.start_ns, 0, []
    graphs, fresh = list(run.intervals), []
    for message in run.bag.messages():
        end_ns = start_ns + round((window * HOP_S + WINDOW_S) * SECOND_NS)
        if message.stamp_ns >= end_ns:
            judge.add(fresh)
            if graphs and end_ns - start_ns >= (graphs[0].start_s + INTERVAL_S) * SECOND_NS:
                judge.add_graph(graphs.pop(0))
            judge.end_window(start_ns, end_ns - round(WINDOW_S * SECOND_NS), end_ns)
            window += 1
            answer = judge.verdicts(600.0)
            verdicts += [next(answer) for _ in spaces]  # as slowly as a robot
            fresh = []
        fresh += [message._replace(topic=f"{space}{message.topic}") for space in spaces]
    return verdicts, window


def test_each_robot_of_a_fleet_is_judged_as_if_it_were_alone(normal_card, recorded_run):
    found = []
    with open_run(recorded_run(NORMAL).path) as run:
        for spaces in (("",), ("/robot1", "/robot2")):
            judge = JudgeProcess(normal_card, PER_HOUR)
            verdicts, windows = judged(judge, replace(run, intervals=()), spaces)
            assert not judge.close()
            found.append(verdicts)
    alone, fleet = found
    assert [each.robot for each in fleet] == ["robot1", "robot2"] * windows
    for own in (fleet[::2], fleet[1::2]):
        assert [each.score for each in own] == pytest.approx([each.score for each in alone])


def test_every_window_gets_its_verdict_and_an_attack_raises_an_alarm(normal_card, recorded_run):
    judge = JudgeProcess(normal_card, PER_HOUR)
    with open_run(recorded_run("random_noise", 5).path) as run:
        attacked, windows = judged(judge, run)
    assert [verdict.end_s for verdict in attacked] == [WINDOW_S + HOP_S * n for n in range(windows)]
    with open_run(recorded_run(NORMAL, 5).path) as run:
        normal, _ = judged(judge, run)
    assert not judge.close()
    assert any(verdict.alarm for verdict in attacked)
    assert attacked[-1].evidence
    assert np.median([v.score for v in attacked]) > 3 * np.median([v.score for v in normal])


def windows_as_they_end(run, manager, context_s):
    """Return the windows of a run whose messages come one after the other, but for cut ones."""
    recent, carried, rows = RecentMessages(context_s), {}, []
    for topic in run.bag.topics.values():
        recent.add_topic(topic.name, topic.msgtype, topic.qos)
    graphs, fresh, end_s = list(run.intervals), [], WINDOW_S
    for message in run.bag.messages():
        end_ns = run.bag.start_ns + round(end_s * SECOND_NS)
        if message.stamp_ns >= end_ns:
            recent.add(fresh)
            if graphs and end_s >= graphs[0].start_s + INTERVAL_S:
                recent.add_graph(graphs.pop(0))
            ended = recent.until(run.bag.start_ns, end_ns)
            row, carried = extract_window(ended, manager, end_s - WINDOW_S, carried, signals=True)
            rows.append(row)
            fresh, end_s = [], end_s + HOP_S
        fresh.append(message)
    return pd.concat(rows, ignore_index=True)


# Interpolated to the next message, fitted to the motion so far, or on the scale of all numbers.
LATER = ("kinematics.", "map.", "pairs.histogram_distance", "redundancy.range", "transforms.odom")


@pytest.fixture(scope="module")
def both(recorded_run):
    """Return windows as they end, and those of the whole recording, of one run of two goals."""
    manager = build_manager(None)
    with open_run(recorded_run(NORMAL, 0, Campaign(goals_per_run=2)).path) as run:
        live, whole = windows_as_they_end(run, manager, CONTEXT_S), extract(run, manager).windows
    return live, whole.iloc[: len(live)], manager.features()


def test_features_of_live_windows_are_those_of_the_whole_recording(both):
    live, whole, _ = both
    assert live[WINDOW_START].tolist() == whole[WINDOW_START].tolist()
    assert live[WINDOW_START].iloc[-1] > CONTEXT_S + WINDOW_S
    for column in feature_columns(whole):
        if not column.startswith(LATER):
            np.testing.assert_allclose(
                live[column], whole[column], rtol=1e-6, atol=1e-9, err_msg=column
            )


def test_signals_of_live_windows_are_those_of_the_whole_recording(both):
    live, whole, _ = both
    signals = [column for column in signal_columns(whole) if not is_lag(column.rpartition(".")[0])]
    assert len(signals) > 500
    np.testing.assert_allclose(live[signals], whole[signals], rtol=1e-6, atol=1e-9)


def test_the_roles_that_a_card_was_learned_with_count(recorded_run):
    manager, choices = build_manager(None), RoleChoices(topics={"odometry": ()})
    recent = RecentMessages()
    with open_run(recorded_run(NORMAL).path) as run:
        for topic in run.bag.topics.values():
            recent.add_topic(topic.name, topic.msgtype, topic.qos)
        recent.add(list(run.bag.messages()))
        end_ns = run.bag.start_ns + 20 * SECOND_NS
        ended = recent.until(run.bag.start_ns, end_ns)
    found, chosen = (
        extract_window(ended, manager, 15.0, {}, *find_robots(ended.bag, roles)).row
        for roles in (None, choices)
    )
    assert found["contextual.speed"].notna().all()
    assert "role odometry" in json.loads(chosen["missing"].iloc[0])["contextual.speed"]


def test_values_that_live_windows_lack_change_little(both):
    live, whole, features = both
    for column in feature_columns(whole):
        if column.startswith(LATER):
            assert (live[column].isna() == whole[column].isna()).mean() > 0.9, column
            apart = (live[column] - whole[column]).abs().dropna() / features[column].floor
            assert apart.empty or apart.median() <= 3.0, column


def test_a_message_on_a_latched_topic_is_kept_regardless_of_its_age(recorded_run):
    with open_run(recorded_run(NORMAL).path) as run:
        topics, messages = run.bag.topics, list(run.bag.messages())
        start_ns, end_ns = run.bag.start_ns, run.bag.end_ns
    recent = RecentMessages(5.0)
    for topic in topics.values():
        recent.add_topic(topic.name, topic.msgtype, topic.qos)
    recent.add(messages)
    kept = recent.until(start_ns, end_ns).bag
    assert kept.topics["/map"].count == topics["/map"].count
    assert 0 < kept.topics["/scan"].count < topics["/scan"].count / 3
    (scans,) = kept.batches(["/scan"])
    assert scans.stamps_ns.min() >= end_ns - 5 * SECOND_NS


def test_graphs_older_than_the_limit_are_dropped(recorded_run):
    with open_run(recorded_run(NORMAL).path) as run:
        graph = run.intervals[0].graph
    recent = RecentMessages(20.0)
    recent.add_topic("/words", STRING, ())
    for number in range(100):
        recent.add_graph(Interval(10.0 * number, graph))
    recent.add([RawMessage("/words", 1000 * SECOND_NS, b"\0\1\0\0")])
    assert len(recent.until(0, 1001 * SECOND_NS).intervals) == 3


def test_a_missing_card_is_reported_at_once(tmp_path):
    with pytest.raises(OracleError, match="oracle learn"):
        JudgeProcess(tmp_path / "none.card", None)


def test_the_death_of_the_judging_process_is_reported(normal_card, eventually):
    judge = JudgeProcess(normal_card, PER_HOUR)
    judge._process.kill()
    judge._process.join()

    def told():
        judge.add([RawMessage("/words", 0, b"\0\1\0\0")])
        with pytest.raises(OracleError, match="died"):
            list(judge.verdicts(1.0))
        return True

    assert eventually(told)
    judge.close()


class Hurried:
    """A judge that gets a whole run at once, and then its windows."""

    def __init__(self, card, path):
        self.judge = JudgeProcess(card, PER_HOUR)
        with open_run(path) as run:
            self.start_ns = run.bag.start_ns
            for topic in run.bag.topics.values():
                self.judge.add_topic(topic.name, topic.msgtype, topic.qos)
            self.judge.add(list(run.bag.messages()))

    def end_window(self, end_s):
        end_ns = self.start_ns + round(end_s * SECOND_NS)
        self.judge.end_window(self.start_ns, end_ns - round(WINDOW_S * SECOND_NS), end_ns)


def test_windows_that_come_too_fast_or_from_before_a_step_of_the_clock_are_left_out(
    normal_card, recorded_run
):
    hurried = Hurried(normal_card, recorded_run(NORMAL, 5).path)
    judge, verdicts = hurried.judge, []
    for number in range(10):
        hurried.end_window(10.0 + number)
    while not verdicts or verdicts[-1].end_s < 19.0:
        verdicts += judge.verdicts(1.0)
    left_out = 10 - len(verdicts)
    assert 0 < judge.left_out == left_out
    hurried.end_window(20.0)
    judge.begin()
    while judge.left_out == left_out:
        assert not list(judge.verdicts(1.0))
    judge.close()


def test_a_judge_that_is_far_behind_judges_no_window_that_lacks_messages(normal_card, recorded_run):
    hurried = Hurried(normal_card, recorded_run(NORMAL, 5).path)
    judge, ended, verdicts = hurried.judge, 30, []
    for number in range(ended):
        hurried.end_window(5.0 + 0.1 * number)
    while len(verdicts) + judge.left_out < ended:
        verdicts += judge.verdicts(1.0)
    last_s = 5.0 + 0.1 * (ended - 1)
    assert all(verdict.end_s < last_s for verdict in verdicts)
    assert not list(judge.verdicts())
    hurried.end_window(last_s + 10.0)  # it overlaps what was not sent
    hurried.end_window(last_s + CONTEXT_S + WINDOW_S + 0.1)
    (verdict,) = [next(judge.verdicts(60.0))]
    assert verdict.end_s > last_s + CONTEXT_S + WINDOW_S
    judge.close()
