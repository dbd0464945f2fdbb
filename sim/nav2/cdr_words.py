"""CDR as words of four bytes, for messages that compiled code lays out.

Every field of such a message is four or eight bytes long or is padded to that. Doubles begin at
even words, counted from the end of the encapsulation.
"""

import struct

import numpy as np
from numpy.typing import NDArray

from sim.jit import jit

CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"  # the encapsulation, before the first word


def _string_words(text: str) -> NDArray[np.uint32]:
    """Return a string: its length, then its bytes and a zero, padded."""
    data = text.encode() + b"\0"
    return _words(struct.pack("<I", len(data)) + data)


def header_words(time_ns: int, frame: str) -> NDArray[np.uint32]:
    """Return a ``std_msgs/msg/Header``."""
    stamp = _words(struct.pack("<iI", *divmod(time_ns, 1_000_000_000)))
    return np.append(stamp, _string_words(frame))


def _words(data: bytes) -> NDArray[np.uint32]:
    """Return bytes as words of four, the last one padded: how CDR aligns whatever comes next."""
    return np.frombuffer(data.ljust(-4 * (-len(data) // 4), b"\0"), np.uint32)


@jit
def put(words: NDArray[np.uint32], at: int, part: NDArray[np.uint32]) -> int:
    """Write a part and return where it ends."""
    end = at + len(part)
    words[at:end] = part
    return end
