"""Messages decoded in bulk are those that the rosbags library decodes one by one, value by value."""

import random

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.interfaces import Nodetype

from cyclekit_adapters.rosbag.decode import MIN_ROWS, Decoder
from cyclekit_adapters.rosbag.definitions import types_of
from cyclekit_adapters.rosbag.layout import NoLayout, trace
from cyclekit_adapters.rosbag.payloads import Channel, Payloads

TYPES = [
    "sensor_msgs/msg/JointState",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseArray",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "std_msgs/msg/Float64",
    "std_msgs/msg/Bool",
    "std_msgs/msg/Byte",
    "std_msgs/msg/String",
    "std_msgs/msg/Empty",
    "std_msgs/msg/Int16MultiArray",
    "visualization_msgs/msg/MarkerArray",
    "trajectory_msgs/msg/JointTrajectory",
    "diagnostic_msgs/msg/DiagnosticArray",
    "sensor_msgs/msg/BatteryState",
    "sensor_msgs/msg/PointCloud2",
    "nav_msgs/msg/Odometry",
]
# Numbers of every width beside each other, so that every alignment occurs.
ODD = "test/msg/Odd"
ODD_TEXT = """
bool a
float64 b
int8 c
string d
uint16 e
int64[] f
byte g
string[2] h
float32[3] i
test/Inner[] j
char k
test/Inner[2] l
uint8[] m
float64 n
bool[] o
================================================================================
MSG: test/Inner
uint8 p
float64[] q
string[] r
int16 s
"""
CODINGS = ["little", "big", "ros1"]
NUMBERS = {"bool": "?", "byte": "i1", "char": "u1"}


def channel(kind, coding):
    text = ODD_TEXT if kind == ODD else ""
    return Channel(1, "/topic", kind, definition=text, coding="ros1" if coding == "ros1" else "cdr")


def packed(raws):
    size = np.array([len(raw) for raw in raws], np.int64)
    return Payloads(
        np.frombuffer(b"".join(raws), np.uint8), np.cumsum(size) - size, size, np.arange(len(raws), dtype=np.int64)
    )


def store_of(one):
    return types_of(one).store(one.kind)


def serialised(types, message, kind, coding):
    if coding == "ros1":
        return bytes(types.serialize_ros1(message, kind))
    return bytes(types.serialize_cdr(message, kind, little_endian=coding == "little"))


class Maker:
    """Random messages; those of one `form` have equal texts and lengths."""

    def __init__(self, types, form, numbers):
        self.types, self.form, self.numbers = types, random.Random(form), numbers

    def message(self, kind):
        fields = self.types.get_msgdef(kind).fields
        return self.types.types[kind](**{name: self.value(description) for name, description in fields})

    def value(self, description):
        kind, what = description
        if kind == Nodetype.NAME:
            return self.message(what)
        if kind == Nodetype.BASE:
            return self.text() if what[0] == "string" else self.array(what[0], 1)[0].item()
        item, count = what
        if kind == Nodetype.SEQUENCE:
            count = self.form.choice([0, 0, 1, 2, 3])
        if item[0] == Nodetype.BASE and item[1][0] != "string":
            return self.array(item[1][0], count)
        return [self.value(item) for _ in range(count)]

    def text(self):
        return "".join(self.form.choice("abcé ") for _ in range(self.form.randint(0, 5)))

    def array(self, name, count):
        dtype = np.dtype(NUMBERS.get(name, name))
        if dtype.kind == "b":
            return self.numbers.integers(0, 2, count).astype(bool)
        return np.frombuffer(self.numbers.bytes(count * dtype.itemsize), dtype)


def leaves(types, value, path=()):
    """Yield every number, array and text of a decoded message with its path."""
    if hasattr(value, "__msgtype__"):
        for name, _ in types.get_msgdef(value.__msgtype__).fields:
            if name != "structure_needs_at_least_one_member":  # not there in ROS 1
                yield from leaves(types, getattr(value, name), (*path, name))
    elif isinstance(value, list):
        for number, item in enumerate(value):
            yield from leaves(types, item, (*path, number))
    else:
        yield path, value


def by_the_library(types, raw, one):
    return (types.deserialize_ros1 if one.coding == "ros1" else types.deserialize_cdr)(raw, one.kind)


def assert_as_the_library_says(one, raws):
    types = store_of(one)
    decoder = Decoder(one)
    seen, fast, groups = [], 0, list(decoder.groups(packed(raws)))
    for group in groups:
        fast += group.rows.size if group.rows.size >= MIN_ROWS else 0
        seen += group.rows.tolist()
        expected = [dict(leaves(types, by_the_library(types, raws[row], one))) for row in group.rows.tolist()]
        for path in expected[0]:
            values = [said[path] for said in expected]
            if isinstance(values[0], str):
                assert set(values) == {group.first(*path)}
                continue
            np.testing.assert_array_equal(group.first(*path), values[0])
            found = group.numbers(*path)
            assert found.dtype == np.asarray(values[0]).dtype.newbyteorder("=") or np.isscalar(values[0])
            np.testing.assert_array_equal(found, np.array(values))
    assert sorted(seen + [row for row, _ in decoder.broken]) == list(range(len(raws)))
    return fast, decoder.broken


