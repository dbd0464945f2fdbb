"""Draw docs/images/architecture.svg: the rooms of the code and their imports.

A room is a package; the modules directly in ``assets`` and in ``resources`` count as a room each.
Each room is drawn above every room that it imports, directly or through single modules, which are
not drawn. An arrow that follows from others is left out. ``make architecture`` runs this.
"""

from pathlib import Path

import grimp
import matplotlib as mpl
import networkx as nx
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

COLOURS = {
    "oracle_pipeline": "#cfe3f5",
    "assets": "#f9dfc5",
    "resources": "#e2d7f0",
    "sim": "#d4ecd2",
}
WHOLE = ("assets", "resources")  # rooms of their own, besides the packages in them
ROOF = "oracle_pipeline.definitions"  # the one module that is a room
PICTURE = Path(__file__).parent / "images" / "architecture.svg"
ROOM_WIDTH, ROOM_HEIGHT = 0.86, 0.46  # in steps between rooms and between layers


def room_of(module: str, packages: set[str]) -> str:
    """Return the room of a module, or the module itself if it is in none."""
    second_level = ".".join(module.split(".")[:2])
    top = module.partition(".")[0]
    return top if top in WHOLE and second_level not in packages else second_level


def room_graph() -> "nx.DiGraph[str]":
    """Return the graph of rooms: an edge to each room that one needs, without implied edges."""
    imports = grimp.build_graph(*COLOURS)
    packages = {module.rpartition(".")[0] for module in imports.modules}
    graph: nx.DiGraph[str] = nx.DiGraph()
    for importer in sorted(imports.modules):
        for imported in sorted(imports.find_modules_directly_imported_by(importer)):
            graph.add_edge(room_of(importer, packages), room_of(imported, packages))
    graph.remove_edges_from(list(nx.selfloop_edges(graph)))
    rooms = [
        room for room in graph if room in packages | {ROOF} and room not in COLOURS.keys() - WHOLE
    ]
    return nx.transitive_reduction(nx.transitive_closure(graph).subgraph(sorted(rooms)))


def positions(graph: "nx.DiGraph[str]") -> dict[str, tuple[float, float]]:
    """Return the position of each room; within a layer, it is near the rooms that it imports."""
    placed: dict[str, tuple[float, float]] = {}
    for height, layer in enumerate(nx.topological_generations(graph.reverse())):
        wish = {room: [placed[below][0] for below in graph[room]] for room in layer}
        order = sorted(layer, key=lambda room: (sum(wish[room]) / (len(wish[room]) or 1), room))
        for index, room in enumerate(order):
            placed[room] = (index - (len(order) - 1) / 2.0, float(height))
    return placed


def draw(graph: "nx.DiGraph[str]", axes: Axes) -> None:
    """Draw rooms and arrows."""
    place = positions(graph)
    for importer, imported in graph.edges:
        (x0, y0), (x1, y1) = place[importer], place[imported]
        axes.annotate(
            "",
            xy=(x1, y1 + ROOM_HEIGHT / 2.0),
            xytext=(x0, y0 - ROOM_HEIGHT / 2.0),
            arrowprops={"arrowstyle": "-|>", "color": "#777777", "linewidth": 0.9},
        )
    for room, (x, y) in place.items():
        package, _, name = room.partition(".")
        corner = (x - ROOM_WIDTH / 2.0, y - ROOM_HEIGHT / 2.0)
        axes.add_patch(
            plt.Rectangle(
                corner, ROOM_WIDTH, ROOM_HEIGHT, facecolor=COLOURS[package], edgecolor="#555555"
            )
        )
        label = f"{package}\n{name}" if name else package
        axes.text(x, y, label, ha="center", va="center", fontsize=8.5, color="#222222")
    across = [x for x, _ in place.values()]
    axes.set_xlim(min(across) - 0.6, max(across) + 0.6)
    axes.set_ylim(-0.5, max(y for _, y in place.values()) + 0.5)
    axes.set_axis_off()


def main() -> None:
    """Draw the picture of the present code."""
    graph = room_graph()
    mpl.rcParams["svg.hashsalt"] = "architecture"  # the same code gives the same file
    mpl.rcParams["svg.fonttype"] = "none"
    figure, axes = plt.subplots(figsize=(8.5, 8.5), facecolor="white")
    draw(graph, axes)
    figure.tight_layout(pad=0.2)
    figure.savefig(PICTURE, metadata={"Date": None})


if __name__ == "__main__":
    main()
