"""``oracle card``: what a reference card holds."""

from pathlib import Path

import click

from oracle_pipeline.bags.errors import OracleError


@click.group()
def card() -> None:
    """Look into reference cards.

    \b
    Example:
        oracle card show robot.card
    """  # noqa: D301 -- click reads the control character


@card.command()
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False, exists=True))
@click.option("--contract", is_flag=True, help="Print the contract alone, as YAML to edit.")
def show(file: Path, *, contract: bool) -> None:
    """Print what a reference card holds.

    Its hash, release and day, blocks, the rates that it supports, roles, the contract, and
    recordings that were set aside.

    \b
    Examples:
        oracle card show robot.card
        oracle card show robot.card --contract > contract.yaml
        oracle score tonight/* --reference robot.card --contract contract.yaml
    """  # noqa: D301 -- click reads the control character
    from oracle_pipeline.scoring.card import ReferenceCard
    from oracle_pipeline.scoring.card_output import card_as_text, terms_as_text
    from oracle_pipeline.scoring.contract_file import contract_as_yaml

    known = ReferenceCard.load(file)
    if not contract:
        click.echo("\n".join([str(known.origin), card_as_text(known), *terms_as_text(known)]))
    elif known.contract is None:
        raise OracleError(f"{file} has no contract: it was learned from tables.")
    else:
        click.echo(contract_as_yaml(known.contract), nl=False)
