"""Every built-in feature and every outcome has a sentence that a person understands."""

import re
from dataclasses import replace
from itertools import product

import pytest

from oracle_pipeline.features import build_manager
from oracle_pipeline.scoring.output import paragraph
from oracle_pipeline.scoring.sentences import _PHRASES, _phrase, headline, sentence
from oracle_pipeline.scoring.verdict import Evidence, Verdict

FEATURES = build_manager().features()


def evidence(feature: str, where: str | None = "/scan", z: float = 9.0) -> Evidence:
    unit = FEATURES[feature].unit if feature in FEATURES else "m"
    return Evidence(feature, z, False, 2.5, unit, 0.5, 1.0, where, 12.5)


def test_sentence_says_how_much_usual_and_when():
    for feature, where in product(FEATURES, (None, "/scan", "/scan against /odom")):
        told = sentence(evidence(feature, where))
        assert "2.5" in told
        assert "0.5 to 1" in told
        assert told.endswith("most of all from 12.5 s on.")
        assert not re.search(r"[{}]|  |\bof  |None| 1/", told)


def test_every_phrase_is_used():
    used = {_phrase(evidence(feature)) for feature in FEATURES}
    assert [phrase for phrase in _PHRASES.values() if phrase not in used] == []


def test_sentence_says_until_when_and_whether_it_lasts_all_the_time():
    told = evidence("contextual.speed")
    assert sentence(replace(told, window_end_s=20.0)).endswith("from 12.5 s to 20 s.")
    assert sentence(replace(told, window_start_s=0.0)).endswith(" all the time.")


@pytest.mark.parametrize(
    ("signal", "words"),
    [
        ("signals./odom/twist.linear.x.std", "The spread of twist.linear.x on /odom is 2.5"),
        ("signals./imu/orientation.w.held", "The time without a change of orientation.w on /imu"),
        ("signals./sonar/range.min", "The minimum of range on /sonar is 2.5"),
        ("signals./odom/x minus cmd.x.mean", "The mean of x minus cmd.x on /odom is 2.5"),
        ("signals./odom/x minus cmd.x.lag.mean", "The lag of x behind cmd.x on /odom is 2.5"),
        ("signals./a/b/range.missing", "The share without a number of range on /a/b is 2.5"),
    ],
)
def test_signals_of_any_robot_have_a_sentence_with_topic_and_size(signal, words):
    told = sentence(evidence(signal, None))
    assert told.startswith(words)
    assert "normal runs have 0.5 to 1" in told


def test_numbers_that_differ_never_look_the_same():
    volt = evidence("signals./log/volt.mean")
    told = sentence(replace(volt, value=86.8, usual_low=84.98, usual_high=85.02))
    assert "is 86.8 m; normal runs have 84.98 to 85.02 m" in told
    told = sentence(replace(volt, usual_low=0.0, usual_high=0.0, unit="1"))
    assert told.startswith("The mean of volt on /log is 2.5; normal runs have 0, ")


def test_feature_without_a_phrase_is_called_a_statistic():
    assert sentence(evidence("my_plugin.value")).startswith(
        "Only a statistic is unusual: my_plugin"
    )


def test_less_disagreement_than_usual_is_not_called_one():
    told = evidence("redundancy.scan_contradicted")
    assert "see different things" in sentence(told)
    assert sentence(replace(told, value=0.1)).startswith("Only a statistic is unusual: redundancy")


def test_headline_prefers_what_people_understand_unless_another_is_much_farther():
    statistic, clear = evidence("my_plugin.value", z=50.0), evidence("contextual.speed", z=30.0)
    near = Verdict("bag", "anomalous", evidence=(statistic, clear))
    far = Verdict("bag", "anomalous", evidence=(statistic, evidence("contextual.speed", z=9.0)))
    assert headline(near).startswith("The robot moved at 2.5 m/s on average")
    assert headline(far).startswith("Only a statistic is unusual")


@pytest.mark.parametrize(
    ("verdict", "told"),
    [
        (Verdict("bag", "error", error="There is no bag."), "There is no bag."),
        (Verdict("bag", "normal"), "It behaved as the normal runs did."),
        (Verdict("bag", "breach", contract=("Topic /a is gone.", "b")), "Topic /a is gone."),
        (
            Verdict(
                "bag",
                "anomalous",
                evidence=(evidence("my_plugin.value"),),
                contract=("Topic /a is gone.",),
            ),
            "Topic /a is gone.",
        ),
        (Verdict("bag", "anomalous"), "none of them alone is."),
        (
            Verdict("bag", "unsupported", evidence=(evidence("contextual.speed"),)),
            "Most unusual: the robot moved at 2.5 m/s",
        ),
    ],
    ids=lambda value: value.outcome if isinstance(value, Verdict) else "",
)
def test_every_outcome_has_a_headline(verdict, told):
    assert told in headline(verdict)


def test_normal_verdict_tells_what_is_far_outside():
    near, far = evidence("noise.smooth", z=9.9), evidence("contextual.speed", z=-10.0)
    verdict = Verdict("bag", "normal", p_value=0.5, suite_p_value=0.5, score=0.1)
    for shown in ((near,), ()):
        usual = replace(verdict, evidence=shown)
        assert headline(usual) == "It behaved as the normal runs did."
        assert not any("z" in line.split() for line in paragraph(usual))
    lines = list(paragraph(replace(verdict, evidence=(far, near))))
    assert "far outside in one feature: The robot moved at 2.5" in lines[1]
    assert "contextual.speed" in lines[-2]
    assert "noise.smooth" not in "".join(lines)
