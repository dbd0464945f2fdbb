"""The content hash, which is equal for recordings with the same messages."""

import hashlib
import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


class ContentHash:
    """SHA-256 over (topic, type, stamp, payload) of messages, in the order given."""

    def __init__(self) -> None:
        self._sha256 = hashlib.sha256()
        self._update = self._sha256.update
        self._pack = struct.Struct("<qQ").pack

    def add(self, prefix: bytes, stamp_ns: int, data: bytes) -> None:
        """Add one message; ``prefix`` is the result of `ContentHash.prefix` for its topic."""
        self._update(prefix + self._pack(stamp_ns, len(data)) + data)

    def add_many(
        self,
        prefixes: Sequence[bytes],
        stamps: Sequence[int] | NDArray[np.int64],
        payloads: Sequence[bytes],
    ) -> None:
        """Add several messages, in the order given."""
        tails = np.empty((len(payloads), 2), "<i8")
        tails[:, 0] = stamps
        tails[:, 1] = np.fromiter(map(len, payloads), np.int64, len(payloads))
        data, size = tails.tobytes(), tails.itemsize * 2
        parts = [b""] * (3 * len(payloads))
        parts[0::3] = prefixes
        parts[1::3] = [data[at : at + size] for at in range(0, len(data), size)]
        parts[2::3] = payloads
        self._update(b"".join(parts))

    @staticmethod
    def prefix(topic: str, msgtype: str) -> bytes:
        """Return the part of the hashed bytes that all messages of a topic share."""
        return f"{topic}\0{msgtype}\0".encode()

    def hexdigest(self) -> str:
        """Return the hash of all messages so far."""
        return self._sha256.hexdigest()
