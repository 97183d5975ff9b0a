"""What a message of a channel looks like: by the definition recorded with it, else by the well-known one.

Each channel has its own types: two recordings, and two channels of one recording, may carry the same type name with
different fields. A definition that contradicts itself or its own hash gives way to the well-known one (bags of 2010
name types that no longer exist).
"""

from __future__ import annotations

from functools import lru_cache

from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from cyclekit_adapters.rosbag.modes import DEFINITIONS
from cyclekit_adapters.rosbag.payloads import Channel

_RULE = "=" * 80 + "\n"


def types_of(channel: Channel) -> Typestore:
    """Return the types of a channel; its own type may be missing where no definition is known."""
    return _types(channel.kind, channel.definition, channel.notation, channel.coding, channel.digest)


def is_known(channel: Channel) -> bool:
    """Tell whether the messages of a channel can be decoded: a definition is in the bag, or well known."""
    return channel.kind in types_of(channel).fielddefs


@lru_cache(maxsize=256)
def _types(kind: str, definition: str, notation: str, coding: str, digest: str) -> Typestore:
    if definition:
        try:
            return _recorded(kind, definition, notation, digest if coding == "ros1" else "")
        except Exception:  # whatever the parser raises, the well-known definition is next
            return _known(coding)
    return _known(coding)


@lru_cache(maxsize=2)
def _known(coding: str) -> Typestore:
    store = get_typestore(Stores.ROS1_NOETIC if coding == "ros1" else Stores.ROS2_HUMBLE)
    for kind, definition in DEFINITIONS.items():
        store.register(get_types_from_msg(definition, kind))
    return store


def _recorded(kind: str, definition: str, notation: str, digest: str) -> Typestore:
    store = get_typestore(Stores.EMPTY)
    if notation == "msg":
        store.register(get_types_from_msg(definition, kind))
    elif definition.startswith(f"{_RULE}IDL: "):
        for part in definition.split(_RULE)[1:]:
            store.register(get_types_from_idl(part.partition("\n")[2]))
    else:
        store.register(get_types_from_idl(definition))
    if digest and store.generate_msgdef(kind)[1] != digest:
        raise ValueError("the definition does not have the hash recorded with it")
    store.get_msgdef(kind)
    return store
