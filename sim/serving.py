"""Mirrors a testbed's domain on a real DDS domain: its nodes, endpoints and messages.

It accompanies a run and changes nothing in it, unless its nodes receive what others publish.
Service requests stay inside the simulation, so services are not on DDS; neither is the ground
truth.
"""

from collections.abc import Iterable

import numpy as np

from oracle_pipeline.bags import dds
from oracle_pipeline.bags.dds_names import ENTITIES_TOPIC, ENTITIES_TYPE, dds_topic
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC, message_class, serialize
from sim.fuzzing.compilation import compile_document
from sim.fuzzing.execution import execute
from sim.fuzzing.scenario import ScenarioError
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.endpoints import Publisher, Sample, Subscription
from sim.middleware.executor import MILLISECOND
from sim.testbed import Recipe
from sim.testbed_run import TestbedRun

_PERIOD_NS = 100 * MILLISECOND  # period of the search for new endpoints
_GID_BYTES = 24  # of an identifier on Humble; DDS gives 16 of them

_Gid = message_class("rmw_dds_common/msg/Gid")
_Node = message_class("rmw_dds_common/msg/NodeEntitiesInfo")
_Participant = message_class("rmw_dds_common/msg/ParticipantEntitiesInfo")


class ServedDomain:
    """Puts the nodes, endpoints and messages of a domain on DDS.

    Each publisher has a writer with its profile there, and each subscription a reader. As in a
    ROS 2 container, all nodes share one participant.

    Parameters
    ----------
    domain : Domain
        Of the testbed.
    number : int
        Of the DDS domain.
    receives : bool
        Whether subscriptions receive what others publish there.
    """

    def __init__(self, domain: Domain, number: int, *, receives: bool = False) -> None:
        self._domain, self._receives = domain, receives
        self._participant = dds.join(number)
        self._announcer = NodeAnnouncer(self._participant)
        self._writers: dict[Publisher, dds.RawWriter] = {}
        self._readers: dict[Subscription, dds.RawReader] = {}
        self._nodes: list[str] = []
        self._foreign = dds.ReadyReaders(self._participant)
        self._looked_ns: int | None = None

    def listen(self) -> None:
        """Pass what others have published to the subscriptions; call it as `look`."""
        if not self._receives:
            return
        ready = self._foreign.wait(0.0)
        for subscription, reader in self._readers.items() if ready else ():
            for raw in reader.take() if reader in ready else ():
                executor = self._domain.executor
                due_ns = subscription.due_ns(executor.now_ns)
                sample = Sample(subscription.msgtype, data=raw.data)
                executor.call_at(due_ns, subscription.deliver, sample)

    def look(self, now_ns: int) -> None:
        """Mirror what is new; call it whenever simulated time advances."""
        if self._looked_ns is not None and now_ns - self._looked_ns < _PERIOD_NS:
            return
        self._looked_ns = now_ns
        before = len(self._writers), len(self._readers), self._nodes
        self._nodes = self._domain.node_names()
        for publisher in self._domain.publishers():
            # The simulated world sets its conditions through a publisher of no node.
            is_public = publisher.node in self._nodes and publisher.topic != GROUND_TRUTH_TOPIC
            if is_public and publisher not in self._writers:
                self._writers[publisher] = dds.RawWriter(
                    self._participant, dds_topic(publisher.topic), publisher.msgtype, publisher.qos
                )
                publisher.tap(self._writers[publisher].write)
        for subscription in self._domain.subscriptions():
            if subscription not in self._readers and subscription.topic != GROUND_TRUTH_TOPIC:
                reader = self._readers[subscription] = dds.RawReader(
                    self._participant,
                    dds_topic(subscription.topic),
                    subscription.msgtype,
                    subscription.qos,
                    others_only=True,
                )
                if subscription.callback is not None:
                    self._foreign.add(reader)
        if (len(self._writers), len(self._readers), self._nodes) != before:
            self._publish_entities()

    def _publish_entities(self) -> None:
        readers = [(subscription.node, reader) for subscription, reader in self._readers.items()]
        writers = [(publisher.node, writer) for publisher, writer in self._writers.items()]
        self._announcer.publish(self._nodes, readers, writers)


class NodeAnnouncer:
    """Publishes which endpoints belong to which node, as every ROS 2 process does.

    Parameters
    ----------
    participant
        Owner of the endpoints.
    """

    def __init__(self, participant: dds.Participant) -> None:
        self._participant = participant
        self._entities = dds.RawWriter(participant, ENTITIES_TOPIC, ENTITIES_TYPE, qos.LATCHED)

    def publish(
        self,
        nodes: Iterable[str],
        readers: Iterable[tuple[str, dds.RawReader]],
        writers: Iterable[tuple[str, dds.RawWriter]],
    ) -> None:
        """Publish all nodes by their full names, and endpoints, each with its node."""
        ends: dict[str, tuple[list[object], list[object]]] = {node: ([], []) for node in nodes}
        for node, reader in readers:
            ends[node][0].append(_gid(reader.guid))
        for node, writer in writers:
            ends[node][1].append(_gid(writer.guid))
        named = []
        for full_name, own in ends.items():
            namespace, _, name = full_name.rpartition("/")
            named.append(_Node(namespace or "/", name, *own))
        message = _Participant(_gid(self._participant.guid.bytes), named)
        self._entities.write(serialize(message, ENTITIES_TYPE))


def switch(run: TestbedRun, recipe: Recipe) -> None:
    """Let the mode's node run the scenario of another recipe of the same testbed from now on.

    The run then no longer follows its own recipe.

    Raises
    ------
    ScenarioError
        If the node does not exist yet, or reads or publishes other topics in that recipe.
    """
    program = compile_document(recipe.mode, recipe.scenario)
    if run.node is None:
        raise ScenarioError("The mode's node has not started yet; try again in a few seconds.")
    run.node.switch(execute(program, recipe.attack_seed(), recipe.parameters))


def _gid(guid: bytes) -> object:
    return _Gid(np.frombuffer(guid.ljust(_GID_BYTES, b"\0"), dtype=np.uint8))
