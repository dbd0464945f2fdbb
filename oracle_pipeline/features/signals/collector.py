"""Collects the signals of a recording while its bag is read for the features."""

from collections.abc import Collection, Iterator
from contextlib import suppress
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.limits import LARGEST_DECODED
from oracle_pipeline.bags.merging import Messages, Rows
from oracle_pipeline.bags.reader import BagReader, Topic
from oracle_pipeline.bags.terminal import join_first
from oracle_pipeline.features.engine.columns import SerializedMessages
from oracle_pipeline.features.signals.fields import Numbers, labelled_alike, numbers_of
from oracle_pipeline.robots.robot import Robot
from oracle_pipeline.robots.roles import is_static

MOST_SIGNALS = 4096  # of a recording; a PX4 log has about 2,000
PERIOD = "period"  # name of a signal: the time between the messages of a topic
CUT = f"The recording has more than {MOST_SIGNALS} signals"  # begins a note
MOST_BYTES = 32 * 2**20  # of the messages of a topic that are decoded; the others are passed over
MOST_MESSAGES = 200_000  # of a topic that are decoded
_OUT_OF_STEP = 7919  # a prime: how far a pair is from the place of the one before, by block
_MOST_WAITING = 4 * 2**20  # bytes of a topic's messages that wait to be decoded together
_OF_THE_MIDDLEWARE = "rcl_interfaces/"  # types of logs and of parameters
_PAIRED = 0.25  # least share of messages right after another; fewer tell little of changes
_WHOLE_SHARE = 0.9  # of the messages of a topic; if fewer are whole, its type is wrong

Floats: TypeAlias = NDArray[np.float64]
Adjacent: TypeAlias = NDArray[np.bool_] | None  # to the number before; None if all are


class Signals(NamedTuple):
    """Signals of one topic that have their numbers at the same times."""

    topic: str
    names: tuple[str, ...]  # of the fields
    units: tuple[str, ...]  # empty if unknown
    times_ns: NDArray[np.int64]  # ascending, since the start of the recording
    values: Floats  # shape (n, n_names)
    adjacent: Adjacent = None
    stamps_s: Floats | None = None  # of the messages' headers, if they have any


