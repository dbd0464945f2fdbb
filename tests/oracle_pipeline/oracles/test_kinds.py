import json
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from oracle_pipeline.bags.types import serialize
from oracle_pipeline.bags.writer import BagWriter
from oracle_pipeline.cli import main
from oracle_pipeline.evaluation.kinds_comparison import UNION, compare_kinds
from oracle_pipeline.features.engine.plugin import TopicArrivals
from oracle_pipeline.oracles import human
from oracle_pipeline.oracles.calibration import calibrated, union
from oracle_pipeline.oracles.collecting import numbers_to_learn, traced_runs
from oracle_pipeline.oracles.implicit import Implicit
from oracle_pipeline.oracles.invariants import Invariants
from oracle_pipeline.oracles.kind import RELATION, KindError, Material
from oracle_pipeline.oracles.metamorphic import Differential, Metamorphic
from oracle_pipeline.oracles.registry import build_kinds
from oracle_pipeline.oracles.requirements import NAV2, Requirements, load
from oracle_pipeline.oracles.specified import Specified
from oracle_pipeline.oracles.traces import STEP_S, _keep_scans, quiet_topics
from tests.oracle_pipeline.features.conftest import drive
from tests.oracle_pipeline.oracles.made_runs import campaign, trace


class Drawn:
    """A kind without information: its scores are random."""

    name, asks = "drawn", "luck"

    def __init__(self, seed):
        self.seed = seed

    def learn(self, normal):
        return self

    def score(self, runs):
        return np.random.default_rng(self.seed).normal(size=len(runs.traces))


@pytest.mark.parametrize(
    ("kind", "altered"),
    [
        (Implicit, {"errors": 3.0}),
        (Implicit, {"quiet_topics": 1.0}),
        (Implicit, {"goals_failed": 1.0}),
        (lambda: Specified(load(NAV2)), {"command_speed": 0.2}),
        (Invariants, {"nearest_max": 0.2}),
        (Invariants, {"acceleration": 2.0}),
    ],
)
def test_each_kind_detects_its_failures(kind, altered):
    runs = campaign(**altered)
    p = calibrated(kind(), runs).p
    assert p[runs.malicious].max() <= 0.05
    assert (p[runs.normal] <= 0.05).mean() <= 0.1


def test_a_run_is_compared_with_others_of_its_task():
    runs = campaign(nearest_min=-0.2, nearest_max=-0.2)
    p = calibrated(Differential(runs), runs).p
    assert p[runs.malicious].max() <= 0.05


def test_without_a_second_run_of_a_task_there_is_no_differential_oracle():
    with pytest.raises(KindError, match="0 normal runs have another run of the same task"):
        calibrated(Differential(campaign(repeats=1)), campaign(repeats=1))


def turning(relation, **altered):
    """Runs of tasks with different turns, no task twice; mirrored runs turn the other way."""
    runs = campaign(repeats=1, **altered)
    side = -1.0 if relation == "mirrored" else 1.0
    drift = 1.0 if relation == "same" else 1.001  # differs a little: exact repetitions are ignored
    traces = tuple(
        drift * trace.assign(turn=trace["turn"] + side * np.sin(7.0 * block))
        for trace, block in zip(runs.traces, runs.block, strict=True)
    )
    return type(runs)(runs.table.assign(**{RELATION: relation}), traces)


@pytest.mark.parametrize("relation", ["mirrored", "shifted"])
def test_without_repeated_tasks_a_run_in_another_relation_detects_attacks(relation):
    runs, follow_ups = turning("same", turn=0.3), turning(relation)
    found = calibrated(Metamorphic(follow_ups), runs).p
    assert found[runs.malicious].max() <= 0.05
    assert (found[runs.normal] <= 0.05).mean() <= 0.1
    other = {"mirrored": "shifted", "shifted": "mirrored"}[relation]
    wrong = type(runs)(follow_ups.table.assign(**{RELATION: other}), follow_ups.traces)
    normal = runs.where(runs.normal)
    right, reversed_ = (
        np.nanmax(np.abs(Metamorphic(each).differences(normal))) for each in (follow_ups, wrong)
    )
    assert right < 0.1 < 1.0 < reversed_


def test_follow_up_runs_are_needed_for_all_blocks_or_none():
    runs, follow_ups = turning("same"), turning("mirrored")
    some = follow_ups.where(follow_ups.block < 22)
    with pytest.raises(KindError, match="2 of 24 normal runs have no mirrored run of their block"):
        Metamorphic(some).learn(runs.where(runs.normal))


