"""The message types of one recording: its own definitions first, then built-in ones.

A definition is text of unknown origin. Its size, and the number of fields it expands to, are
limited before code is generated from it.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from oracle_pipeline.bags import types
from oracle_pipeline.bags.errors import BagError, one_line
from oracle_pipeline.bags.limits import LARGEST_DEFINITION, MOST_FIELDS
from oracle_pipeline.bags.part import Channel
from oracle_pipeline.bags.types import TypeDefinition

_PREPROCESSED = re.compile(r"^[ \t]*#.*$", re.MULTILINE)  # lines for a C preprocessor
_SEPARATOR = "=" * 80 + "\n"  # between the files of a definition


class BagTypes:
    """Decoders for each type of a recording.

    Parameters
    ----------
    path : Path
        Of the recording, for error messages.
    channels : iterable of Channel
        All channels in its files.
    type_hashes : mapping of str to str
        By type, for files that do not store them.
    """

    def __init__(
        self, path: Path, channels: Iterable[Channel], type_hashes: Mapping[str, str]
    ) -> None:
        self._path = path
        self._type_hashes = type_hashes
        self._channels: dict[str, Channel] = {}
        for channel in channels:
            known = self._channels.get(channel.msgtype)
            if known is None or (channel.definition and not known.definition):
                self._channels[channel.msgtype] = channel
        self._own = get_typestore(Stores.EMPTY)
        self._stores: dict[str, Typestore | BagError] = {}

    def decoder(self, msgtype: str) -> Callable[[bytes, str], Any]:
        """Return the function that decodes a type's bytes."""
        store = self.store(msgtype)
        is_ros1 = self._channels[msgtype].encoding == "ros1"
        return store.deserialize_ros1 if is_ros1 else store.deserialize_cdr

    def definition(self, msgtype: str) -> TypeDefinition:
        """Return a type's definition from the bag, or else the built-in one."""
        channel = self._channels[msgtype]
        text = channel.definition
        if not text and msgtype in types.typestore().fielddefs:
            return TypeDefinition(types.definition(msgtype), types.type_hash(msgtype))
        if channel.definition_format == "idl" and not text.startswith(_SEPARATOR):
            text = f"{_SEPARATOR}IDL: {msgtype}\n{text}"  # or it would be parsed as .msg
        return TypeDefinition(text, channel.type_hash or self._type_hashes.get(msgtype, ""))

    def store(self, msgtype: str) -> Typestore:
        """Return the store that defines a type.

        Raises
        ------
        BagError
            If its definition is unusable, or neither in the bag nor known to us.
        """
        if msgtype not in self._stores:
            try:
                self._stores[msgtype] = self._find(msgtype)
            except BagError as error:
                self._stores[msgtype] = error
        found = self._stores[msgtype]
        if isinstance(found, BagError):
            raise found
        return found

    def _find(self, msgtype: str) -> Typestore:
        channel = self._channels[msgtype]
        if channel.encoding not in ("cdr", "ros1"):
            raise BagError(
                f"{self._path} has {msgtype or 'messages'} encoded as {channel.encoding!r}; only "
                "CDR and ROS 1's encoding are decoded. Its messages can only be read raw."
            )
        known = msgtype in types.typestore().fielddefs
        # Real bags hold an empty text for action types, whose files rosbag2 does not find.
        if known and channel.definition in ("", types.definition(msgtype)):
            return types.typestore()
        if channel.definition:
            try:
                return self._registered(channel, msgtype)
            except Exception as error:  # the text of a definition may be anything
                if known:  # genpy broke comments that have a backslash
                    return types.typestore()
                raise BagError(
                    f"{self._path} has an unusable definition of {msgtype}: {one_line(error)}. "
                    "Its messages can only be read raw."
                ) from error
        if known:
            return types.typestore()
        if not msgtype:
            raise BagError(f"{self._path} has messages without a type; they can only be read raw.")
        raise BagError(
            f"{self._path} has no definition of {msgtype}, and it is not among the types that we "
            "know. Record as MCAP, which keeps definitions, or add it to oracle_pipeline/bags/msg."
        )

    def _registered(self, channel: Channel, msgtype: str) -> Typestore:
        """Register the definition of a type; return the store that contains it."""
        if len(channel.definition) > LARGEST_DEFINITION:
            raise ValueError(f"it is longer than {LARGEST_DEFINITION} (LARGEST_DEFINITION)")
        return self._filled(self._own, _parse(channel, msgtype), msgtype)

    def _with_known(self, parsed: dict[str, Any], store: Typestore) -> dict[str, Any]:
        """Return definitions plus the built-in ones that they use and a store lacks."""
        used = _used(parsed) - parsed.keys() - store.fielddefs.keys()
        ours = types.typestore().fielddefs
        return parsed | {name: ours[name] for name in sorted(used & ours.keys())}

    def _filled(self, store: Typestore, parsed: dict[str, Any], msgtype: str) -> Typestore:
        """Return a store with a type and all types that it uses."""
        parsed = self._with_known(parsed, store)
        if any(parsed[name] != store.fielddefs.get(name, parsed[name]) for name in parsed):
            store = get_typestore(Stores.EMPTY)  # another topic's type of the same name differs
            parsed = self._with_known(parsed, store)
        _check_size(msgtype, {**store.fielddefs, **parsed})
        store.register(parsed)
        return store


