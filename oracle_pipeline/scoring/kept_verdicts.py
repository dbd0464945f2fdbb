"""Verdicts on recordings that arrived: each as JSON beside its features, and a table of all.

The table is what a sensor, a page or a trend reads, so that they cost the same for any number of
recordings. It can be computed again from the files.
"""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import pandas as pd

from oracle_pipeline.bags import layout
from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.remote import is_local
from oracle_pipeline.bags.scratch import lock
from oracle_pipeline.datasets import DatasetError, read_table, replacing, write_table
from oracle_pipeline.detectors import FamilyDeviation
from oracle_pipeline.scoring.alarms import Alarm
from oracle_pipeline.scoring.sentences import headline
from oracle_pipeline.scoring.verdict import AspectScore, CardOrigin, Evidence, Verdict, WindowSeries

VERSION = 2


class KeptVerdictError(OracleError):
    """A file is not a verdict, or was written by another release."""


@dataclass(frozen=True, slots=True)
class KeptVerdict:
    """A verdict, with the card and the false positive rate that it is based on."""

    key: str  # of the recording, from `oracle_pipeline.bags.arrivals`
    fingerprint: str  # of its files when it was judged
    verdict: Verdict
    far: float  # false positive rate
    card: str  # path of the reference card
    judged_at: str  # ISO 8601, UTC
    batch: str = ""  # of recordings that were judged together

    @property
    def row(self) -> dict[str, object]:
        """What the table of all verdicts has of it."""
        return {
            "key": self.key,
            "fingerprint": self.fingerprint,
            "batch": self.batch,
            "recording": self.verdict.recording,
            "outcome": self.verdict.outcome,
            "sentence": headline(self.verdict),
            "p_value": self.verdict.p_value,
            "score": self.verdict.score,
            "far": self.far,
            "judged_at": self.judged_at,
        }

    def save(self, path: Path) -> None:
        """Write the verdict atomically."""
        document = {"version": VERSION, **dataclasses.asdict(self)}
        with replacing(path) as sink:
            sink.write(json.dumps(document, indent=2, allow_nan=False).encode("ascii"))

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a verdict.

        Raises
        ------
        KeptVerdictError
            The file is damaged, or from another release.
        """
        try:
            document = json.loads(path.read_bytes())
            version = document.pop("version")
            if version != VERSION:
                raise ValueError(f"it has version {version}, and this release reads {VERSION}")
            return cls(**document | {"verdict": _verdict(document["verdict"])})
        except (ValueError, KeyError, TypeError) as error:
            raise KeptVerdictError(
                f"{path} is not a verdict ({error}); judge the recording again."
            ) from error


def verdict_rows(root: Path) -> pd.DataFrame:
    """Return a `KeptVerdict.row` for each foreign recording of a root, in order of judgement."""
    try:
        return read_table(layout.foreign_rows(root))
    except DatasetError:  # of an older release, or damaged
        return _table([kept_verdict(path) for path in layout.foreign_verdicts(root)])


def add_verdicts(root: Path, verdicts: Sequence[KeptVerdict]) -> pd.DataFrame:
    """Put verdicts into the table, in place of earlier ones on the same recordings; return it."""
    folder = root / layout.FOREIGN
    folder.mkdir(parents=True, exist_ok=True)
    with lock(folder) if is_local(root) else nullcontext():
        before, added = verdict_rows(root), _table(verdicts)
        kept = before[~before["key"].isin(added["key"])]
        rows = pd.concat([kept, added], ignore_index=True) if len(kept) else added
        write_table(rows, layout.foreign_rows(root))
    return rows


def _table(verdicts: Sequence[KeptVerdict]) -> pd.DataFrame:
    empty = KeptVerdict("", "", Verdict("", "normal"), 0.0, "", "")
    rows = pd.DataFrame([kept.row for kept in verdicts], columns=list(empty.row))
    numbers = dict.fromkeys(("p_value", "score", "far"), np.float64)
    return rows.astype(numbers).sort_values("judged_at", kind="stable", ignore_index=True)


def kept_verdict(path: Path) -> KeptVerdict:
    """Return the verdict in a file; one that is unreadable could not be judged."""
    try:
        return KeptVerdict.load(path)
    except KeptVerdictError as error:
        key = path.parent.name
        return KeptVerdict(key, "", Verdict(key, "error", error=str(error)), 0.0, "", "")


def _series(document: Mapping[str, Any]) -> WindowSeries:
    arrays = {name: tuple(document[name]) for name in ("start_s", "values")}
    return WindowSeries(**{**document, **arrays})


def _verdict(document: Mapping[str, Any]) -> Verdict:
    return Verdict(
        **{
            **document,
            "contract": tuple(document["contract"]),
            "aspects": {name: AspectScore(**of) for name, of in document["aspects"].items()},
            "alarms": tuple(Alarm(**each) for each in document["alarms"]),
            "evidence": tuple(Evidence(**each) for each in document["evidence"]),
            "series": tuple(_series(each) for each in document.get("series", ())),
            "families": tuple(FamilyDeviation(*each) for each in document["families"]),
            **{name: tuple(document[name]) for name in ("notes", "cautions", "differences")},
            "card": CardOrigin(**document["card"]) if document.get("card") else None,
        }
    )
