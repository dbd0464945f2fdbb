"""Verdicts on recordings, by the scorer of a reference card.

A verdict has the breaches of the contract of the system, which need no statistics, the p-value
among the normal runs, and the features outside their usual range.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.datasets import MISSING
from oracle_pipeline.detectors import by_family
from oracle_pipeline.features import FeatureManager, FeatureTables
from oracle_pipeline.features.signals.collector import CUT
from oracle_pipeline.logs.formats import recordings_at
from oracle_pipeline.robots.known import Known
from oracle_pipeline.robots.roles_file import RoleChoices
from oracle_pipeline.scoring import isolation
from oracle_pipeline.scoring.alarms import RATE_PER_H, Alarm, AlarmRule, AlarmWatch
from oracle_pipeline.scoring.blocks import PER_SEED
from oracle_pipeline.scoring.card import ReferenceCard
from oracle_pipeline.scoring.comparable import (
    given_numbers,
    lacking_numbers,
    same_recording,
    shared_features,
)
from oracle_pipeline.scoring.conformal import adjusted_for_suite, runs_needed
from oracle_pipeline.scoring.contract import Observation
from oracle_pipeline.scoring.cross_conformal import CrossConformalScorer
from oracle_pipeline.scoring.evidence import (
    farthest_features,
    ranked_deviations,
    usual_ranges,
    window_series,
)
from oracle_pipeline.scoring.lengths import comparable_tables, is_outside
from oracle_pipeline.scoring.likeness import LEAST, likeness
from oracle_pipeline.scoring.measured_runs import MeasuredRuns
from oracle_pipeline.scoring.verdict import (
    AspectScore,
    CardOrigin,
    Judgement,
    ScoringError,
    Verdict,
)
from oracle_pipeline.windows import WINDOW_S

NO_BLOCK = int(np.iinfo(np.int64).min)  # of a recording that the card was not learned from
_OF_ALL_TOPICS = "generic."  # prefix of features that sum or compare all topics
_LACKS_TOPICS = "topics of the reference are not recorded"


class Recording(NamedTuple):
    """A recording whose features are known."""

    name: str
    tables: FeatureTables
    seen: Observation | None  # its interfaces; without them, the contract is not compared


class CardSource(Protocol):
    """A reference card, or an object that learns a card for each kind of system."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on the reference, for readers of the verdicts."""

    @property
    def roles(self) -> RoleChoices | None:
        """Robots and topics from the roles file of the normal runs; None without one."""

    @property
    def known(self) -> Known | None:
        """Topics of the normal runs, and their roles; None if only their features are known."""

    @property
    def origin(self) -> CardOrigin | None:
        """Of the file of the card; None if there is none."""

    def card_for(self, row: pd.DataFrame) -> ReferenceCard:
        """Return the card to judge a recording by, given its run features."""


def score(
    recordings: Sequence[Path], reference: CardSource, manager: FeatureManager, far: float,
    limits: isolation.Limits = isolation.DEFAULT_LIMITS, *, strict: bool = False,
    choices: RoleChoices | None = None, hold_to_contract: bool = True, together: bool = False,
    check: isolation.Check | None = None,
) -> list[Verdict]:  # fmt: skip
    """Judge recordings by comparison with normal runs, each by itself.

    A recording that cannot be judged gets a verdict with the reason, and the others are still
    judged. Each robot of a recording gets its own verdict.

    Parameters
    ----------
    recordings : sequence of Path
        Run directories or bags, or folders of these.
    reference : CardSource
    manager : FeatureManager
        The plugins to compute the features with.
    far : float
        False positive rate, in (0, 1).
    limits : Limits
        Limits of the process that computes the features of one recording.
    strict : bool
        Whether an incomplete recording is an error.
    choices : RoleChoices, optional
        Content of a roles file; by default, that of the reference.
    hold_to_contract : bool
        Whether to compare each recording with the contract of the reference too.
    together : bool
        Whether `far` is the share of normal recordings among those called anomalous, over all
        recordings (Benjamini-Hochberg), instead of the rate for each.
    check : callable, optional
        Looks for faults that need no reference; they are notes of the verdicts.
    """
    known = reference.known
    if choices is None and reference.roles is not None:
        choices = reference.roles if known is None else replace(reference.roles, topics={})
    reading = isolation.Reading(strict, choices, known, check=check)
    paths = recordings_at(recordings)
    verdicts: list[Verdict] = []
    for path, robots in isolation.extract_each(paths, manager, limits, reading):
        if isinstance(robots, Exception):
            verdicts.append(Verdict(str(path), "error", error=str(robots)))
        else:
            verdicts += [_judge_robot(each, reference) for each in robots]
    if not hold_to_contract:
        verdicts = [replace(each, contract=()) for each in verdicts]
    verdicts = [replace(each, card=reference.origin) for each in verdicts]
    return decide_suite(verdicts, far) if together else [decided(each, far) for each in verdicts]