def test_false_positives_of_each_kind_and_of_the_union_are_controlled():
    runs = campaign(40, repeats=1)
    rates = []
    for seed in range(0, 100, 5):
        found = [calibrated(Drawn(seed + n), runs) for n in range(5)]
        p = np.array([each.p for each in found])
        rates.append([(p <= 0.1).mean(), (union(found, runs).p <= 0.1).mean()])
        assert (p.min(axis=0) <= 0.1).mean() > 0.2  # what the correction is for
    assert np.mean(rates, axis=0) == pytest.approx([0.1, 0.1], abs=0.03)


def test_no_run_is_judged_by_a_model_of_its_session():
    class Remembers(Drawn):
        def learn(self, normal):
            learned = Drawn(0)
            learned.seen = set(normal.table["run_id"])
            learned.score = lambda runs: np.array(
                [float(run not in learned.seen) for run in runs.table["run_id"]]
            )
            return learned

    runs = campaign(12, repeats=2)
    assert calibrated(Remembers(0), runs).score[runs.normal] == pytest.approx(1.0)


def test_the_table_has_a_row_for_each_kind_with_the_reason_for_missing_ones():
    runs = campaign(errors=2.0)
    follow_ups = type(runs)(runs.table.assign(**{RELATION: "shifted"}), runs.traces)
    kinds = build_kinds(Material(runs, load(NAV2), {"attack|run000": True}, follow_ups))
    comparison = compare_kinds(kinds, runs)
    table = comparison.oracles.set_index("oracle")
    assert [*table.index] == [
        "implicit", "specified", "invariants", "differential", "metamorphic", "human", UNION,
    ]  # fmt: skip
    assert "all equal" in table.loc["human", "note"]
    assert table.loc["implicit", "detection_rate"] == 1.0
    assert table.loc[UNION, "detection_rate"] == 1.0
    assert table.loc[UNION, "false_alarm_rate"] <= 0.1
    assert set(comparison.p["mode"]) == {"attack", "patrol0", "patrol1", "patrol2"}


def test_a_kind_of_oracle_comes_from_the_plugin_folder(tmp_path):
    (tmp_path / "mine.py").write_text(
        "import numpy as np\n"
        "from oracle_pipeline.features import hookimpl\n"
        "class Slow:\n"
        "    name, asks = 'slow', 'patience'\n"
        "    def learn(self, normal): return self\n"
        "    def score(self, runs): return np.array([-t['speed'].mean() for t in runs.traces])\n"
        "@hookimpl\n"
        "def register_oracles(): return [lambda material: Slow()]\n"
        "@hookimpl\n"
        "def register_features(): return []\n",
        "utf-8",
    )
    runs = campaign(speed=-0.1)
    (mine,) = (
        kind
        for kind in build_kinds(Material(runs, Requirements()), tmp_path)
        if kind.name == "slow"
    )
    assert calibrated(mine, runs).p[runs.malicious].max() <= 0.05


def test_questions_are_about_uncertain_runs_and_answers_move_the_threshold():
    runs = campaign(20, nearest_max=0.12)
    material = human.answered_by_labels(Material(runs, load(NAV2)), 16)
    bad = dict(zip(runs.table["run_id"], runs.malicious, strict=True))
    assert all(bad[run] == answer for run, answer in material.answers.items())
    assert len(material.answers) == 16
    assert set(material.answers.values()) == {True, False}
    person = human.Human(material.answers, runs, human.input_kinds(material))
    opinion = person.learn(runs.where(runs.normal))
    above = opinion.score(runs) > opinion.threshold
    assert (above == runs.malicious).mean() > 0.9


def test_answers_on_a_session_are_not_used_to_judge_it():
    runs = campaign(8)
    asked = human.Human({"attack|run003": True, "patrol0|run005": False}, runs, [Implicit()])
    for block in (3, 5):
        with pytest.raises(human.AnswerError, match="all equal"):
            asked.learn(runs.where(runs.normal & (runs.block != block)))


