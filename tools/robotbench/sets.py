"""Labelled recordings of real robots as cases: what each label means is in the folder's README."""

import json
import re
import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from oracle_pipeline.logs.dataflash import read_dataflash
from oracle_pipeline.logs.log import Log, LogTopic
from oracle_pipeline.logs.recording import write_bag
from tools.robotbench.faults import FAULTS, OF_JOINTS, Positions, Tables

# Length of the parts of long recordings.
_PART_S = {
    "kairos": 8.0,
    "faults": 15.0,
    "arm": 15.0,
    "flight": 15.0,
    "aeroplane": 15.0,
    "shaft": 5.0,
}
_UCI_STEP_S = 0.315 / 15
_UCI_COLUMNS = ("fx", "fy", "fz", "tx", "ty", "tz")
_OF_SHAFT = (
    "Desired",
    "Actual",
    "Shaft",
    "Orient",
    "AngVel",
    "LinAcc",
    "Mag",
    "Quat",
    "Audio",
    "Strain",
)  # what is measured; other columns say what is done to the shaft
_FLYING_US = 1250  # width of a motor's pulse, above which the quadcopter flies


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


def humanoid(fault: Callable[[Positions], Positions]) -> Callable[[Path, Path], Iterator[Case]]:
    """Return the loader of the same tasks of a humanoid's arms, with and without a fault."""

    def load(source: Path, work: Path) -> Iterator[Case]:
        shutil.copytree(source, work, dirs_exist_ok=True)
        for number, file in enumerate(sorted(work.glob("data/*/*.parquet"))):
            episode = source / file.stem
            yield Case(episode, file.stem, abnormal=False)
            if number % 2:
                table = pd.read_parquet(file)
                positions = fault(np.stack(table["observation.state"].to_list()))
                table["observation.state"] = list(positions)
                table.to_parquet(file)
                yield Case(work / file.stem, file.stem, abnormal=True, original=episode)

    return load


def arm(source: Path, work: Path) -> Iterator[Case]:
    """Yield parts of sequences of an arm with six motors; dose is the share of faulty samples."""
    for sequence in sorted(source.glob("2*")):
        for part, tables in _parts(sequence, work, "time", _PART_S["arm"]):
            faulty = float(np.max([table["label"].mean() for table in tables]))
            yield Case(part, sequence.name, faulty > 0.0, faulty)


def quadcopter(task: str) -> Callable[[Path, Path], Iterator[Case]]:
    """Return the loader of a quadcopter's flights of one task, whole propellers or one cut.

    Parts of a flight between take-off and landing are recordings; dose in mm cut.
    """

    def load(source: Path, work: Path) -> Iterator[Case]:
        for file in sorted(source.glob(f"{task}/*/*.BIN")):
            cut = re.match(r"\d+", file.name)
            log = read_dataflash(file)
            pulses = next(topic for topic in log.topics if topic.name == "/RCOU")
            flying = pulses.times_ns[pulses.columns["C1"] > _FLYING_US]
            part_ns = int(_PART_S["flight"] * 1e9)
            for begin in range(flying[0], flying[-1] - part_ns, part_ns):
                bag = work / f"{file.stem}_{begin}"
                write_bag(_between(log, begin, begin + part_ns), bag)
                yield Case(bag, file.stem, cut is not None, float(cut[0]) if cut else np.nan)

    return load


def _between(log: Log, begin_ns: int, end_ns: int) -> Log:
    """Return the messages of some time; a topic without any is left out."""
    topics = []
    for topic in log.topics:
        rows = (topic.times_ns >= begin_ns) & (topic.times_ns < end_ns)
        if rows.any():
            columns = {name: values[rows] for name, values in topic.columns.items()}
            topics.append(topic._replace(times_ns=topic.times_ns[rows], columns=columns))
    return Log(topics)


def jackal(safe: str, unsafe: str) -> Callable[[Path, Path], Iterator[Case]]:
    """Return the loader of some seconds of a wheeled robot that meets something that moves.

    Half of the set mirrors the other half left to right; those recordings are left out.
    """

    def load(source: Path, work: Path) -> Iterator[Case]:
        for kind in (safe, unsafe):
            known = set()
            for file in sorted(source.glob(f"{kind}/*/{kind}_*.json")):
                frames = pd.DataFrame(json.loads(file.read_text())["frames"])
                speeds = tuple(forward for forward, _ in frames["lin_vel"])
                if speeds in known:
                    continue
                known.add(speeds)
                write_bag(Log(_topics(frames)), work / file.stem)
                yield Case(work / file.stem, file.stem, kind == unsafe)

    return load


def alfa(source: Path, work: Path) -> Iterator[Case]:
    """Yield parts of an aeroplane's flights: all without a failure, and the ends of the others.

    A file of a failed flight is also among those without a failure, and left out there.
    """
    for file in sorted(source.glob("*/carbonZ_*.csv")):
        failed, parts = "no_failure" not in file.name, list(_time_parts(file))
        if failed != (file.parent.name != "no_failure"):
            continue
        for number, part in list(enumerate(parts))[-1 if failed else 0 :]:
            path = work / f"{file.stem}_{number:03d}.csv"
            part.to_csv(path, index=False)
            yield Case(path, file.stem[:27], failed)


