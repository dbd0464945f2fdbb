"""The reference card: everything that scoring needs, learned once and kept in one file.

A card is a ZIP of JSON and Parquet: ``card.json`` says what it holds, ``runs.parquet`` has the
features of the normal recordings, ``models.parquet`` the fitted scorers. Nothing in it is executed
when it is read, and the checksums of the ZIP notice damage.
"""

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from sklearn.pipeline import Pipeline

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.datasets import parse_table, replacing, table_bytes
from oracle_pipeline.detectors import Mahalanobis, pipeline
from oracle_pipeline.scoring.contract import Contract
from oracle_pipeline.scoring.cross_conformal import CrossConformalScorer
from oracle_pipeline.scoring.run_scorer import Design, RunScorer

VERSION = 1
SUFFIX = ".card"
_FACTS, _RUNS, _MODELS = "card.json", "runs.parquet", "models.parquet"
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the same card gives the same bytes
_LARGEST = 1 << 30  # bytes of one member; a card of 840 runs has 40 MB


class CardError(OracleError):
    """A file is no reference card, or not one of this release."""


@dataclass(frozen=True, eq=False, slots=True)
class ReferenceCard:
    """A scorer and the normal recordings that it was learned from.

    Attributes
    ----------
    scorer : CrossConformalScorer
    runs : DataFrame
        Features of the normal recordings, a row each.
    contract : Contract or None
        Of the recordings' topics and graphs; None if the card was learned from tables.
    notes : tuple of str
        What a reader of a verdict should know, such as recordings that were left out.
    """

    scorer: CrossConformalScorer
    runs: pd.DataFrame
    contract: Contract | None = None
    notes: tuple[str, ...] = ()

    def save(self, path: Path) -> None:
        """Write the card; a reader sees all of it or the old one."""
        members = {_RUNS: table_bytes(self.runs), _MODELS: _models(self.scorer)}
        facts = {
            "version": VERSION,
            "design": _design(self.scorer.design),
            "calibration": _calibration(self.scorer),
            "contract": None if self.contract is None else self.contract.to_dict(),
            "notes": list(self.notes),
        }
        members = {_FACTS: json.dumps(facts, indent=1, allow_nan=False).encode(), **members}
        with replacing(path) as sink, zipfile.ZipFile(sink, "w") as archive:
            for name, data in members.items():
                archive.writestr(zipfile.ZipInfo(name, _EPOCH), data)

    @classmethod
    def load(cls, path: Path) -> "ReferenceCard":
        """Read a card.

        Raises
        ------
        CardError
            There is none, it is damaged, or it is of another release.
        """
        try:
            facts, runs, models = _read(path)
        except FileNotFoundError as error:
            raise CardError(
                f"There is no reference card {path}; make one with `oracle learn`."
            ) from error
        except (zipfile.BadZipFile, KeyError, ValueError, OSError) as error:
            raise CardError(
                f"{path} is no reference card, or is damaged ({error}); make it again with "
                "`oracle learn`."
            ) from error
        contract = facts["contract"]
        return cls(
            _scorer(facts, models),
            runs,
            None if contract is None else Contract.from_dict(contract),
            tuple(facts["notes"]),
        )

    def card_for(self, _row: pd.DataFrame) -> "ReferenceCard":
        """Return this card: it is for one kind of system."""
        return self


def is_card(path: Path) -> bool:
    """Tell whether a path names a reference card, by its suffix."""
    return path.suffix == SUFFIX


def _read(path: Path) -> tuple[dict[str, Any], pd.DataFrame, list[dict[str, Any]]]:
    with path.open("rb") as source, zipfile.ZipFile(source) as archive:
        facts = json.loads(_member(archive, _FACTS))
        if facts["version"] != VERSION:
            raise CardError(
                f"{path} is a card of version {facts['version']}, this release reads {VERSION}; "
                "make it again with `oracle learn`."
            )
        runs = parse_table(_member(archive, _RUNS), f"{path}/{_RUNS}")
        models = pq.read_table(io.BytesIO(_member(archive, _MODELS))).to_pylist()
    return facts, runs, models


def _member(archive: zipfile.ZipFile, name: str) -> bytes:
    if archive.getinfo(name).file_size > _LARGEST:
        raise ValueError(f"{name} claims {archive.getinfo(name).file_size} bytes")
    return archive.read(name)


def _design(design: Design) -> dict[str, Any]:
    return {
        "detector": "mahalanobis",
        "run_features": list(design.run_features),
        "window_features": list(design.window_features),
        "floors": dict(design.floors),
    }


def _calibration(scorer: CrossConformalScorer) -> dict[str, Any]:
    return {
        "fold": scorer.fold_.tolist(),
        "block": scorer.block_.tolist(),
        "held_out": scorer.held_out_.tolist(),
        "centre": scorer.centre_.tolist(),
        "spread": scorer.spread_.tolist(),
        "windows_counted": [of_fold.windows_counted_ for of_fold in scorer.scorers_],
    }


def _models(scorer: CrossConformalScorer) -> bytes:
    """Return the fitted scalers and detectors as a table, a row a fold and level."""
    rows = [
        {"fold": fold, "level": level, **_state(model)}
        for fold, of_fold in enumerate(scorer.scorers_)
        for level, model in of_fold.models_.items()
    ]
    sink = io.BytesIO()
    pq.write_table(pa.Table.from_pylist(rows), sink, compression="zstd")
    return sink.getvalue()


def _state(model: Pipeline) -> dict[str, Any]:
    scaler, detector = model[0], model[1]
    precision = detector.precision_
    return {
        "kept": scaler.kept_,
        "indicated": scaler.indicated_,
        "center": scaler.center_,
        "scale": scaler.scale_,
        "location": detector.location_,
        "precision": precision[np.triu_indices(len(precision))],  # symmetric
    }


def _restored(state: Mapping[str, Any], floors: Mapping[str, float]) -> Pipeline:
    """Return the fitted scaler and detector that `_state` described."""
    model = pipeline(Mahalanobis(), floors)
    scaler, detector = model[0], model[1]
    scaler.kept_, scaler.indicated_ = list(state["kept"]), list(state["indicated"])
    scaler.center_, scaler.scale_ = np.array(state["center"]), np.array(state["scale"])
    detector.location_ = np.array(state["location"])
    n_features = detector.n_features_in_ = len(detector.location_)
    upper = np.zeros((n_features, n_features))
    upper[np.triu_indices(n_features)] = state["precision"]
    detector.precision_ = upper + np.triu(upper, 1).T
    return model


def _scorer(facts: Mapping[str, Any], models: list[dict[str, Any]]) -> CrossConformalScorer:
    design, calibration = facts["design"], facts["calibration"]
    scorer = CrossConformalScorer(
        Design(
            Mahalanobis(),
            tuple(design["run_features"]),
            tuple(design["window_features"]),
            design["floors"],
        )
    )
    scorer.fold_ = np.array(calibration["fold"], dtype=np.intp)
    scorer.block_ = np.array(calibration["block"], dtype=np.int64)
    scorer.held_out_ = np.array(calibration["held_out"])
    scorer.centre_, scorer.spread_ = (np.array(calibration[n]) for n in ("centre", "spread"))
    scorer.scorers_ = []
    for fold, counted in enumerate(calibration["windows_counted"]):
        of_fold = RunScorer(scorer.design)
        of_fold.windows_counted_ = counted
        of_fold.models_ = {
            state["level"]: _restored(state, design["floors"])
            for state in models
            if state["fold"] == fold
        }
        scorer.scorers_.append(of_fold)
    return scorer
