"""The ROS graph of a domain, in the form that the recorder of the testbeds writes."""

from collections.abc import Mapping

import networkx as nx

from oracle_pipeline.bags.discovery import Discovery
from oracle_pipeline.bags.graph_files import RosGraph, add_traffic, vertex_id
from oracle_pipeline.bags.protocol import is_hidden
from oracle_pipeline.bags.qos_profiles import compatible


def snapshot(discovery: Discovery, sent: Mapping[int, tuple[int, int]]) -> RosGraph:
    """Return the current graph with the traffic of each edge; hidden topics are left out.

    Parameters
    ----------
    discovery : Discovery
    sent : mapping of int to tuple
        Messages and bytes, by the handle of the publisher. A subscription receives all messages
        of the publishers of its topic with a compatible QoS.
    """
    graph: RosGraph = nx.DiGraph()
    for name in discovery.node_names():
        graph.add_node(vertex_id("node", name), kind="node", type="", label=name)
    publishers = discovery.topics()
    for endpoint, owner in discovery.owned():
        if is_hidden(endpoint.topic):
            continue
        node, topic = vertex_id("node", owner), vertex_id("topic", endpoint.topic)
        graph.add_node(topic, kind="topic", type=endpoint.msgtype, label=endpoint.topic)
        if endpoint.publishes:
            add_traffic(graph, node, topic, *sent.get(endpoint.handle, (0, 0)))
            continue
        received = [
            sent.get(publisher.handle, (0, 0))
            for publisher in publishers.get(endpoint.topic, ())
            if compatible(publisher.qos, endpoint.qos)
        ]
        add_traffic(graph, topic, node, sum(m for m, _ in received), sum(b for _, b in received))
    return graph
