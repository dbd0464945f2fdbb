"""GEXF and GraphML files of a ROS graph.

A graph is a ``networkx.DiGraph`` whose vertices are ROS nodes and topics (in a full view services
and actions too). A vertex's identifier is ``kind:name``, since a ROS node and a topic may share a
name. Attributes of a vertex: ``label`` (the plain name), ``kind``, ``type`` (message type, empty
for ROS nodes). Edges run from node to topic (publish) and from topic to node (subscribe) and count
``messages`` and ``bytes``. Equal graphs make equal bytes: no dates, everything sorted.
"""

import functools
import io
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias
from xml.parsers import expat
from xml.sax.saxutils import escape

from oracle_pipeline.bags.errors import GraphError
from oracle_pipeline.bags.limits import DEEPEST_GRAPH, LARGEST_GRAPH

if TYPE_CHECKING:
    import networkx as nx

    RosGraph: TypeAlias = nx.DiGraph[str]
else:  # most recordings have no graph, and importing networkx takes longer than reading them
    RosGraph = Any

Kind: TypeAlias = Literal["node", "topic", "service", "action"]

KINDS: tuple[Kind, ...] = ("node", "topic", "service", "action")
_VERTEX_ATTRIBUTES = ("kind", "type")
_EDGE_ATTRIBUTES = ("messages", "bytes")


def vertex_id(kind: Kind, name: str) -> str:
    """Return the identifier of a vertex, such as ``topic:/scan``."""
    return f"{kind}:{name}"


def add_traffic(graph: RosGraph, source: str, target: str, messages: int, size: int) -> None:
    """Add traffic to an edge; several endpoints of one node on one topic are one edge."""
    if not graph.has_edge(source, target):
        graph.add_edge(source, target, messages=0, bytes=0)
    edge = graph.edges[source, target]
    edge["messages"] += messages
    edge["bytes"] += size


def write_gexf(graph: RosGraph, path: Path) -> None:
    """Write GEXF 1.2, which Gephi and NetworkX open.

    A run has one every 10 s, so it is assembled as text; a tree of elements takes much longer.
    """
    nodes = [
        f"      <node id={_quoted(vertex)} label={_quoted(graph.nodes[vertex]['label'])}>\n"
        f"{_attvalues(_VERTEX_ATTRIBUTES, graph.nodes[vertex])}      </node>\n"
        for vertex in sorted(graph.nodes)
    ]
    edges = [
        f'      <edge id="{number}" source={_quoted(source)} target={_quoted(target)}>\n'
        f"{_attvalues(_EDGE_ATTRIBUTES, graph.edges[source, target])}      </edge>\n"
        for number, (source, target) in enumerate(sorted(graph.edges))
    ]
    text = (
        f"{_GEXF_BEGIN}{_declared('node', _VERTEX_ATTRIBUTES, 'string')}"
        f"{_declared('edge', _EDGE_ATTRIBUTES, 'long')}{_listed('nodes', nodes)}"
        f"{_listed('edges', edges)}  </graph>\n</gexf>\n"
    )
    path.write_bytes(text.encode())


_GEXF_BEGIN = """\
<?xml version='1.0' encoding='utf-8'?>
<gexf xmlns="http://www.gexf.net/1.2draft" version="1.2">
  <graph defaultedgetype="directed" mode="static">
"""


def _declared(owner: str, names: Sequence[str], kind: str) -> str:
    """Return the declaration of the attributes of nodes or edges."""
    declarations = "".join(
        f'      <attribute id="{name}" title="{name}" type="{kind}" />\n' for name in names
    )
    return f'    <attributes class="{owner}" mode="static">\n{declarations}    </attributes>\n'


def _attvalues(names: Sequence[str], data: Mapping[str, Any]) -> str:
    values = "".join(
        f'          <attvalue for="{name}" value={_quoted(str(data[name]))} />\n' for name in names
    )
    return f"        <attvalues>\n{values}        </attvalues>\n"


def _listed(name: str, elements: Sequence[str]) -> str:
    if not elements:
        return f"    <{name} />\n"
    return f"    <{name}>\n{''.join(elements)}    </{name}>\n"


_ENTITIES = {'"': "&quot;", "\r": "&#13;", "\n": "&#10;", "\t": "&#09;"}


@functools.lru_cache(maxsize=4096)  # names repeat in every interval
def _quoted(text: str) -> str:
    """Return an attribute's value, in quotes."""
    return f'"{escape(text, _ENTITIES)}"'


def write_graphml(graph: RosGraph, path: Path) -> None:
    """Write GraphML, the format of the thesis's single graph."""
    root = ET.Element("graphml", xmlns="http://graphml.graphdrawing.org/xmlns")
    for owner, names, kind in (
        ("node", ("label", *_VERTEX_ATTRIBUTES), "string"),
        ("edge", _EDGE_ATTRIBUTES, "long"),
    ):
        for name in names:
            ET.SubElement(
                root, "key", {"id": name, "for": owner, "attr.name": name, "attr.type": kind}
            )
    element = ET.SubElement(root, "graph", edgedefault="directed")
    for vertex in sorted(graph.nodes):
        data = graph.nodes[vertex]
        node = ET.SubElement(element, "node", id=vertex)
        for name in ("label", *_VERTEX_ATTRIBUTES):
            ET.SubElement(node, "data", key=name).text = data[name]
    for source, target in sorted(graph.edges):
        data = graph.edges[source, target]
        edge = ET.SubElement(element, "edge", source=source, target=target)
        for name in _EDGE_ATTRIBUTES:
            ET.SubElement(edge, "data", key=name).text = str(data[name])
    _write(root, path)