def _parse(channel: Channel, msgtype: str) -> dict[str, Any]:
    definition = channel.definition.lstrip("\ufeff").replace("\r\n", "\n").replace("\r", "\n")
    if channel.definition_format != "idl":
        # The parser does not accept the names of services.
        name = msgtype.replace("/srv/", "/msg/")
        parsed = dict(get_types_from_msg(definition, name))
        return {msgtype: parsed.pop(name), **parsed}
    found: dict[str, Any] = {}
    for part in definition.split(_SEPARATOR):
        # rosbag2 puts "IDL: <name>" above each file of a definition; plain IDL has no such line.
        text = part.partition("\n")[2] if part.startswith("IDL: ") else part
        text = _PREPROCESSED.sub("", text)
        if text.strip():
            found.update(get_types_from_idl(text))
    return {_plain(name): _undecorated(name, fields) for name, fields in found.items()}


def _plain(name: str) -> str:
    """Return the name of a type without the parts that ROS adds for DDS, ``p/msg/dds_/A_``."""
    return name.replace("/dds_/", "/").removesuffix("_") if "/dds_/" in name else name


def _undecorated(name: str, defined: Any) -> Any:
    """Return the fields of a type with the names that they have in ROS."""
    constants, fields = defined
    if "/dds_/" not in name:
        return defined

    def known(kind: Nodetype, what: Any) -> tuple[Nodetype, Any]:
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            return kind, (known(*what[0]), what[1])
        return kind, _plain(what) if kind == Nodetype.NAME else what

    return constants, [(field.removesuffix("_"), known(*each)) for field, each in fields]


def _kinds(fields: Any) -> Iterable[tuple[Any, int | None]]:
    """Yield base type or type name of each field, and its count; None if it varies by message."""
    for _, (kind, what) in fields:
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            yield what[0], what[1] if kind == Nodetype.ARRAY else None
        else:
            yield (kind, what), 1


def _used(parsed: dict[str, Any]) -> set[str]:
    return {
        what
        for _, fields in parsed.values()
        for (kind, what), _ in _kinds(fields)
        if kind == Nodetype.NAME
    }


def _check_size(msgtype: str, defined: dict[str, Any]) -> None:
    """Refuse a type that contains itself, or that expands to more fields than any real one."""
    sizes: dict[str, int] = {}
    under_way: set[str] = set()

    def unfolded(name: str) -> int:
        if name in under_way:
            raise ValueError(f"{name} contains itself")
        if name not in defined:
            raise ValueError(f"it uses {name}, which neither the bag nor we define")
        if name not in sizes:
            under_way.add(name)
            fields = 0
            for (kind, what), times in _kinds(defined[name][1]):
                if kind != Nodetype.NAME:
                    fields += 1
                    continue
                inside = unfolded(what)
                if times is None and not inside:
                    raise ValueError(f"{name} has a sequence of {what}, which has no field")
                fields += max(1, inside) * (1 if times is None else times)
            under_way.remove(name)
            sizes[name] = fields
        if sizes[name] > MOST_FIELDS:
            raise ValueError(f"{name} unfolds to more than {MOST_FIELDS} fields (MOST_FIELDS)")
        return sizes[name]

    unfolded(msgtype)