@pytest.mark.filterwarnings("ignore:invalid value")
@pytest.mark.parametrize("coding", CODINGS)
@settings(deadline=None, suppress_health_check=list(HealthCheck))
@given(kind=st.sampled_from([*TYPES, ODD, ODD, ODD]), seed=st.integers(0, 2**32 - 1))
def test_every_field_of_every_message_is_what_the_library_decodes(coding, kind, seed):
    one = channel(kind, coding)
    types, numbers, chance = store_of(one), np.random.default_rng(seed), random.Random(seed)
    raws = []
    for form in range(3):
        count = chance.choice([1, MIN_ROWS - 1, MIN_ROWS, 50])
        makers = [Maker(types, seed + form, numbers) for _ in range(count)]
        raws += [serialised(types, maker.message(kind), kind, coding) for maker in makers]
    chance.shuffle(raws)
    _, broken = assert_as_the_library_says(one, raws)
    assert broken == []


@pytest.mark.parametrize("coding", CODINGS)
@pytest.mark.parametrize("kind", [*TYPES, ODD])
def test_messages_of_one_form_are_decoded_at_once(coding, kind):
    one = channel(kind, coding)
    types, numbers = store_of(one), np.random.default_rng(7)
    raws = [serialised(types, Maker(types, 7, numbers).message(kind), kind, coding) for _ in range(MIN_ROWS)]
    fast, _ = assert_as_the_library_says(one, raws)
    assert fast == MIN_ROWS or kind == "std_msgs/msg/Empty"


@pytest.mark.parametrize("coding", CODINGS)
def test_names_of_equal_size_are_not_taken_for_each_other(coding):
    one = channel("sensor_msgs/msg/JointState", coding)
    types = store_of(one)
    raws = []
    for number in range(3 * MIN_ROWS):
        names = [["ab", "c"], ["a", "bc"], ["c", "ab"]][number % 3]
        message = Maker(types, 1, np.random.default_rng(number)).message(one.kind)
        message.name = names
        message.position = np.array([float(number), -1.0])
        raws.append(serialised(types, message, one.kind, coding))
    fast, _ = assert_as_the_library_says(one, raws)
    assert fast == len(raws)


def test_padding_that_a_writer_left_as_it_was_in_memory_does_not_matter():
    one = channel("sensor_msgs/msg/JointState", "little")
    types, chance = store_of(one), random.Random(1)
    message = Maker(types, 1, np.random.default_rng(1)).message(one.kind)
    message.header.frame_id, message.name, message.position = "b", ["ab", "c"], np.array([1.0, 2.0])
    raw = serialised(types, message, one.kind, "little")
    layout, _ = trace(types_of(one), one.kind, raw, cdr=True)
    used = {at for begin, end in layout.fixed for at in range(begin, end)}
    for leaf in layout.leaves.values():
        used |= set(
            range(leaf.offset, leaf.offset + np.dtype(leaf.dtype).itemsize * (1 if leaf.count is None else leaf.count))
        )
    padding = sorted(set(range(2, len(raw))) - used)
    assert len(padding) > 4
    raws = []
    for _ in range(MIN_ROWS):
        dirty = bytearray(raw)
        for at in padding:
            dirty[at] = chance.randrange(256)
        raws.append(bytes(dirty))
    assert assert_as_the_library_says(one, raws) == (MIN_ROWS, [])


@pytest.mark.parametrize("coding", CODINGS)
def test_a_broken_message_among_good_ones_is_broken_exactly_where_the_library_refuses_it(coding):
    one = channel("sensor_msgs/msg/JointState", coding)
    types, chance = store_of(one), random.Random(3)
    good = [
        serialised(types, Maker(types, 4, np.random.default_rng(n)).message(one.kind), one.kind, coding)
        for n in range(60)
    ]
    raws = list(good)
    for raw in good:
        broken = bytearray(raw)
        broken[chance.randrange(len(broken))] ^= 1 << chance.randrange(8)
        raws += [bytes(broken), raw[: chance.randrange(len(raw))], raw + b"\0" * 4]
    refused = set()
    for row, raw in enumerate(raws):
        try:
            by_the_library(types, raw, one)
        except Exception:
            refused.add(row)
    _, found = assert_as_the_library_says(one, raws)
    assert {row for row, _ in found} == refused
    assert len(refused) > 60


@pytest.mark.parametrize("head", [b"\0\7\0\0", b"\0\3\0\0", b"\1\1\0\0"])
def test_another_encapsulation_is_never_read_as_cdr(head):
    one = channel("geometry_msgs/msg/PoseStamped", "little")
    types = store_of(one)
    message = Maker(types, 1, np.random.default_rng(1)).message(one.kind)
    raw = head + serialised(types, message, one.kind, "little")[4:]
    decoder = Decoder(one)
    assert list(decoder.groups(packed([raw] * 40))) == []
    assert len(decoder.broken) == 40
    with pytest.raises(NoLayout):
        trace(types_of(one), one.kind, raw, cdr=True)


def test_two_recordings_may_give_one_type_name_different_fields():
    old = Channel(1, "/a", "acme/msg/Speed", "float32 speed\nfloat64 time\n", coding="cdr")
    new = Channel(2, "/b", "acme/msg/Speed", "float64 speed\n", coding="cdr")
    for one, speed in ((old, 0.25), (new, 0.5)):
        types = store_of(one)
        message = types.types[one.kind](**{"speed": speed, **({"time": 7.0} if one is old else {})})
        (group,) = Decoder(one).groups(packed([bytes(types.serialize_cdr(message, one.kind))] * 40))
        assert group.numbers("speed").tolist() == [speed] * 40
