"""The rows that all requests keep of one topic; each message is decoded at most once."""

from typing import Any

import numpy as np

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.limits import LARGEST_DECODED
from oracle_pipeline.bags.reader import BagReader, Topic
from oracle_pipeline.features.engine.columns import SerializedMessages
from oracle_pipeline.features.engine.kept_rows import KeptRows
from oracle_pipeline.features.engine.memory import MemoryBudget
from oracle_pipeline.features.engine.message_layout import MessageLayout
from oracle_pipeline.features.engine.plugin import Form, RawRecord, Request
from oracle_pipeline.features.engine.point_clouds import CutClouds, sliced
from oracle_pipeline.features.engine.spans import Integers
from oracle_pipeline.robots.roles import POINT_CLOUD, SCAN

_MOST_WAITING = 2**22  # bytes of messages of a topic that wait to be decoded together


class KeptTopic:
    """One topic of the bag, and the rows that requests keep of its messages."""

    def __init__(self, bag: BagReader, topic: Topic) -> None:
        self.name, self.msgtype = topic.name, topic.msgtype
        self.layout = MessageLayout(bag, topic.name)
        self.kept: dict[Any, KeptRows] = {}  # by key of the request
        self.by_period: dict[int, list[KeptRows]] = {}  # by time between sampled messages [ns]
        self._asked: set[tuple[int, Form]] = set()  # periods, and what is requested
        self.undecodable = ""
        #: Numbers of messages, and the messages, by period.
        self._waiting: dict[int, tuple[list[Integers], list[bytes]]] = {}
        self._held = 0  # bytes of the waiting messages
        try:
            self._decode = bag.decoder(topic.name)
            self._store = bag.typestore(topic.msgtype)
        except BagError as error:
            self.undecodable = str(error)

    def ask(self, request: Request, budget: MemoryBudget) -> KeptRows:
        """Return the store of a request's rows, which equal requests share."""
        as_scan = request.role == SCAN and self.msgtype == POINT_CLOUD
        key = (
            request.keep, np.dtype(request.dtype), request.raw, request.every_s, request.carried,
            as_scan,
        )  # fmt: skip
        if key not in self.kept:
            self.kept[key] = kept = KeptRows(request, budget)
            kept.as_scan = as_scan
            period_ns = round(request.every_s * 1e9)
            self.by_period.setdefault(period_ns, []).append(kept)
            if self.undecodable and not request.raw:
                kept.fail(self.undecodable)
            else:
                self._asked.add((period_ns, request.form))
        return self.kept[key]

    def has(self, period_ns: int, form: Form) -> bool:
        """Return whether messages are requested at a period in some form."""
        return (period_ns, form) in self._asked

    def keep_raw(self, period_ns: int, numbers: Integers, messages: list[bytes]) -> None:
        """Keep the requested part of messages as they were recorded."""
        for kept in self.by_period[period_ns]:
            if kept.request.form == "raw":
                for number, data in zip(numbers.tolist(), messages, strict=True):
                    kept.add(number, RawRecord(data, self.layout), len(data))

    def keep_decoded(self, number: int, data: bytes, periods_ns: list[int]) -> None:
        """Decode a message that was sampled at some periods, and keep the requested part."""
        content: Any = None
        scan: Any = None
        for period_ns in periods_ns:
            for kept in self.by_period[period_ns]:
                if kept.error or kept.request.form != "decoded":
                    continue
                try:
                    content = content or self._decoded(data)
                    if kept.as_scan:
                        scan = scan or sliced(content)
                except BagError as error:
                    kept.skip(str(error))
                else:
                    kept.add(number, scan if kept.as_scan else content, len(data))

    def queue(self, period_ns: int, numbers: Integers, messages: list[bytes]) -> int:
        """Queue messages for decoding in a batch; return their size [B]."""
        if max(map(len, messages)) > LARGEST_DECODED:
            numbers, messages = self._without_large(period_ns, numbers, messages)
        queued = self._waiting.setdefault(period_ns, ([], []))
        queued[0].append(numbers)
        queued[1].extend(messages)
        size = sum(map(len, messages))
        self._held += size
        if self._held > _MOST_WAITING:
            self.keep_waiting()
        return size

    def _without_large(
        self, period_ns: int, numbers: Integers, messages: list[bytes]
    ) -> tuple[Integers, list[bytes]]:
        """Skip the messages that are too large to be decoded; return the others."""
        fits = np.array([len(data) <= LARGEST_DECODED for data in messages], dtype=np.bool_)
        for row in np.flatnonzero(~fits).tolist():
            for kept in self.by_period[period_ns]:
                if kept.request.many:
                    kept.skip(_too_large(messages[row]))
        return numbers[fits], [messages[row] for row in np.flatnonzero(fits).tolist()]

    def keep_waiting(self) -> None:
        """Keep the requested part of the queued messages."""
        for period_ns, (parts, messages) in self._waiting.items():
            many = [kept for kept in self.by_period[period_ns] if kept.request.many]
            numbers = np.concatenate(parts)
            batch = self._serialized(messages, is_cdr=self.layout.is_cdr)
            whole = batch.whole
            if not whole.all():
                self._keep_odd(numbers[~whole], batch.some(np.flatnonzero(~whole)), many)
                numbers, batch = numbers[whole], batch.some(np.flatnonzero(whole))
            self._add(numbers, batch, many)
        self._waiting.clear()
        self._held = 0

    def _keep_odd(self, numbers: Integers, batch: SerializedMessages, many: list[KeptRows]) -> None:
        """Decode messages one by one that are broken or encoded differently; keep valid ones."""
        written, good = [], []
        for number, data in zip(numbers.tolist(), batch.data, strict=True):
            try:
                content = self._decoded(data)
                written.append(bytes(self._store.serialize_cdr(content, self.msgtype)))
                good.append(number)
            except Exception as error:  # of a generated encoder, too
                for kept in many:
                    kept.skip(str(error))
        again = self._serialized(written, is_cdr=True)
        self._add(np.array(good, dtype=np.int64), again, many)

    def _serialized(self, messages: list[bytes], *, is_cdr: bool) -> SerializedMessages:
        return SerializedMessages(messages, self._store, self.msgtype, is_cdr=is_cdr)

    def _add(self, numbers: Integers, batch: SerializedMessages, many: list[KeptRows]) -> None:
        scans = CutClouds(batch, self._decoded)
        for kept in many:
            kept.add_many(numbers, scans if kept.as_scan else batch)

    def _decoded(self, data: bytes) -> Any:
        if len(data) > LARGEST_DECODED:
            raise BagError(_too_large(data))
        return self._decode(data)


def _too_large(data: bytes) -> str:
    return (
        f"a message of {len(data)} bytes is not decoded; the limit is {LARGEST_DECODED} "
        "(LARGEST_DECODED)"
    )
