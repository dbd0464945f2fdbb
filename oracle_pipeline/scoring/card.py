"""The reference card: everything that scoring needs, learned once and kept in one file.

A card is a ZIP of JSON and Parquet: ``card.json`` describes the content, ``runs.parquet`` has the
features of the normal recordings, ``models.parquet`` the fitted scorers, ``windows.parquet`` the
scores of the normal windows. Reading a card executes nothing in it, and the checksums of the ZIP
reveal damage. A card is read in a process with limits on time and memory, and all its parts are
checked there, since it may come from any source. A detector that a user named is not in the file:
it is fitted again.
"""

import hashlib
import io
import json
import zipfile
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from sklearn.pipeline import Pipeline

from oracle_pipeline.bags.errors import BagError, OracleError, one_line, refuse_pointer
from oracle_pipeline.bags.json_schema import faults
from oracle_pipeline.clustering.scaling import FlooredRobustScaler
from oracle_pipeline.datasets import check_runs, is_malicious, parse_table, replacing, table_bytes
from oracle_pipeline.detectors import (
    BeyondRange,
    LargestGroup,
    Mahalanobis,
    SignalScaler,
    named_detector,
)
from oracle_pipeline.robots.known import Known
from oracle_pipeline.robots.roles_file import RoleChoices
from oracle_pipeline.scoring.alarms import NormalWindows
from oracle_pipeline.scoring.card_check import check_scorer
from oracle_pipeline.scoring.contract import Contract
from oracle_pipeline.scoring.contract_file import card_schema
from oracle_pipeline.scoring.cross_conformal import SEED, CrossConformalScorer
from oracle_pipeline.scoring.isolation import Limits, run_isolated
from oracle_pipeline.scoring.measured_runs import MeasuredRuns
from oracle_pipeline.scoring.run_scorer import BEYOND, Design, RunScorer
from oracle_pipeline.scoring.verdict import CardOrigin

VERSION = 10  # of the card format and of the windowing it was learned with
SUFFIX = ".card"
_FACTS, _RUNS, _MODELS = "card.json", "runs.parquet", "models.parquet"
_WINDOWS = "windows.parquet"
_HEADLINE = "all"  # the scorer that makes the verdict
_OfScorers: TypeAlias = dict[str, list[dict[str, Any]]]  # rows of a table, by scorer
_OF_WINDOWS = pa.schema(
    {"scorer": pa.string(), **dict.fromkeys(("scores", "start_s"), pa.list_(pa.float64()))}
)
_OF_DETECTORS = {
    "precision": pa.list_(pa.float32()),
    "constant": pa.list_(pa.bool_()),
    "groups": pa.list_(pa.string()),
    "components": pa.list_(pa.float32()),
    "variances": pa.list_(pa.list_(pa.float64())),
    **dict.fromkeys(("noise", "typical", "location", "low", "high"), pa.list_(pa.float64())),
}
_OF_MODELS = pa.schema(
    {
        "scorer": pa.string(),
        "fold": pa.int64(),
        "level": pa.string(),
        **_OF_DETECTORS,
        **dict.fromkeys(("kept", "indicated"), pa.list_(pa.string())),
        **dict.fromkeys(("center", "scale", "reach"), pa.list_(pa.float64())),
    }
)
_EPOCH = (1980, 1, 1, 0, 0, 0)  # fixed, so that the same card gives the same bytes
_LARGEST_FACTS, _LARGEST = 1 << 24, 1 << 28  # bytes; a card of 840 runs has 40 MB
_MOST_VALUES = 32_000_000  # of a table; one of a card of 840 runs has 5 million
_LIMITS = Limits(120.0, 2.0, "it is broken or hostile; create it again with `oracle learn`")


class CardError(OracleError):
    """A file is not a reference card, or was written by another release."""


