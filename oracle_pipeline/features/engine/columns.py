"""Messages of one type as one object whose fields are arrays.

The offset of each field is computed for all messages together: after fields of fixed size it is
the same, after a string or a sequence it differs by message. Only accessed fields are read.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple, Protocol, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from oracle_pipeline.bags.cdr import DTYPES, ENCAPSULATION, is_number
from oracle_pipeline.bags.jit import jit

_Ints: TypeAlias = NDArray[np.int64]
_Place: TypeAlias = "int | _Ints"  # offset after the encapsulation [B]; of all messages, or of each

_HEADER = "std_msgs/msg/Header"
_ENCAPSULATION = len(ENCAPSULATION)
_PADDING = 3  # maximum of bytes after a message in CDR
_TURNS = 2  # elements that are gone through before the others are taken to be as long
_READ_BEYOND = bytes(16)  # so that every read is inside the buffer

_DTYPES = {**DTYPES, "byte": DTYPES["uint8"]}  # a byte has no sign, as rosbags decodes it


class _Number(NamedTuple):
    dtype: np.dtype[Any]
    at: _Place


class _Text(NamedTuple):
    at: _Place
    sizes: _Place


class _Numbers(NamedTuple):
    dtype: np.dtype[Any]
    at: _Place
    counts: _Place
    is_fixed: bool  # the length is part of the type


class _Parts(NamedTuple):
    nodes: "dict[str, _Node]"


class _Elements(NamedTuple):
    kind: Any
    starts: _Ints  # of each element
    owners: _Ints  # number of its message


_Node: TypeAlias = _Number | _Text | _Numbers | _Parts | _Elements


@dataclass(slots=True)
class _Buffer:
    """Bytes of messages, concatenated."""

    data: bytes
    starts: _Ints  # of each message, after its encapsulation
    sizes: _Ints  # of each message, without it
    is_cdr: bool
    store: Typestore
    views: dict[np.dtype[Any], NDArray[Any]] = field(default_factory=dict)

    def read(self, dtype: np.dtype[Any], at: _Place) -> NDArray[Any]:
        """Return a number of each message; several if the offset has a row for each of them."""
        if dtype not in self.views:
            count = len(self.data) - dtype.itemsize + 1
            self.views[dtype] = np.ndarray((count,), dtype, self.data, strides=(1,))
        view = self.views[dtype]
        numbers: NDArray[Any] = view[np.minimum((self.starts + at).T, len(view) - 1)]
        return numbers

    def of(self, rows: _Ints) -> "_Buffer":
        """Return a buffer of some messages, with repetitions if ``rows`` has them."""
        some = self.starts[rows], self.sizes[rows]
        return _Buffer(self.data, *some, self.is_cdr, self.store, self.views)


class Columns:
    """Messages of one type; an attribute for each field, with a row for each message.

    A number is an array of float64 or of whole numbers, shape (n,); a string an array of ``str``;
    an array of fixed length has shape (n, length); a sequence of numbers is an array of n arrays,
    a sequence of strings an array of n tuples; a nested message is again ``Columns``. So is a
    sequence of messages, which has a row for each element and ``owners``.

    Attributes
    ----------
    owners : ndarray of shape (n,)
        For elements, the indices of the messages that contain them.
    """

    def __init__(self, buffer: _Buffer, nodes: dict[str, _Node], owners: _Ints) -> None:
        self._buffer = buffer
        self._nodes = nodes
        self.owners = owners

    def __len__(self) -> int:
        return len(self._buffer.starts)

    def __getattr__(self, name: str) -> Any:
        try:
            node = self._nodes[name]
        except KeyError:
            raise AttributeError(f"the messages have no field {name!r}") from None
        value = self._value(node)
        setattr(self, name, value)
        return value

    @property
    def first_array(self) -> NDArray[np.object_] | None:
        """The first sequence of floating-point numbers of each message; None without any."""
        for name, node in self._nodes.items():
            if isinstance(node, _Numbers) and not node.is_fixed and node.dtype.kind == "f":
                return cast(NDArray[np.object_], getattr(self, name))
            if isinstance(node, _Parts) and (found := getattr(self, name).first_array) is not None:
                return cast(NDArray[np.object_], found)
        return None

    def _value(self, node: _Node) -> Any:
        buffer = self._buffer
        match node:
            case _Parts(nodes):
                return Columns(buffer, nodes, self.owners)
            case _Elements(kind, starts, owners):
                of_element = buffer.of(owners)
                found, _ = _Walk(of_element).to(kind, starts)
                nodes = found.nodes if isinstance(found, _Parts) else {}
                elements = Columns(of_element, nodes, owners)
                if isinstance(found, _Parts):
                    return elements
                return _grouped(elements._value(found), owners, len(self))
            case _Number(dtype, at):
                return _wide(buffer.read(dtype, at))
            case _Text(at, sizes):
                return _texts(buffer.data, buffer.starts + at, sizes + np.zeros_like(buffer.starts))
            case _Numbers(dtype, at, int(count), is_fixed=True):
                places = np.arange(count)[:, None] * dtype.itemsize
                return _wide(buffer.read(dtype, at + places))
            case _Numbers(dtype, at, counts):
                return _arrays(
                    buffer.data, dtype, buffer.starts + at, counts + np.zeros_like(buffer.starts)
                )


class ColumnSource(Protocol):
    """Messages of one topic that are available as columns."""

    data: Sequence[bytes]  # of each message

    def columns(self) -> Any:
        """Return the messages as columns."""
        ...

    def some(self, rows: _Ints) -> "ColumnSource":
        """Return some of the messages."""
        ...


class SerializedMessages:
    """Messages of one type, concatenated; implements `ColumnSource` if all are whole.

    Parameters
    ----------
    data : list of bytes
        Of each message.
    store : Typestore
        Has the definition of the type.
    msgtype : str
        Of the messages.
    is_cdr : bool
        False for ROS 1's encoding.
    """

    def __init__(
        self, data: Sequence[bytes], store: Typestore, msgtype: str, *, is_cdr: bool
    ) -> None:
        before = _ENCAPSULATION if is_cdr else 0
        sizes = np.array([len(each) for each in data], dtype=np.int64)
        starts = np.cumsum(sizes) - sizes + before
        whole = b"".join([*data, _READ_BEYOND])
        self.data = data
        self._buffer = _Buffer(whole, starts, sizes - before, is_cdr, store)
        self._kind = Nodetype.NAME, msgtype
        self._little = np.ones(len(data), dtype=np.bool_)
        if is_cdr and len(data):
            encapsulation = self._buffer.read(_DTYPES["uint16"], -_ENCAPSULATION)
            self._little = (encapsulation == 0x0100) & (sizes >= _ENCAPSULATION)

    @cached_property
    def _walked(self) -> tuple[_Node, NDArray[np.bool_]]:
        walk = _Walk(self._buffer)
        node, end = walk.to(self._kind, 0)
        padding = _PADDING if self._buffer.is_cdr else 0
        left = self._buffer.sizes - end
        return node, self._little & walk.whole & (left >= 0) & (left <= padding)

    @property
    def whole(self) -> NDArray[np.bool_]:
        """Which messages are little-endian and exactly as long as their fields."""
        return self._walked[1]

    def some(self, rows: _Ints) -> "SerializedMessages":
        """Return some of the messages."""
        data = [self.data[row] for row in rows.tolist()]
        buffer = self._buffer
        return SerializedMessages(data, buffer.store, self._kind[1], is_cdr=buffer.is_cdr)

    def columns(self) -> Columns:
        """Return the messages as columns."""
        node, _ = self._walked
        assert isinstance(node, _Parts)  # noqa: S101 -- a message is no number
        return Columns(self._buffer, node.nodes, np.arange(len(self._buffer.starts)))


class _Walk:
    """Goes through the fields of all messages of a buffer at once."""

    def __init__(self, buffer: _Buffer) -> None:
        self._buffer = buffer
        self.whole = np.ones(len(buffer.starts), dtype=np.bool_)

    def to(self, kind: Any, at: _Place) -> tuple[_Node, _Place]:
        """Return the location of a field, and the offset of its end."""
        what: Any
        of, what = kind
        if of == Nodetype.NAME:
            nodes: dict[str, _Node] = {}
            if what == _HEADER and not self._buffer.is_cdr:
                at = at + 4  # sequence number of ROS 1
            for name, each in self._buffer.store.fielddefs[what][1]:
                nodes[name], at = self.to(each, at)
            return _Parts(nodes), at
        if of == Nodetype.BASE:
            if what[0] == "string":
                sizes, at = self._count(at, 1)
                if self._buffer.is_cdr:
                    last = self._buffer.read(_DTYPES["uint8"], at + sizes - 1)
                    self.whole &= (last == 0) & (np.asarray(sizes) > 0)
                return _Text(at, sizes), at + sizes
            dtype = _DTYPES[what[0]]
            at = self._aligned(at, dtype.itemsize)
            return _Number(dtype, at), at + dtype.itemsize
        element, count = what
        if is_number(element):
            return self._numbers(element, None if of == Nodetype.SEQUENCE else count, at)
        counts: _Place = count
        if of == Nodetype.SEQUENCE:
            counts, at = self._count(at, 1)
        return self._elements(element, counts, at)

    def _numbers(self, element: Any, count: int | None, at: _Place) -> tuple[_Node, _Place]:
        dtype = _DTYPES[element[1][0]]
        counts: _Place
        if count is None:
            counts, at = self._count(at, dtype.itemsize)
            # An empty sequence has no element to align.
            at = _same(np.where(counts > 0, self._aligned(at, dtype.itemsize), at))
        else:
            counts, at = count, self._aligned(at, dtype.itemsize)
        return _Numbers(dtype, at, counts, count is not None), at + counts * dtype.itemsize

    def _elements(self, element: Any, counts: _Place, at: _Place) -> tuple[_Node, _Place]:
        """Go from element to element, in all messages at once."""
        count = counts + np.zeros_like(self._buffer.starts)
        ends = at + np.zeros_like(self._buffer.starts)
        starts, owners = [], []
        rows = np.flatnonzero(self.whole & (count > 0))
        turn = 0
        while len(rows):
            turn += 1
            starts.append(ends[rows])
            owners.append(rows)
            after, fits = self._after(element, rows, ends[rows])
            length, ends[rows] = after - ends[rows], after
            self.whole[rows[~fits]] = False
            left = fits & (count[rows] > turn)
            rows, length = rows[left], length[left]
            if turn == _TURNS:
                places, of = self._equal(element, rows, ends[rows], length, count[rows] - turn)
                starts.append(places)
                owners.append(of)
                equal = np.isin(rows, of)
                ends[rows[equal]] += (length * (count[rows] - turn))[equal]
                rows = rows[~equal]
        owner = np.concatenate([np.zeros(0, np.int64), *owners])
        order = np.argsort(owner, kind="stable")
        start = np.concatenate([np.zeros(0, np.int64), *starts])[order]
        return _Elements(element, start, owner[order]), _same(ends)

    def _after(self, element: Any, rows: _Ints, at: _Ints) -> tuple[_Ints, NDArray[np.bool_]]:
        """Return the offset after an element of each of some messages, and which are whole."""
        walk = _Walk(self._buffer.of(rows))
        after = walk.to(element, at)[1] + np.zeros_like(at)
        return after, walk.whole & (after <= self._buffer.sizes[rows])

    def _equal(
        self, element: Any, rows: _Ints, at: _Ints, length: _Ints, count: _Ints
    ) -> tuple[_Ints, _Ints]:
        """Return the offsets of all elements, and their messages, where all have one length."""
        count = np.where(at + length * count <= self._buffer.sizes[rows], count, 0)
        place = np.repeat(np.arange(len(rows)), count)
        number = np.arange(len(place)) - np.repeat(np.cumsum(count) - count, count)
        places = at[place] + length[place] * number
        after, fits = self._after(element, rows[place], places)
        differ = np.bincount(place, ~fits | (after != places + length[place]), len(rows))
        kept = differ[place] == 0
        return places[kept], rows[place[kept]]

    def _count(self, at: _Place, size: int) -> tuple[_Place, _Place]:
        """Read the length of a sequence or string whose elements take at least ``size`` bytes."""
        at = self._aligned(at, 4)
        counts = self._buffer.read(_DTYPES["uint32"], at).astype(np.int64)
        fits = at + 4 + counts * size <= self._buffer.sizes
        self.whole &= fits
        return _same(np.where(fits, counts, 0)), at + 4

    def _aligned(self, at: _Place, size: int) -> _Place:
        return at + (-at & size - 1) if self._buffer.is_cdr else at  # sizes are powers of two


def _same(places: _Ints) -> _Place:
    """Return one number if all offsets are equal."""
    if places.size and (places == places.flat[0]).all():
        return int(places.flat[0])
    return places


def _wide(numbers: NDArray[Any]) -> NDArray[Any]:
    """Return numbers as float64, int64 or uint64."""
    if numbers.dtype.kind == "f":
        return numbers.astype(np.float64)
    return numbers.astype(np.uint64 if numbers.dtype == np.uint64 else np.int64)


def _texts(data: bytes, starts: _Ints, sizes: _Ints) -> NDArray[np.object_]:
    """Return strings; equal ones, which are common, are decoded once."""
    firsts = np.flatnonzero(_differ(np.frombuffer(data, np.uint8), starts, sizes))
    texts = np.empty(len(firsts), dtype=object)
    known: dict[bytes, str] = {}
    for row, first in enumerate(firsts.tolist()):
        raw = data[starts[first] : starts[first] + sizes[first]]
        if raw not in known:
            known[raw] = raw.removesuffix(b"\0").decode("utf-8", "replace")
        texts[row] = known[raw]
    return np.repeat(texts, np.diff(firsts, append=len(starts)))


@jit
def _differ(data: NDArray[np.uint8], starts: _Ints, sizes: _Ints) -> NDArray[np.bool_]:
    """Return which strings differ from the one before."""
    differ = np.ones(len(starts), np.bool_)
    for i in range(1, len(starts)):
        if sizes[i] == sizes[i - 1]:
            same = 0
            while same < sizes[i] and data[starts[i] + same] == data[starts[i - 1] + same]:
                same += 1
            differ[i] = same < sizes[i]
    return differ


def _grouped(values: NDArray[Any], owners: _Ints, count: int) -> NDArray[np.object_]:
    """Return a tuple of values for each owner."""
    grouped = np.empty(count, dtype=object)
    parts = np.split(values, np.searchsorted(owners, np.arange(1, count)))
    grouped[:] = [tuple(part.tolist()) for part in parts] if count else []
    return grouped


def _arrays(data: bytes, dtype: np.dtype[Any], starts: _Ints, counts: _Ints) -> NDArray[np.object_]:
    arrays = np.empty(len(starts), dtype=object)
    for row, (start, count) in enumerate(zip(starts.tolist(), counts.tolist(), strict=True)):
        arrays[row] = np.frombuffer(data, dtype, count, start)
    return arrays
