"""Mirrors a testbed's domain on a real DDS domain: its nodes, endpoints and messages.

It accompanies a run and changes nothing in it. Service requests stay inside the
simulation, so services are not on DDS; neither is the ground truth.
"""

import numpy as np

from oracle_pipeline.bags import dds
from oracle_pipeline.bags.dds_names import ENTITIES_TOPIC, ENTITIES_TYPE, dds_topic
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC, message_class, serialize
from sim.fuzzing.compilation import compile_document
from sim.fuzzing.execution import execute
from sim.fuzzing.scenario import ScenarioError
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.endpoints import Publisher, Subscription
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

    Each publisher has a writer with its profile there, and each subscription a reader that is never
    read. As in a ROS 2 container, all nodes share one participant.

    Parameters
    ----------
    domain : Domain
        Of the testbed.
    number : int
        Of the DDS domain.
    """

    def __init__(self, domain: Domain, number: int) -> None:
        self._domain = domain
        self._participant = dds.join(number)
        self._entities = dds.RawWriter(
            self._participant, ENTITIES_TOPIC, ENTITIES_TYPE, qos.LATCHED
        )
        self._writers: dict[Publisher, dds.RawWriter] = {}
        self._readers: dict[Subscription, dds.RawReader] = {}
        self._nodes: list[str] = []
        self._looked_ns: int | None = None

    def look(self, now_ns: int) -> None:
        """Mirror what is new; call it whenever simulated time advances."""
        if self._looked_ns is not None and now_ns - self._looked_ns < _PERIOD_NS:
            return
        self._looked_ns = now_ns
        before = len(self._writers), len(self._readers), self._nodes
        self._nodes = self._domain.node_names()
        for publisher in self._domain.publishers():
            if publisher not in self._writers and publisher.topic != GROUND_TRUTH_TOPIC:
                self._writers[publisher] = dds.RawWriter(
                    self._participant, dds_topic(publisher.topic), publisher.msgtype, publisher.qos
                )
                publisher.tap(self._writers[publisher].write)
        for subscription in self._domain.subscriptions():
            if subscription not in self._readers and subscription.topic != GROUND_TRUTH_TOPIC:
                self._readers[subscription] = dds.RawReader(
                    self._participant,
                    dds_topic(subscription.topic),
                    subscription.msgtype,
                    subscription.qos,
                )
        if (len(self._writers), len(self._readers), self._nodes) != before:
            self._publish_entities()

    def _publish_entities(self) -> None:
        """Publish which endpoints belong to which node, as every ROS 2 process does."""
        readers: dict[str, list[object]] = {}
        writers: dict[str, list[object]] = {}
        for subscription, reader in self._readers.items():
            readers.setdefault(subscription.node, []).append(_gid(reader.guid))
        for publisher, writer in self._writers.items():
            writers.setdefault(publisher.node, []).append(_gid(writer.guid))
        nodes = []
        for full_name in self._nodes:
            namespace, _, name = full_name.rpartition("/")
            own = readers.get(full_name, []), writers.get(full_name, [])
            nodes.append(_Node(namespace or "/", name, *own))
        message = _Participant(_gid(self._participant.guid.bytes), nodes)
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
