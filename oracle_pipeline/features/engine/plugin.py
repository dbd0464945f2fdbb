"""The plugin interface: named outputs, requested topics, and a plain function.

A plugin registers through pluggy: a hook returns its description, the manager does the rest. The
bag is read once for all plugins, so a plugin declares what to keep of each message, and its
function gets that as arrays for one window. The thesis's own contract is in
``oracle_pipeline.features.adapters.thesis``. Our own plugins import this module as ``fp``.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
import pluggy
from numpy.typing import DTypeLike, NDArray

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.graph_files import RosGraph
from oracle_pipeline.bags.reader import Topic
from oracle_pipeline.features.engine.message_layout import MessageLayout
from oracle_pipeline.graphs.intervals import Interval
from oracle_pipeline.robots.roles import ROLES, Roles

PROJECT = "oracle_pipeline"  # the entry-point group that other distributions use

hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)

Origin: TypeAlias = Literal["generic", "domain", "navigation"]
Form: TypeAlias = Literal["many", "raw", "decoded"]


class PluginError(OracleError):
    """Plugins cannot be loaded as they are configured."""


@dataclass(frozen=True, slots=True)
class Missing:
    """Replaces a value that cannot be computed for a window, with the reason."""

    reason: str


@dataclass(frozen=True, slots=True)
class Located:
    """A number, and its place in the system: a topic, a pair of topics, an edge."""

    value: float
    where: str


@dataclass(frozen=True, slots=True)
class Feature:
    """One output of a plugin: a column of the feature tables, without its family."""

    name: str
    unit: str  # "1" for a pure number
    floor: float  # the smallest meaningful difference, in the unit; scalers use it
    description: str
    origin: Origin = "generic"  # generic: any bag; domain: needs a sensor; navigation: needs Nav2
    shortcut: bool = False  # identifies a run by its nodes and topics, not by its behaviour
    behaviour: bool = False  # measures the robot's behaviour, not the consistency of messages
    per_window: bool = True  # False: makes sense for a whole run only
    extensive: bool = False  # depends on the length of a recording: a total, or an extreme
    timing: bool = False  # depends on when messages arrived at the recorder, or on how many did
    share: float = 0.0  # the smallest meaningful difference as a share of the usual value


def timed(*features: Feature, extensive: bool = False) -> tuple[Feature, ...]:
    """Return features as those that depend on when messages arrive, or on how many do."""
    return tuple(replace(f, timing=True, extensive=extensive or f.extensive) for f in features)


@dataclass(frozen=True, slots=True)
class Request:
    """The topics that a plugin reads, and what it keeps of each message.

    Parameters
    ----------
    keep : callable
        Takes a decoded message and returns a number, a tuple of numbers or an array of the same
        shape each time; with ``dtype=object`` anything; None leaves the message out. Called once
        a message, even if several plugins have the same ``Request``.
    many : bool
        ``keep`` takes many messages at once, as `Columns`, whose fields are arrays with a row for
        each message. It returns an array with a row for each, or a tuple of such columns; with
        ``dtype=object`` a list is one of rows, of which None are left out. Many times faster. If
        it raises an error, it is called for one message after the other.
    name, msgtype : str
        Globs over topic names and message types; a topic must match both. A robot's topics are
        named without its namespace.
    role : str
        Only topics that the robot has in this role, one of ``oracle_pipeline.robots.roles.ROLES``,
        regardless of their names. A point cloud in the role ``scan`` is converted to a
        ``LaserScan``.
    dtype : dtype
        Of the array that the kept values become.
    optional : bool
        Compute even when no topic matches, or none of them has a message in the window.
    raw : bool
        ``keep`` takes a ``RawRecord`` instead; nothing is decoded.
    every_s : float
        Of each span of this length, counted from the start of the recording, only the first
        message of a topic is taken [s]; 0: all.
    needs_array : bool
        Only topics whose messages have a `Columns.first_array`.
    carried : bool
        A window of a running robot gets the last rows regardless of their age, such as the goal
        that was accepted minutes ago. Without it, rows are of the last seconds.
    """

    keep: Callable[[Any], Any]
    name: str = "*"
    msgtype: str = "*"
    role: str = ""
    dtype: DTypeLike = np.float64
    optional: bool = False
    raw: bool = False
    every_s: float = 0.0
    needs_array: bool = False
    many: bool = False
    carried: bool = False

    def __post_init__(self) -> None:
        if self.role and self.role not in ROLES:
            raise PluginError(
                f"A request has the role {self.role!r}, which does not exist; there are "
                f"{', '.join(ROLES)}."
            )

    @property
    def form(self) -> Form:
        """What ``keep`` takes."""
        return "many" if self.many else "raw" if self.raw else "decoded"

    def matches(self, topic: Topic, layout: MessageLayout, roles: Roles) -> bool:
        """Return whether a topic of a robot matches this request."""
        return (
            (not self.role or roles.has(self.role, topic.name))
            and fnmatchcase(topic.name, self.name)
            and fnmatchcase(topic.msgtype, self.msgtype)
            and (layout.has_array or not self.needs_array)
        )

    def __str__(self) -> str:
        described = " of type ".join(part for part in (self.name, self.msgtype) if part != "*")
        return f"for the role {self.role} {described}".rstrip() if self.role else described


class RawRecord(NamedTuple):
    """A message as recorded, with the parts that can be read without decoding."""

    data: bytes
    layout: MessageLayout

    @property
    def header_stamp_ns(self) -> int | None:
        """Stamp in the header [ns]; None if it has no header."""
        return self.layout.header_stamp_ns(self.data)


class TopicArrivals(NamedTuple):
    """All messages of one topic, unread; shape (n,) each, read-only."""

    msgtype: str  # sensor_msgs/msg/LaserScan
    times_s: NDArray[np.float64]  # recorded at, since the start of the recording [s]
    sizes: NDArray[np.int64]  # serialised [B]
    header_stamps_ns: NDArray[np.int64]  # shape (0,) if the type has no header


class Series(NamedTuple):
    """The values that a plugin kept of the messages of one topic; read-only."""

    times_s: NDArray[np.float64]  # shape (n,), recorded at, since the start of the recording [s]
    values: NDArray[Any]  # shape (n, ...)


def sole_series(topics: Mapping[str, Series]) -> Series | None:
    """Return the messages of a role that a robot has one topic of; None if it has none."""
    return next(iter(topics.values()), None)


@dataclass(frozen=True, slots=True)
class Window:
    """A span of a recording for one plugin, without label, mode and ground truth.

    Attributes
    ----------
    start_s, end_s : float
        Since the start of the recording [s].
    graph : DiGraph or None
        The ROS graph of the span, frozen; None if the bag came without.
    system : DiGraph or None
        The same without observers, ``oracle_pipeline.graphs.views.system_view``.
    intervals : tuple of Interval
        The graphs that it was composed of, in order of time: of the intervals of the span that
        ended before it did, or else the newest one before them.
    arrivals : mapping of str to TopicArrivals
        The times of the messages in the span, for every topic of the bag, including silent ones.
    topics : mapping of str to (mapping of str to Series)
        By name of the request, then of the topic: the messages within the span. Topics that are
        silent in it are left out; if all are, ``compute`` is only called for optional requests.
    history : mapping of str to (mapping of str to Series)
        The same from the start of the recording to the end of the span, silent topics included.
    prepared
        The result of the plugin's ``prepare`` for the whole recording; None without one.
    roles : Roles
        Of the robot's topics.
    shared : dict
        Results that the plugins of one recording share, by keys of their choice.
    """

    start_s: float
    end_s: float
    graph: RosGraph | None
    system: RosGraph | None
    intervals: tuple[Interval, ...]
    arrivals: Mapping[str, TopicArrivals]
    topics: Mapping[str, Mapping[str, Series]] = field(default_factory=dict)
    history: Mapping[str, Mapping[str, Series]] = field(default_factory=dict)
    prepared: Any = None
    roles: Roles = field(default_factory=Roles)
    shared: dict[Any, Any] = field(default_factory=dict)


Values: TypeAlias = Mapping[str, "float | Located | Missing"]


@dataclass(frozen=True, slots=True)
class FeaturePlugin:
    """A plain function of a window, with the description needed to call it.

    Parameters
    ----------
    name : str
        Of the plugin, for messages.
    family : str
        Columns are named ``<family>.<feature>``.
    features : tuple of Feature
        Exactly those that ``compute`` returns.
    compute : callable
        Takes a window and returns a number, ``Located`` or ``Missing`` by feature name; or one
        ``Missing`` for all.
    topics : mapping of str to Request
        The requests, by names of the plugin's choice.
    needs_graph : bool
        Without a graph, ``compute`` is not called and the features are missing.
    prepare : callable, optional
        Takes the window of the whole recording and returns a result for all calls of ``compute``.
        Called once per recording; a ``Missing``, or an exception, is the reason for all features
        of the plugin.
    """

    name: str
    family: str
    features: tuple[Feature, ...]
    compute: Callable[[Window], Values | Missing]
    topics: Mapping[str, Request] = field(default_factory=dict)
    needs_graph: bool = False
    prepare: Callable[[Window], Any] | None = None

    def column(self, feature: Feature) -> str:
        """Return the name of a feature's column."""
        return f"{self.family}.{feature.name}"


class FeatureHooks:
    """The hooks that plugins implement."""

    @hookspec
    def register_features(self) -> list[FeaturePlugin]:  # type: ignore[empty-body]
        """Return the feature plugins of a module."""