@dataclass(frozen=True, eq=False, slots=True)
class ReferenceCard:
    """A scorer and the normal recordings that it was learned from.

    Attributes
    ----------
    scorer : CrossConformalScorer
    runs : DataFrame
        Features of the normal recordings, one row each.
    contract : Contract or None
        Topics and graphs of the recordings; None if the card was learned from tables.
    notes : tuple of str
        Remarks for readers of a verdict, such as which recordings were left out.
    aspects : mapping of str to CrossConformalScorer
        Scorers of ``tampering`` and ``misbehaviour``, if the recordings have such features.
    roles : RoleChoices or None
        Robots and topics that a roles file named; None without one.
    breaching : int or None
        Number of recordings that break the contract of the others; None without a contract.
    origin : CardOrigin
        Of the file, if it was loaded from one.
    """

    scorer: CrossConformalScorer
    runs: pd.DataFrame
    contract: Contract | None = None
    notes: tuple[str, ...] = ()
    aspects: Mapping[str, CrossConformalScorer] = field(default_factory=dict)
    roles: RoleChoices | None = None
    breaching: int | None = None
    origin: CardOrigin = field(default_factory=CardOrigin)

    def save(self, path: str | Path) -> None:
        """Write the card atomically."""
        scorers = {_HEADLINE: self.scorer, **self.aspects}
        members = {
            _RUNS: table_bytes(self.runs),
            _MODELS: _parquet(_models(scorers), _OF_MODELS),
            _WINDOWS: _parquet(_windows(scorers), _OF_WINDOWS),
        }
        facts = {
            "version": VERSION,
            "floors": dict(self.scorer.design.floors),
            "scorers": {name: _described(scorer) for name, scorer in scorers.items()},
            "contract": None if self.contract is None else self.contract.to_dict(),
            "notes": list(self.notes),
            "roles": None if self.roles is None else self.roles.document(),
            "breaching": self.breaching,
            "release": self.origin.release,
            "learned": self.origin.learned,
        }
        members = {_FACTS: json.dumps(facts, indent=1, allow_nan=False).encode(), **members}
        with replacing(Path(path)) as sink, zipfile.ZipFile(sink, "w") as archive:
            for name, data in members.items():
                archive.writestr(zipfile.ZipInfo(name, _EPOCH), data)

    @classmethod
    def load(cls, path: str | Path) -> "ReferenceCard":
        """Read a card in another process, and check it.

        Raises
        ------
        CardError
            The file is missing, damaged, or from another release, its parts do not fit, or reading
            it takes too much time or memory.
        """
        if not Path(path).is_file():
            raise CardError(f"There is no reference card {path}; create one with `oracle learn`.")
        try:
            return run_isolated(checked_card, Path(path), _LIMITS)
        except OracleError as error:
            raise CardError(str(error)) from error

    @property
    def known(self) -> Known | None:
        """Topics of the recordings, and their roles; None without a contract."""
        return None if self.contract is None else self.contract.known

    def by_detector(self, name: str) -> "ReferenceCard":
        """Return this card if its detector has a name; any has the empty one.

        Raises
        ------
        CardError
            It was learned with another detector.
        """
        own = self.scorer.design.named
        if name not in ("", own):
            raise CardError(
                f"The card was learned {f'with the detector {own}' if own else 'without a name'}, "
                f"not with {name}; use `oracle learn --detector {name}`."
            )
        return self

    def card_for(self, _row: pd.DataFrame) -> "ReferenceCard":
        """Return this card: it covers one kind of system only."""
        return self


def is_card(path: Path) -> bool:
    """Return whether the suffix of a path is that of a reference card."""
    return path.suffix == SUFFIX


def checked_card(path: Path) -> ReferenceCard:
    """Return the card in a file, read and checked in this process; errors as `load`."""
    try:
        refuse_pointer(path)
        card = _card(*_read(path))
        check_runs(card.runs)
        if is_malicious(card.runs).any():
            raise ValueError("it has an attacked recording")
        for name, scorer in {_HEADLINE: card.scorer, **card.aspects}.items():
            try:
                check_scorer(scorer, card.runs)
            except ValueError as error:
                raise ValueError(f"scorer {name}: {error}") from error
    except (BagError, CardError, MemoryError):
        raise
    except Exception as error:  # whatever fails, the file is at fault
        lacks = "it lacks " if isinstance(error, KeyError) else ""
        raise CardError(
            f"{path} is not a reference card, or is damaged: {lacks}{one_line(error)}. Create it "
            "again with `oracle learn`."
        ) from error
    return card


