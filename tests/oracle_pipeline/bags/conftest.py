"""Small bags, made with the writer under test or with rosbags itself."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)

from oracle_pipeline.bags.types import message_class, serialize, typestore
from oracle_pipeline.bags.writer import BagWriter

CLOCK = "rosgraph_msgs/msg/Clock"
STRING = "std_msgs/msg/String"

_FOREIGN = os.environ.get("ORACLE_FOREIGN_BAGS")
FOREIGN_BAGS = sorted(Path(_FOREIGN).glob("*/metadata.yaml")) if _FOREIGN else []


def clock(seconds: int) -> bytes:
    time = message_class("builtin_interfaces/msg/Time")(seconds, 0)
    return serialize(message_class(CLOCK)(time), CLOCK)


def text(content: str) -> bytes:
    return serialize(message_class(STRING)(content), STRING)


@pytest.fixture
def qos() -> Callable[..., Qos]:
    forever = QosTime(9223372036, 854775807)

    def build(depth: int = 10) -> Qos:
        return Qos(
            QosHistory.KEEP_LAST, depth, QosReliability.RELIABLE, QosDurability.VOLATILE,
            forever, forever, QosLiveliness.AUTOMATIC, forever, False,
        )  # fmt: skip

    return build


@pytest.fixture
def write_bag(qos: Callable[..., Qos]) -> Callable[..., Path]:
    """Write twenty clock and twenty string messages, a tenth of a second apart."""

    def write(path: Path, storage: str = "mcap") -> Path:
        with BagWriter(path, storage) as bag:
            bag.add_topic("/clock", CLOCK, [qos(1)])
            bag.add_topic("/chatter", STRING, [qos(10), qos(5)])
            for number in range(20):
                bag.write("/clock", number * 100_000_000, clock(number))
                bag.write("/chatter", number * 100_000_000, text(f"message {number}"))
        return path

    return write


@pytest.fixture(params=[*FOREIGN_BAGS, "own mcap", "own sqlite3"], ids=lambda p: str(p)[-40:])
def any_bag(request: pytest.FixtureRequest, write_bag: Callable[..., Path], tmp_path: Path) -> Path:
    """Each available bag: foreign ones, if there are any, and two of our own."""
    if isinstance(request.param, Path):
        return request.param.parent
    return write_bag(tmp_path / "bag", request.param.split()[1])


@pytest.fixture(scope="session")
def zero_message() -> Callable[[str], object]:
    """Return a function that makes a message of any type, all fields zero or empty."""
    store = typestore()

    def value(kind: tuple) -> object:
        tag, rest = int(kind[0]), kind[1]
        if tag == 1:
            return {"string": "", "bool": False}.get(rest[0], 0)
        if tag == 2:
            return zero(rest)
        (inner_tag, inner), size = rest
        count = size if tag == 3 else 0
        if int(inner_tag) == 1 and inner[0] != "string":
            kinds = {"byte": "uint8", "octet": "uint8", "char": "uint8"}
            return np.zeros(count, dtype=kinds.get(inner[0], inner[0]))
        return [value((inner_tag, inner)) for _ in range(count)]

    def zero(msgtype: str) -> object:
        fields = store.get_msgdef(msgtype).fields
        return store.types[msgtype](*[value(kind) for _, kind in fields])

    return zero
