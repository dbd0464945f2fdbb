"""A contract as a text file (YAML) that a team reviews and edits; `oracle score` reads it."""

import json
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml

from oracle_pipeline.bags import bounded_yaml
from oracle_pipeline.bags.errors import OracleError, one_line
from oracle_pipeline.bags.json_schema import faults
from oracle_pipeline.bags.limits import LARGEST_YAML
from oracle_pipeline.scoring.contract import Contract


class ContractError(OracleError):
    """A file is not a contract."""


def contract_as_yaml(contract: Contract) -> str:
    """Return a contract as YAML, for `read_contract`."""
    document = json.loads(json.dumps(contract.to_dict()))  # tuples are lists in a file
    return str(yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=100))


def read_contract(path: Path) -> Contract:
    """Read the file of a contract.

    Raises
    ------
    ContractError
        With the first fault and its place.
    """
    try:
        with path.open("rb") as source:
            document = bounded_yaml.load(source.read(LARGEST_YAML + 1).decode())
        of_contract = card_schema()["$defs"]["contract"]
        if found := faults(document, {**of_contract, "$defs": card_schema()["$defs"]}):
            raise ValueError(f"{found[0].json_path}: {found[0].message}")
        if unknown := sorted(set(document) - set(of_contract["properties"])):
            raise ValueError(
                f"it has {unknown[0]}; known are {', '.join(of_contract['properties'])}"
            )
        return Contract.from_dict(document)
    except (ValueError, TypeError) as error:
        raise ContractError(
            f"{path} is not a contract: {one_line(error)}. Start from what "
            "`oracle card show CARD --contract` prints."
        ) from error


@cache
def card_schema() -> Any:
    """Return the JSON Schema of ``card.json``, which has that of a contract."""
    return json.loads(files(__package__).joinpath("card.schema.json").read_text("utf-8"))