def _card(
    facts: Mapping[str, Any], runs: pd.DataFrame, models: _OfScorers, windows: _OfScorers
) -> ReferenceCard:
    """Return the card from the content of its file."""
    contract, roles = facts["contract"], facts["roles"]
    scorers = {
        name: _scorer(described, facts["floors"], models[name], windows[name], runs)
        for name, described in facts["scorers"].items()
    }
    return ReferenceCard(
        scorers.pop(_HEADLINE),
        runs,
        None if contract is None else Contract.from_dict(contract),
        tuple(facts["notes"]),
        scorers,
        None if roles is None else RoleChoices.of(roles),
        facts["breaching"],
        CardOrigin(facts["sha256"], facts.get("release", ""), facts.get("learned", "")),
    )


def _read(path: Path) -> tuple[dict[str, Any], pd.DataFrame, _OfScorers, _OfScorers]:
    with path.open("rb") as source:
        digest = hashlib.file_digest(source, "sha256").hexdigest()
    with path.open("rb") as source, zipfile.ZipFile(source) as archive:
        facts = json.loads(_member(archive, _FACTS, _LARGEST_FACTS))
        if facts["version"] != VERSION:
            raise CardError(
                f"{path} is a card of version {facts['version']}, but this release reads version "
                f"{VERSION}; create it again with `oracle learn`."
            )
        if found := faults(facts, card_schema()):
            raise ValueError(f"{_FACTS}, {found[0].json_path}: {found[0].message}")
        runs, models, windows = (_table(archive, name) for name in (_RUNS, _MODELS, _WINDOWS))
    table = parse_table(runs, f"{path}/{_RUNS}")
    return facts | {"sha256": digest}, table, _rows(models, _OF_MODELS), _rows(windows, _OF_WINDOWS)


def _member(archive: zipfile.ZipFile, name: str, largest: int) -> bytes:
    """Return the content of a member; what it claims to be is checked before it is unpacked."""
    member = archive.getinfo(name)
    if member.compress_type != zipfile.ZIP_STORED or member.file_size > largest:
        raise ValueError(f"{name} is compressed, or has more than {largest} bytes")
    return archive.read(member)


def _table(archive: zipfile.ZipFile, name: str) -> bytes:
    """Return a Parquet file; what it claims to hold is checked before it is decoded."""
    content = _member(archive, name, _LARGEST)
    claimed = pq.read_metadata(pa.BufferReader(content))
    groups = [claimed.row_group(number) for number in range(claimed.num_row_groups)]
    values = sum(group.column(j).num_values for group in groups for j in range(group.num_columns))
    size = sum(group.total_byte_size for group in groups)
    if max(values, claimed.num_rows) > _MOST_VALUES or size > _LARGEST:
        raise ValueError(f"{name} claims {values} values in {size} bytes, more than any card has")
    return content


def _parquet(rows: list[dict[str, Any]], schema: pa.Schema) -> bytes:
    sink, table = io.BytesIO(), pa.Table.from_pylist(rows, schema)
    pq.write_table(table, sink, compression="zstd", use_dictionary=False)
    return sink.getvalue()


def _rows(content: bytes, schema: pa.Schema) -> _OfScorers:
    """Return the rows of a Parquet table, grouped by scorer."""
    rows: _OfScorers = defaultdict(list)
    table = pq.read_table(pa.BufferReader(content)).select(schema.names).cast(schema)
    columns = [[_value(each) for each in column] for column in table.columns]
    for row in zip(*columns, strict=True):
        named = dict(zip(schema.names, row, strict=True))
        rows[named.pop("scorer")].append(named)
    return rows


