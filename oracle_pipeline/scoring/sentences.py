"""One sentence for a verdict: what happened, where, since when, and by how much.

A feature has a phrase in everyday terms, by its name. What has none is called a statistic.
"""

from collections.abc import Sequence
from fnmatch import fnmatchcase

from oracle_pipeline.datasets import SIGNALS, topic_of_signal
from oracle_pipeline.scoring.verdict import Evidence, Verdict

_ROUNDING = 1e-12  # below all that features resolve
FAR_OUT = 10.0  # distance of a feature that is told with a normal verdict too [scales]
_CLEAR = 0.5  # evidence with a phrase is preferred down to this share of the largest distance
_AGAINST = " against "  # between two places

# Phrases by globs over names of features; the first that fits counts. {where} is the place, or
# both places, of the feature; {value} and {usual} have its unit.
_PHRASES: Sequence[tuple[str, str]] = (
    ("redundancy.range_*", "The range sensor and the scanner of {where} disagree"),
    ("redundancy.*", "Scanners {where} see different things"),
    ("permanence.driven_across", "The robot drives through what {where} sees"),
    ("permanence.loose", "Something in the scans of {where} moves faster than usual"),
    ("permanence.*", "Things appear in the scans of {where}, or vanish"),
    ("noise.repeated", "Scans of {where} repeat earlier ones exactly"),
    ("noise.smooth*", "Parts of the scans of {where} are smoother than its noise allows"),
    ("noise.*", "The noise of {where} is unlike that in normal runs"),
    ("scan.*", "The ranges of {where} are unlike those in normal runs"),
    ("map.*", "The scans of {where} do not fit the map"),
    ("costmap.*", "The local costmap lacks what {where} sees"),
    ("pairs.identity", "Topics {where} carry equal numbers unlike in normal runs"),
    ("pairs.*", "The numbers on {where} do not agree as in normal runs"),
    ("kinematics.gravity*", "The inertial unit {where} measures gravity wrongly"),
    ("kinematics.turn_*", "What {where} say of the robot's turning does not agree"),
    ("kinematics.travel_*", "What {where} say of the robot's travel does not agree"),
    ("kinematics.spin_*", "Angles and speeds of the joints of {where} do not agree"),
    ("transforms.*jump", "The pose of {where} jumps"),
    ("transforms.*", "Poses and transforms of {where} do not agree"),
    ("stamps.*latency", "Messages of {where} arrive later or earlier than usual"),
    ("stamps.*", "The times of messages of {where} are irregular"),
    ("contextual.total_turning", "The robot turned {value} in all; normal runs turn {usual}"),
    ("contextual.turning_per_metre", "The robot turned {value}; normal runs turn {usual}"),
    ("contextual.speed", "The robot moved at {value} on average; normal runs move at {usual}"),
    ("contextual.clearance", "The robot came within {value} of things; normal runs keep {usual}"),
    ("contextual.duration", "The robot had a goal for {value}; normal runs take {usual}"),
    ("contextual.goals_reached", "The robot reached {value} of its goals; usual is {usual}"),
    ("contextual.time_per_planned_metre", "The robot took {value} of plan; usual is {usual}"),
    ("contextual.range_variance_*", "The ranges of {where} are spread unlike those in normal runs"),
    ("contextual.non_finite_*", "{where} has another share of rays without a return"),
    ("navigation.recoveries", "The robot needed recoveries: {value}; normal runs have {usual}"),
    ("navigation.replans", "The robot planned anew {value}; normal runs do {usual}"),
    ("navigation.stalled", "The robot made no way for {value} of its time; usual is {usual}"),
    ("navigation.longest_stall", "The robot made no way for {value}; usual is {usual}"),
    ("navigation.driven_without_goal", "The robot drove {value} without a goal; usual is {usual}"),
    ("navigation.monitor_*", "The collision monitor changed {value} of commands; usual is {usual}"),
    ("navigation.position_*", "The robot is less or more certain of its position than usual"),
    ("navigation.yaw_*", "The robot is less or more certain of its heading than usual"),
    ("navigation.plan_*", "Plans are unlike those in normal runs"),
    ("navigation.p*", "The robot comes nearer to its goals at {value}; usual is {usual}"),
    ("navigation.command_*", "The velocity commands are unlike those in normal runs"),
    ("navigation.lethal_*", "Obstacles in the costmap come or go at {value}; usual is {usual}"),
    ("atc.*_residual", "Radar and ADS-B of an aircraft do not agree"),
    ("atc.report_*", "An aircraft reports {value}; usual is {usual}"),
    ("atc.appearances", "Aircraft appear inside the airspace: {value}; usual is {usual}"),
    ("atc.disappearances", "Aircraft vanish inside the airspace: {value}; usual is {usual}"),
    ("atc.*_only", "Aircraft have only one kind of report: {value}; usual is {usual}"),
    ("atc.nameless", "Aircraft have no address: {value}; usual is {usual}"),
    ("atc.closest_*", "Two aircraft come close: {value}; usual is {usual}"),
    ("atc.*_advisories", "Aircraft get advisories: {value}; usual is {usual}"),
    ("generic.gap_max", "{where} was silent for {value} of its periods; usual is {usual}"),
    ("generic.jitter_*", "Messages of {where} come at irregular times"),
    ("generic.silent_topics", "{value} of the topics are silent; usual is {usual}"),
    ("generic.message_rate", "Messages of all topics come at {value}; usual is {usual}"),
    ("generic.out_of_order_max", "Stamps of {where} go back"),
    ("traffic.*", "Messages take other ways between nodes than in normal runs"),
    ("structural*", "The graph of nodes and topics is not that of normal runs"),
)  # fmt: skip
_STATISTICS = {
    "std": "spread", "change": "change from message to message", "held": "time without a change",
    "missing": "share without a number",
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
    if verdict.contract and (verdict.outcome == "breach" or not verdict.evidence):
        return verdict.contract[0]
    if not verdict.evidence:
        return "Its features together are unlike those of normal runs; none of them alone is."
    told = sentence(clearest(verdict.evidence))
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
    value = f"{rounded(evidence.value, 3)}{unit}"
    usual = f"{rounded(evidence.usual_low, 3)} to {rounded(evidence.usual_high, 3)}{unit}"
    text = _text(evidence, value, usual)
    return f"{text}{_when(evidence)}."


def rounded(value: float, digits: int = 4) -> str:
    """Return a value with some digits; a rounding error around zero is 0.

    Examples
    --------
    >>> [rounded(value) for value in (0.0123456, 8.3e-18, -1e-16)]
    ['0.01235', '0', '0']
    """
    return f"{value:.{digits}g}" if abs(value) > _ROUNDING else "0"


def _when(evidence: Evidence) -> str:
    start_s, end_s = evidence.window_start_s, evidence.window_end_s
    if start_s is None:
        return ""
    if end_s is not None:
        return f", most of all from {start_s:g} s to {end_s:g} s"
    return f", most of all from {start_s:g} s on" if start_s else ", all the time"


def _text(evidence: Evidence, value: str, usual: str) -> str:
    feature, phrase = evidence.feature, _phrase(evidence.feature)
    if topic := topic_of_signal(feature):
        signal, _, statistic = feature.removeprefix(f"{SIGNALS}{topic}/").rpartition(".")
        words = _STATISTICS.get(statistic, statistic)
        return f"The {words} of {signal} on {topic} is {value}; normal runs have {usual}"
    a, _, b = (evidence.where or "").partition(_AGAINST)
    if not phrase:
        at = f" at {evidence.where}" if evidence.where else ""
        return f"Only a statistic is unusual: {feature}{at}: {value}, in normal runs {usual}"
    where = f"{a} and {b}" if b else a or "the recording"
    text = phrase.format(value=value, usual=usual, where=where)
    if _QUANTIFIED in phrase:
        return text
    name = feature.partition(".")[2].replace("_", " ")
    return f"{text}: {name} {value}, in normal runs {usual}"


def clearest(evidence: Sequence[Evidence]) -> Evidence:
    """Return the farthest feature that has a phrase, unless another is much farther."""
    farthest = abs(evidence[0].z)
    clear = (e for e in evidence if _is_clear(e.feature) and abs(e.z) >= _CLEAR * farthest)
    return next(clear, evidence[0])


def _is_clear(feature: str) -> bool:
    return bool(_phrase(feature) or topic_of_signal(feature))


def _phrase(feature: str) -> str:
    phrases = (phrase for glob, phrase in _PHRASES if fnmatchcase(feature, glob))
    return next(phrases, "")
