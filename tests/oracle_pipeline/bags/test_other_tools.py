"""The content of our bags as read by other tools: the mcap package, and sqlite3 by itself."""

import sqlite3
from contextlib import closing

import yaml
from mcap.reader import make_reader

from oracle_pipeline.bags.types import definition, type_hash
from tests.oracle_pipeline.bags.conftest import CLOCK, STRING, text

PERIOD_NS = 100_000_000


def test_the_mcap_package_finds_summary_schemas_and_profiles(write_bag, tmp_path):
    with (write_bag(tmp_path / "bag") / "bag_0.mcap").open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
    assert summary.statistics.message_count == 40
    assert summary.statistics.message_start_time == 0
    assert summary.statistics.message_end_time == 19 * PERIOD_NS
    assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
    schemas = {schema.name: schema for schema in summary.schemas.values()}
    assert {schema.encoding for schema in schemas.values()} == {"ros2msg"}
    assert {n: s.data.decode() for n, s in schemas.items()} == {
        CLOCK: definition(CLOCK), STRING: definition(STRING),
    }  # fmt: skip
    channels = {channel.topic: channel for channel in summary.channels.values()}
    assert {channel.message_encoding for channel in channels.values()} == {"cdr"}
    assert channels["/clock"].schema_id == schemas[CLOCK].id
    profiles = yaml.safe_load(channels["/chatter"].metadata["offered_qos_profiles"])
    assert [profile["depth"] for profile in profiles] == [10, 5]
    assert summary.statistics.channel_message_counts == {c.id: 20 for c in channels.values()}


def test_the_mcap_package_finds_a_message_by_topic_and_time(write_bag, tmp_path):
    with (write_bag(tmp_path / "bag") / "bag_0.mcap").open("rb") as stream:
        found = [
            (message.log_time, message.data)
            for _, _, message in make_reader(stream).iter_messages(
                ["/chatter"], starting_at=3 * PERIOD_NS, ending_before=5 * PERIOD_NS
            )
        ]
    assert found == [(n * PERIOD_NS, text(f"message {n}")) for n in (3, 4)]


def test_sqlite_finds_the_tables_of_rosbag2(write_bag, tmp_path):
    file = write_bag(tmp_path / "bag", "sqlite3") / "bag_0.db3"
    with closing(sqlite3.connect(f"file:{file}?mode=ro", uri=True)) as db:
        topics = db.execute(
            "SELECT name, type, serialization_format, type_description_hash FROM topics ORDER BY id"
        ).fetchall()
        messages = db.execute(
            "SELECT timestamp, data FROM messages JOIN topics ON topic_id = topics.id "
            "WHERE name = '/chatter' ORDER BY timestamp"
        ).fetchall()
        ((schema_version,),) = db.execute("SELECT schema_version FROM schema")
        definitions = dict(
            db.execute("SELECT topic_type, encoded_message_definition FROM message_definitions")
        )
        ((check,),) = db.execute("PRAGMA integrity_check")
    assert topics == [
        ("/clock", CLOCK, "cdr", type_hash(CLOCK)),
        ("/chatter", STRING, "cdr", type_hash(STRING)),
    ]
    assert messages == [(n * PERIOD_NS, text(f"message {n}")) for n in range(20)]
    assert schema_version == 4  # from Iron on
    assert definitions == {CLOCK: definition(CLOCK), STRING: definition(STRING)}
    assert check == "ok"