def read_gexf(path: Path) -> RosGraph:
    """Read a file that ``write_gexf`` wrote.

    Raises
    ------
    GraphError
        If the file is missing, broken, has a document type, or lacks an attribute.
    """
    return _read(path, _Gexf)


def read_graphml(path: Path) -> RosGraph:
    """Read a file that ``write_graphml`` wrote; raises as ``read_gexf`` does."""
    return _read(path, _GraphMl)


def _write(root: ET.Element, path: Path) -> None:
    ET.indent(root)
    # As text, which is then encoded at once: ElementTree would encode word by word.
    text = ET.tostring(root, encoding="unicode")
    path.write_bytes(f"<?xml version='1.0' encoding='utf-8'?>\n{text}\n".encode())


def _refuse_document_type(*_declaration: object) -> None:
    """Refuse a DTD, and with it every entity, before anything is expanded."""
    raise GraphError("it has a document type, which a graph file never needs")


class _Xml:
    """Visits a file's elements; refuses those that are nested too deeply."""

    def __init__(self) -> None:
        self._depth = 0

    def enter(self, _name: str, _attributes: dict[str, str]) -> None:
        self._depth += 1
        if self._depth > DEEPEST_GRAPH:
            raise GraphError(f"its elements are deeper than {DEEPEST_GRAPH} (DEEPEST_GRAPH)")

    def leave(self, _name: str) -> None:
        self._depth -= 1

    def graph(self, data: bytes) -> RosGraph:
        """Return the graph, after all elements were visited."""
        raise NotImplementedError


class _GraphMl(_Xml):
    def graph(self, data: bytes) -> RosGraph:
        import networkx as nx

        return _checked(nx.read_graphml(io.BytesIO(data)))


class _Gexf(_Xml):
    """Builds the graph from the elements; a run has one every 10 s, so no tree is built first."""

    def __init__(self) -> None:
        super().__init__()
        self._vertices: dict[str, dict[str, str]] = {}
        self._edges: list[tuple[str, str, dict[str, str]]] = []
        self._titles: dict[tuple[str, str], str] = {}  # of attributes, by owner and identifier
        self._owner = ""
        self._values: dict[str, str] = {}  # of the vertex or edge that was entered

    def enter(self, name: str, attributes: dict[str, str]) -> None:
        super().enter(name, attributes)
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

    def graph(self, data: bytes) -> RosGraph:  # noqa: ARG002 -- already visited
        import networkx as nx

        graph: RosGraph = nx.DiGraph()
        graph.add_nodes_from(
            (vertex, _vertex(vertex, values)) for vertex, values in self._vertices.items()
        )
        for source, target, values in self._edges:
            if source not in self._vertices or target not in self._vertices:
                raise GraphError(f"the edge from {source!r} to {target!r} has no vertex")
            graph.add_edge(source, target, **_traffic(values))
        if self._owner == "":
            raise GraphError("it is no GEXF file")
        return graph


def _read(path: Path, kind: type[_Xml]) -> RosGraph:
    import networkx as nx

    try:
        if path.stat().st_size > LARGEST_GRAPH:
            raise GraphError(f"it is larger than {LARGEST_GRAPH} bytes (LARGEST_GRAPH)")
        data = path.read_bytes()
        scanner, elements = expat.ParserCreate(), kind()
        scanner.StartDoctypeDeclHandler = _refuse_document_type
        scanner.StartElementHandler, scanner.EndElementHandler = elements.enter, elements.leave
        scanner.Parse(data, True)
        return elements.graph(data)
    except (OSError, expat.ExpatError, nx.NetworkXError, GraphError, KeyError, ValueError) as error:
        raise GraphError(
            f"Could not read the graph {path}: {error}. Restore the file, or record the run again."
        ) from error


def _checked(parsed: Any) -> RosGraph:
    """Return the parsed graph with the attributes of our schema and no others."""
    import networkx as nx

    graph: RosGraph = nx.DiGraph()
    for vertex, data in parsed.nodes(data=True):
        graph.add_node(vertex, **_vertex(vertex, data))
    for source, target, data in parsed.edges(data=True):
        graph.add_edge(source, target, **_traffic(data))
    return graph


def _vertex(vertex: str, data: Mapping[str, Any]) -> dict[str, str]:
    kind, name = data["kind"], data["label"]
    if kind not in KINDS or vertex != vertex_id(kind, name):
        raise GraphError(f"vertex {vertex!r} is not 'kind:name' of a known kind")
    return {"label": name, "kind": kind, "type": data.get("type") or ""}


def _traffic(data: Mapping[str, Any]) -> dict[str, int]:
    return {name: int(data[name]) for name in _EDGE_ATTRIBUTES}
