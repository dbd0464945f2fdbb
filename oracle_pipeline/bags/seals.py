"""A hash inside the file that it protects, so that any change of the file is noticed.

The writer puts ``BLANK`` somewhere into the file, then fills in the SHA-256 of the whole file as it
is then. A reader computes that hash again, with zeros in the place of the seal. So the
file and its hash are replaced in one step, and are copied together.
"""

import hashlib
from typing import Literal, TypeAlias

_MARK = b"oracle-sha256:"
_ZEROS = b"0" * 64
BLANK = (_MARK + _ZEROS).decode()

State: TypeAlias = Literal["right", "wrong", "absent"]


def seal(content: bytearray) -> None:
    """Fill in the seal of a file that has a blank one; the last one, if there are several."""
    place = _place(content)
    if place is None or content[place] != _ZEROS:
        raise ValueError("there is no blank seal to fill in")
    content[place] = _digest(content, place)


def check(content: bytes) -> State:
    """Return whether a file is unchanged since it was sealed; ``absent`` if it has no seal."""
    place = _place(content)
    if place is None:
        return "absent"
    return "right" if content[place] == _digest(content, place) else "wrong"


def _place(content: bytes | bytearray) -> slice | None:
    mark = content.rfind(_MARK)
    start = mark + len(_MARK)
    return None if mark < 0 else slice(start, start + len(_ZEROS))


def _digest(content: bytes | bytearray, place: slice) -> bytes:
    with memoryview(content) as view:
        digest = hashlib.sha256(view[: place.start])
        digest.update(_ZEROS)
        digest.update(view[place.stop :])
    return digest.hexdigest().encode()
