"""One sentence for a verdict: what happened, where, since when, and by how much.

A feature has a phrase in everyday terms, by its name. What has none is called a statistic.
"""

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

import yaml

from oracle_pipeline.datasets import LAG, MINUS, SIGNALS, is_lag, topic_of_signal
from oracle_pipeline.scoring.verdict import Evidence, Verdict

_ROUNDING = 1e-12  # below all that features resolve
_LONG = 1e7  # values from here on have an exponent
FAR_OUT = 10.0  # distance of a feature that is reported with a normal verdict too [scales]
_CLEAR = 0.5  # evidence with a phrase is preferred down to this share of the largest distance
_AGAINST = " against "  # between two places
_PHRASES: Mapping[str, str] = yaml.safe_load(
    Path(__file__).with_name("phrases.yaml").read_text("utf8")
)

_STATISTICS = {
    "std": "spread", "change": "change from message to message", "held": "time without a change",
    "missing": "share without a number", "min": "minimum", "max": "maximum",
}  # fmt: skip
_QUANTIFIED = "{value}"  # phrases without it get the value at their end


def headline(verdict: Verdict) -> str:
    """Return one sentence on a verdict, for the top of a page or a line of a terminal."""
    if verdict.outcome == "error":
        return verdict.error
    if verdict.outcome == "another system" and verdict.in_common is not None:
        return (
            f"It is another kind of system: {verdict.in_common:.0%} of roles, topics and types are "
            "those of the reference. Use a reference of this system."
        )
    if verdict.outcome == "normal" and (far := far_out(verdict)):
        return f"Normal as a whole, but far outside in one feature: {sentence(clearest(far))}"
    if verdict.outcome == "normal":
        return "It behaved as the normal runs did."
    clear = clearest(verdict.evidence) if verdict.evidence else None
    is_plain = verdict.outcome == "breach" or clear is None or not _phrase(clear)
    if verdict.contract and is_plain:
        return verdict.contract[0]
    if clear is None:
        return "Its features together are unlike those of normal runs; none of them alone is."
    told = sentence(clear)
    if verdict.outcome == "unsupported":
        return f"Too few normal runs for a verdict. Most unusual: {told[0].lower()}{told[1:]}"
    return told


def far_out(verdict: Verdict) -> tuple[Evidence, ...]:
    """Return the features that are so far outside that even a normal verdict tells them."""
    return tuple(each for each in verdict.evidence if abs(each.z) >= FAR_OUT)


def sentence(evidence: Evidence) -> str:
    """Return what one feature says of a recording.

    Examples
    --------
    >>> sentence(Evidence("contextual.total_turning", -8.0, False, 0.29, "rad", 1.1, 1.6))
    'The robot turned 0.29 rad in all; normal runs turn 1.1 to 1.6 rad.'
    """
    unit = "" if evidence.unit in ("1", "") else f" {evidence.unit.replace('1/', 'per ', 1)}"
    own, *ends = told_apart(evidence.value, evidence.usual_low, evidence.usual_high)
    text = _text(evidence, f"{own}{unit}", f"{' to '.join(dict.fromkeys(ends))}{unit}")
    return f"{text}{_when(evidence)}."


def rounded(value: float, digits: int = 4) -> str:
    """Return a value with some digits; a rounding error around zero is 0.

    Examples
    --------
    >>> [rounded(value) for value in (0.0123456, 101325.0, 8.3e-18, -1e-16)]
    ['0.01235', '101300', '0', '0']
    """
    text = f"{value:.{digits}g}" if abs(value) > _ROUNDING else "0"
    return f"{float(text):.0f}" if "e" in text and 1.0 < abs(value) < _LONG else text


def told_apart(*values: float) -> list[str]:
    """Return values with at least three digits, and more where they would look the same.

    Examples
    --------
    >>> told_apart(86.81, 84.98, 85.02)
    ['86.81', '84.98', '85.02']
    """
    texts = [[rounded(value, digits) for value in values] for digits in range(3, 7)]
    return max(texts, key=lambda some: len(set(some)))


def _when(evidence: Evidence) -> str:
    start_s, end_s = evidence.window_start_s, evidence.window_end_s
    if start_s is None:
        return ""
    if end_s is not None:
        return f", most of all from {start_s:g} s to {end_s:g} s"
    return f", most of all from {start_s:g} s on" if start_s else ", all the time"


def _text(evidence: Evidence, value: str, usual: str) -> str:
    feature, phrase = evidence.feature, _phrase(evidence)
    if topic := topic_of_signal(feature):
        signal, _, statistic = feature.removeprefix(f"{SIGNALS}{topic}/").rpartition(".")
        told = f"The {_STATISTICS.get(statistic, statistic)} of {signal}"
        if is_lag(signal):
            told = f"The lag of {signal.removesuffix(LAG).replace(MINUS, ' behind ')}"
        return f"{told} on {topic} is {value}; normal runs have {usual}"
    a, _, b = (evidence.where or "").partition(_AGAINST)
    if not phrase:
        at = f" at {evidence.where}" if evidence.where else ""
        return f"Only a statistic is unusual: {feature}{at}: {value}, in normal runs {usual}"
    where = f"{a} and {b}" if b else a or "the recording"
    text = phrase.format(value=value, usual=usual, where=where)
    if _QUANTIFIED in phrase:
        return text
    return f"{text}: {feature.partition('.')[2].replace('_', ' ')} {value}, in normal runs {usual}"


def clearest(evidence: Sequence[Evidence]) -> Evidence:
    """Return the farthest feature that has a phrase, unless another is much farther."""
    farthest = abs(evidence[0].z)
    clear = (e for e in evidence if _phrase(e) or topic_of_signal(e.feature))
    return next((e for e in clear if abs(e.z) >= _CLEAR * farthest), evidence[0])


def _phrase(evidence: Evidence) -> str:
    usual = max(abs(evidence.usual_low), abs(evidence.usual_high))
    names = evidence.feature, f"{evidence.feature}{'+' if abs(evidence.value) > usual else '-'}"
    fitting = (
        phrase for glob, phrase in _PHRASES.items() if any(fnmatchcase(n, glob) for n in names)
    )
    return next(fitting, "")
