"""Labelled recordings of real robots as cases: what each label means is in the folder's README."""

import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from tools.robotbench.faults import FAULTS, Tables

_PART_S = {"kairos": 8.0, "faults": 15.0, "arm": 15.0}  # length of the parts of long drives
_UCI_STEP_S = 0.315 / 15
_UCI_COLUMNS = ("fx", "fy", "fz", "tx", "ty", "tz")


class Case(NamedTuple):
    """One recording of a set."""

    path: Path
    session: str  # recordings of one session are not independent
    abnormal: bool
    dose: float = np.nan  # how strong the fault is, where it is known
    original: Path | None = None  # the recording that this one is an altered copy of


def crazyflie(source: Path, _: Path) -> Iterator[Case]:
    """Yield flights of a quadrotor with whole, cut, taped or loaded propellers; dose in mm cut."""
    for row in pd.read_csv(source / "labels.csv").to_dict("records"):
        abnormal = str(row["kind"]) != "normal"
        yield Case(source / str(row["file"]), str(row["airframe"]), abnormal, float(row["cut_mm"]))


def uci_arm(number: int) -> Callable[[Path, Path], Iterator[Case]]:
    """Return the loader of one set of an arm's forces and torques, 315 ms each."""

    def load(source: Path, work: Path) -> Iterator[Case]:
        text = (source / f"lp{number}.data").read_text()
        examples = re.findall(r"^(\w+)\s*\n((?:\t.*\n)+)", text, re.MULTILINE)
        for index, (label, block) in enumerate(examples):
            rows = np.array([[float(word) for word in line.split()] for line in block.splitlines()])
            frame = pd.DataFrame(rows, columns=list(_UCI_COLUMNS))
            frame.insert(0, "time", np.arange(len(frame)) * _UCI_STEP_S)
            path = work / f"{index:03d}.csv"
            frame.to_csv(path, index=False)
            yield Case(path, f"{index}", label != "normal")

    return load


def kairos(source: Path, work: Path) -> Iterator[Case]:
    """Yield parts of drives of a wheeled robot; another plan past a window is abnormal."""
    for drive in sorted(source.glob("*_plan*")):
        for part, _ in _parts(drive, work, "Time", _PART_S["kairos"]):
            yield Case(part, drive.name, drive.name.startswith("window"))


def faulty_kairos(fault: Callable[[Tables], None]) -> Callable[[Path, Path], Iterator[Case]]:
    """Return the loader of the same drives, all of them normal, with and without a fault."""

    def load(source: Path, work: Path) -> Iterator[Case]:
        for drive in sorted(source.glob("*_plan*")):
            for part, _ in _parts(drive, work, "Time", _PART_S["faults"]):
                yield Case(part, drive.name, abnormal=False)
                altered = part.with_name(f"{part.name}_faulty")
                altered.mkdir()
                tables = {file.stem.rpartition("-")[2]: file for file in part.iterdir()}
                content = {name: pd.read_csv(file) for name, file in tables.items()}
                fault(content)
                for name, table in content.items():
                    table.to_csv(altered / tables[name].name, index=False)
                yield Case(altered, drive.name, abnormal=True, original=part)

    return load


def arm(source: Path, work: Path) -> Iterator[Case]:
    """Yield parts of sequences of an arm with six motors; dose is the share of faulty samples."""
    for sequence in sorted(source.glob("2*")):
        for part, tables in _parts(sequence, work, "time", _PART_S["arm"]):
            faulty = float(np.max([table["label"].mean() for table in tables]))
            yield Case(part, sequence.name, faulty > 0.0, faulty)


def _parts(
    folder: Path, work: Path, time: str, part_s: float
) -> Iterator[tuple[Path, list[pd.DataFrame]]]:
    """Cut a folder of tables into parts of equal length; a shorter rest is left out."""
    tables = {file.name: pd.read_csv(file) for file in sorted(folder.glob("*.csv"))}
    start = min(table[time].iloc[0] for table in tables.values())
    end = max(table[time].iloc[-1] for table in tables.values())
    for number in range(int((end - start) / part_s)):
        begin = start + number * part_s
        cut = {name: t[t[time].between(begin, begin + part_s)] for name, t in tables.items()}
        if min(map(len, cut.values())) < 2:
            continue
        part = work / f"{folder.name}_{number:03d}"
        part.mkdir()
        for name, table in cut.items():
            table.to_csv(part / name, index=False)
        yield part, list(cut.values())


#: By name: the folder below that of all sets, the robot, and the loader.
SETS: Mapping[str, tuple[str, str, Callable[[Path, Path], Iterator[Case]]]] = {
    "crazyflie": ("crazyflie", "quadrotor", crazyflie),
    **{f"uci_lp{n}": ("uci_arm", "arm, forces", uci_arm(n)) for n in (1, 2, 4, 5)},
    "arm": ("arm", "arm, motors", arm),
    "kairos": ("kairos", "wheeled", kairos),
    **{name: ("kairos", "wheeled", faulty_kairos(fault)) for name, fault in FAULTS.items()},
}
