"""Parses the built-in message types from ROS's own interface files.

Humble's are those of rosbags. The ones that it lacks are below ``oracle_pipeline/bags/msg/``:
``<package>/msg/*.msg``, ``<package>/srv/*.srv`` and ``<package>/action/*.action``; a service or
action file yields the messages that ROS derives from it (``NavigateToPose_Goal``,
``NavigateToPose_FeedbackMessage``).

``python -m tools.message_types`` writes ``fields.json`` for
``oracle_pipeline.bags.types``.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

_PACKAGE = Path(__file__).parents[1] / "oracle_pipeline" / "bags"
# IDL has no empty struct, so ROS puts this byte into messages without fields.
_EMPTY = "uint8 structure_needs_at_least_one_member\n"


def parsed() -> dict[str, Any]:
    """Return the fields of all types, by name, as rosbags has them."""
    ours = {
        name: fields
        for package in _PACKAGE.joinpath("msg").iterdir()
        for folder in package.iterdir()
        for file in folder.iterdir()
        for msgtype, text in _messages_of(package.name, folder.name, file)
        for name, fields in _parse(msgtype, text).items()
    }
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(ours)
    return dict(store.fielddefs)


def as_text(fields: dict[str, Any]) -> str:
    """Return the fields of types as JSON, one type per line."""
    lines = [f"{json.dumps(name)}: {json.dumps(fields[name])}" for name in sorted(fields)]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _messages_of(package: str, folder: str, file: Path) -> Iterator[tuple[str, str]]:
    """Yield name and text of every message that one interface file defines."""
    name = f"{package}/{folder}/{file.name.partition('.')[0]}"
    parts = [part.strip() + "\n" for part in f"\n{file.read_text('utf8')}\n".split("\n---\n")]
    parts = [_EMPTY if part == "\n" else part for part in parts]
    if folder == "msg":
        yield name, parts[0]
    elif folder == "srv":
        yield from zip((f"{name}_Request", f"{name}_Response"), parts, strict=True)
    else:
        goal, result, feedback = (f"{name}_{part}" for part in ("Goal", "Result", "Feedback"))
        uuid = "unique_identifier_msgs/msg/UUID goal_id\n"
        yield from zip((goal, result, feedback), parts, strict=True)
        yield f"{name}_FeedbackMessage", f"{uuid}{feedback} feedback\n"
        yield f"{name}_SendGoal_Request", f"{uuid}{goal} goal\n"
        yield (f"{name}_SendGoal_Response", "bool accepted\nbuiltin_interfaces/msg/Time stamp\n")
        yield f"{name}_GetResult_Request", uuid
        yield f"{name}_GetResult_Response", f"int8 status\n{result} result\n"


def _parse(msgtype: str, text: str) -> dict[str, Any]:
    """Parse one message; the parser rejects ``srv`` names, so they are passed as ``msg``."""
    (fields,) = get_types_from_msg(text, msgtype.replace("/srv/", "/msg/")).values()
    return {msgtype: fields}


if __name__ == "__main__":
    _PACKAGE.joinpath("fields.json").write_text(as_text(parsed()), encoding="utf-8")
