"""Whatever number stands in a message, no feature and no check fails."""

from pathlib import Path

import pytest

from tools.soak.numbers import failures, write_every_type

COPIES = 7  # one of each recording; `python -m tools.soak.numbers` makes 2,000, with bounds checks


@pytest.mark.slow(4)
def test_odd_numbers_in_messages_fail_no_feature_and_no_check(recorded_run, tmp_path: Path) -> None:
    paths = [recorded_run("lidar_passthrough_odom", 0).bag, *write_every_type(tmp_path)]
    assert failures(paths, COPIES, 7, tmp_path) == []
