"""MAVLink telemetry of PX4, ArduPilot and others, by pymavlink: each type of message is a topic."""

import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from oracle_pipeline.logs.dataflash import TIME, log_of
from oracle_pipeline.logs.log import Log, reading

_AUTOPILOT = 1  # number of that component
_STAMP = 8  # bytes before each packet: microseconds since 1970
_BEGIN = re.compile(rb"[\xfd\xfe]..", re.DOTALL)  # version, size of the content, flags
_SECOND = 0xFD  # version
_AROUND, _SIGNED, _SIGNATURE = {_SECOND: 12, 0xFE: 8}, 1, 13  # bytes around the content; a flag
# Unknown types, parameters, files and data for others: no signals.
_SKIPPED = re.compile("UNKNOWN|PARAM_|FILE_|LOG_|SERIAL_|TUNNEL|ENCAPSULATED_|GPS_(RTCM|INJECT)_")


def read_telemetry(path: Path) -> Log:
    """Read a ``.tlog`` file, as ground stations write it.

    Topics have the names of messages, ``/ATTITUDE``; those of several sensors are numbered,
    ``/BATTERY_STATUS_0``. What others than the vehicle's autopilot sent has their system and
    component in its name, ``/HEARTBEAT_255_190``. Times are those of the ground station.

    Raises
    ------
    LogError
        If the file is damaged or holds no messages.
    """
    rows: dict[str, list[dict[str, Any]]] = defaultdict(list)
    vehicle: tuple[int, int] | None = None  # system and component of the first autopilot
    taken = 0
    with reading(path, "MAVLink telemetry"):
        content = path.read_bytes()
        for stamp_us, message in _messages(content):
            taken += _STAMP + len(message.get_msgbuf())
            if not _SKIPPED.match(message.get_type()):
                fields = message.to_dict() | {TIME: stamp_us}
                sender = message.get_srcSystem(), message.get_srcComponent()
                if vehicle is None and sender[1] == _AUTOPILOT:
                    vehicle = sender
                name = [fields.pop("mavpackettype"), *(() if sender == vehicle else sender)]
                if message.instance_field:
                    name.append(fields.pop(message.instance_field))
                rows["/" + "_".join(map(str, name))].append(fields)
    found = log_of(path, rows)
    if lost := len(content) - taken:
        found.notes.append(f"{lost} bytes are damaged or cut off and are not used.")
    return found


def _messages(content: bytes) -> Iterator[tuple[int, Any]]:
    """Yield the stamp [us since 1970] of each message, and the message; skip what is damaged."""
    parser = mavlink.MAVLink(None)
    begin = _BEGIN.search(content, _STAMP)
    while begin:
        at, (kind, size, flags) = begin.start(), begin[0]
        size += _AROUND[kind] + _SIGNATURE * (kind == _SECOND and flags & _SIGNED)
        try:
            message = parser.decode(bytearray(content[at : at + size]))
        except mavlink.MAVError:
            at += 1
        else:
            yield int.from_bytes(content[at - _STAMP : at]), message
            at += size + _STAMP
        begin = _BEGIN.search(content, at)
