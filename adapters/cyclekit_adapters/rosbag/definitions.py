"""Message types of a channel: from the recorded definition, else from the well-known one.

Each channel has its own types: two recordings, and two channels of one recording, may use the same type name with
different fields. A definition that contradicts itself or its own hash is replaced by the well-known one (bags of 2010
refer to types that no longer exist). A definition that would take a decoder excessive time is refused.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from cyclekit_adapters.rosbag.known import known
from cyclekit_adapters.rosbag.msg_text import Description, Fields, UnsupportedText, item_of, read_text
from cyclekit_adapters.rosbag.payloads import Channel

_RULE = "=" * 80 + "\n"
_COMMON = (Stores.ROS2_HUMBLE, Stores.ROS1_NOETIC)
_DISTRIBUTIONS = {"humble": Stores.ROS2_HUMBLE, "foxy": Stores.ROS2_FOXY}
_WIDTH = {"string": 4, "8": 1, "16": 2, "32": 4, "64": 8, "bool": 1, "byte": 1, "char": 1}
_MAX_DEFINITION = 1 << 20  # bytes of the text of a definition
_MAX_FIELDS = 100_000  # fields of the smallest message of a type
_FIELDS_PER_BYTE = 8  # with more, a definition has fields without content


class NoDefinition(ValueError):
    """No usable definition of the type."""


@dataclass
class Types:
    """Fields of a type and of all types it consists of, by full name.

    Attributes:
        fields: Fields by type, as `msg_text` reads them.
    """

    fields: Mapping[str, Fields]
    _stores: dict[str, Typestore] = field(default_factory=dict)
    _sound: set[str] = field(default_factory=set)

    def store(self, kind: str) -> Typestore:
        """Return the library's store of these types, created on first use: that takes as long as reading a bag."""
        if kind not in self._stores:
            self.check(kind)
            store = get_typestore(Stores.EMPTY)
            needed = [name for name in sorted(set(self._parts(kind, set()))) if name not in store.fielddefs]
            store.register({name: ([], list(self.fields[name])) for name in needed})
            self._stores[kind] = store
        return self._stores[kind]

    def check(self, kind: str) -> None:
        """Refuse a type that contains itself, lacks a part, or would take excessive time to decode.

        Raises:
            NoDefinition: The type is one of these.
        """
        if kind in self._sound:
            return
        steps, size = self._least(kind, (), {})
        if steps > _MAX_FIELDS or steps > _FIELDS_PER_BYTE * (size + 64):
            raise NoDefinition(f"the definition of {kind} has {steps} fields in {size} bytes: no message has that")
        self._sound.add(kind)

    def _parts(self, kind: str, seen: set[str]) -> Iterator[str]:
        if kind in seen:
            return
        seen.add(kind)
        yield kind
        for _, description in self.fields[kind]:
            item = item_of(description)
            if item[0] == Nodetype.NAME:
                yield from self._parts(item[1], seen)

    def _least(self, kind: str, above: tuple[str, ...], known: dict[str, tuple[int, int]]) -> tuple[int, int]:
        """Return number of fields and number of bytes of the smallest message of a type."""
        if kind in above:
            raise NoDefinition(f"the definition of {kind} contains itself")
        if kind not in self.fields:
            raise NoDefinition(f"no definition of {kind}")
        if kind not in known:
            parts = [self._field(description, (*above, kind), known) for _, description in self.fields[kind]]
            known[kind] = 1 + sum(steps for steps, _ in parts), sum(size for _, size in parts)
        return known[kind]

    def _field(
        self, description: Description, above: tuple[str, ...], known: dict[str, tuple[int, int]]
    ) -> tuple[int, int]:
        form, what = description
        if form == Nodetype.BASE:
            return 1, _width(what[0])
        if form == Nodetype.NAME:
            return self._least(what, above, known)
        steps, size = self._field(what[0], above, known)
        if form == Nodetype.SEQUENCE:
            return 1, 4
        plain = what[0][0] == Nodetype.BASE and what[0][1][0] != "string"
        return 1 if plain else 1 + what[1] * steps, what[1] * size


def types_of(channel: Channel) -> Types:
    """Return the types of a channel; its own type is missing if no definition is known."""
    return _types(channel.kind, channel.definition, channel.notation, channel.coding, channel.digest)


def is_known(channel: Channel) -> bool:
    """Return whether the messages of a channel can be decoded: the definition is in the bag, or well known."""
    return channel.kind in types_of(channel).fields


@lru_cache(maxsize=256)
def _types(kind: str, definition: str, notation: str, coding: str, digest: str) -> Types:
    if notation == "known":
        layout = known(kind, definition)
        common = well_known(_DISTRIBUTIONS[layout.distribution]).fields
        return Types(read_text(layout.text, kind, common).fields if layout.text else common)
    if definition and len(definition) <= _MAX_DEFINITION:
        expected = digest if coding == "ros1" else ""
        if notation == "msg":
            try:
                texts = read_text(definition, kind)
                if not expected or texts.digest(kind) == expected:
                    return Types(texts.fields)
            except (UnsupportedText, RecursionError):
                pass
        try:
            return _by_the_library(kind, definition, notation, expected)
        except Exception:  # after any error of the parser, the well-known definition is used
            return well_known(_COMMON[coding == "ros1"])
    return well_known(_COMMON[coding == "ros1"])


@lru_cache(maxsize=3)
def well_known(distribution: Stores) -> Types:
    """Return the types that a ROS distribution provides."""
    return Types(_fields(get_typestore(distribution)))


def _fields(store: Typestore) -> dict[str, Fields]:
    return {kind: list(fields) for kind, (_, fields) in store.fielddefs.items()}


def _by_the_library(kind: str, definition: str, notation: str, digest: str) -> Types:
    store = get_typestore(Stores.EMPTY)
    if notation == "msg":
        store.register(get_types_from_msg(definition, kind))
    elif definition.startswith(f"{_RULE}IDL: "):
        for part in definition.split(_RULE)[1:]:
            store.register(get_types_from_idl(part.partition("\n")[2]))
    else:
        store.register(get_types_from_idl(definition))
    if digest and store.generate_msgdef(kind)[1] != digest:
        raise ValueError("the definition does not match the hash recorded with it")
    types = Types(_fields(store))
    types.check(kind)
    return types


def _width(name: str) -> int:
    return next((width for ending, width in _WIDTH.items() if name.endswith(ending)), 1)
