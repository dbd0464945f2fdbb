import json
import logging
import re
import textwrap

import networkx as nx
import numpy as np
import pytest

from oracle_pipeline import features
from oracle_pipeline.bags.types import typestore
from oracle_pipeline.bags.writer import BagWriter
from oracle_pipeline.datasets import feature_dataset, read_table, write_table
from oracle_pipeline.features import (
    Feature,
    FeatureManager,
    FeaturePlugin,
    Located,
    Missing,
    Request,
)
from oracle_pipeline.opened_run import open_run

NO_NODES = nx.freeze(nx.DiGraph())

PLUGIN = """
    from oracle_pipeline.features import Feature, FeaturePlugin, Request, hookimpl

    def compute(window):
        return {"messages": len(window.topics["scans"]["/scan"].times_s)}

    @hookimpl
    def register_features():
        topics = {"scans": Request(lambda scan: 0.0, "/scan")}
        feature = Feature("messages", "1", 1.0, "scans in the window")
        return [FeaturePlugin("counter", "my_lab", (feature,), compute, topics)]
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "plugins").mkdir()
    return tmp_path / "plugins"


def write(folder, name: str, code: str) -> None:
    (folder / name).write_text(textwrap.dedent(code))


def extract(path, manager) -> features.FeatureTables:
    with open_run(path) as run:
        return features.extract(run, manager)


def reasons(table, row=0) -> dict[str, str]:
    return json.loads(table["missing"].iloc[row])


def plugin_of(compute, name="odd", topics=None, **options) -> FeaturePlugin:
    feature = Feature("value", "1", 0.0, "a value")
    return FeaturePlugin(name, name, (feature,), compute, topics or {}, **options)


def test_every_built_in_feature_has_a_description():
    manager = features.build_manager()
    assert len(manager.features()) > 20
    for column, feature in manager.features().items():
        assert re.fullmatch(r"[a-z_]+\.[a-z0-9_]+", column)
        assert feature.unit
        assert feature.description
        assert feature.floor > 0


def test_a_file_of_the_folder_adds_its_columns(folder, make_run):
    write(folder, "counter.py", PLUGIN)
    manager = features.build_manager(folder)
    tables = extract(make_run().path, manager)
    assert tables.run["my_lab.messages"].tolist() == [136.0]
    assert tables.windows["my_lab.messages"].tolist() == 9 * [25.0] + [23.0]
    assert tables.run.attrs["fields"]["my_lab.messages"]["unit"] == "1"


def test_a_file_may_be_any_python(folder):
    data = """
        from __future__ import annotations
        from dataclasses import dataclass

        @dataclass
        class Setting:
            width_m: float = 1.0
    """
    write(folder, "counter.py", textwrap.dedent(data) + textwrap.dedent(PLUGIN))
    assert features.build_manager(folder).broken == {}


def test_the_folder_can_come_from_the_environment(folder, monkeypatch):
    write(folder, "counter.py", PLUGIN)
    monkeypatch.setenv("ORACLE_PLUGINS", str(folder))
    assert "my_lab.messages" in features.build_manager().features()


def test_a_missing_folder_is_an_error(tmp_path):
    with pytest.raises(features.PluginError, match=r"no plugin folder .*absent"):
        features.build_manager(tmp_path / "absent")


def test_a_column_offered_twice_is_an_error(folder):
    write(folder, "one.py", PLUGIN)
    write(folder, "two.py", PLUGIN.replace('"counter"', '"other"'))
    with pytest.raises(features.PluginError, match=r"'my_lab.messages' .*by counter and by other"):
        features.build_manager(folder)
    write(folder, "two.py", PLUGIN.replace('"my_lab"', '"your_lab"'))
    with pytest.raises(features.PluginError, match="2 plugins are called 'counter'"):
        features.build_manager(folder)


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("import no_such_module", "No module named 'no_such_module'"),
        ("def broken(:", "SyntaxError"),
        (PLUGIN.replace("return [Fea", "return 1 / 0, [Fea"), "ZeroDivisionError"),
        (PLUGIN.replace("return [", "return 3 or ["), "must return a list"),
        (PLUGIN.replace("register_features()", "register_features(bag)"), "PluginValidationError"),
    ],
)
def test_a_file_that_cannot_be_loaded_is_kept_as_a_reason(code, reason, folder, make_run, caplog):
    write(folder, "broken.py", code)
    manager = features.build_manager(folder)
    (text,) = manager.broken.values()
    assert reason in text
    assert reason in caplog.text
    tables = extract(make_run().path, manager)
    assert set(manager.broken.items()) <= set(reasons(tables.run).items())
    assert np.isfinite(tables.run["structural.density"]).all()


def raises(_window):
    raise ValueError("no good")


@pytest.mark.parametrize(
    ("compute", "reason"),
    [
        (raises, "ValueError: no good"),
        (lambda _: {"value": float("nan")}, "the plugin returned nan"),
        (lambda _: {"value": float("inf")}, "the plugin returned inf"),
        (lambda _: {"value": Located(float("nan"), "/scan")}, "the plugin returned nan"),
        (lambda _: {"value": "many"}, "could not convert string to float"),
        (lambda _: {}, "instead of ['value']"),
        (lambda _: {"value": 1.0, "more": 2.0}, "instead of ['value']"),
        (lambda _: None, "NoneType"),
        (lambda _: Missing("not here"), "not here"),
        (lambda _: {"value": Missing("not now")}, "not now"),
        (lambda w: {"value": (w.graph or NO_NODES).add_node("x")}, "Frozen graph"),
    ],
)
def test_a_plugin_that_fails_loses_only_its_own_columns(compute, reason, make_run, caplog):
    good = plugin_of(lambda _: {"value": 1.0}, "good")
    manager = FeatureManager((plugin_of(compute), good))
    with caplog.at_level(logging.ERROR):
        tables = extract(make_run().path, manager)
    for table in tables:
        assert table["odd.value"].isna().all()
        assert (table["good.value"] == 1.0).all()
        for row in range(len(table)):
            assert table["where"].iloc[row] == "{}"
            assert list(reasons(table, row)) == ["odd.value"]
            assert reason in reasons(table, row)["odd.value"]
    assert len(caplog.records) <= 1  # once a run, not once a window


def test_values_that_a_plugin_keeps_are_cut_to_the_window(make_run):
    def compute(window):
        (series,) = window.topics["odometry"].values()
        (past,) = window.history["odometry"].values()
        assert (series.times_s >= window.start_s).all()
        assert (series.times_s < window.end_s).all()
        assert (series.values == np.floor(series.times_s)).all()
        assert past.times_s[0] == 0.0
        assert past.times_s[-1] == series.times_s[-1]
        with pytest.raises(ValueError, match="read-only"):
            series.values[0] = 0.0
        return {"value": len(series.times_s)}

    topics = {"odometry": Request(lambda m: m.header.stamp.sec, msgtype="nav_msgs/msg/Odom*")}
    tables = extract(make_run().path, FeatureManager((plugin_of(compute, topics=topics),)))
    assert reasons(tables.run) == {}
    assert tables.run["odd.value"].tolist() == [136]
    assert tables.windows["odd.value"].tolist() == 9 * [25] + [23]


def test_where_a_value_was_attained_stands_beside_it(make_run, tmp_path):
    plugin = plugin_of(lambda window: {"value": Located(window.end_s, "/scan")})
    tables = extract(make_run().path, FeatureManager((plugin,)))
    for table in tables:
        path = tmp_path / "table.parquet"
        write_table(table, path)
        for where in read_table(path)["where"]:
            assert json.loads(where) == {"odd.value": "/scan"}
    assert tables.windows["odd.value"].tolist()[:3] == [5.0, 7.5, 10.0]
    assert feature_dataset([tables.run])["where"].tolist() == ['{"odd.value": "/scan"}']


def test_prepared_results_are_shared_by_all_windows(make_run):
    whole = []

    def prepare(window):
        whole.append((window.start_s, window.end_s, len(window.topics["scans"]["/scan"].times_s)))
        return "shared"

    topics = {"scans": Request(lambda _: 0.0, "/scan")}
    plugin = plugin_of(
        lambda window: {"value": float(window.prepared == "shared")}, topics=topics, prepare=prepare
    )
    for table in extract(make_run().path, FeatureManager((plugin,))):
        assert (table["odd.value"] == 1.0).all()
    assert whole == [(0.0, pytest.approx(27.0), 136)]


def test_a_plugin_without_preparation_finds_none(make_run):
    plugin = plugin_of(lambda window: {"value": float(window.prepared is None)})
    assert extract(make_run().path, FeatureManager((plugin,))).run["odd.value"].tolist() == [1.0]


@pytest.mark.parametrize(
    ("prepare", "reason"),
    [(raises, "ValueError: no good"), (lambda _: Missing("nothing to compare"), "nothing to com")],
)
def test_a_plugin_whose_preparation_fails_loses_only_its_own_columns(prepare, reason, make_run):
    plugin = plugin_of(lambda _: {"value": 1.0}, prepare=prepare)
    for table in extract(make_run().path, FeatureManager((plugin,))):
        assert table["odd.value"].isna().all()
        assert reason in reasons(table)["odd.value"]


def test_raw_requests_decode_nothing(make_run):
    stamps_ns = []
    topics = {
        "scans": Request(
            lambda record: stamps_ns.append(record.header_stamp_ns) or 0.0, "/scan", raw=True
        )
    }
    with open_run(make_run().path) as run:
        run.bag.deserialize = raises
        plugin = plugin_of(lambda _: {"value": 1.0}, topics=topics)
        table = features.extract(run, FeatureManager((plugin,))).run
    assert reasons(table) == {}
    assert len(stamps_ns) == 136
    assert None not in stamps_ns


def test_a_request_may_take_the_first_message_of_each_span(make_run):
    def compute(window):
        (series,) = window.topics["scans"].values()
        assert series.times_s.tolist() == list(range(27 + 1))
        return {"value": 1.0}

    topics = {"scans": Request(lambda _: 0.0, "/scan", every_s=1.0)}
    table = extract(make_run().path, FeatureManager((plugin_of(compute, topics=topics),))).run
    assert reasons(table) == {}


@pytest.mark.parametrize("many", [False, True])
def test_values_that_are_none_are_left_out(many, make_run):
    odd = iter(range(136))

    def keep(messages):
        kept = [1.0 if next(odd) % 2 else None for _ in range(len(messages) if many else 1)]
        return kept if many else kept[0]

    topics = {"scans": Request(keep, "/scan", many=many, dtype=object)}
    plugin = plugin_of(lambda w: {"value": len(w.topics["scans"]["/scan"].times_s)}, topics=topics)
    assert extract(make_run().path, FeatureManager((plugin,))).run["odd.value"].tolist() == [68.0]


@pytest.mark.parametrize("little_endian", [True, False])
def test_arrays_are_read_in_either_byte_order_and_broken_messages_are_left_out(
    little_endian, messages, tmp_path
):
    seen = []
    with BagWriter(tmp_path / "bag") as bag:
        for number in range(21):
            scan = messages.scan(number, [1.0, np.nan, -3.0, number])
            data = typestore().serialize_cdr(scan, scan.__msgtype__, little_endian=little_endian)
            bag.add_topic("/scan", scan.__msgtype__, [])
            bag.write("/scan", number * 10**9, bytes(data)[: -9 if number == 20 else None])
    request = Request(lambda m: list(m.first_array), many=True, needs_array=True, dtype=object)
    plugin = plugin_of(
        lambda w: seen.append(w.topics["arrays"]["/scan"].values) or {"value": 1.0},
        topics={"arrays": request},
    )
    extract(tmp_path / "bag", FeatureManager((plugin,)))
    arrays = max(seen, key=len)
    np.testing.assert_array_equal(np.stack(arrays), [[1.0, np.nan, -3.0, n] for n in range(20)])


def test_a_request_can_be_limited_to_topics_with_arrays(make_run):
    topics = {"arrays": Request(lambda _: 0.0, raw=True, needs_array=True)}
    seen = []
    plugin = plugin_of(
        lambda w: seen.append(set(w.topics["arrays"])) or {"value": 1.0}, topics=topics
    )
    extract(make_run().path, FeatureManager((plugin,)))
    assert set.union(*seen) == {"/scan", "/scan_fakeobject"}


def test_every_plugin_sees_when_messages_came(make_run):
    def compute(window):
        scans, tree = window.arrivals["/scan"], window.arrivals["/behavior_tree_log"]
        assert scans.msgtype == "sensor_msgs/msg/LaserScan"
        assert (scans.times_s >= window.start_s).all()
        assert (scans.times_s < window.end_s).all()
        assert (scans.header_stamps_ns == np.floor(scans.times_s) * 1e9).all()
        assert set(scans.sizes) == {4 + 8 + 4 + 10 + 2 + 28 + 4 + 14 * 4 + 4}
        assert tree.header_stamps_ns.size == 0
        return {"value": len(scans.times_s)}

    tables = extract(make_run().path, FeatureManager((plugin_of(compute),)))
    assert reasons(tables.run) == {}
    assert tables.windows["odd.value"].tolist() == 9 * [25.0] + [23.0]


def test_each_message_is_decoded_once_for_all_plugins(make_run):
    kept = []
    topics = {"scans": Request(lambda m: kept.append(id(m)) or 0.0, "/scan")}
    plugins = tuple(plugin_of(lambda _: {"value": 1.0}, f"p{n}", topics) for n in range(3))
    with open_run(make_run().path) as run:
        decoded = []
        decoder = run.bag.decoder

        def counting(topic):
            decode = decoder(topic)
            return lambda data: decoded.append(topic) or decode(data)

        run.bag.decoder = counting
        features.extract(run, FeatureManager(plugins))
    assert decoded == ["/scan"] * 136
    assert len(kept) == 136  # all ask with the same request


def test_a_request_that_fails_gives_a_reason(make_run):
    def computes(_):
        return {"value": 1.0}

    manager = FeatureManager(
        (
            plugin_of(computes, "absent", {"r": Request(float, "/absent", "my/msg/Type")}),
            plugin_of(computes, "raising", {"r": Request(lambda m: m.nothing, "/scan")}),
            plugin_of(computes, "ragged", {"r": Request(lambda m: m.no or [1], "/odom")}),
            plugin_of(computes, "optional", {"r": Request(float, "/absent", optional=True)}),
            plugin_of(computes, "graph", needs_graph=True),
        )
    )
    run = make_run()
    missing = reasons(extract(run.path, manager).run)
    assert missing["absent.value"] == "no topic /absent of type my/msg/Type is recorded"
    assert (
        "/scan cannot be used: 136 of 136 messages are broken: AttributeError"
        in missing["raising.value"]
    )
    assert missing.keys() == {"absent.value", "raising.value", "ragged.value"}
    missing = reasons(extract(run.bag, manager).run)
    assert missing["graph.value"] == "no ROS graph was recorded before the end of the window"


def test_kept_values_of_different_shapes_are_an_error(make_run):
    count = iter(range(1000))
    topics = {"r": Request(lambda _: [0.0] * next(count), "/scan")}
    manager = FeatureManager((plugin_of(lambda _: {"value": 1.0}, topics=topics),))
    assert "same shape" in reasons(extract(make_run().path, manager).run)["odd.value"]


def test_plugins_see_neither_ground_truth_nor_manifest(make_run):
    seen = []

    def compute(window):
        seen.append({topic for topics in window.topics.values() for topic in topics})
        assert {f for f in dir(window) if not f.startswith("_")} == {
            "start_s", "end_s", "graph", "system", "intervals", "arrivals", "topics", "history",
            "prepared", "shared", "roles",
        }  # fmt: skip
        return {"value": 1.0}

    manager = FeatureManager((plugin_of(compute, topics={"all": Request(lambda _: 0.0)}),))
    assert reasons(extract(make_run().path, manager).run) == {}
    assert set.union(*seen) == {
        "/odom", "/scan", "/scan_fakeobject", "/behavior_tree_log", "/plan",
    }  # fmt: skip