def decided(verdict: Verdict, far: float) -> Verdict:
    """Return a verdict on a recording that is judged by itself, with its outcome."""
    return verdict if verdict.p_value is None else _in_suite(verdict, verdict.p_value, 1, far)


def decide_suite(verdicts: Sequence[Verdict], far: float) -> list[Verdict]:
    """Adjust the p-values of verdicts that are judged together, and set the outcomes.

    With few normal runs, the correction can make it impossible for a single recording to be
    anomalous. Then a recording that is not anomalous is unsupported, not normal.
    """
    verdicts = _aspects_in_suite(verdicts)
    scored = [verdict for verdict in verdicts if verdict.p_value is not None]
    p = np.array([verdict.p_value for verdict in scored], dtype=np.float64)
    adjusted = iter(adjusted_for_suite(p).tolist() if len(p) else [])
    return [
        verdict if verdict.p_value is None else _in_suite(verdict, next(adjusted), len(scored), far)
        for verdict in verdicts
    ]


def _aspects_in_suite(verdicts: Sequence[Verdict]) -> list[Verdict]:
    """Adjust the p-values of each aspect for the recordings that are judged together."""
    corrected = list(verdicts)
    for name in dict.fromkeys(name for verdict in verdicts for name in verdict.aspects):
        places = [n for n, verdict in enumerate(verdicts) if name in verdict.aspects]
        p = np.array([verdicts[n].aspects[name].p_value for n in places])
        for n, adjusted in zip(places, adjusted_for_suite(p).tolist(), strict=True):
            aspect = replace(corrected[n].aspects[name], suite_p_value=adjusted)
            corrected[n] = replace(corrected[n], aspects={**corrected[n].aspects, name: aspect})
    return corrected


def _in_suite(verdict: Verdict, p: float, size: int, far: float) -> Verdict:
    lowest = size / (verdict.normal_blocks + 1.0)  # adjusted p-value if only one is anomalous
    if p <= far:
        return replace(verdict, suite_p_value=p, outcome="anomalous")
    if lowest <= far:
        outcome: Judgement = "breach" if verdict.contract else "normal"
        return replace(verdict, suite_p_value=p, outcome=outcome)
    return replace(
        verdict,
        suite_p_value=p,
        outcome="unsupported",
        notes=(*verdict.notes, _unsupported(verdict.normal_blocks, size, far)),
    )


def _unsupported(blocks: int, size: int, far: float) -> str:
    needed = math.ceil(size / far) - 1 if size > 1 else runs_needed(far)
    alone = (
        f"{blocks} normal recordings cannot support a false positive rate of {far:.3g}"
        + (f" for {size} recordings judged together" if size > 1 else "")
        + f": no {'single ' if size > 1 else ''}recording could be called anomalous. "
        f"{needed} are needed, {needed - blocks} more; or allow a higher rate with --far."
    )
    return alone + (" Or judge each by itself, without --suite." if size > 1 else "")


def _judge_robot(extracted: isolation.Extracted, reference: CardSource) -> Verdict:
    recording, tables, seen, origin, faults = extracted
    tables = tables._replace(run=tables.run.assign(seed=str(origin.seed)))
    try:
        verdict = _scored(recording, tables, reference.card_for(tables.run), seen)
        notes = [note for note in tables.notes if note not in seen.losses]
        return replace(
            verdict,
            notes=(*faults, *notes, *verdict.notes),
            cautions=(*seen.losses, *verdict.cautions),
        )
    except (OracleError, OSError) as error:
        cautions = _moved(seen, reference.known)
        return Verdict(recording, "error", error=str(error), cautions=cautions)
    except Exception as error:  # a defect of ours costs this verdict, not the others
        told = f"{recording} cannot be judged: {type(error).__name__}: {error}. Please report it."
        return Verdict(recording, "error", error=told)


def judge(
    recording: str,
    tables: FeatureTables,
    card: ReferenceCard,
    far: float,
    seen: Observation | None = None,
) -> Verdict:
    """Judge one recording on its own, from its features.

    Raises
    ------
    OracleError
        The recording shares no feature with the card, has one in another unit, or is too short.
    """
    return decided(replace(_scored(recording, tables, card, seen), card=card.origin), far)


def judge_all(recordings: Sequence[Recording], card: ReferenceCard, far: float) -> list[Verdict]:
    """Judge recordings at once, as `judge` does each of them, but without evidence."""
    return [decided(verdict, far) for verdict, _ in _without_evidence(recordings, card)]