def _value(scalar: pa.Scalar) -> Any:
    """Return a value of a table; numbers of a list as an array."""
    if pa.types.is_list(scalar.type) and pa.types.is_floating(scalar.type.value_type):
        return None if scalar.values is None else scalar.values.to_numpy(zero_copy_only=False)
    return scalar.as_py()


def _described(scorer: CrossConformalScorer) -> dict[str, Any]:
    return {
        "detector": scorer.design.named,
        "run_features": list(scorer.design.run_features),
        "window_features": list(scorer.design.window_features),
        "run_signals": list(scorer.design.run_signals),
        "window_signals": list(scorer.design.window_signals),
        "levels": list(scorer.levels_),
        "fold": scorer.fold_.tolist(),
        "block": scorer.block_.tolist(),
        "held_out": scorer.held_out_.tolist(),
        "centre": scorer.centre_.tolist(),
        "spread": scorer.spread_.tolist(),
        "windows_counted": [of_fold.windows_counted_ for of_fold in scorer.scorers_],
    }


def _models(scorers: Mapping[str, CrossConformalScorer]) -> list[dict[str, Any]]:
    """Return the fitted scalers and detectors, one row per scorer, fold and level."""
    return [
        {
            "scorer": name,
            "fold": fold,
            "level": level,
            **_state(model),
            "reach": of_fold.reach_.get(level),
        }
        for name, scorer in scorers.items()
        if not scorer.design.named
        for fold, of_fold in enumerate(scorer.scorers_)
        for level, model in of_fold.models_.items()
    ]


def _windows(scorers: Mapping[str, CrossConformalScorer]) -> list[dict[str, Any]]:
    """Return the held-out scores of the normal windows, one row per scorer and recording."""
    return [
        {"scorer": name, "scores": windows.scores[rows], "start_s": windows.start_s[rows]}
        for name, scorer in scorers.items()
        if (windows := scorer.windows_) is not None
        for rows in (windows.run == run for run in range(len(windows.block)))
    ]


def _state(model: Pipeline) -> dict[str, Any]:
    scaler, detector = model[0], model[1]
    state = dict.fromkeys(_OF_DETECTORS) | {
        "kept": scaler.kept_,
        "indicated": scaler.indicated_,
        "center": scaler.center_,
        "scale": scaler.scale_,
    }
    if isinstance(scaler, SignalScaler):
        state |= {"constant": scaler.is_constant_}
    if isinstance(detector, BeyondRange):
        return state | {"low": detector.low_, "high": detector.high_}
    state |= {"location": detector.location_}
    if isinstance(detector, LargestGroup):
        return state | {
            "groups": detector.groups,
            "components": np.concatenate([c.ravel() for c in detector.components_], dtype="f4"),
            "variances": [variances.tolist() for variances in detector.variances_],
            "noise": detector.noise_,
            "typical": detector.typical_,
        }
    precision = detector.precision_
    # The matrix is symmetric, and single precision is enough.
    return state | {"precision": precision[np.triu_indices(len(precision))].astype(np.float32)}


def _restored(state: Mapping[str, Any], floors: Mapping[str, float]) -> Pipeline:
    """Return the fitted scaler and detector from the values of `_state`."""
    is_of_signals = state["constant"] is not None
    detector = _restored_detector(state)
    scaler = SignalScaler(floors) if is_of_signals else FlooredRobustScaler(floors)
    if isinstance(scaler, SignalScaler):
        scaler.is_constant_ = np.array(state["constant"], dtype=np.bool_)
    scaler.kept_, scaler.indicated_ = list(state["kept"]), list(state["indicated"])
    scaler.center_, scaler.scale_ = np.array(state["center"]), np.array(state["scale"])
    return Pipeline([("scaler", scaler), ("detector", detector)])


