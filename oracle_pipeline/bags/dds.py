"""Raw messages on a DDS domain, through Eclipse Cyclone DDS and without ROS.

Types are built at run time from the type store. Endpoints here exchange CDR bytes without decoding
them. All uses of cyclonedds-python's internals are in this module; the package is the optional
extra ``live``.
"""

import atexit
import contextlib
import ctypes
import functools
import weakref
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import (
    Nodetype,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.typesys.store import Typestore

from oracle_pipeline.bags import types
from oracle_pipeline.bags.dds_names import dds_type, from_wire, to_wire
from oracle_pipeline.bags.errors import DdsError
from oracle_pipeline.bags.jit import calls_from_c

try:
    from cyclonedds import _clayer, builtin, core, domain, internal, pub, sub, topic
    from cyclonedds.idl import make_idl_struct
    from cyclonedds.idl import types as idl
    from cyclonedds.qos import Policy
    from cyclonedds.qos import Qos as DdsQos
except ImportError as error:
    raise DdsError(
        "Eclipse Cyclone DDS is not installed; in the checkout, install it with "
        "`python -m pip install '.[live]'`."
    ) from error

Participant: TypeAlias = domain.DomainParticipant

_PRIMITIVES: dict[str, Any] = {
    "bool": bool, "byte": idl.byte, "octet": idl.byte, "char": idl.uint8,
    "float32": idl.float32, "float64": idl.float64,
    "int8": idl.int8, "int16": idl.int16, "int32": idl.int32, "int64": idl.int64,
    "uint8": idl.uint8, "uint16": idl.uint16, "uint32": idl.uint32, "uint64": idl.uint64,
}  # fmt: skip
_IDL: Any = idl  # type checkers do not know the subscripts of its types
_joined: weakref.WeakSet[Participant] = weakref.WeakSet()
_EVERYTHING = core.SampleState.Any | core.ViewState.Any | core.InstanceState.Any
_INFINITE_NS = 2**63 - 1
_SECOND_NS = 1_000_000_000
_MOST_AT_ONCE = 256  # samples of a reader that are taken in one call
_BY_INFO = 3  # DDS_TOPIC_FILTER_SAMPLEINFO_ARG: the filter gets no decoded message


def join(number: int) -> Participant:
    """Join a domain.

    Raises
    ------
    DdsError
        If there is no such domain, or no usable network interface.
    """
    try:
        participant = domain.DomainParticipant(number)
    except core.DDSException as error:
        raise DdsError(
            f"Could not join the DDS domain {number}: {error}. Choose a domain from 0 to 232 with "
            "--domain, and check the network interfaces that CYCLONEDDS_URI allows."
        ) from error
    _joined.add(participant)
    return participant


def leave(participant: Participant) -> None:
    """Leave a domain: delete a participant and its endpoints."""
    if participant in _joined:
        _joined.remove(participant)
        participant.__del__()


@atexit.register
def _leave_all() -> None:
    """Leave before the interpreter shuts down, because later a thread of DDS could block it."""
    for participant in list(_joined):
        leave(participant)


@functools.cache
def idl_type(msgtype: str, store: Typestore) -> Any:
    """Return the DDS type of a message type, with the name that ROS 2 gives it.

    Raises
    ------
    DdsError
        If the type is not known, or has a kind of field that is not supported (``wstring``).
    """
    if msgtype not in store.fielddefs:
        raise DdsError(f"The message type {msgtype} is not known.")
    _, fields = store.fielddefs[msgtype]
    name = dds_type(msgtype)
    members = {field: _member(kind, what, store) for field, (kind, what) in fields}
    return make_idl_struct(name.rpartition("::")[2], name, members)


def _member(kind: Nodetype, what: Any, store: Typestore) -> Any:
    if kind is Nodetype.ARRAY:
        (element_kind, element_type), length = what
        return _IDL.array[_member(element_kind, element_type, store), length]
    if kind is Nodetype.SEQUENCE:
        (element_kind, element_type), bound = what
        element = _member(element_kind, element_type, store)
        return _IDL.sequence[element, bound] if bound else _IDL.sequence[element]
    if kind is Nodetype.NAME:
        return idl_type(what, store)
    base, bound = what
    if base == "string":
        return _IDL.bounded_str[bound] if bound else str
    if base not in _PRIMITIVES:
        raise DdsError(f"A field of type {base} is not supported on DDS.")
    return _PRIMITIVES[base]


def _endpoint(
    make: Any, doing: str, participant: Participant, name: str, msgtype: str, qos: Qos,
    store: Typestore | None, arrived: NDArray[np.int64] | None = None,
) -> tuple[Any, Any]:  # fmt: skip
    """Return a topic, and a reader or writer of it; arrived messages are counted, if wanted."""
    definition = idl_type(msgtype, store or types.typestore())
    try:
        named = topic.Topic(participant, name, definition)
        if arrived is not None:
            _count(named, arrived)
        return named, make(participant, named, dds_qos(qos))
    except (core.DDSException, RuntimeError) as error:
        raise DdsError(f"Could not {doing} {name} ({msgtype}): {error}.") from error


class _Filter(ctypes.Structure):
    """A filter of the messages of a topic: ``struct dds_topic_filter``."""

    _fields_ = (("mode", ctypes.c_int), ("function", ctypes.c_void_p), ("counter", ctypes.c_void_p))


@calls_from_c("boolean(voidptr, CPointer(int64))")
def _let_through(_info: Any, counter: Any) -> bool:
    counter[0] += 1
    return True


def _count(named: Any, arrived: NDArray[np.int64]) -> None:
    """Count the messages of a topic as they arrive, in the thread of DDS that receives them.

    A reader that has its history full replaces the oldest message and says nothing: Cyclone DDS
    does not call that lost. So a filter that takes every message counts them.
    """
    counting = _Filter(_BY_INFO, _let_through.address, arrived.ctypes.data)
    code = internal.load_cyclonedds().dds_set_topic_filter_extended(
        named._ref, ctypes.byref(counting)
    )
    if code:
        raise DdsError(f"Could not count the messages of {named.name}: code {code}.")


def dropped_packets() -> int:
    """Return how many packets found the sockets of this process full so far; 0 if unknown."""
    own, dropped = set(), 0
    with contextlib.suppress(OSError):  # not Linux
        for entry in Path("/proc/self/fd").iterdir():
            with contextlib.suppress(OSError):  # it was closed meanwhile
                own.add(str(entry.readlink()))
        for table in ("udp", "udp6"):
            for line in Path("/proc/self/net", table).read_text().splitlines()[1:]:
                fields = line.split()
                dropped += int(fields[-1]) if f"socket:[{fields[9]}]" in own else 0
    return dropped


class Raw(NamedTuple):
    """A message as it was on DDS."""

    data: bytes  # CDR with its encapsulation header
    source_ns: int  # when it was sent, by the sender's clock [ns since 1970]
    writer: int  # instance handle of the writer that sent it


class RawReader:
    """Takes the messages of a topic as bytes.

    Parameters
    ----------
    participant
        Participant that owns the reader.
    name : str
        DDS name of the topic.
    msgtype : str
    qos : Qos
        The requested QoS.
    store : Typestore, optional
        Defines the type; by default the built-in one.
    others_only : bool
        Whether messages of the same participant are left out.

    Attributes
    ----------
    guid : bytes
        Its identifier on the network, 16 bytes.
    lost : int
        Messages that arrived, and were replaced by newer ones before they were taken.
    """

    def __init__(
        self, participant: Participant, name: str, msgtype: str, qos: Qos,
        store: Typestore | None = None, *, others_only: bool = False,
    ) -> None:  # fmt: skip
        self.lost = self._taken = 0
        self._arrived = np.zeros(1, np.int64)
        reader = _foreign_reader if others_only else sub.DataReader
        self.topic, self.entity = _endpoint(
            reader, "subscribe to", participant, name, msgtype, qos, store, self._arrived
        )
        self.guid = bytes(self.entity.guid.bytes)

    def take(self) -> list[Raw]:
        """Return some of the received messages; an empty list if there is none."""
        arrived = int(self._arrived[0])
        taken = _clayer.ddspy_take(self.entity._ref, _EVERYTHING, _MOST_AT_ONCE)
        if isinstance(taken, int):
            raise DdsError(f"Could not take messages of {self.topic.name}: code {taken}.")
        messages = [
            Raw(from_wire(data), info.source_timestamp, info.publication_handle)
            for data, info in taken
            if info.valid_data
        ]
        self._taken += len(messages)
        if len(taken) < _MOST_AT_ONCE:  # none is left of those that had arrived
            self.lost = max(self.lost, arrived - self._taken)
        return messages


def _foreign_reader(participant: Participant, named: Any, qos: "DdsQos") -> Any:
    """Return a reader that does not receive what its own participant sends."""
    return sub.DataReader(participant, named, qos + DdsQos(Policy.IgnoreLocal.Participant))


class RawWriter:
    """Sends bytes as the messages of a topic; parameters and `guid` are as for `RawReader`."""

    def __init__(
        self,
        participant: Participant,
        name: str,
        msgtype: str,
        qos: Qos,
        store: Typestore | None = None,
    ) -> None:
        self._topic, self._entity = _endpoint(
            pub.DataWriter, "publish", participant, name, msgtype, qos, store
        )
        self.guid = bytes(self._entity.guid.bytes)

    def write(self, data: bytes) -> None:
        """Send CDR bytes, encapsulation header included."""
        code = _clayer.ddspy_write(self._entity._ref, to_wire(data))
        if code:
            raise DdsError(f"Could not send a message on {self._topic.name}: code {code}.")


class ReadyReaders:
    """Waits until any of its readers has messages, and returns those that have."""

    def __init__(self, participant: Participant) -> None:
        self._waitset = core.WaitSet(participant)
        self._readers: dict[int, RawReader] = {}  # by the address that DDS gives back
        self._kept: list[Any] = []  # must not be freed while DDS knows its address
        self._waitset.attach(core.GuardCondition(participant))  # an empty set would not wait

    def add(self, reader: RawReader) -> None:
        """Wait for a reader too; may be called while another thread waits."""
        condition = core.ReadCondition(reader.entity, _EVERYTHING)
        self._waitset.attach(condition)
        mark = self._waitset.attached[-1][1]
        self._readers[ctypes.addressof(mark)] = reader
        self._kept.append(condition)

    def wait(self, timeout_s: float) -> Iterable[RawReader]:
        """Return the readers that have messages, within some time.

        Raises
        ------
        DdsError
            The domain was left.
        """
        size = len(self._readers) + 1
        marks = (ctypes.c_void_p * size)()
        count = self._waitset._waitset_wait(
            self._waitset._ref, marks, size, round(timeout_s * _SECOND_NS)
        )
        if count < 0:
            raise DdsError(f"No messages can be waited for: code {count}.")
        found = (self._readers.get(mark or 0) for mark in marks[: min(count, size)])
        return [reader for reader in found if reader is not None]


def dds_qos(qos: Qos) -> "DdsQos":
    """Return a QoS profile as DDS policies."""
    depth = max(1, qos.depth)
    kept = Policy.History.KeepLast(depth)
    if qos.history is QosHistory.KEEP_ALL:
        kept = Policy.History.KeepAll
    policies = [
        kept,
        Policy.Reliability.BestEffort
        if qos.reliability is QosReliability.BEST_EFFORT
        else Policy.Reliability.Reliable(_SECOND_NS // 10),
        Policy.Liveliness.Automatic(_nanoseconds(qos.liveliness_lease_duration)),
        Policy.Deadline(_nanoseconds(qos.deadline)),
        Policy.Lifespan(_nanoseconds(qos.lifespan)),
    ]
    if qos.durability is QosDurability.TRANSIENT_LOCAL:
        policies += [
            Policy.Durability.TransientLocal,
            # What a writer keeps for late readers; Cyclone DDS does not take it from the history.
            Policy.DurabilityService(0, kept, -1, -1, -1),
        ]
    return DdsQos(*policies)


def ros_qos(qos: "DdsQos") -> Qos:
    """Return the profile that an endpoint announced; some do not announce their history."""
    history, depth = QosHistory.UNKNOWN, 0
    if isinstance(kept := qos[Policy.History], Policy.History.KeepLast):
        history, depth = QosHistory.KEEP_LAST, kept.depth
    reliable = isinstance(qos[Policy.Reliability], Policy.Reliability.Reliable)
    latched = qos[Policy.Durability] == Policy.Durability.TransientLocal
    liveliness = qos[Policy.Liveliness]
    return Qos(
        history=history,
        depth=depth,
        reliability=QosReliability.RELIABLE if reliable else QosReliability.BEST_EFFORT,
        durability=QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        deadline=_time(qos[Policy.Deadline].deadline if qos[Policy.Deadline] else _INFINITE_NS),
        lifespan=_time(qos[Policy.Lifespan].lifespan if qos[Policy.Lifespan] else _INFINITE_NS),
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=_time(
            liveliness.lease_duration if liveliness is not None else _INFINITE_NS
        ),
        avoid_ros_namespace_conventions=False,
    )


def _nanoseconds(time: QosTime) -> int:
    """Return a duration; 0 in a bag means unlimited."""
    return min(time.sec * _SECOND_NS + time.nsec, _INFINITE_NS) or _INFINITE_NS


def _time(duration_ns: int) -> QosTime:
    return QosTime(*divmod(duration_ns, _SECOND_NS))


class Discovered(NamedTuple):
    """A participant or an endpoint, as described on a built-in topic of DDS."""

    handle: int
    alive: bool  # if not, only the handle is known
    guid: bytes = b""
    participant: bytes = b""
    topic: str = ""
    type: str = ""
    qos: Qos = ros_qos(DdsQos())


class BuiltinReaders:
    """Observes participants and endpoints; each method returns what is new since its last call."""

    def __init__(self, participant: Participant) -> None:
        self._participants = builtin.BuiltinDataReader(
            participant, builtin.BuiltinTopicDcpsParticipant
        )
        self._publications = builtin.BuiltinDataReader(
            participant, builtin.BuiltinTopicDcpsPublication
        )
        self._subscriptions = builtin.BuiltinDataReader(
            participant, builtin.BuiltinTopicDcpsSubscription
        )

    def participants(self) -> Iterator[Discovered]:
        """Yield participants."""
        for sample, handle, alive in _taken(self._participants):
            yield Discovered(handle, alive, sample.key.bytes if alive else b"")

    def publications(self) -> Iterator[Discovered]:
        """Yield writers."""
        return _endpoints(self._publications)

    def subscriptions(self) -> Iterator[Discovered]:
        """Yield readers."""
        return _endpoints(self._subscriptions)


def _endpoints(reader: Any) -> Iterator[Discovered]:
    for sample, handle, alive in _taken(reader):
        if not alive:
            yield Discovered(handle, alive)
            continue
        yield Discovered(
            handle, alive, sample.key.bytes, sample.participant_key.bytes, sample.topic_name,
            sample.type_name, ros_qos(sample.qos),
        )  # fmt: skip


def _taken(reader: Any) -> Iterator[tuple[Any, int, bool]]:
    """Yield samples of a built-in topic, each with its handle and whether it still exists."""
    while samples := reader.take(_MOST_AT_ONCE):
        for sample in samples:
            info = sample.sample_info
            alive = info.valid_data and info.instance_state == core.InstanceState.Alive
            yield sample, info.instance_handle, alive
