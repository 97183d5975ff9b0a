"""Definitions of messages: read as the rosbags library reads them, and refused where no message can be like that."""

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from cyclekit_adapters.rosbag.decode import Decoder
from cyclekit_adapters.rosbag.definitions import NoDefinition, types_of
from cyclekit_adapters.rosbag.msg_text import EMPTY_FIELD, UnsupportedText, read_text
from cyclekit_adapters.rosbag.payloads import Channel, Payloads

RULE = "=" * 80
BASE = Nodetype.BASE


@pytest.mark.parametrize("distribution", [Stores.ROS1_NOETIC, Stores.ROS2_FOXY, Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY])
def test_every_definition_of_a_distribution_is_read_as_the_library_reads_it(distribution):
    store, ros1 = get_typestore(distribution), distribution is Stores.ROS1_NOETIC
    for kind in store.fielddefs:
        text, digest = store.generate_msgdef(kind, ros_version=1 if ros1 else 2)
        ours = read_text(text, kind)
        for name, (_, fields) in get_types_from_msg(text, kind).items():
            assert ours.fields[name] == (fields or [(EMPTY_FIELD, (BASE, ("uint8", 0)))])
        assert not ros1 or "builtin_interfaces" in kind or ours.digest(kind) == digest


def test_comments_constants_defaults_and_limits_do_not_confuse_the_fields():
    text = f"""# a comment with int32 in it
uint8 KIND=3            # a constant
string NAME=a # b = c
float64 GAIN = 0.5
int32   count 7         # a default
string  text "x = 1"
string<=10 short
float64[<=3] few        # up to three
float32[9] nine
uint8[] many
time when
duration[] each
Header header
Inner inner
other/Kind[2] two
float64 from
{RULE}
MSG: std_msgs/Header
uint32 seq
{RULE}
MSG: pkg/Inner
{RULE}
MSG: other/Kind\r
bool flag
"""
    fields = dict(read_text(text, "pkg/msg/Outer").fields["pkg/msg/Outer"])
    assert list(fields) == [
        *("count", "text", "short", "few", "nine", "many", "when", "each", "header", "inner", "two", "from_"),
    ]
    assert fields["short"] == (BASE, ("string", 10))
    assert fields["few"] == (Nodetype.SEQUENCE, ((BASE, ("float64", 0)), 3))
    assert fields["nine"] == (Nodetype.ARRAY, ((BASE, ("float32", 0)), 9))
    assert fields["when"] == (Nodetype.NAME, "builtin_interfaces/msg/Time")
    assert fields["two"] == (Nodetype.ARRAY, ((Nodetype.NAME, "other/msg/Kind"), 2))
    assert fields["inner"] == (Nodetype.NAME, "pkg/msg/Inner")


@pytest.mark.parametrize("text", ["wstring a", "@key\nint32 a", "Unknown a", "int32 a\nint32 a", "?"])
def test_what_is_not_of_the_plain_form_is_left_to_the_library(text):
    with pytest.raises(UnsupportedText):
        read_text(text, "pkg/msg/Outer")


def test_a_definition_that_only_the_library_can_read_is_read_by_it():
    text = "@optional\nfloat64 x\n"
    with pytest.raises(UnsupportedText):
        read_text(text, "pkg/msg/Outer")
    channel = Channel(1, "/t", "pkg/msg/Outer", text)
    assert types_of(channel).fields["pkg/msg/Outer"] == [("x", (BASE, ("float64", 0)))]


def nested(depth, *, width=1, last="float64 x"):
    """A type within a type within a type, each `width` times."""
    parts = [f"T{n + 1}[{width}] inner" if width > 1 else f"T{n + 1} inner" for n in range(depth)]
    heads = [f"MSG: pkg/T{n + 1}\n{text}" for n, text in enumerate([*parts[1:], last])]
    return f"\n{RULE}\n".join([parts[0], *heads])


HOSTILE = {
    "holds itself": "T0 again",
    "holds itself in a list": "T0[] again",
    "two that hold each other": f"Other a\n{RULE}\nMSG: pkg/Other\nT0 b",
    "three thousand deep": nested(3000),
    "two to the sixtieth fields": nested(60, width=2),
    "a billion texts": "string[1000000000] names",
    "a billion messages": f"Inner[1000000000] all\n{RULE}\nMSG: pkg/Inner\nfloat64 x",
    "nothing, very often": nested(9, width=9, last="# nothing"),
}


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("coding", ["cdr", "ros1"])
def test_a_definition_that_would_keep_a_decoder_busy_for_ever_is_refused(name, coding):
    channel = Channel(1, "/t", "pkg/msg/T0", HOSTILE[name], coding=coding)
    with pytest.raises((NoDefinition, RecursionError)):
        types_of(channel).check("pkg/msg/T0")
    size = np.full(40, 64, np.int64)
    payloads = Payloads(np.zeros(64 * 40, np.uint8), np.arange(40) * 64, size, np.arange(40))
    decoder = Decoder(channel)
    assert list(decoder.groups(payloads)) == []
    assert len(decoder.broken) == 40


@pytest.mark.parametrize("name", ["numbers", "texts", "messages", "nothing"])
@pytest.mark.parametrize("rows", [1, 40])
def test_a_message_that_announces_billions_of_things_is_refused(name, rows):
    kinds = {"numbers": "float64[] all", "texts": "string[] all", "messages": "Inner[] all", "nothing": "Empty[] all"}
    text = f"{kinds[name]}\n{RULE}\nMSG: pkg/Inner\nfloat64 x\n{RULE}\nMSG: pkg/Empty\n"
    raw = b"\0\1\0\0" + b"\xff\xff\xff\x7f" + bytes(100)
    size = np.full(rows, len(raw), np.int64)
    buffer = np.frombuffer(raw * rows, np.uint8)
    decoder = Decoder(Channel(1, "/t", "pkg/msg/T0", text))
    assert list(decoder.groups(Payloads(buffer, np.arange(rows) * len(raw), size, np.arange(rows)))) == []
    assert len(decoder.broken) == rows


@pytest.mark.parametrize("rows", [1, 3, 40])
def test_a_message_of_more_fields_than_any_is_refused_without_making_them(rows):
    text = f"Inner[] all\n{RULE}\nMSG: pkg/Inner\nbool x"
    count = 5_000_000
    raw = b"\0\1\0\0" + count.to_bytes(4, "little") + bytes(count)
    buffer = np.frombuffer(raw * rows, np.uint8)
    size = np.full(rows, len(raw), np.int64)
    decoder = Decoder(Channel(1, "/t", "pkg/msg/T0", text))
    assert list(decoder.groups(Payloads(buffer, np.arange(rows) * len(raw), size, np.arange(rows)))) == []
    assert "more than 20000 fields" in decoder.broken[0][1]
    assert [row for row, _ in decoder.broken] == list(range(rows))