@np.errstate(all="ignore")  # features may be as large as numbers can be
def _scored(
    recording: str, tables: FeatureTables, card: ReferenceCard, seen: Observation | None
) -> Verdict:
    """Return score, p-value and evidence of one recording, without an outcome."""
    ((verdict, tables),) = _without_evidence([Recording(recording, tables, seen)], card)
    if verdict.outcome == "another system":
        return verdict
    design = card.scorer.design
    columns: list[str] = []
    signals = [column for column in design.run_signals if column in tables.run.columns]
    if design.uses_features:
        columns, notes = shared_features(tables.run, card.runs, design.run_features)
        if is_outside(len(tables.windows), card.scorer.lengths):
            signals = []  # they do not count for a recording of another length
    else:
        _, notes = shared_features(tables.run, card.runs, design.run_signals)
    block = _known_block(tables.run, card)
    if block != NO_BLOCK:
        notes.append("Its block is part of the reference: all runs of that block are left out.")
    others = card.runs[card.runs["block"] != block]
    usual = usual_ranges(others, columns, signals, design.floors)
    deviations = ranked_deviations(usual, tables.run)
    normal = card.scorer.scorers_[0].normal_in_windows
    evidence = farthest_features(deviations, tables, normal)
    return replace(
        verdict,
        features=len(columns or signals),
        evidence=evidence,
        series=window_series(evidence, tables.windows, normal),
        families=tuple(by_family(deviations, [*columns, *signals])),
        notes=(*verdict.notes, *notes),
    )


def _without_evidence(
    recordings: Sequence[Recording], card: ReferenceCard
) -> list[tuple[Verdict, FeatureTables]]:
    """Return a verdict on each recording, without outcome and evidence, and what is compared.

    A recording of one of the card's blocks (same start, goals and nuisance) is scored by the scorer
    that was not fitted on the block, and the block has no vote. So a run of a campaign gets the
    same verdict as in the evaluation.
    """
    usual = given_numbers(card.runs)
    found = [_compared(each, card, usual) for each in recordings]
    alike = [n for n, (verdict, _) in enumerate(found) if verdict.outcome != "another system"]
    if not alike:
        return found
    measured = _joined([_measured(found[n][1], card) for n in alike])
    block = np.array([_known_block(found[n][1].run, card) for n in alike])
    headline = _aspect_scores(card.scorer, measured, block)
    aspects = {name: _aspect_scores(of, measured, block) for name, of in card.aspects.items()}
    alarms = _alarms(card.scorer, measured, block)
    for row, n in enumerate(alike):
        verdict, tables = found[n]
        verdict = replace(
            verdict,
            p_value=headline[row].p_value,
            suite_p_value=headline[row].p_value,
            score=headline[row].score,
            aspects={name: scores[row] for name, scores in aspects.items()},
            alarms=alarms[row][0],
            alarms_per_h=alarms[row][1],
            normal_runs=int((card.runs["block"] != block[row]).sum()),
            normal_blocks=int((np.unique(card.scorer.block_) != block[row]).sum()),
        )
        found[n] = verdict, tables
    return found


def _compared(
    recording: Recording, card: ReferenceCard, usual: pd.DataFrame
) -> tuple[Verdict, FeatureTables]:
    """Return what is known without statistics, and the features that can be compared."""
    name, tables, seen = recording
    cautions = _moved(seen, card.known)
    if card.contract is not None and seen is not None and seen.topics:
        share, differences = likeness(card.contract, seen, card.runs.columns, tables.run.columns)
        if share < LEAST:
            unlike = Verdict(
                name, "another system", cautions=cautions, in_common=share, differences=differences
            )
            return unlike, tables
        if any(t.always and name not in seen.topics for name, t in card.contract.topics.items()):
            tables = _without_rates(tables)
    breaches, notes = _lines_of_contract(card, seen, tables, usual)
    tables, of_length = comparable_tables(tables, card.scorer.lengths)
    verdict = Verdict(
        name,
        "unsupported",  # until `decide_suite` sets the outcome
        contract=breaches,
        notes=notes,
        cautions=(*cautions, *of_length),
    )
    return verdict, tables


def _moved(seen: Observation | None, known: Known | None) -> tuple[str, ...]:
    """Return what to do if topics of the recording may play roles of other topics."""
    if seen is None or known is None or not seen.instead:
        return ()
    moved = "; ".join(
        f"{role} (in the reference {', '.join(known.roles[role])}; here perhaps {', '.join(names)})"
        for role, names in seen.instead.items()
    )
    file = json.dumps(RoleChoices(topics=seen.instead).document())
    return (
        f"Not compared, because their topics have other names: {moved}. If they are the same, put "
        f"this line into a file and name it with --roles: {file}",
    )


