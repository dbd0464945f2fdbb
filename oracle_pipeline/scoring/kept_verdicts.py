"""Verdicts on recordings that arrived, stored as JSON beside their features."""

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from oracle_pipeline.bags import layout
from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.datasets import replacing
from oracle_pipeline.detectors import FamilyDeviation
from oracle_pipeline.scoring.alarms import Alarm
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


def kept_verdicts(root: Path) -> list[KeptVerdict]:
    """Return all verdicts on foreign recordings below a root, the newest first.

    An unreadable file counts as a recording that could not be judged.
    """
    verdicts = [_or_error(path) for path in layout.foreign_verdicts(root)]
    return sorted(verdicts, key=lambda kept: kept.judged_at, reverse=True)


def _or_error(path: Path) -> KeptVerdict:
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
