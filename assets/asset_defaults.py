"""What all assets declare: owner, scope, and the place of their content."""

from typing import Any, Literal, TypedDict

import dagster as dg

# A partition, all of them, a recording that arrived, or a scenario that is searched.
Scope = Literal["run", "campaign", "recording", "scenario"]

SINGLE_RUN = dg.BackfillPolicy.single_run()  # one Dagster run for any range of partitions


class Declared(TypedDict):
    """Arguments that every ``AssetSpec`` takes."""

    owners: list[str]
    tags: dict[str, str]
    metadata: dict[str, Any]


def declared(scope: Scope, place: str) -> Declared:
    """Return owner, tag and definition metadata of an asset.

    Parameters
    ----------
    scope
        What one item of the asset describes; ``--select tag:scope=campaign`` selects by it.
    place
        Where its content is, below the root of the store.
    """
    return {
        "owners": ["team:behaviour-oracle"],
        "tags": {"scope": scope},
        "metadata": {"place": dg.MetadataValue.text(f"<ORACLE_HOME>/{place}")},
    }
