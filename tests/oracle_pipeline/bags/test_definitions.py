"""Definitions of other tools are decoded, or refused with a reason in one line."""

import struct

import pytest

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.features import build_manager, extract
from oracle_pipeline.opened_run import open_run
from tests.oracle_pipeline.bags.conftest import text
from tests.oracle_pipeline.bags.makers import McapChannel, attachment, write_channels

LINE = "=" * 80 + "\n"
INT = "int32 a\n"
IDL = """module p { module msg {
  @verbatim (language="comment", text="x")
  struct A { @key int32 a; sequence<int32, 4> v; string<10> s; };
}; };
"""
EVENT = (
    "service_msgs/ServiceEventInfo info\nstd_srvs/SetBool_Request[<=1] request\n"
    f"{LINE}MSG: service_msgs/ServiceEventInfo\nuint8 event_type\n"
    f"{LINE}MSG: std_srvs/SetBool_Request\nbool data\n"
)
ROS1 = f"int32 a\nHeader h\n{LINE}MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"


def cdr(form, *values):
    """Return values in CDR, little-endian."""
    return b"\0\1\0\0" + struct.pack(f"<{form}", *values)


def channel(definition, data, msgtype="p/msg/A", form="ros2msg", encoding="cdr"):
    return McapChannel("/t", msgtype, definition, [data], form, encoding)


FIVE = cdr("i", 5)
IDL_DATA = cdr("iIiI3s", 5, 1, 7, 3, b"hi\0")
DECODED = {
    "Windows line ends": channel(
        f"int32 a\r\nint32 B=3\r\nq/C c\r\n{LINE}MSG: q/C\r\nint32 x".replace("=\n", "=\r\n"),
        cdr("ii", 5, 6),
    ),
    "byte order mark": channel("\ufeffint32 a\n", FIVE),
    "comment in Unicode": channel("# Größe 你好\nint32 a # µm\n", FIVE),
    "comment in Latin-1": channel(b"# Gr\xf6\xdfe\nint32 a\n", FIVE),
    "comment like a separator": channel(f"#{LINE}int32 a\n", FIVE),
    "no line end": channel("int32 a", FIVE),
    "tabs": channel("\tint32\t a \t# b\n", FIVE),
    "constants": channel('string S="a # b"\nuint8 H=0x1F\nfloat32 F=-1.5e-3\nint32 a\n', FIVE),
    "defaults": channel('int32 a 7\nfloat64[] v [1.0, 2]\n', cdr("iI", 5, 0)),
    "bounds": channel("int32 a\nstring<=9 s\nint32[<=3] v\n", cdr("iI2s2xI", 5, 2, b"h\0", 0)),
    "keywords of Python": channel("int32 a\nint32 from\nint32 self\n", cdr("iii", 5, 6, 7)),
    "big-endian": channel("int32 a\n", b"\0\0\0\0" + struct.pack(">i", 5)),
    "definition of a type of ours that differs": channel(
        f"std_msgs/Header h\nint32 a\n{LINE}MSG: std_msgs/Header\nint32 own\n", cdr("ii", 6, 5)
    ),
    "IDL of ROS": channel(f"{LINE}IDL: p/msg/A\n{IDL}", IDL_DATA, form="ros2idl"),
    "IDL": channel(IDL, IDL_DATA, "p::msg::A", "omgidl"),
    "IDL for a preprocessor": channel(f"#ifndef A\n{IDL}#endif\n", IDL_DATA, "p::msg::A", "omgidl"),
    "IDL of DDS": channel(
        "module p { module msg { module dds_ { struct A_ { int32 a_; }; }; }; };", FIVE,
        "p::msg::dds_::A_", "omgidl",
    ),
    "ROS 1": channel(ROS1, struct.pack("<iIIIIs", 5, 1, 2, 3, 1, b"x"), "p/A", "ros1msg", "ros1"),
}  # fmt: skip


@pytest.mark.parametrize("name", DECODED)
def test_definitions_of_other_tools_are_decoded(name, tmp_path):
    write_channels(tmp_path / "a.mcap", [DECODED[name]])
    with BagReader(tmp_path / "a.mcap") as bag:
        (message,) = bag.messages()
        assert bag.deserialize(message).a == 5
        assert bag.topics["/t"].msgtype == "p/msg/A"
        assert not bag.notes


