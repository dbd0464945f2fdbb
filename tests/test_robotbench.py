"""RobotBench tells a weight on a vehicle from none, and files that its figures are not of."""

import re

import numpy as np
import pandas as pd
import pytest

from tools.robotbench.__main__ import main


def dive(rng, weight):
    """Return 5 s of diving: motors push harder against a weight."""
    times = np.arange(100) / 20.0
    push = 1200.0 + 40.0 * weight + 5.0 * rng.normal(size=100)
    return pd.DataFrame({"time": times, "pwm1": push, "depth": 0.1 * times + rng.normal() * 0.01})


def test_a_fault_is_told_and_so_are_other_files(tmp_path, monkeypatch, capsys):
    rng = np.random.default_rng(0)
    for kind, count, weight in (("Normal", 12, 0.0), ("AddWeight", 6, 1.0)):
        folder = tmp_path / "auv" / "test" / kind
        folder.mkdir(parents=True)
        for number in range(count):
            dive(rng, weight).to_csv(folder / f"{number:02d}.csv", index=False)
    monkeypatch.setattr("sys.argv", ["robotbench", str(tmp_path), "auv_weight", "alfa"])
    main()
    printed = capsys.readouterr()
    heads, row = (
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in printed.out.splitlines()[::2]
    )
    cells = dict(zip(heads, row, strict=True))
    assert cells["normal / abnormal"] == "12 / 6"
    assert float(cells["oracle"].split()[0]) == pytest.approx(1.0)
    assert re.fullmatch(r"\d+\.\d times", cells["time"])
    assert "are of 1,225 files" in printed.err
    assert "here are 18" in printed.err
    assert "alfa has no file of the set" in printed.err
