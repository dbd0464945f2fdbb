import functools
import re
from importlib import resources

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2._dynamic import generate_dynamic
from mcap_ros2.decoder import DecoderFactory

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.types import (
    definition,
    deserialize,
    fields_from_text,
    message_class,
    serialize,
    type_hash,
    typestore,
)
from oracle_pipeline.bags.writer import BagWriter
from tools.message_types import as_text, parsed

OURS = (
    "atc_msgs/",
    "nav2_msgs/",
    "dwb_msgs/",
    "bond/",
    "map_msgs/",
    "gazebo_msgs/",
    "oracle_msgs/",
    "control_msgs/",
    "crazyflie_interfaces/",
    "moveit_msgs/",
    "motion_capture_tracking_interfaces/",
)
ALL_TYPES = sorted(typestore().fielddefs)
LARGEST = 40  # fields, unfolded; larger messages consist of smaller ones


@functools.cache
def size(msgtype):
    """Number of fields of a message, unfolded."""
    total = 0
    for _, (tag, rest) in typestore().fielddefs[msgtype][1]:
        inner_tag, inner = rest[0] if int(tag) > 2 else (tag, rest)
        total += size(inner) if int(inner_tag) == 2 else 1
    return total


def messages(msgtype):
    """Any message of a type, NaN left out so that equal means equal."""
    fields = typestore().get_msgdef(msgtype).fields
    return st.builds(message_class(msgtype), *[values(kind) for _, kind in fields])


def values(kind):
    tag, rest = int(kind[0]), kind[1]
    if tag == 1:
        return scalars(rest[0])
    if tag == 2:
        return messages(rest)
    inner, size = rest
    lengths = {"min_size": size, "max_size": size} if tag == 3 else {"max_size": 2}
    if int(inner[0]) == 1 and inner[1][0] not in ("string", "bool"):
        dtype = np.dtype({"byte": "uint8", "char": "uint8"}.get(inner[1][0], inner[1][0]))
        shape = st.integers(lengths.get("min_size", 0), lengths["max_size"])
        return hnp.arrays(dtype, shape, elements=scalars(inner[1][0]))
    if int(inner[0]) == 1 and inner[1][0] == "bool":
        return st.lists(st.booleans(), **lengths).map(lambda v: np.array(v, dtype=np.bool_))
    return st.lists(values(inner), **lengths)


def scalars(name):
    if name == "string":
        return st.text(st.characters(blacklist_categories=["Cs"], blacklist_characters="\0"))
    if name == "bool":
        return st.booleans()
    if name.startswith("float"):
        return st.floats(width=int(name[5:]), allow_nan=False)
    info = np.iinfo({"byte": "uint8", "char": "uint8"}.get(name, name))
    return st.integers(int(info.min), int(info.max))


@pytest.mark.parametrize(
    "msgtype", [t for t in ALL_TYPES if t.startswith(OURS) and size(t) <= LARGEST]
)
def test_serialising_and_back_gives_the_same_bytes(msgtype):
    @settings(max_examples=10)
    @given(messages(msgtype))
    def check(message):
        data = serialize(message, msgtype)
        assert serialize(deserialize(data, msgtype), msgtype) == data

    check()


def test_every_known_message_is_decoded_by_a_decoder_that_is_not_rosbags(tmp_path, zero_message):
    names = [name for name in ALL_TYPES if "/msg/" in name]
    with BagWriter(tmp_path / "bag") as bag:
        for number, msgtype in enumerate(names):
            bag.add_topic(f"/{msgtype}", msgtype, [])
            bag.write(f"/{msgtype}", number, serialize(zero_message(msgtype), msgtype))
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        decoded = {s.name: message for s, _, _, message in reader.iter_decoded_messages()}
    assert sorted(decoded) == names
    assert decoded["nav2_msgs/msg/Costmap"].metadata.origin.orientation.w == 0.0


def test_definitions_of_actions_and_services_are_complete(zero_message):
    # That decoder refuses the underscore in the names of these types, so it gets them without.
    def plain(text):
        return re.sub(r"(?<=[A-Za-z])_(?=[A-Z])", "", text)

    for msgtype in (name for name in ALL_TYPES if "/msg/" not in name):
        decode = generate_dynamic(plain(msgtype), plain(definition(msgtype)))[plain(msgtype)]
        message = decode(serialize(zero_message(msgtype), msgtype))
        fields = [name for name, _ in typestore().fielddefs[msgtype][1]]
        placeholder = "structure_needs_at_least_one_member"
        assert message.__slots__ == [field for field in fields if field != placeholder]


def test_an_action_part_without_fields_is_one_byte():
    msgtype = "nav2_msgs/action/ComputePathToPose_Feedback"
    assert serialize(message_class(msgtype)(0), msgtype) == bytes([0, 1, 0, 0, 0])


def test_an_action_has_the_messages_that_ros_derives_from_it():
    parts = ("Goal", "Result", "Feedback", "FeedbackMessage", "SendGoal_Request",
             "SendGoal_Response", "GetResult_Request", "GetResult_Response")  # fmt: skip
    for part in parts:
        assert f"nav2_msgs/action/NavigateToPose_{part}" in ALL_TYPES


def test_type_hash_is_that_of_ros():
    # What Iron and later print for std_msgs/msg/String.
    assert type_hash("std_msgs/msg/String") == (
        "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    )


def test_unknown_type_is_named():
    with pytest.raises(BagError, match=r"no_msgs/msg/Nothing.*unknown"):
        message_class("no_msgs/msg/Nothing")


def test_kept_fields_are_those_of_the_interface_files():
    """If not, run ``python -m tools.message_types``."""
    kept = resources.files("oracle_pipeline.bags").joinpath("fields.json").read_text("utf8")
    assert kept == as_text(parsed())
    assert fields_from_text(kept) == parsed()
