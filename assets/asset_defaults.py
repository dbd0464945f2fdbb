"""Common arguments of all assets: owner, scope, and the path of their content."""

from typing import Any, Literal, TypedDict

import dagster as dg

Scope = Literal["run", "campaign", "batch"]  # a run, all runs, some recordings from the inbox

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
        Unit of one partition; ``--select tag:scope=campaign`` selects by it.
    place
        Path of the content below the root of the store.
    """
    return {
        "owners": ["team:behaviour-oracle"],
        "tags": {"scope": scope},
        "metadata": {"place": dg.MetadataValue.text(f"<ORACLE_HOME>/{place}")},
    }