def _restored_detector(state: Mapping[str, Any]) -> BeyondRange | LargestGroup | Mahalanobis:
    if state["low"] is not None and state["level"] in BEYOND:
        of_range = BeyondRange(BEYOND[state["level"]])
        of_range.low_, of_range.high_ = np.array(state["low"]), np.array(state["high"])
        of_range.n_features_in_ = len(of_range.low_)
        return of_range
    is_matrix = state["precision"] is not None
    detector = _restored_matrix(state) if is_matrix else _restored_groups(state)
    detector.location_ = np.array(state["location"])
    detector.n_features_in_ = len(detector.location_)
    return detector


def _restored_matrix(state: Mapping[str, Any]) -> Mahalanobis:
    detector = Mahalanobis()
    n_features = len(state["location"])
    if len(state["precision"]) != n_features * (n_features + 1) // 2:
        raise ValueError("precision does not fit location")
    upper = np.zeros((n_features, n_features))
    upper[np.triu_indices(n_features)] = state["precision"]
    detector.precision_ = upper + np.triu(upper, 1).T
    return detector


def _restored_groups(state: Mapping[str, Any]) -> LargestGroup:
    detector = LargestGroup(state["groups"])
    detector.noise_, detector.typical_ = np.array(state["noise"]), np.array(state["typical"])
    detector.variances_ = [np.array(variances) for variances in state["variances"]]
    sizes = detector.sizes(len(state["location"]))
    flat, detector.components_ = np.array(state["components"], dtype=np.float64), []
    for size, variances in zip(sizes, detector.variances_, strict=True):
        own, flat = np.split(flat, [size * len(variances)])
        detector.components_.append(own.reshape(len(variances), size))
    return detector


def _scorer(
    described: Mapping[str, Any],
    floors: Mapping[str, float],
    models: list[dict[str, Any]],
    windows: list[dict[str, Any]],
    runs: pd.DataFrame,
) -> CrossConformalScorer:
    named = described["detector"]
    detector = named_detector(named, SEED) if named else Mahalanobis()
    run_features, window_features = described["run_features"], described["window_features"]
    scorer = CrossConformalScorer(
        Design(
            detector, tuple(run_features), tuple(window_features), floors,
            tuple(described["run_signals"]), tuple(described["window_signals"]),
            tuple(described["levels"]), named,
        )
    )  # fmt: skip
    scorer.levels_ = tuple(described["levels"])
    scorer.fold_ = np.array(described["fold"], dtype=np.intp)
    scorer.block_ = np.array(described["block"], dtype=np.int64)
    scorer.held_out_ = np.array(described["held_out"])
    scorer.centre_, scorer.spread_ = (np.array(described[n]) for n in ("centre", "spread"))
    scorer.scorers_ = []
    for fold, counted in enumerate(described["windows_counted"]):
        of_fold = RunScorer(scorer.design)
        of_fold.windows_counted_ = counted
        states = {state["level"]: state for state in models if state["fold"] == fold}
        of_fold.models_ = {level: _restored(state, floors) for level, state in states.items()}
        reaches = {level: state["reach"] for level, state in states.items()}
        of_fold.reach_ = {level: np.array(r) for level, r in reaches.items() if r is not None}
        if named:
            of_fold.fit(_whole(runs).where(scorer.fold_ != fold))
        scorer.scorers_.append(of_fold)
    scorer.windows_ = _normal_windows(windows, scorer.block_) if window_features else None
    return scorer


def _whole(runs: pd.DataFrame) -> MeasuredRuns:
    """Return the recordings of a card, without their windows."""
    windows = pd.DataFrame({"run_id": runs["run_id"], "window_start_s": 0.0})
    return MeasuredRuns.ordered(runs, windows)


def _normal_windows(rows: list[dict[str, Any]], block: NDArray[np.int64]) -> NormalWindows:
    run = np.repeat(np.arange(len(rows)), [len(row["scores"]) for row in rows])
    scores, start_s = (np.concatenate([row[of] for row in rows]) for of in ("scores", "start_s"))
    return NormalWindows(scores, start_s, run, block)
