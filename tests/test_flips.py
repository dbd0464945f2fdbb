"""No flipped bit in recordings and tables changes features without an error."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from oracle_pipeline.cli import main
from tools.soak.flips import Target, flip_bits, made

pytestmark = pytest.mark.slow

FLIPS = 12  # in each target; `python -m tools.soak.flips` makes 500


@pytest.fixture(scope="module")
def targets(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Target]:
    root = tmp_path_factory.mktemp("flips")
    return {f"{target.name}, {storage}": target for storage, target in made(root)}


@pytest.mark.parametrize(
    "name",
    [
        *(
            f"{name}, {storage}"
            for storage in ("mcap", "sqlite3")
            for name in ("bag", "graphs", "manifest", "feature tables")
        ),
        "MCAP file alone, mcap",
        "joined table, both",
    ],
)
def test_no_flipped_bit_goes_unnoticed(targets: dict[str, Target], name: str) -> None:
    tally = flip_bits(targets[name], FLIPS, np.random.default_rng(15))
    assert tally.unnoticed == []
    assert tally.tried == FLIPS
    if name != "MCAP file alone, mcap":  # it has parts that are not read
        assert tally.harmless == 0


@pytest.mark.parametrize(
    ("damaged", "said"), [("bag, mcap", "bag"), ("joined table, both", "parquet")]
)
def test_the_commands_refuse_damaged_files(
    targets: dict[str, Target], damaged: str, said: str
) -> None:
    recording, reference = (
        targets["manifest, mcap"].files[0],
        targets["joined table, both"].files[0],
    )
    file = max(targets[damaged].files, key=lambda path: path.stat().st_size)
    content = file.read_bytes()
    flipped = bytearray(content)
    flipped[len(content) // 2] ^= 1
    file.write_bytes(flipped)
    try:
        arguments = ["score", str(recording.parent), "--reference", str(reference), "--far", "0.5"]
        result = CliRunner().invoke(main, arguments)
    finally:
        file.write_bytes(content)
    assert result.exit_code == 2
    assert "damaged" in result.output
    assert said in result.output


def test_a_flip_that_changes_features_is_reported(tmp_path: Path) -> None:
    """The counter works: a file without protection."""
    file = tmp_path / "plain"
    file.write_bytes(bytes(8))
    plain = Target("plain", (file,), lambda: [pd.DataFrame({"bytes": list(file.read_bytes())})])
    tally = flip_bits(plain, 3, np.random.default_rng(0))
    assert (tally.caught, tally.harmless, len(tally.unnoticed)) == (0, 0, 3)
    assert file.read_bytes() == bytes(8)