class _Topic:
    """The messages of one topic that wait to be decoded, and the numbers of the decoded ones."""

    def __init__(self, bag: BagReader, topic: Topic) -> None:
        self._msgtype = topic.msgtype
        self._is_static = is_static(topic)
        self._store = bag.typestore(topic.msgtype)
        self._decode = bag.decoder(topic.name)
        self._is_cdr = topic.encoding != "ros1"
        self.every = max(1, -(-topic.count // MOST_MESSAGES))
        self._count = topic.count
        self._passed = self._tried = self._whole = self._held = 0
        self._waiting: list[bytes] = []
        self._rows: list[int] = []
        self._found: list[Numbers] = []  # rows are numbers of messages in the recording

    def add(self, batch: Messages, rows: Rows, first: int) -> None:
        """Take the next messages; `first` is the number of the batch's first message."""
        if not self._passed:
            mean = float(batch.sizes[rows].mean())
            self.every = max(self.every, int(-(-self._count * mean // MOST_BYTES)))
        chosen, block = rows, 2 * self.every
        if self.every > 1:
            # Pairs, since a change over many messages is larger than that from one to the next; out
            # of step, since what oscillates would become a level.
            number = self._passed + np.arange(-1, len(rows))
            begins = number % block == number // block * _OUT_OF_STEP % block
            chosen = rows[begins[1:] | begins[:-1]]
        self._passed += len(rows)
        chosen = chosen[batch.sizes[chosen] <= LARGEST_DECODED]
        self._waiting += batch.messages(chosen)
        self._rows += (first + chosen).tolist()
        self._held += int(batch.sizes[chosen].sum())
        if self._held > _MOST_WAITING:
            self.decode()

    def decode(self) -> None:
        """Decode the messages that wait; those that are broken are left out."""
        if not self._waiting:
            return
        batch = SerializedMessages(self._waiting, self._store, self._msgtype, is_cdr=self._is_cdr)
        rows, whole = np.array(self._rows, dtype=np.int64), batch.whole
        self._tried += len(rows)
        if whole.all():
            self._take(rows, batch)
        else:
            self._take(rows[whole], batch.some(np.flatnonzero(whole)))
            self._take(*self._written_again(rows[~whole], batch.some(np.flatnonzero(~whole))))
        self._waiting, self._rows, self._held = [], [], 0

    def _written_again(
        self, rows: Rows, batch: SerializedMessages
    ) -> tuple[Rows, SerializedMessages]:
        """Return the messages in our encoding that were in another one, and are not broken."""
        written, good = [], []
        for row, data in zip(rows.tolist(), batch.data, strict=True):
            try:
                content = self._decode(data)
                written.append(bytes(self._store.serialize_cdr(content, self._msgtype)))
            except Exception:  # noqa: S112 -- of a generated encoder, too; `numbers` counts them
                continue
            good.append(row)
        again = SerializedMessages(written, self._store, self._msgtype, is_cdr=True)
        return np.array(good, dtype=np.int64), again

    def _take(self, rows: Rows, batch: SerializedMessages) -> None:
        """Keep the numbers of whole messages."""
        if not len(rows):
            return
        self._whole += len(rows)
        store, msgtype, columns = self._store, self._msgtype, batch.columns()
        most = MOST_SIGNALS + 1  # one more tells that some are left out
        for alike in labelled_alike(columns, store, msgtype):
            part = columns if len(alike) == len(rows) else batch.some(alike).columns()
            for each in numbers_of(part, store, msgtype, most, static=self._is_static):
                self._found.append(each._replace(rows=rows[alike[each.rows]]))

    def numbers(self) -> Iterator[Numbers]:
        """Yield the numbers; none if too many messages are broken: their type is wrong."""
        self.decode()
        if self._whole >= _WHOLE_SHARE * self._tried:
            yield from _joined(self._found)


class SignalCollector:
    """Collects the signals of a bag: `see` is given the batches of messages as they are read.

    Parameters
    ----------
    robot : Robot
        Whose bag is read.
    topics : collection of str, optional
        Topics whose numbers are collected; by default, all that the robot uses.

    Attributes
    ----------
    notes : list of str
        Signals that were left out, once `signals` was called.
    """

    def __init__(self, robot: Robot, topics: Collection[str] | None = None) -> None:
        bag, chosen = robot.bag, robot.used if topics is None else topics
        self.notes: list[str] = []
        self._names = list(bag.topics)
        self._first = 0  # number of the next batch's first message
        self._numbers: dict[int, list[NDArray[np.uint32]]] = {}  # of each topic's messages
        self._topics: dict[int, _Topic] = {}
        for number, topic in enumerate(bag.topics.values()):
            if topic.name not in chosen or topic.msgtype.startswith(_OF_THE_MIDDLEWARE):
                continue
            with suppress(BagError):  # the features note topics of unknown types
                self._topics[number] = _Topic(bag, topic)

    def see(self, batch: Messages) -> None:
        """Take the numbers of the next messages of the bag."""
        for number, rows in batch.by_topic():
            # Half the memory of what may be millions.
            self._numbers.setdefault(number, []).append((self._first + rows).astype(np.uint32))
            if number in self._topics:
                self._topics[number].add(batch, rows, self._first)
        self._first += len(batch.topics)

    def signals(self, times_ns: NDArray[np.int64]) -> list[Signals]:
        """Return the signals of the recording, by topic.

        Parameters
        ----------
        times_ns : ndarray of shape (n_messages,)
            Of each message in the order of reading, since the start of the recording.
        """
        found: list[Signals] = []
        left = MOST_SIGNALS
        cut: list[str] = []
        for number in sorted(self._numbers, key=self._order):
            name, rows = self._names[number], np.concatenate(self._numbers[number])
            topic = self._topics.get(number)
            for numbers in topic.numbers() if topic else ():
                if len(numbers.names) > left:
                    cut.append(name)
                if left:
                    signals = _in_time(name, numbers, times_ns, left)
                    if topic and topic.every > 1:
                        signals = signals._replace(adjacent=_adjacent(rows, numbers.rows))
                    found.append(signals)
                    left -= len(signals.names)
            found.append(_periods(name, np.sort(times_ns[rows])))
        if topics := list(dict.fromkeys(cut)):
            self.notes.append(f"{CUT}; some of {join_first(topics)} are left out.")
        return sorted(found, key=lambda signals: signals.topic)

    def _order(self, number: int) -> tuple[int, str]:
        """Return the place of a topic: those with many messages first, by powers of two."""
        return -sum(map(len, self._numbers[number])).bit_length(), self._names[number]


def _joined(parts: list[Numbers]) -> Iterator[Numbers]:
    """Yield numbers of the same signals as one; those that only some parts have apart."""
    in_parts: dict[str, list[Numbers]] = {}
    for part in parts:
        for name in dict.fromkeys(part.names):
            in_parts.setdefault(name, []).append(part)
    together: dict[tuple[int, ...], list[str]] = {}
    for name, some in in_parts.items():
        together.setdefault(tuple(map(id, some)), []).append(name)
    for names in together.values():
        some = in_parts[names[0]]
        columns = [[part.names.index(name) for name in names] for part in some]
        units = tuple(some[0].units[column] for column in columns[0])
        rows = np.concatenate([part.rows for part in some])
        values = [part.values[:, taken] for part, taken in zip(some, columns, strict=True)]
        stamps = [part.stamps_s for part in some if part.stamps_s is not None]
        stamps_s = np.concatenate(stamps) if len(stamps) == len(some) else None
        yield Numbers(tuple(names), units, rows, np.concatenate(values), stamps_s)


def _periods(topic: str, in_order: NDArray[np.int64]) -> Signals:
    """Return the time between the messages of a topic as a signal [s]."""
    return Signals(topic, (PERIOD,), ("s",), in_order[1:], np.diff(in_order)[:, None] * 1e-9)


def _adjacent(of_topic: NDArray[np.uint32], chosen: Rows) -> Adjacent:
    """Return which of the chosen messages of a topic came right after another; None if few."""
    adjacent = np.diff(np.searchsorted(of_topic, chosen), prepend=-2) == 1
    return adjacent if adjacent.mean() > _PAIRED else None


def _in_time(topic: str, numbers: Numbers, times_ns: NDArray[np.int64], most: int) -> Signals:
    """Return the first numbers of a topic in the order of time."""
    of_rows = times_ns[numbers.rows]
    order = np.argsort(of_rows, kind="stable")
    names, units = numbers.names[:most], numbers.units[:most]
    stamps_s = None if numbers.stamps_s is None else numbers.stamps_s[order]
    return Signals(
        topic, names, units, of_rows[order], numbers.values[order, :most], stamps_s=stamps_s
    )