REFUSED = {
    "protobuf": (channel(b"\n\xff", b"\x08\1", "a.Scan", "protobuf", "protobuf"), "'protobuf'"),
    "JSON": (channel("{}", b"{}", "Thing", "jsonschema", "json"), "'json'"),
    "no schema": (channel("", FIVE, "", None), "without a type"),
    "a service's own text": (channel("int64 a\n---\nint64 b\n", FIVE, "p/srv/A_Event"), "unusable"),
    "an unknown action": (channel("", FIVE, "x/action/Y_FeedbackMessage"), "no definition of"),
    "an enumeration": (
        channel("module p { module msg { enum E { X }; struct A { E e; }; }; };", FIVE, "p/msg/A",
                "omgidl"),
        "unusable",
    ),
    "XCDR2": (channel(INT, b"\0\7\0\0" + struct.pack("<i", 5)), "encapsulation"),
    "parameter lists": (channel(INT, b"\0\3\0\0" + bytes(8)), "encapsulation"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_an_undecodable_type_is_reported_in_one_line_and_affects_its_topic_only(name, tmp_path):
    refused, reason = REFUSED[name]
    good = McapChannel("/good", "q/msg/B", INT, [FIVE])
    write_channels(tmp_path / "a.mcap", [refused, good])
    with open_run(tmp_path / "a.mcap") as run:
        raw = {message.topic: message for message in run.bag.messages()}
        assert run.bag.deserialize(raw["/good"]).a == 5
        with pytest.raises(BagError, match=reason) as refused:
            run.bag.deserialize(raw["/t"])
        assert "\n" not in str(refused.value)
        notes = extract(run, build_manager()).notes
        assert reason == "encapsulation" or any(reason in note for note in notes)
        assert not any("\n" in note for note in notes)


def test_topics_of_an_unknown_type_share_a_note_and_empty_ones_have_none(tmp_path):
    unknown = [McapChannel(f"/{name}", "x/msg/Y", "", [FIVE]) for name in "ab"]
    empty = McapChannel("/empty", "x/msg/Z", "", [])
    known = McapChannel("/good", "q/msg/B", INT, [FIVE, FIVE])
    write_channels(tmp_path / "a.mcap", [*unknown, empty, known])
    with open_run(tmp_path / "a.mcap") as run:
        notes = [note for note in extract(run, build_manager()).notes if "definition" in note]
    assert len(notes) == 1
    assert "/a, /b are used (50% of the messages)" in notes[0]


def test_an_event_of_a_service_is_decoded(tmp_path):
    event = channel(EVENT, cdr("B3xIB", 1, 1, 1), "std_srvs/srv/SetBool_Event")
    write_channels(tmp_path / "a.mcap", [event])
    with BagReader(tmp_path / "a.mcap") as bag:
        assert bag.deserialize(next(bag.messages())).request[0].data


def test_topics_may_use_types_of_one_name_that_differ(tmp_path):
    short = f"q/C c\n{LINE}MSG: q/C\nint32 x\n"
    channels = [
        McapChannel("/a", "p/msg/A", short, [FIVE]),
        McapChannel("/b", "p/msg/B", f"{short}int32 y\n", [cdr("ii", 5, 6)]),
    ]
    write_channels(tmp_path / "a.mcap", channels)
    with BagReader(tmp_path / "a.mcap") as bag:
        a, b = (bag.deserialize(message).c for message in bag.messages())
        assert (a.x, b.x, b.y) == (5, 5, 6)


def test_a_known_type_needs_no_readable_definition(tmp_path):
    """Bags of ROS 1 have comments whose backslashes became line ends."""
    broken = channel("#rief x\note what this is\nstring data\n", text("hi"), "std_msgs/msg/String")
    write_channels(tmp_path / "a.mcap", [broken])
    with BagReader(tmp_path / "a.mcap") as bag:
        assert bag.deserialize(next(bag.messages())).data == "hi"


def test_a_file_of_attachments_and_silent_topics_has_no_message(tmp_path):
    write_channels(tmp_path / "a.mcap", [McapChannel("/t", "p/msg/A", INT, [])], attachment())
    with BagReader(tmp_path / "a.mcap", strict=True) as bag:
        assert (bag.message_count, bag.topics["/t"].count) == (0, 0)
        assert list(bag.messages()) == []
