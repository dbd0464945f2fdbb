"""The work on one recording from the inbox: extract features, then judge it."""

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from oracle_pipeline.bags import layout
from oracle_pipeline.bags.arrivals import Arrival
from oracle_pipeline.bags.terminal import printable

if TYPE_CHECKING:
    from oracle_pipeline.features import FeatureTables
    from oracle_pipeline.scoring.card import ReferenceCard
    from oracle_pipeline.scoring.isolation import Limits
    from oracle_pipeline.scoring.kept_verdicts import KeptVerdict
    from oracle_pipeline.scoring.verdict import Verdict


class ArrivalVerdict(NamedTuple):
    """The result for one recording."""

    kept: "KeptVerdict"
    tables: "FeatureTables | None"  # None if it could not be read


def judge_arrival(
    arrival: Arrival, root: Path, card_path: Path, far: float, limits: "Limits"
) -> ArrivalVerdict:
    """Judge a recording in a separate process, and store features and verdict below the root.

    A recording that cannot be read or judged gets a verdict with the reason.

    Raises
    ------
    OracleError
        If the card does not exist.
    """
    from oracle_pipeline.scoring.card import ReferenceCard
    from oracle_pipeline.scoring.kept_verdicts import KeptVerdict

    card = ReferenceCard.load(card_path)
    verdict, tables = _judged(arrival, card, far, limits)
    folder = layout.foreign(root, arrival.key)
    _keep(tables, folder)
    now = datetime.now(UTC).isoformat(timespec="seconds")
    kept = KeptVerdict(arrival.key, arrival.fingerprint, verdict, far, str(card_path), now)
    kept.save(folder / layout.VERDICT)
    return ArrivalVerdict(kept, tables)


def _judged(
    arrival: Arrival, card: "ReferenceCard", far: float, limits: "Limits"
) -> "tuple[Verdict, FeatureTables | None]":
    from oracle_pipeline.bags.errors import BagError, OracleError
    from oracle_pipeline.features import build_manager
    from oracle_pipeline.scoring.isolation import Reading, extract_isolated
    from oracle_pipeline.scoring.judging import judge
    from oracle_pipeline.scoring.verdict import Verdict

    tables = None
    try:
        robots = extract_isolated(arrival.path, build_manager(), limits, Reading(known=card.known))
        if len(robots) > 1:
            raise BagError(
                f"{arrival.name} has {len(robots)} robots, but an arrival has one verdict. Judge "
                f"each robot with: oracle score {arrival.path} --reference CARD"
            )
        tables = robots[0].tables
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