def test_answers_are_stored_and_invalid_files_are_errors(tmp_path):
    path = tmp_path / "answers.json"
    human.save_answers({"a|run000": True, "b|run001": False}, path)
    assert human.load_answers(path) == {"a|run000": True, "b|run001": False}
    path.write_text(json.dumps({"answers": {"a|run000": "perhaps"}}), "utf-8")
    with pytest.raises(human.AnswerError, match="answer for a.run000 is 'perhaps'; write bad"):
        human.load_answers(path)
    path.write_text("[]", "utf-8")
    with pytest.raises(human.AnswerError, match="is not a file of answers"):
        human.load_answers(path)


def test_a_topic_is_quiet_only_after_it_stops():
    clock = np.arange(0.0, 30.0, STEP_S)
    every = np.arange(0.0, 30.0, 0.1)

    def arrivals(times_s):
        return TopicArrivals("a/msg/B", times_s, np.ones(len(times_s)), np.zeros(0))

    goes_on, stops, rare = arrivals(every), arrivals(every[every < 10.0]), arrivals(every[:3])
    quiet = quiet_topics({"/a": goes_on, "/b": stops, "/c": rare}, clock)
    assert not quiet[clock < 11.5].any()
    assert (quiet[clock > 12.5] == 1.0).all()


rays = hnp.arrays(np.float32, st.integers(0, 9), elements=st.floats(0.0, 4.0, width=32)) | (
    hnp.arrays(np.float32, 6, elements=st.sampled_from([0.5, 1.0, 3.0, np.inf, np.nan]))
)


@given(st.lists(rays, min_size=1, max_size=6))
def test_batched_scans_give_the_values_of_single_scans(ranges):
    many = np.empty(len(ranges), dtype=object)
    many[:] = ranges
    least, most = np.full(len(ranges), 0.25), np.full(len(ranges), 3.5)
    together = _keep_scans(SimpleNamespace(ranges=many, range_min=least, range_max=most))
    for values, scan in zip(together, ranges, strict=True):
        valid = (scan >= 0.25) & (scan <= 3.5)
        far = scan.astype(float)
        bends = [
            abs(far[i - 1] - 2 * far[i] + far[i + 1])
            for i in range(1, len(far) - 1)
            if valid[i - 1 : i + 2].all()
        ]
        nearest = far[valid].min() if valid.any() else np.nan
        without = 1.0 - valid.mean() if len(scan) else np.nan
        uneven = np.median(bends) if bends else np.nan
        assert np.array_equal(values, [nearest, without, uneven], equal_nan=True)


def test_the_trace_of_a_bag_has_the_robots_motion(recorded_run):
    from oracle_pipeline.opened_run import open_run
    from oracle_pipeline.oracles.traces import SIGNALS, TIME, read_trace
    from oracle_pipeline.robots.robot import find_robots

    with open_run(recorded_run("lidar_passthrough").path) as run:
        (robot,) = find_robots(run.bag)
        read, driven_m = read_trace(robot), run.manifest.goal_results[0].driven_m
        duration_s = run.duration_s
    assert [*read] == [TIME, *SIGNALS]
    assert read.iloc[-1].notna().all()
    assert read[TIME].iloc[-1] == pytest.approx(duration_s, abs=2 * STEP_S)
    assert read["travelled"].iloc[-1] == pytest.approx(driven_m, rel=0.1)
    assert 0.2 < read["nearest_min"].min() <= read["nearest_max"].max()
    assert read["goal_time"].max() > 5.0
    assert read[["goals_failed", "errors", "non_finite"]].to_numpy().max() == 0.0


def test_the_trace_of_a_bag_with_a_broken_topic_has_the_signals_of_the_others(tmp_path):
    from oracle_pipeline.opened_run import open_run
    from oracle_pipeline.oracles.traces import read_trace
    from oracle_pipeline.robots.robot import find_robots

    with BagWriter(tmp_path / "bag") as bag:
        for seconds, topic, message in drive():
            data = serialize(message, message.__msgtype__)
            bag.add_topic(topic, message.__msgtype__, [])
            bag.write(topic, round(seconds * 1e9), data[: None if topic == "/odom" else 24])
    with open_run(tmp_path / "bag") as run:
        read = read_trace(find_robots(run.bag)[0])
    assert read["travelled"].iloc[-1] > 5.0
    assert read[["nearest_min", "goal_time"]].isna().all(axis=None)


