"""The hash by which two recordings are known to hold the same messages."""

import hashlib
import struct


class ContentHash:
    """SHA-256 over (topic, type, stamp, payload) of messages, in the order given."""

    def __init__(self) -> None:
        self._sha256 = hashlib.sha256()
        self._update = self._sha256.update
        self._pack = struct.Struct("<qQ").pack

    def add(self, prefix: bytes, stamp_ns: int, data: bytes) -> None:
        """Add one message; ``prefix`` is what ``prefix`` returned for its topic."""
        self._update(prefix + self._pack(stamp_ns, len(data)) + data)

    @staticmethod
    def prefix(topic: str, msgtype: str) -> bytes:
        """Return the part of the hashed bytes that all messages of a topic share."""
        return f"{topic}\0{msgtype}\0".encode()

    def hexdigest(self) -> str:
        """Return the hash of all messages so far."""
        return self._sha256.hexdigest()
