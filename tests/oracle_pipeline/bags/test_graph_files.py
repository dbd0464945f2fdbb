import networkx as nx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from oracle_pipeline.bags.errors import GraphError
from oracle_pipeline.bags.graph_files import KINDS, read_gexf, vertex_id, write_gexf, write_graphml

WRITERS = [write_gexf, write_graphml]

names = st.from_regex(r"/[a-z0-9_/<&>\"'é]{0,12}", fullmatch=True)


@st.composite
def graphs(draw):
    graph = nx.DiGraph()
    for kind, name in draw(st.lists(st.tuples(st.sampled_from(KINDS), names), max_size=8)):
        msgtype = "" if kind == "node" else draw(names)
        graph.add_node(vertex_id(kind, name), label=name, kind=kind, type=msgtype)
    for source in list(graph):
        for target in list(graph):
            if draw(st.booleans()):
                counts = draw(st.tuples(st.integers(0, 2**50), st.integers(0, 2**50)))
                graph.add_edge(source, target, messages=counts[0], bytes=counts[1])
    return graph


@pytest.mark.slow
def test_written_files_are_read_back(tmp_path):
    @settings(max_examples=25)
    @given(graphs())
    def check(graph):
        write_gexf(graph, tmp_path / "graph")
        copy = read_gexf(tmp_path / "graph")
        assert copy.nodes(data=True) == graph.nodes(data=True)
        assert {e: copy.edges[e] for e in copy.edges} == {e: graph.edges[e] for e in graph.edges}

    check()


@pytest.mark.slow
@pytest.mark.parametrize("write", WRITERS)
def test_equal_graphs_give_equal_bytes(write, tmp_path):
    @settings(max_examples=25)
    @given(graphs(), st.randoms())
    def check(graph, random):
        nodes, edges = list(graph.nodes(data=True)), list(graph.edges(data=True))
        random.shuffle(nodes)
        random.shuffle(edges)
        shuffled = nx.DiGraph()
        shuffled.add_nodes_from(nodes)
        shuffled.add_edges_from(edges)
        write(graph, tmp_path / "one")
        write(shuffled, tmp_path / "other")
        assert (tmp_path / "one").read_bytes() == (tmp_path / "other").read_bytes()

    check()


def small() -> nx.DiGraph:
    graph = nx.DiGraph()
    graph.add_node("node:/amcl", label="/amcl", kind="node", type="")
    graph.add_node("topic:/tf", label="/tf", kind="topic", type="tf2_msgs/msg/TFMessage")
    graph.add_edge("node:/amcl", "topic:/tf", messages=5, bytes=460)
    return graph


@pytest.mark.parametrize(
    ("write", "read"), [(write_gexf, nx.read_gexf), (write_graphml, nx.read_graphml)]
)
def test_networkx_opens_the_files(write, read, tmp_path):
    write(small(), tmp_path / "graph")
    graph = read(tmp_path / "graph")
    assert graph.is_directed()
    assert graph.nodes["topic:/tf"]["type"] == "tf2_msgs/msg/TFMessage"
    assert graph.edges["node:/amcl", "topic:/tf"]["bytes"] == 460


ATTACK = '<!DOCTYPE gexf [<!ENTITY a "{}">]>'


def test_entities_are_refused(tmp_path):
    write_gexf(small(), tmp_path / "graph")
    head, _, rest = (tmp_path / "graph").read_text().partition("?>")
    (tmp_path / "graph").write_text(f"{head}?>{ATTACK}{rest.replace('/amcl', '&a;')}")
    with pytest.raises(GraphError, match="document type"):
        read_gexf(tmp_path / "graph")


@pytest.mark.parametrize(
    ("old", "new"),
    [("</", "<"), ("node:/amcl", "amcl"), ("topic", "chart"), ("460", "many"), ("460", ""),
     ("messages", "letters")],
)  # fmt: skip
def test_a_file_that_is_no_graph_is_an_error(old, new, tmp_path):
    write_gexf(small(), tmp_path / "graph")
    text = (tmp_path / "graph").read_text()
    (tmp_path / "graph").write_text(text.replace(old, new))
    with pytest.raises(GraphError, match=f"Could not read the graph {tmp_path / 'graph'}"):
        read_gexf(tmp_path / "graph")


def test_a_missing_or_empty_file_is_an_error(tmp_path):
    (tmp_path / "empty").touch()
    for name in ("empty", "absent"):
        with pytest.raises(GraphError, match=name):
            read_gexf(tmp_path / name)


def test_a_graph_does_not_depend_on_the_layout_of_its_file(tmp_path):
    write_gexf(small(), tmp_path / "written.gexf")
    text = (tmp_path / "written.gexf").read_text()
    for number, same in enumerate(
        (
            text.replace("\n", "\r\n"),
            text.replace('"/amcl"', '"&#47;amcl"'),
            text.replace('for="kind" value="topic"', 'value="topic" for="kind"'),
            text.replace("  <graph", "  <!-- a comment -->\n  <graph"),
        )
    ):
        assert same != text
        (tmp_path / f"{number}.gexf").write_text(same)
        graph = read_gexf(tmp_path / f"{number}.gexf")
        assert graph.nodes(data=True) == small().nodes(data=True)
        assert list(graph.edges(data=True)) == list(small().edges(data=True))


@pytest.mark.parametrize(
    ("name", "written"),
    [
        ("/bell\x07", r"/bell\x07"),
        ("/\x1b[2Jcleared", r"/\x1b[2Jcleared"),
        ("/half\ud800", r"/half\ud800"),
        ("/no\uffff", r"/no\uffff"),
    ],
)
@pytest.mark.parametrize(
    ("write", "read"),
    [(write_gexf, read_gexf), (write_gexf, nx.read_gexf), (write_graphml, nx.read_graphml)],
)
def test_a_name_that_xml_has_no_place_for_is_escaped(write, read, name, written, tmp_path):
    graph = small()
    graph.add_node(vertex_id("node", name), label=name, kind="node", type=name)
    graph.add_edge(vertex_id("node", name), "topic:/tf", messages=1, bytes=2)
    write(graph, tmp_path / "graph")
    copy = read(tmp_path / "graph")
    vertex = copy.nodes[vertex_id("node", written)]
    assert (vertex["label"], vertex["type"]) == (written, written)
    assert copy.number_of_edges() == 2


def test_a_file_with_control_characters_from_an_older_release_is_read(tmp_path):
    write_gexf(small(), tmp_path / "graph")
    old = (tmp_path / "graph").read_bytes().replace(b"/amcl", b"/am\x07cl")
    (tmp_path / "graph").write_bytes(old)
    assert r"node:/am\x07cl" in read_gexf(tmp_path / "graph")
