import json
import textwrap

import pytest

from oracle_pipeline import features
from oracle_pipeline.features.traffic.thesis_features import VECTOR
from oracle_pipeline.opened_run import open_run

# Plugins as people who know the thesis write them: its imports, its bag schema, nothing of ours.
STRUCTURE = """
    import networkx as nx
    from plugin_interface import FeatureExtractionPlugin

    class Structure(FeatureExtractionPlugin):
        def extract_features(self, G, cur=None):
            return [len(G), nx.density(G), max(dict(G.in_degree()).values())]
"""
CONTEXT = """
    from plugin_interface import FeatureExtractionPlugin
    from rclpy import serialization
    from rosidl_runtime_py import convert, utilities

    class Context(FeatureExtractionPlugin):
        def extract_features(self, G, cur):
            cur.execute("SELECT MIN(timestamp), MAX(timestamp), COUNT(*) FROM messages")
            first, last, count = cur.fetchone()
            topics = {row[0]: row for row in cur.execute("SELECT * FROM topics").fetchall()}
            widest = 0.0
            for _, topic_id, _, data in cur.execute("SELECT * FROM messages").fetchall():
                kind = utilities.get_message(topics[topic_id][2])
                message = serialization.deserialize_message(data, kind)
                if topics[topic_id][1] == "/odom":
                    fields = convert.message_to_ordereddict(message)
                    widest = max(widest, abs(fields["pose"]["pose"]["position"]["x"]))
                    assert len(fields["pose"]["covariance"]) == 36
                if "scan" in topics[topic_id][1]:
                    widest = max(widest, convert.message_to_ordereddict(message)["ranges"][0])
            names = sorted(row[1] for row in topics.values())
            return [last - first, count, widest, len(names), "/_oracle/ground_truth" in names]
"""


@pytest.fixture
def extract(tmp_path):
    """Run the plugins given by code on a recording."""
    (tmp_path / "plugins").mkdir()

    def run_plugins(path, **codes):
        for name, code in codes.items():
            (tmp_path / "plugins" / f"{name}.py").write_text(textwrap.dedent(code))
        manager = features.build_manager(tmp_path / "plugins")
        with open_run(path) as run:
            return features.extract(run, manager)

    return run_plugins


def thesis(table) -> dict[str, float]:
    """What the folder's plugins gave; the built-in columns of the family are not theirs."""
    columns = [c for c in table.columns if c.startswith("thesis.") and c not in VECTOR]
    return {c: table[c].iloc[0] for c in columns}


def reasons(table) -> dict[str, str]:
    missing = json.loads(table["missing"].iloc[0])
    return {column: why for column, why in missing.items() if column.startswith("thesis.")}


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_plugins_of_the_thesis_work_unchanged(storage, make_run, extract):
    tables = extract(make_run(storage=storage).path, structure=STRUCTURE, context=CONTEXT)
    values = thesis(tables.run)
    # Plain names, observers included; one edge in each direction or none.
    assert values["thesis.structure_0"] == 8
    assert values["thesis.structure_1"] == pytest.approx(6 / (8 * 7))
    assert values["thesis.structure_2"] == 1
    assert values["thesis.context_0"] == 27e9
    assert values["thesis.context_1"] == 3 * 136 + 7
    assert values["thesis.context_2"] == pytest.approx(1.5, abs=0.01)
    assert values["thesis.context_3"] == 5
    assert values["thesis.context_4"] == 0
    assert reasons(tables.run) == {}
    assert thesis(tables.windows) == {}  # the contract knows whole runs only


def test_a_foreign_bag_has_messages_and_an_empty_graph(foreign_bag, extract):
    code = """
        from plugin_interface import FeatureExtractionPlugin

        class Count(FeatureExtractionPlugin):
            def extract_features(self, G, cur):
                cur.execute("SELECT COUNT(*) FROM messages JOIN topics ON topics.id = topic_id")
                return [len(G), cur.fetchone()[0]]
    """
    with open_run(foreign_bag) as run:
        expected = run.bag.message_count
    values = thesis(extract(foreign_bag, count=code).run)
    assert values == {"thesis.count_0": 0, "thesis.count_1": expected}


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("raise KeyError('odom')", "KeyError: 'odom'"),
        ("return []", "it returned no numbers"),
        ("return None", "TypeError"),
        ("return ['many']", "could not convert"),
        ("return [cur.execute('DELETE FROM messages')]", "readonly"),
    ],
)
def test_a_plugin_that_fails_loses_only_its_own_columns(body, reason, make_run, extract):
    code = f"""
        from plugin_interface import FeatureExtractionPlugin

        class Failing(FeatureExtractionPlugin):
            def extract_features(self, G, cur):
                {body}
    """
    table = extract(make_run().path, failing=code, structure=STRUCTURE).run
    assert list(thesis(table)) == [f"thesis.structure_{number}" for number in range(3)]
    assert reason in reasons(table)["thesis.failing"]
    assert table["structural.density"].notna().all()


def test_a_number_that_is_nan_is_kept_as_missing(make_run, extract):
    code = STRUCTURE.replace("[len(G)", "[float('nan')")
    table = extract(make_run().path, structure=code).run
    assert table["thesis.structure_0"].isna().all()
    assert reasons(table) == {"thesis.structure_0": "the plugin returned nan"}


def test_plugins_do_not_disturb_each_other(make_run, extract):
    vandal = """
        from plugin_interface import FeatureExtractionPlugin

        class Vandal(FeatureExtractionPlugin):
            def extract_features(self, G, cur):
                G.clear()
                cur.close()
                return [0]
    """
    values = thesis(extract(make_run().path, a_vandal=vandal, structure=STRUCTURE).run)
    assert values["thesis.structure_0"] == 8


def test_a_file_may_hold_several_plugins_and_imports_none(make_run, extract):
    code = STRUCTURE + textwrap.indent(
        textwrap.dedent("""
            class Second(Structure):
                def extract_features(self, G, cur=None):
                    return [2]
        """),
        "    ",
    )
    values = thesis(extract(make_run().path, pair=code).run)
    assert list(values) == [
        "thesis.pair_Second_0", "thesis.pair_Structure_0", "thesis.pair_Structure_1",
        "thesis.pair_Structure_2",
    ]  # fmt: skip


def test_stand_ins_are_gone_when_the_plugins_are_done(make_run, extract):
    extract(make_run().path, context=CONTEXT)
    with pytest.raises(ModuleNotFoundError):
        __import__("rosidl_runtime_py.convert")
    with pytest.raises(ModuleNotFoundError):
        __import__("plugin_interface")
