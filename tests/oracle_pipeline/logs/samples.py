"""Small logs of each kind, as the tools that write them do: 3 s of one signal at 20 Hz."""

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import Writer
from pymavlink.dialects.v20 import all as mavlink

COUNT, RATE_HZ = 60, 20.0
BEGIN_US = 1_700_000_000_000_000
TIMES_S = np.arange(COUNT) / RATE_HZ
SIGNAL = np.sin(TIMES_S)


def csv(folder: Path) -> Path:
    path = folder / "flight.csv"
    pd.DataFrame({"time": TIMES_S, "roll": SIGNAL}).to_csv(path, index=False)
    return path


def parquet(folder: Path) -> Path:
    path = folder / "flight.parquet"
    pd.DataFrame({"time": TIMES_S, "roll": SIGNAL}).to_parquet(path)
    return path


def lerobot(folder: Path, version: int = 2) -> Path:
    dataset = folder / f"dataset_v{version}"
    (dataset / "meta").mkdir(parents=True)
    data = dataset / "data" / "chunk-000"
    data.mkdir(parents=True)
    joints = ["pan", "lift"]
    names = {2: joints, 3: [joints]}[version]
    features = {
        "observation.state": {"dtype": "float32", "shape": [2], "names": names},
        "action": {"dtype": "float32", "shape": [2], "names": None},
    }
    about = {"codebase_version": f"v{version}.0", "fps": RATE_HZ, "total_episodes": 2}
    (dataset / "meta" / "info.json").write_text(json.dumps(about | {"features": features}))
    state = np.column_stack([SIGNAL, np.cos(TIMES_S)]).astype(np.float32)
    frames = [
        pd.DataFrame(
            {
                "observation.state": list(state + episode),
                "action": list(state),
                "timestamp": TIMES_S.astype(np.float32),
                "episode_index": episode,
            }
        )
        for episode in range(2)
    ]
    if version == 2:
        for episode, frame in enumerate(frames):
            frame.to_parquet(data / f"episode_{episode:06d}.parquet")
    else:
        pd.concat(frames).to_parquet(data / "file-000.parquet")
    return dataset / "episode_000001"


def ulog(folder: Path, begin_us: int = 0) -> Path:
    def record(kind: bytes, payload: bytes) -> bytes:
        return struct.pack("<Hc", len(payload), kind) + payload

    path = folder / "flight.ulg"
    form = b"vehicle_attitude:uint64_t timestamp;float[2] q;"
    content = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", begin_us)
    content += record(b"B", bytes(40)) + record(b"F", form)
    content += record(b"A", struct.pack("<BH", 0, 0) + b"vehicle_attitude")
    for time_s, value in zip(TIMES_S, SIGNAL, strict=True):
        row = struct.pack("<HQff", 0, int(time_s * 1e6), value, -value)
        content += record(b"D", row)
    path.write_bytes(content)
    return path


def dataflash(folder: Path, field: bytes = b"TimeUS", unit_s: float = 1e-6) -> Path:
    head = b"\xa3\x95"

    def form(kind: int, size: int, name: bytes, types: bytes, columns: bytes) -> bytes:
        return head + struct.pack("<BBB4s16s64s", 128, kind, size, name, types, columns)

    path = folder / "flight.bin"
    content = form(128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    content += form(129, 3 + 8 + 4, b"ATT", b"Qf", field + b",Roll")
    for time_s, value in zip(TIMES_S, SIGNAL, strict=True):
        content += head + struct.pack("<BQf", 129, round(time_s / unit_s), value)
    path.write_bytes(content)
    return path


def packet(time_s: float, message: Any, *sender: int, version: int = 2) -> bytes:
    """Return a message of MAVLink as ground stations log it."""
    parser = mavlink.MAVLink(None, *sender)
    packed: bytes = message.pack(parser, force_mavlink1=version == 1)
    return struct.pack(">Q", BEGIN_US + round(time_s * 1e6)) + packed


def telemetry(folder: Path, version: int = 2) -> Path:
    path = folder / "flight.tlog"
    attitudes = [
        packet(
            time_s, mavlink.MAVLink_attitude_message(0, value, *[0.5] * 5), 1, 1, version=version
        )
        for time_s, value in zip(TIMES_S, SIGNAL, strict=True)
    ]
    path.write_bytes(b"".join(attitudes))
    return path


def attitude(value: float) -> dict[str, Any]:
    return {"angles": {"roll": value}}


def mcap_json(folder: Path, content: Callable[[float], dict[str, Any]] = attitude) -> Path:
    path = folder / "flight.mcap"
    with path.open("wb") as sink:
        writer = Writer(sink)
        writer.start()
        schema = writer.register_schema("Attitude", "jsonschema", b"{}")
        channel = writer.register_channel("/attitude", "json", schema)
        for time_s, value in zip(TIMES_S, SIGNAL, strict=True):
            data = json.dumps(content(float(value))).encode()
            writer.add_message(channel, int(time_s * 1e9), data, int(time_s * 1e9))
        writer.finish()
    return path


def mcap_protobuf(folder: Path) -> Path:
    file = descriptor_pb2.FileDescriptorProto(name="attitude.proto", package="robot")
    file.syntax = "proto3"
    message = file.message_type.add(name="Attitude")
    message.field.add(name="roll", number=1, type=1, label=1)  # an optional double
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    attitude = message_factory.GetMessageClass(pool.FindMessageTypeByName("robot.Attitude"))
    path = folder / "flight.mcap"
    with path.open("wb") as sink:
        writer = Writer(sink)
        writer.start()
        definitions = descriptor_pb2.FileDescriptorSet(file=[file])
        schema = writer.register_schema(
            "robot.Attitude", "protobuf", definitions.SerializeToString()
        )
        channel = writer.register_channel("/attitude", "protobuf", schema)
        for time_s, value in zip(TIMES_S, SIGNAL, strict=True):
            data = attitude(roll=value).SerializeToString()
            writer.add_message(channel, int(time_s * 1e9), data, int(time_s * 1e9))
        writer.finish()
    return path


#: By kind: how it is written, and topic and column of the signal.
SAMPLES: dict[str, tuple[Callable[[Path], Path], str, str]] = {
    "csv": (csv, "/log", "roll"),
    "parquet": (parquet, "/log", "roll"),
    "lerobot": (lerobot, "/observation/state", "pan"),
    "ulog": (ulog, "/vehicle_attitude", "q"),
    "dataflash": (dataflash, "/ATT", "Roll"),
    "telemetry": (telemetry, "/ATTITUDE", "roll"),
    "mcap_json": (mcap_json, "/attitude", "angles_roll"),
    "mcap_protobuf": (mcap_protobuf, "/attitude", "roll"),
}
