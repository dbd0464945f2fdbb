"""The storage plan: what fits, alike for all runs of a block, first blocks first."""

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.bags.manifest import KEPT
from resources.storage.plan import Sizes, StorageError, plan
from resources.storage.stock import RunBytes, make_plan, parse_budget, take_stock
from resources.store import RunStore

size = st.integers(0, 1000)
sizes = st.tuples(size, size, size).map(lambda s: Sizes(*sorted(s, reverse=True)))
blocks = st.dictionaries(st.integers(0, 50), st.lists(sizes, max_size=4), max_size=8)
RUN = Sizes(full=10, trimmed=3, recipe=1)


def taken(of: dict[int, list[Sizes]], kept: dict[int, str]) -> int:
    return sum(run.of(kept[block]) for block, runs in of.items() for run in runs)


@given(blocks, st.integers(0, 10_000))
def test_a_plan_fits_and_covers_every_block(of, available):
    try:
        kept = plan(of, available)
    except StorageError:
        assert taken(of, dict.fromkeys(of, "recipe")) > available
        return
    assert kept.keys() == of.keys()
    assert taken(of, kept) <= available


@given(blocks, st.integers(0, 10_000))
def test_no_block_keeps_more_than_one_before_it(of, available):
    try:
        kept = plan(of, available)
    except StorageError:
        return
    levels = [KEPT.index(kept[block]) for block in sorted(kept)]
    assert levels == sorted(levels)


@given(blocks)
def test_everything_is_kept_if_it_fits(of):
    everything = taken(of, dict.fromkeys(of, "full"))
    assert set(plan(of, everything).values()) <= {"full"}


@pytest.mark.parametrize(
    ("available", "kept"),
    [
        (8, "recipe recipe recipe recipe"),
        (11, "recipe recipe recipe recipe"),  # a trimmed block takes 4 more
        (12, "trimmed recipe recipe recipe"),
        (24, "trimmed trimmed trimmed trimmed"),
        (37, "trimmed trimmed trimmed trimmed"),
        (38, "full trimmed trimmed trimmed"),
        (79, "full full full trimmed"),
        (80, "full full full full"),
    ],
)
def test_four_blocks_of_two_runs(available, kept):
    assert " ".join(plan({block: [RUN, RUN] for block in range(4)}, available).values()) == kept


def test_the_error_states_the_number_of_blocks_that_fit():
    error = pytest.raises(StorageError, match=r"4 blocks .* do not fit.*first 2 blocks would fit")
    with error:
        plan({block: [Sizes(10**7, 10**7, 10**6)] for block in range(4)}, 2_500_000)


@pytest.mark.parametrize(
    ("text", "size"),
    [("", None), (" ", None), ("1500", 1500), ("20GiB", 20 * 2**30), ("2 GB", 2 * 10**9)],
)
def test_a_budget_is_bytes_with_or_without_a_unit(text, size):
    assert parse_budget(text) == size


@pytest.mark.parametrize("text", ["much", "2 apples", "-"])
def test_an_invalid_budget_is_an_error(text):
    with pytest.raises(StorageError, match="ORACLE_STORAGE_BUDGET.*20GiB"):
        parse_budget(text)


def test_everything_below_the_root_is_counted_and_each_file_to_its_run(tmp_path: Path) -> None:
    files = {
        "runs/a/run000/manifest.json": 1,
        "runs/a/run000/bag/bag_0.mcap": 2,
        "runs/a/run000/graphs/run.gexf": 3,
        "features/run/a/run000.parquet": 4,
        "features/window/a/run000.parquet": 5,
        "runs/a/run001/bag/bag_0.mcap": 6,  # of no finished run
        "runs/a/.run002.0badcafe/manifest.json": 7,
        "report/index.html": 8,
    }
    page = os.sysconf("SC_PAGESIZE")  # so that files fill blocks of any disk
    for name, pages in files.items():
        place = tmp_path / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(os.urandom(pages * page))
        os.sync()
    stock = take_stock(tmp_path)
    assert stock.total == sum(files.values()) * page
    run = RunStore(root=str(tmp_path)).run("a|run000")
    assert list(stock.runs) == [run]
    assert stock.runs[run] == RunBytes(2 * page, (4 + 5) * page, (1 + 3) * page)


def test_with_ample_space_everything_is_kept(tmp_path: Path) -> None:
    wanted = [RunStore(root=str(tmp_path)).run(f"a|run00{number}") for number in range(3)]
    made = make_plan(tmp_path, wanted, budget=10**9, reserve=0, workers=2, goals=8)
    assert dict(made.kept) == dict.fromkeys(range(3), "full")
    assert made.blocks_ahead == 3


def test_without_measured_runs_one_block_is_recorded_first(tmp_path: Path) -> None:
    wanted = [RunStore(root=str(tmp_path)).run(f"a|run{number:03d}") for number in range(100)]
    made = make_plan(tmp_path, wanted, budget=100_000_000, reserve=0, workers=2, goals=8)
    assert set(made.kept.values()) == {"recipe"}
    assert made.blocks_ahead == 1


def test_if_no_run_fits_nothing_starts(tmp_path: Path) -> None:
    wanted = [RunStore(root=str(tmp_path)).run("a|run000")]
    with pytest.raises(StorageError, match="do not fit"):
        make_plan(tmp_path, wanted, budget=1000, reserve=0, workers=2, goals=8)