def _without_rates(tables: FeatureTables) -> FeatureTables:
    """Return tables without the features of all topics, as the recording lacks some of them."""
    rates = [column for column in tables.run.columns if column.startswith(_OF_ALL_TOPICS)]
    reasons = json.loads(tables.run[MISSING].iloc[0]) | dict.fromkeys(rates, _LACKS_TOPICS)
    of_windows = [column for column in rates if column in tables.windows.columns]
    return FeatureTables(
        tables.run.assign(**dict.fromkeys(rates, np.nan), **{MISSING: json.dumps(reasons)}),
        tables.windows.assign(**dict.fromkeys(of_windows, np.nan)),
    )


def _aspect_scores(
    scorer: CrossConformalScorer, measured: MeasuredRuns, block: NDArray[np.int64]
) -> list[AspectScore]:
    """Return p-value and score of each recording."""
    scores = scorer.scores(measured)
    p, own = scorer.p_values(scores, block), scorer.own_score(scores, block)
    return [AspectScore(*each) for each in zip(p.tolist(), p.tolist(), own.tolist(), strict=True)]


def _alarms(
    scorer: CrossConformalScorer, measured: MeasuredRuns, block: NDArray[np.int64]
) -> list[tuple[tuple[Alarm, ...], float | None]]:
    """Return the alarms of each recording, and the promised rate of false alarms per hour."""
    if scorer.windows_ is None:
        return [((), None)] * len(block)
    scores = scorer.window_scores(measured.windows, block[measured.run])
    families = scorer.window_families(measured.windows)
    ends_s = measured.start_s + WINDOW_S
    rules: dict[int, AlarmRule] = {}
    raised: list[tuple[tuple[Alarm, ...], float | None]] = []
    for row, own in enumerate(block.tolist()):
        if own not in rules:
            normal = scorer.windows_ if own == NO_BLOCK else scorer.windows_.without(own)
            rules[own] = normal.rule(max(RATE_PER_H, normal.lowest_rate()))
        watch = AlarmWatch(rules[own])
        fed = ((ends_s[n], scores[n], families[n]) for n in np.flatnonzero(measured.run == row))
        alarms = (watch.feed(float(end), float(score), by) for end, score, by in fed)
        raised.append((tuple(filter(None, alarms)), rules[own].per_hour))
    return raised


def _lines_of_contract(
    card: ReferenceCard, seen: Observation | None, tables: FeatureTables, usual: pd.DataFrame
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the breaches of the contract, and the notes on it."""
    if card.contract is None or seen is None:
        return (), ()
    if is_outside(len(tables.windows), card.scorer.lengths):
        seen = replace(seen, repeats={})  # a longer one repeats more
    is_cut = any(note.startswith(CUT) for note in tables.notes)
    lacking = {} if is_cut else lacking_numbers(given_numbers(tables.run), usual)
    found = card.contract.breaches(seen, lacking)
    return (
        tuple(each.text for each in found if each.severity == "breach"),
        tuple(each.text for each in found if each.severity == "note"),
    )


def _measured(tables: FeatureTables, card: ReferenceCard) -> MeasuredRuns:
    """Return the recording with the card's columns; absent ones are missing values."""
    design = card.scorer.design
    if design.window_features and tables.windows.empty:
        raise ScoringError("The recording is too short to judge: it has no window of 5 s.")
    run = tables.run.reindex(columns=["block", *design.run_columns])
    windows = tables.windows.reindex(columns=["window_start_s", *design.window_columns])
    if windows.empty:
        windows = pd.DataFrame({"window_start_s": [0.0]})
    return MeasuredRuns(run, windows, np.zeros(len(windows), dtype=np.intp))


def _joined(recordings: Sequence[MeasuredRuns]) -> MeasuredRuns:
    """Return recordings of the same columns as the runs of one table."""
    return MeasuredRuns(
        pd.concat([each.features for each in recordings], ignore_index=True),
        pd.concat([each.windows for each in recordings], ignore_index=True),
        np.repeat(np.arange(len(recordings)), [len(each.run) for each in recordings]),
    )


def _known_block(row: pd.DataFrame, card: ReferenceCard) -> int:
    """Return the block of the recording if the card was learned from it, else `NO_BLOCK`."""
    (identical,) = np.nonzero(same_recording(card.runs, row))
    if len(identical):
        return int(card.runs["block"].iloc[identical[0]])
    if row["label"].iloc[0] == "unknown":
        return NO_BLOCK
    same = card.runs["world"].eq(row["world"].iloc[0])
    same &= card.runs["block"].mod(PER_SEED).eq(row["block"].iloc[0])
    if "seed" in card.runs and "seed" in row:  # tables of a campaign have none
        same &= card.runs["seed"].eq(row["seed"].iloc[0])
    return int(card.runs.loc[same, "block"].iloc[0]) if same.any() else NO_BLOCK
