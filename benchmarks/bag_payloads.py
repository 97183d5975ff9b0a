"""Random payloads of many message types: compares every decoded value with rosbags' deserialisation.

Forms (texts, lengths of lists) and numbers are random, in CDR of both byte orders and in ROS 1 coding; each number,
text and element of an array is one leaf. Numbers are compared bit by bit, so NaN equals the same NaN. A round tests one
type in one coding: several forms, each many times, shuffled. Rounds continue up to the given number of leaves.

    python benchmarks/bag_payloads.py --leaves 10000000
"""

from __future__ import annotations

import argparse
import random
import time
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from rosbags.interfaces import Nodetype

from cyclekit_adapters.rosbag.decode import MIN_ROWS, Decoder
from cyclekit_adapters.rosbag.definitions import types_of
from cyclekit_adapters.rosbag.payloads import Channel, Payloads

TYPES = (
    "sensor_msgs/msg/JointState",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseArray",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TwistStamped",
    "geometry_msgs/msg/WrenchStamped",
    "geometry_msgs/msg/TransformStamped",
    "std_msgs/msg/Float64",
    "std_msgs/msg/Bool",
    "std_msgs/msg/Int64",
    "std_msgs/msg/String",
    "std_msgs/msg/Float64MultiArray",
    "visualization_msgs/msg/MarkerArray",
    "trajectory_msgs/msg/JointTrajectory",
    "diagnostic_msgs/msg/DiagnosticArray",
    "sensor_msgs/msg/BatteryState",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/LaserScan",
    "sensor_msgs/msg/PointCloud2",
    "nav_msgs/msg/Odometry",
)
CODINGS = ("little", "big", "ros1")
ROWS = 400  # number of messages per form and round
NAMES = {"bool": "?", "byte": "i1", "char": "u1"}


class Maker:
    """Makes random messages; those with the same seed of the form have equal texts and lengths."""

    def __init__(self, types: Any, form: int, numbers: np.random.Generator) -> None:  # noqa: ANN401 - the library's
        self.types, self.form, self.numbers = types, random.Random(form), numbers

    def message(self, kind: str) -> Any:  # noqa: ANN401 - a class that the library makes
        """Return one message of a type."""
        fields = self.types.get_msgdef(kind).fields
        return self.types.types[kind](**{name: self.value(*about) for name, about in fields})

    def value(self, node: Nodetype, what: Any) -> Any:  # noqa: ANN401 - as deep as the type is
        """Return a value of one field."""
        if node == Nodetype.NAME:
            return self.message(what)
        if node == Nodetype.BASE:
            return self.text() if what[0] == "string" else self.array(what[0], 1)[0].item()
        (inner, name), count = what
        if node == Nodetype.SEQUENCE:
            count = self.form.choice([0, 1, 2, 3, 6, 25])
        if inner == Nodetype.BASE and name[0] != "string":
            return self.array(name[0], count)
        return [self.value(inner, name) for _ in range(min(count, 3) if node == Nodetype.SEQUENCE else count)]

    def text(self) -> str:
        """Return a short text."""
        return "".join(self.form.choice("abcdefgh é") for _ in range(self.form.randint(0, 9)))

    def array(self, name: str, count: int) -> np.ndarray[Any, Any]:
        """Return numbers of one type with random bits."""
        dtype = np.dtype(NAMES.get(name, name))
        if dtype.kind == "b":
            return self.numbers.integers(0, 2, count).astype(bool)
        return np.frombuffer(self.numbers.bytes(count * dtype.itemsize), dtype)


def leaves(types: Any, value: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[tuple[str | int, ...], Any]]:  # noqa: ANN401 - any message
    """Yield every number, array and text of a message with its path."""
    if hasattr(value, "__msgtype__"):
        for name, _ in types.get_msgdef(value.__msgtype__).fields:
            if name != "structure_needs_at_least_one_member":  # missing in ROS 1
                yield from leaves(types, getattr(value, name), (*path, name))
    elif isinstance(value, list):
        for number, item in enumerate(value):
            yield from leaves(types, item, (*path, number))
    else:
        yield path, value


def same(theirs: Any, ours: Any) -> bool:  # noqa: ANN401 - numbers or arrays of them
    """Return whether numbers are equal, bit by bit if both have the same type (Python has only one float)."""
    left, right = (array.astype(array.dtype.newbyteorder("=")) for array in map(np.asarray, (theirs, ours)))
    if left.dtype == right.dtype:
        return left.shape == right.shape and left.tobytes() == right.tobytes()
    return np.array_equal(left, right, equal_nan=left.dtype.kind == "f")


def compare(kind: str, coding: str, seed: int, count: Counter[str]) -> None:
    """Make one round of payloads, decode them with both readers, and count leaves and differences."""
    channel = Channel(1, "/topic", kind, definition="", coding="ros1" if coding == "ros1" else "cdr")
    types, numbers = types_of(channel).store(kind), np.random.default_rng(seed)
    raws = []
    for form in range(3):
        for _ in range(ROWS):
            said = Maker(types, seed * 10 + form, numbers).message(kind)
            if coding == "ros1":
                raws.append(bytes(types.serialize_ros1(said, kind)))
            else:
                raws.append(bytes(types.serialize_cdr(said, kind, little_endian=coding == "little")))
    random.Random(seed).shuffle(raws)
    size = np.array([len(raw) for raw in raws], np.int64)
    payloads = Payloads(np.frombuffer(b"".join(raws), np.uint8), np.cumsum(size) - size, size, np.arange(size.size))
    read = types.deserialize_ros1 if coding == "ros1" else types.deserialize_cdr
    decoder, rows = Decoder(channel), 0
    for group in decoder.groups(payloads):
        rows += group.rows.size
        count["in bulk"] += group.rows.size * (group.rows.size >= MIN_ROWS)
        theirs = [dict(leaves(types, read(raws[row], kind))) for row in group.rows.tolist()]
        for path, first in theirs[0].items():
            values = [one[path] for one in theirs]
            count["leaves"] += len(values) * np.size(first)
            if isinstance(first, str):
                count["different"] += sum(value != group.first(*path) for value in values)
            elif not same(values, ours := group.numbers(*path)):
                count["different"] += sum(not same(one, other) for one, other in zip(values, ours, strict=True))
        count["different"] += sum(one.keys() != theirs[0].keys() for one in theirs)
    count["payloads"] += len(raws)
    count["different"] += len(raws) - rows  # none is damaged, so each must be decoded


def main() -> None:
    """Compare up to the number of leaves; print the counts of each coding."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--leaves", type=int, default=10_000_000)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    counts, begin, seed = {coding: Counter[str]() for coding in CODINGS}, time.perf_counter(), asked.seed
    with np.errstate(invalid="ignore"):
        while sum(count["leaves"] for count in counts.values()) < asked.leaves:
            for kind in TYPES:
                for coding in CODINGS:
                    compare(kind, coding, seed, counts[coding])
            seed += 1
    columns = ("payloads", "in bulk", "leaves", "different")
    table = Table(title=f"{len(TYPES)} types, {seed - asked.seed} rounds, {time.perf_counter() - begin:.0f} s")
    for name in ("coding", *columns):
        table.add_column(name, justify="right")
    for coding, count in counts.items():
        table.add_row(coding, *(f"{count[name]}" for name in columns))
    table.add_row("all", *(f"{sum(count[name] for count in counts.values())}" for name in columns))
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
