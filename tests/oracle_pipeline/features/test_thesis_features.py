import json
import re
import textwrap

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline import features
from oracle_pipeline.features import FeatureManager
from oracle_pipeline.features.traffic import thesis_features
from oracle_pipeline.features.traffic.thesis_features import VECTOR, graph_numbers
from oracle_pipeline.opened_run import open_run

PLUGINS = tuple(thesis_features.register_features())


def numbers_of(path, manager=None) -> dict:
    """The ten features of a recording, reasons in place of numbers."""
    with open_run(path) as run:
        tables = features.extract(run, manager or FeatureManager(PLUGINS))
    assert not [column for column in tables.windows if column.startswith("thesis.")]
    row = tables.run.iloc[0].to_dict()
    values = {**row, **json.loads(row["missing"])}
    return {k.removeprefix("thesis."): v for k, v in values.items() if k.startswith("thesis.")}


def test_the_vector_is_the_thesis_s_seven_and_three_in_its_order():
    assert [name.removeprefix("thesis.") for name in VECTOR] == [
        "max_degree", "avg_degree", "density", "entropy", "max_centrality", "avg_centrality",
        "variance", "yaw_variance", "range_variance", "duration_ns",
    ]  # fmt: skip
    assert list(FeatureManager(PLUGINS).features()) == list(VECTOR)


def test_the_test_vector_gives_what_the_thesis_s_code_gives():
    graph = nx.DiGraph([("A", "t1"), ("A", "t2"), ("t1", "B"), ("t2", "B"), ("B", "t3")])
    assert graph_numbers(graph) == pytest.approx(
        {
            "max_degree": 2.0,
            "avg_degree": 1.25,
            "density": 0.25,
            "entropy": 1.5571,
            "max_centrality": 0.5,
            "avg_centrality": 0.25,
            "variance": 0.4,
        },
        abs=5e-5,
    )


def test_a_tie_of_degrees_gives_the_smallest():
    assert graph_numbers(nx.DiGraph([("a", "b"), ("c", "b"), ("b", "c")]))["max_degree"] == 1


def test_an_isolated_vertex_makes_the_entropy_nan_which_becomes_0():
    graph = nx.DiGraph([("A", "t1")])
    assert graph_numbers(graph)["entropy"] == pytest.approx(np.log(2))
    graph.add_node("alone")
    assert graph_numbers(graph)["entropy"] == 0.0
    assert graph_numbers(nx.empty_graph(3, nx.DiGraph))["entropy"] == 0.0


@given(st.sets(st.tuples(st.integers(0, 6), st.integers(0, 6)), min_size=1))
def test_average_centrality_is_the_density(edges):
    graph = nx.DiGraph([(a, b) for a, b in edges if a != b] or [(0, 1)])
    numbers = graph_numbers(graph)
    assert numbers["avg_centrality"] == pytest.approx(numbers["density"])


def test_the_graph_is_that_of_the_whole_run_with_its_observers(make_run):
    numbers = numbers_of(make_run().path)
    assert numbers["density"] == pytest.approx(6 / (8 * 7))  # the recorder's edge is the sixth


def test_the_thesis_s_yaw_jumps_at_plus_minus_pi(bag_of, messages):
    turns = [(t, "/odom", messages.odometry(t, 0, 0, yaw, 0)) for t, yaw in ((0, 3.1), (1, -3.1))]
    assert numbers_of(bag_of(turns))["yaw_variance"] == pytest.approx(9.61)


def test_one_ray_without_a_range_makes_the_range_variance_0(bag_of, messages):
    scans = [(t, "/scan_tom", messages.scan(t, [1.0, 3.0])) for t in range(5)]
    assert numbers_of(bag_of(scans))["range_variance"] == pytest.approx(1.0)


@pytest.mark.parametrize("odd", [[1.0, np.inf], [np.nan, 2.0], []])
def test_one_ray_of_one_scan_is_enough(odd, bag_of, messages):
    scans = [(t, "/scan", messages.scan(t, [1.0, 3.0])) for t in range(5)]
    assert numbers_of(bag_of([*scans, (5, "/scan", messages.scan(5, odd))]))["range_variance"] == 0


def test_duration_is_that_of_the_bag_in_nanoseconds(bag_of, messages):
    recorded = [(0.0, "/plan", messages.plan(0, 1.0)), (7.25, "/plan", messages.plan(7, 1.0))]
    numbers = numbers_of(bag_of(recorded))
    assert numbers["duration_ns"] == 7_250_000_000
    # The thesis has 0 there, which is also what a robot that stands still gives.
    assert numbers["yaw_variance"] == "no odometry"
    assert numbers["range_variance"] == "no scans"


def test_scans_are_known_by_their_type_and_not_by_their_name(bag_of, messages):
    recorded = [
        (0.0, "/scan_plan", messages.plan(0, 1.0)),
        (0.0, "/front_lidar", messages.scan(0, [1.0, 3.0])),
        (1.0, "/wheels", messages.odometry(1, 0, 0, 0, 0)),
    ]
    assert numbers_of(bag_of(recorded))["range_variance"] == pytest.approx(1.0)


def test_a_quaternion_longer_than_one_loses_the_three_contextual_features(bag_of, messages):
    steep = messages.odometry(0, 0, 0, 0, 0)
    q = steep.pose.pose.orientation
    q.x = q.z = 0.7072  # with rounding, the sine of the pitch comes out above 1
    q.w = q.y = 0.0
    numbers = numbers_of(bag_of([(0, "/odom", steep), (1, "/odom", steep)]))
    assert "ValueError" in numbers["duration_ns"]


# The same numbers by another way: over the bag's database, in the thesis's form of a plugin.
FROM_DATABASE = """
    import numpy as np
    from plugin_interface import FeatureExtractionPlugin
    from rclpy.serialization import deserialize_message
    from rosidl_runtime_py.utilities import get_message

    class FromDatabase(FeatureExtractionPlugin):
        def extract_features(self, G, cur):
            rows = cur.execute(
                "SELECT name, type, timestamp, data FROM messages "
                "JOIN topics ON topics.id = topic_id ORDER BY messages.id"
            ).fetchall()
            yaws, variances = [], []
            for topic, kind, _, data in rows:
                if topic != "/odom" and "scan" not in topic:
                    continue
                message = deserialize_message(data, get_message(kind))
                if topic == "/odom":
                    q = message.pose.pose.orientation
                    direction = complex(q.w, q.z) ** 2  # of a robot on level ground
                    yaws.append(np.angle(direction))
                else:
                    ranges = np.array(message.ranges, dtype=float)
                    variances.append(ranges.var() if np.isfinite(ranges).all() else np.nan)
            mean = np.mean(variances)
            stamps = [stamp for _, _, stamp, _ in rows]
            return [np.var(yaws), 0.0 if np.isnan(mean) else mean, max(stamps) - min(stamps)]
"""


def test_built_in_and_plugin_in_the_thesis_s_form_agree(make_run, tmp_path):
    (tmp_path / "plugins").mkdir()
    (tmp_path / "plugins" / "check.py").write_text(textwrap.dedent(FROM_DATABASE))
    numbers = numbers_of(make_run().path, features.build_manager(tmp_path / "plugins"))
    ours = [numbers[name] for name in ("yaw_variance", "range_variance", "duration_ns")]
    theirs = [numbers[f"check_{number}"] for number in range(3)]
    assert ours == pytest.approx(theirs, rel=1e-12)
    assert ours[0] > 0


def test_no_built_in_column_could_be_one_of_a_plugin_in_the_thesis_s_form():
    assert not [name for name in VECTOR if re.search(r"_\d+$", name)]