def underwater(fault: str) -> Callable[[Path, Path], Iterator[Case]]:
    """Return the loader of 10 s of diving of an underwater vehicle, whole or with one fault."""

    def load(source: Path, _: Path) -> Iterator[Case]:
        for kind in ("Normal", fault):
            for file in sorted(source.glob(f"*/{kind}/*.csv")):
                if kind == "Normal" or file.parts[-3] == "test":
                    yield Case(file, "/".join(file.parts[-3:]), kind == fault)

    return load


def shaft(folder: str, mode: str) -> Callable[[Path, Path], Iterator[Case]]:
    """Return the loader of seconds of a motor's shaft, without a fault and with one all the time.

    The fault comes and goes within sequences, so both are of the same ones.
    """

    def load(source: Path, work: Path) -> Iterator[Case]:
        for file in sorted(source.glob(f"{folder}/*.csv")):
            table = pd.read_csv(file, low_memory=False, skipinitialspace=True)
            faulty, times_s = table[f"{mode}-mode?"].astype(bool), table["Time"] / 1000.0
            measured = table[[c for c in table.columns if str(c).startswith(_OF_SHAFT)]]
            measured.insert(0, "time", times_s)
            run = (faulty != faulty.shift()).cumsum()
            for number, rows in measured.groupby(run):
                parts = ((rows["time"] - rows["time"].iloc[0]) // _PART_S["shaft"]).astype(int)
                for part in range(parts.iloc[-1]):
                    path = work / f"{file.stem}_{number:03d}_{part:03d}.csv"
                    rows[parts == part].to_csv(path, index=False)
                    yield Case(path, file.stem, bool(faulty[rows.index[0]]))

    return load


def _time_parts(file: Path) -> Iterator[pd.DataFrame]:
    """Cut a table into parts of equal length, from its end."""
    table = pd.read_csv(file)
    left_s = (times := pd.to_datetime(table["%time"])).iloc[-1] - times
    part = (left_s.dt.total_seconds() // _PART_S["aeroplane"]).astype(int)
    for number in range(part.max() - 1, -1, -1):
        yield table[part == number]


def _topics(frames: pd.DataFrame) -> list[LogTopic]:
    """Return the frames of a Jackal as messages; its heading is the integral of its turning."""
    times_ns = (frames["timestamp"].to_numpy() * 1e9).astype(np.int64)
    position, speed, acceleration = (
        np.array(frames[name].to_list()) for name in ("position", "lin_vel", "lin_acc")
    )
    scan, turn = np.array(frames["scan"].to_list()), frames["ang_vel"].to_numpy()
    steps = np.diff(frames["timestamp"], prepend=frames["timestamp"][0])
    half = np.cumsum(turn * steps) / 2.0
    zero = np.zeros(len(frames))
    odometry = {
        "pose.pose.position.x": position[:, 0],
        "pose.pose.position.y": position[:, 1],
        "pose.pose.orientation.z": np.sin(half),
        "pose.pose.orientation.w": np.cos(half),
        "twist.twist.linear.x": speed[:, 0],
        "twist.twist.linear.y": speed[:, 1],
        "twist.twist.angular.z": turn,
    }
    imu = {
        "linear_acceleration.x": acceleration[:, 0],
        "linear_acceleration.y": acceleration[:, 1],
        "angular_velocity.z": turn,
    }
    angles = scan[0, :, 0]
    ranges = {
        "ranges": scan[:, :, 1],
        "angle_min": zero + angles[0],
        "angle_max": zero + angles[-1],
        "angle_increment": zero + (angles[-1] - angles[0]) / (len(angles) - 1),
        "range_max": zero + 30.0,
    }
    return [
        LogTopic("/odom", times_ns, odometry, "nav_msgs/msg/Odometry"),
        LogTopic("/imu", times_ns, imu, "sensor_msgs/msg/Imu"),
        LogTopic("/scan", times_ns, ranges, "sensor_msgs/msg/LaserScan"),
    ]


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
    **{name: ("humanoid", "humanoid", humanoid(fault)) for name, fault in OF_JOINTS.items()},
    "jackal_straight": ("jackal", "wheeled", jackal("E2", "N4")),
    "jackal_cross": ("jackal", "wheeled", jackal("E3", "N5")),
    "jackal_unsafe": ("jackal", "wheeled", jackal("E3", "N6")),
    "quadcopter_hover": ("quadcopter", "quadrotor", quadcopter("Hover")),
    "alfa": ("alfa", "aeroplane", alfa),
    "auv_weight": ("auv", "underwater", underwater("AddWeight")),
    "auv_depth": ("auv", "underwater", underwater("PressureGain_constant")),
    "auv_propeller": ("auv", "underwater", underwater("PropellerDamage_bad")),
    "auv_cut": ("auv", "underwater", underwater("PropellerDamage_slight")),
    "shaft_load": ("shaft", "motor's shaft", shaft("Manual N Mode", "N")),
    "shaft_vibration": ("shaft", "motor's shaft", shaft("MC-generated V Mode", "V")),
    "shaft_damping": ("shaft", "motor's shaft", shaft("Manual D Mode", "D")),
    "quadcopter_line": ("quadcopter", "quadrotor", quadcopter("Straight line")),
}