def test_a_trace_without_a_signal_is_judged_by_the_others():
    runs = campaign(8, nearest_max=0.5)
    blind = tuple(trace.assign(gyro_turn=np.nan, pose_spread=np.nan) for trace in runs.traces)
    runs = type(runs)(runs.table, blind)
    for kind in (Implicit(), Specified(load(NAV2)), Invariants()):
        assert np.isfinite(calibrated(kind, runs).score).all()
    assert np.isfinite(Implicit().score(type(runs)(runs.table[:1], (trace(0)[:0],)))).all()
    assert isinstance(runs.table, pd.DataFrame)


REQUIREMENT = """
requirements:
  - {{name: charged, formula: always (charge{}), scale: 0.1}}
signals: {{charge: /log/volts}}
"""


@pytest.mark.parametrize("condition", [" >= 11.5", "_rate >= -0.5"])
def test_a_requirement_on_any_number_of_a_robot_is_held_to_its_recordings(condition, tmp_path):
    times_s, paths = np.arange(0.0, 6.0, 0.1), []
    for number, lowest in enumerate((11.8, 11.8, 11.0)):
        volts = np.where(times_s < 3.0, 12.0, lowest)
        paths.append(tmp_path / f"{number}.csv")
        pd.DataFrame({"time": times_s, "volts": volts}).to_csv(paths[-1], index=False)
    file = tmp_path / "requirements.yaml"
    file.write_text(REQUIREMENT.format(condition))
    wanted = load(file)
    runs = traced_runs(paths[1:], paths[:1], wanted.signals)
    held = Specified(wanted).score(runs) <= 0.0
    assert held.tolist() == [True, True, False]
    assert runs.known_in(runs.digests()[2:]).tolist() == [False, False, True]
    assert runs.known_in(traced_runs(paths[1:], paths[:1]).digests()).all()
    with pytest.raises(KindError, match="No recording has /log/volt, which .* call charge"):
        traced_runs(paths, [], {"charge": "/log/volt"})


def test_invariants_of_a_robot_that_does_not_drive_are_those_of_its_numbers(tmp_path):
    draw, good = np.random.default_rng(0).normal, tmp_path / "good"
    good.mkdir()
    for number in range(8):
        table = {"time": np.arange(80) * 0.05, "torque": draw(size=80).clip(-1.0, 1.0)}
        pd.DataFrame(table).to_csv(good / f"{number}.csv", index=False)
    bad = tmp_path / "bad.csv"
    pd.DataFrame(table | {"torque": 3.0}).to_csv(bad, index=False)
    file = tmp_path / "invariants.yaml"
    done = CliRunner().invoke(main, ["invariants", str(good), "--output", str(file)])
    assert done.exit_code == 0, done.output
    assert load(file).signals["log_torque"] == "/log/torque"
    for more in ([], ["--requirements", str(file)]):
        arguments = [str(bad), "--reference", str(good), "--far", "0.2", "--format", "json"]
        done = CliRunner().invoke(main, ["kinds", *arguments, *more])
        assert done.exit_code == 0, done.output
        *usual, odd = json.loads(done.stdout)["runs"]
        assert {run["invariants"] for run in usual} == {1.0}
        assert odd["invariants"] == pytest.approx(1 / (len(usual) + 1))
        assert not more or odd["specified"] == odd["invariants"]


@pytest.mark.slow(3)
@pytest.mark.parametrize("mode", ["arm_normal", "atc_normal"])
def test_numbers_of_a_testbed_have_values_in_each_trace(mode, recorded_run):
    """Topics with one message have no period, and rotations of length 0 no angles."""
    folder = recorded_run(mode).path
    numbers = numbers_to_learn([folder])
    trace = traced_runs([], [folder], numbers).traces[0]
    assert len(numbers) > 30
    assert trace[list(numbers)].notna().any().all()


def test_all_recordings_that_cannot_be_read_are_named_at_once(tmp_path):
    for name in ("first.mcap", "second.mcap"):
        (tmp_path / name).write_bytes(b"no recording")
    with pytest.raises(KindError, match=r"(?s)second\.mcap is not.*first\.mcap is not"):
        traced_runs([tmp_path / "first.mcap"], [tmp_path / "second.mcap"])
    for command in (["kinds", str(tmp_path)], ["invariants", str(tmp_path), "--output", "no.yaml"]):
        done = CliRunner().invoke(main, command)
        assert [line.partition(" is not")[0] for line in done.stderr.splitlines()][-2:] == [
            f"Error: {tmp_path / 'first.mcap'}", f"{tmp_path / 'second.mcap'}"
        ]  # fmt: skip
