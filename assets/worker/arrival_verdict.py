"""The work on recordings from the inbox: extract features, then judge."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from oracle_pipeline.bags import layout
from oracle_pipeline.bags.arrivals import Arrival
from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.terminal import printable

if TYPE_CHECKING:
    from oracle_pipeline.features import FeatureTables
    from oracle_pipeline.scoring.card import ReferenceCard
    from oracle_pipeline.scoring.isolation import Extracted, Limits
    from oracle_pipeline.scoring.kept_verdicts import KeptVerdict
    from oracle_pipeline.scoring.verdict import Verdict


def judge_each(
    arrivals: Sequence[Arrival],
    root: Path,
    card_path: Path,
    far: float,
    limits: "Limits",
    batch: str,
) -> "Iterator[tuple[KeptVerdict, FeatureTables | None]]":
    """Judge recordings, each in a separate process, and store features and verdicts below the root.

    A recording that cannot be read or judged gets a verdict with the reason.

    Raises
    ------
    OracleError
        If the card does not exist.
    """
    from oracle_pipeline.features import build_manager
    from oracle_pipeline.scoring.card import ReferenceCard
    from oracle_pipeline.scoring.isolation import Reading, extract_each
    from oracle_pipeline.scoring.kept_verdicts import KeptVerdict

    card = ReferenceCard.load(card_path)
    paths = [arrival.path for arrival in arrivals]
    found = extract_each(paths, build_manager(), limits, Reading(known=card.known))
    for arrival, (_, robots) in zip(arrivals, found, strict=True):
        verdict, tables = _judged(arrival, robots, card, far)
        folder = layout.foreign(root, arrival.key)
        _keep(tables, folder)
        now = datetime.now(UTC).isoformat(timespec="seconds")
        kept = KeptVerdict(
            arrival.key, arrival.fingerprint, verdict, far, str(card_path), now, batch
        )
        kept.save(folder / layout.VERDICT)
        yield kept, tables


def _judged(
    arrival: Arrival, robots: "list[Extracted] | OracleError", card: "ReferenceCard", far: float
) -> "tuple[Verdict, FeatureTables | None]":
    from oracle_pipeline.scoring.judging import judge
    from oracle_pipeline.scoring.verdict import Verdict

    if isinstance(robots, OracleError):
        return Verdict(arrival.name, "error", error=printable(str(robots))), None
    if len(robots) > 1:
        several = (
            f"{arrival.name} has {len(robots)} robots, but an arrival has one verdict. Judge each "
            f"robot with: oracle score {arrival.path} --reference CARD"
        )
        return Verdict(arrival.name, "error", error=several), None
    tables = robots[0].tables
    try:
        verdict = judge(arrival.name, tables, card, far, robots[0].observation)
    except (OracleError, OSError) as error:
        return Verdict(arrival.name, "error", error=printable(str(error))), tables
    return replace(verdict, notes=(*tables.notes, *verdict.notes)), tables


def _keep(tables: "FeatureTables | None", folder: Path) -> None:
    """Write the feature tables, or remove those of a previous recording of this name."""
    from oracle_pipeline.datasets import write_table

    files = {name: folder / f"{name}.parquet" for name in layout.TABLES}
    if tables is None:
        for file in files.values():
            file.unlink(missing_ok=True)
    else:
        write_table(tables.windows, files["window"])
        write_table(tables.run, files["run"])
