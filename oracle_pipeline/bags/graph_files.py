"""GEXF and GraphML files of a ROS graph.

A graph is a ``networkx.DiGraph`` whose vertices are ROS nodes and topics (in a full view services
and actions too). A vertex's identifier is ``kind:name``, since a ROS node and a topic may share a
name. Attributes of a vertex: ``label`` (the plain name), ``kind``, ``type`` (message type, empty
for ROS nodes). Edges run from node to topic (publish) and from topic to node (subscribe) and count
``messages`` and ``bytes``. Equal graphs make equal bytes: no dates, everything sorted. A character
that XML has no place for, such as a bell in a name, is written as its Python escape.
"""

import functools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias
from xml.parsers import expat
from xml.sax.saxutils import escape

from oracle_pipeline.bags.errors import GraphError
from oracle_pipeline.bags.limits import DEEPEST_GRAPH, LARGEST_GRAPH

if TYPE_CHECKING:
    import jinja2
    import networkx as nx

    RosGraph: TypeAlias = nx.DiGraph[str]
else:  # most recordings have no graph, and importing networkx takes longer than reading them
    RosGraph = Any

VertexKind: TypeAlias = Literal["node", "topic", "service", "action"]

KINDS: tuple[VertexKind, ...] = ("node", "topic", "service", "action")
_EDGE_ATTRIBUTES = ("messages", "bytes")


def vertex_id(kind: VertexKind, name: str) -> str:
    """Return the identifier of a vertex, such as ``topic:/scan``."""
    return f"{kind}:{name}"


def add_traffic(graph: RosGraph, source: str, target: str, messages: int, size: int) -> None:
    """Add traffic to an edge; several endpoints of one node on one topic are one edge."""
    edge = graph.get_edge_data(source, target)
    if edge is None:
        graph.add_edge(source, target, messages=messages, bytes=size)
    else:
        edge["messages"] += messages
        edge["bytes"] += size


def write_gexf(graph: RosGraph, path: Path) -> None:
    """Write GEXF 1.2, which Gephi and NetworkX open."""
    nodes, edges = (sorted(each(data=True)) for each in (graph.nodes, graph.edges))
    path.write_bytes(_gexf().render(nodes=nodes, edges=edges).encode())


@functools.cache
def _gexf() -> "jinja2.Template":
    import jinja2

    environment = jinja2.Environment(  # noqa: S701 -- the filter escapes all values
        loader=jinja2.PackageLoader("oracle_pipeline.bags"),
        trim_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["quoted"] = _quoted
    return environment.get_template("graph.gexf")


# The rest of what UTF-8 or XML 1.0 excludes; a file with such bytes was written by 0.2 or older.
_FORBIDDEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")
_FORBIDDEN_BYTES = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f]")
_ENTITIES = {'"': "&quot;", "\r": "&#13;", "\n": "&#10;", "\t": "&#09;"}


@functools.lru_cache(maxsize=4096)  # names repeat in every interval
def _quoted(text: str) -> str:
    """Return an attribute's value, in quotes."""
    return f'"{escape(_valid(text), _ENTITIES)}"'


def _valid(text: str) -> str:
    """Return text as XML can hold it."""
    return _FORBIDDEN.sub(lambda match: ascii(match[0])[1:-1], text)


def write_graphml(graph: RosGraph, path: Path) -> None:
    """Write GraphML, the format of the thesis's single graph."""
    import networkx as nx

    ordered: RosGraph = nx.DiGraph()
    for vertex in sorted(graph):
        data = graph.nodes[vertex]
        values = {name: _valid(data[name]) for name in ("label", "kind", "type")}
        ordered.add_node(_valid(vertex), **values)
    for source, target, traffic in sorted(graph.edges(data=True)):
        ordered.add_edge(_valid(source), _valid(target), **traffic)
    nx.write_graphml_xml(ordered, path)


def read_gexf(path: Path) -> RosGraph:
    """Read a file that ``write_gexf`` wrote.

    Raises
    ------
    GraphError
        If the file is missing, broken, has a document type, or lacks an attribute.
    """
    elements = _Gexf()
    try:
        if path.stat().st_size > LARGEST_GRAPH:
            raise GraphError(f"it is larger than {LARGEST_GRAPH} bytes (LARGEST_GRAPH)")
        data = _FORBIDDEN_BYTES.sub(lambda match: b"\\x%02x" % match[0][0], path.read_bytes())
        scanner = expat.ParserCreate()
        scanner.StartDoctypeDeclHandler = _refuse_document_type
        scanner.StartElementHandler, scanner.EndElementHandler = elements.enter, elements.leave
        scanner.Parse(data, True)
        return elements.graph()
    except (OSError, expat.ExpatError, GraphError, KeyError, ValueError) as error:
        raise GraphError(
            f"Could not read the graph {path}: {error}. Restore the file, or record the run again."
        ) from error


def _refuse_document_type(*_declaration: object) -> None:
    """Refuse a DTD, and with it every entity, before anything is expanded."""
    raise GraphError("it has a document type, which a graph file never needs")


class _Gexf:
    """Builds the graph from the elements; a run has one every 10 s, so no tree is built first."""

    def __init__(self) -> None:
        self._depth = 0
        self._vertices: dict[str, dict[str, str]] = {}
        self._edges: list[tuple[str, str, dict[str, str]]] = []
        self._titles: dict[tuple[str, str], str] = {}  # of attributes, by owner and identifier
        self._owner = ""
        self._values: dict[str, str] = {}  # of the vertex or edge that was entered

    def enter(self, name: str, attributes: dict[str, str]) -> None:
        """Visit an element."""
        self._depth += 1
        if self._depth > DEEPEST_GRAPH:
            raise GraphError(f"its elements are deeper than {DEEPEST_GRAPH} (DEEPEST_GRAPH)")
        if name == "attributes":
            self._owner = attributes["class"]
        elif name == "attribute":
            self._titles[self._owner, attributes["id"]] = attributes["title"]
        elif name == "node":
            self._owner = name
            self._values = self._vertices[attributes["id"]] = {"label": attributes["label"]}
        elif name == "edge":
            self._owner = name
            self._values = {}
            self._edges.append((attributes["source"], attributes["target"], self._values))
        elif name == "attvalue":
            self._values[self._titles[self._owner, attributes["for"]]] = attributes["value"]
        elif name == "graph" and attributes["defaultedgetype"] != "directed":
            raise GraphError("its edges are not directed")

    def leave(self, _name: str) -> None:
        """Leave an element."""
        self._depth -= 1

    def graph(self) -> RosGraph:
        """Return the graph, after all elements were visited."""
        import networkx as nx

        if self._owner == "":
            raise GraphError("it is no GEXF file")
        graph: RosGraph = nx.DiGraph()
        graph.add_nodes_from(
            (vertex, _vertex(vertex, data)) for vertex, data in self._vertices.items()
        )
        for source, target, data in self._edges:
            if source not in self._vertices or target not in self._vertices:
                raise GraphError(f"the edge from {source!r} to {target!r} has no vertex")
            graph.add_edge(source, target, **{name: int(data[name]) for name in _EDGE_ATTRIBUTES})
        return graph


def _vertex(vertex: str, data: Mapping[str, str]) -> dict[str, str]:
    kind, name = data["kind"], data["label"]
    if kind not in KINDS or vertex != vertex_id(kind, name):
        raise GraphError(f"vertex {vertex!r} is not 'kind:name' of a known kind")
    return {"label": name, "kind": kind, "type": data.get("type", "")}
