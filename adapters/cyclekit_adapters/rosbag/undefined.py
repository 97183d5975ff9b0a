"""Determination of the message layout of a topic without a definition in the bag.

Every historic layout of the type is tried on every message of the topic. If exactly one decodes all of them to their
last byte, it is used. If several do and give different values, or none does, the topic is not read.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit_adapters.rosbag.decode import Decoder, Group
from cyclekit_adapters.rosbag.inflate import unpacked
from cyclekit_adapters.rosbag.known import KNOWN

if TYPE_CHECKING:
    from cyclekit_adapters.rosbag.payloads import BagFile, Channel


@dataclass(frozen=True)
class TopicFindings:
    """Result for a topic without a definition.

    Attributes:
        channel: The channel with the chosen layout; None if there is none.
        reason: The reason, to display.
    """

    channel: Channel | None
    reason: str


def find_layout(file: BagFile, channel: Channel) -> TopicFindings:
    """Return which of the known layouts the messages of a channel have.

    Args:
        file: The file that holds the channel.
        channel: A channel of a type in `KNOWN`, without a definition.
    """
    left = [replace(channel, notation="known", definition=layout.name) for layout in KNOWN[channel.kind]]
    doubt, messages = False, 0
    for block in file.blocks({channel.number}):
        for payloads in map(unpacked, block.values()):
            messages += payloads.size.size
            decoded = []
            for one in left:
                decoder = Decoder(one)
                groups = list(decoder.groups(payloads))
                if not decoder.broken:
                    decoded.append((one, groups))
            left = [one for one, _ in decoded]
            doubt |= any(not _same(decoded[0][1], groups) for _, groups in decoded[1:])
        if not left:
            return TopicFindings(None, f"none of the known layouts of {channel.kind} fits its messages")
    names = " and ".join(repr(one.definition) for one in left)
    if len(left) > 1 and doubt:
        return TopicFindings(None, f"several layouts of {channel.kind} fit its messages ({names})")
    if len(left) > 1:
        return TopicFindings(left[0], f"{names}: they give the same values in all {messages} messages")
    return TopicFindings(left[0], f"{names}: the only known layout that fits all {messages} messages")


def _same(some: list[Group], others: list[Group]) -> bool:
    """Return whether two decodings are equal, which holds for empty lists, for example."""
    if len(some) != len(others):
        return False
    return all(
        np.array_equal(one.rows, other.rows) and one.has_places_of(other) and _tree(one.message) == _tree(other.message)
        for one, other in zip(some, others, strict=True)
    )


def _tree(value: object) -> object:
    """Return a message as plain values that can be compared."""
    if isinstance(value, list):
        return [_tree(item) for item in value]
    if hasattr(value, "__dict__"):
        return {name: _tree(item) for name, item in vars(value).items()}
    return value.tolist() if hasattr(value, "tolist") else value
