"""``oracle-sim storage`` shows the storage of runs; ``oracle-sim remake`` re-simulates bags."""

import os
from pathlib import Path

import click

from oracle_pipeline.bags.integrity import damaged_files
from oracle_pipeline.bags.manifest import KEPT, Manifest
from oracle_pipeline.bags.run_directory import RunDirectory
from resources.storage.plan import megabytes
from resources.storage.stock import (
    BUDGET_VARIABLE,
    Stock,
    expected_sizes,
    parse_budget,
    storage_of_modes,
    take_stock,
)
from sim.commands.batch import home, short_errors
from sim.experiments import remake_run


@click.command()
@click.option(
    "--root", type=click.Path(path_type=Path, file_okay=False, exists=True),
    default=home,
    help="Root of the run directories.  [default: $ORACLE_HOME or ./data]")  # fmt: skip
def storage(root: Path) -> None:
    """Show how much disk space runs take, and how many more fit.

    \b
    Example:
        ORACLE_STORAGE_BUDGET=20GiB oracle-sim storage
    """  # noqa: D301 -- click reads the control character
    with short_errors():
        budget = parse_budget(os.environ.get(BUDGET_VARIABLE, ""))
    stock = take_stock(root.resolve())
    capacity = stock.total + stock.free
    limit = capacity if budget is None else min(budget, capacity)
    click.echo(f"{root}: {megabytes(stock.total)} of {megabytes(limit)} used")
    _show_modes(stock)
    _show_free_space(stock, limit - stock.total)


def _show_modes(stock: Stock) -> None:
    rows = storage_of_modes(stock)
    heads = [tuple(row) for row in rows[:1]]
    for first, *others in (*heads, *(tuple(row.values()) for row in rows)):
        click.echo(f"{first:<32}" + "".join(f"{cell:>14}" for cell in others))


def _show_free_space(stock: Stock, room: int) -> None:
    """Print how many further blocks fit, each with one run of every recorded mode."""
    modes = sorted({run.mode for run in stock.runs})
    sizes = [size for mode in modes if (size := expected_sizes(mode, stock))]
    for kept in KEPT if sizes else ():
        block = sum(size.of(kept) for size in sizes)
        click.echo(f"room for {max(room, 0) // block} more blocks, {kept}: {megabytes(block)} each")


def _is_verified(run: RunDirectory, manifest: Manifest) -> bool:
    """Return whether a run has its complete bag and graphs, verified by their hashes."""
    measured = manifest.measured
    known = measured.kept == "full" and bool(measured.files)
    return known and not damaged_files(run.path, manifest)


@click.command()
@click.argument("run", type=click.Path(path_type=Path, file_okay=False, exists=True))
def remake(run: Path) -> None:
    """Rebuild a dropped, trimmed or damaged bag from its recipe.

    A run of an older release without hashes is always rebuilt.

    \b
    Example:
        oracle-sim remake data/runs/fake_object/run003
    """  # noqa: D301 -- click reads the control character
    with short_errors():
        directory = RunDirectory.at(run)
        with directory.held():
            previous = directory.manifest()
            if _is_verified(directory, previous):
                click.echo(f"{run} has its complete bag.")
                return
            manifest = remake_run(previous, directory)
    click.echo(f"{run}: re-simulated a bag of {megabytes(manifest.measured.bytes['bag'])}.")
    if manifest.content_hash != previous.content_hash:
        click.echo(
            "The software has changed, and so have the messages: this is a new generation of the "
            "run. Its features are extracted again at their next materialization."
        )
