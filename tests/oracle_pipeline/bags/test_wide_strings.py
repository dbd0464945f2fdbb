"""Fields of type wstring, in the encodings of old and new releases of ROS 2."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.bags.types import TypeDefinition
from oracle_pipeline.bags.writer import BagWriter

TYPE = "my_msgs/msg/Named"
IDL = f"""{"=" * 80}
IDL: my_msgs/msg/Named
module my_msgs {{ module msg {{ struct Named {{
    long before; wstring name; sequence<wstring> others; double after; }}; }}; }};
"""
MSG = "int32 before\nwstring{} name\nwstring[] others\nfloat64 after\n"


class Bytes:
    """A message on the way, from behind the encapsulation header."""

    def __init__(self, order):
        self.order, self.data = order, b""

    def put(self, kind, value):
        size = struct.calcsize(kind)
        self.data += bytes(-len(self.data) % size) + struct.pack(self.order + kind, value)

    def wide(self, text, is_new):
        utf16 = text.encode("utf-16-le" if self.order == "<" else "utf-16-be")
        units = [utf16[i : i + 2] for i in range(0, len(utf16), 2)]
        self.put("I", len(utf16) if is_new else len(units))
        for unit in units:
            value = int.from_bytes(unit, "little" if self.order == "<" else "big")
            self.put("H" if is_new else "I", value)


def encoded(before, name, others, after, *, is_new=False, order="<"):
    message = Bytes(order)
    message.put("i", before)
    message.wide(name, is_new)
    message.put("I", len(others))
    for each in others:
        message.wide(each, is_new)
    message.put("d", after)
    return bytes([0, order == "<", 0, 0]) + message.data


def decoded(folder, data, definition=None):
    with BagWriter(folder / "bag") as bag:
        bag.add_topic("/named", TYPE, [], definition or TypeDefinition(MSG.format(""), ""))
        bag.write("/named", 0, data)
    with BagReader(folder / "bag") as bag:
        (message,) = map(bag.deserialize, bag.messages())
    return message.before, message.name, message.others, message.after


@given(
    st.text(min_size=1), st.lists(st.text(), max_size=3), st.floats(allow_nan=False),
    st.booleans(), st.sampled_from("<>"),
)  # fmt: skip
def test_wide_strings_are_text_in_either_encoding(
    tmp_path_factory, name, others, after, is_new, order
):
    data = encoded(7, name, others, after, is_new=is_new, order=order)
    found = decoded(tmp_path_factory.mktemp("wide"), data)
    assert found == (7, name, others, after)


@pytest.mark.parametrize("text", [MSG.format("<=20"), IDL])
def test_bounds_and_idl_are_understood(text, tmp_path):
    definition = TypeDefinition(text, "")
    found = decoded(tmp_path, encoded(1, "Ω", ["a", "😀"], 0.5), definition)
    assert found == (1, "Ω", ["a", "😀"], 0.5)
