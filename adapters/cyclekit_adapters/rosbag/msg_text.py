"""Parser of message definitions: the fields of a type and of all types it consists of.

A recorder stores the text with the messages: `type name` per line, then each type used, below a separator and a line
`MSG: package/Type`. Lines of another form (annotations, wide strings, odd constants) are not guessed: the caller then
uses the parser of the rosbags library, which is complete and slower.
"""

from __future__ import annotations

import hashlib
import keyword
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from rosbags.interfaces import Nodetype

# In the library's form: (BASE, (name, limit)), (NAME, type), (ARRAY or SEQUENCE, (item, count)).
Description = Any
Fields = list[tuple[str, Description]]

EMPTY_FIELD = "structure_needs_at_least_one_member"
"""Field of an empty message: one byte in CDR, none in ROS 1."""
TIMES: dict[str, Fields] = {
    f"builtin_interfaces/msg/{kind}": [
        ("sec", (Nodetype.BASE, ("int32", 0))),
        ("nanosec", (Nodetype.BASE, ("uint32", 0))),
    ]
    for kind in ("Time", "Duration")
}
"""Types that definitions use without defining them."""
_NOTHING: Fields = [(EMPTY_FIELD, (Nodetype.BASE, ("uint8", 0)))]
_RULE = re.compile(r"^={80}\n", re.MULTILINE)
_BASES = "bool|byte|char|float32|float64|u?int8|u?int16|u?int32|u?int64|string"
_BASE = re.compile(_BASES)
_TYPE = r"(?P<kind>(?:[a-zA-Z]\w*/)*[a-zA-Z]\w*)(?P<limit><=\d{1,9})?(?P<many>\[(?P<most><=)?(?P<count>\d{0,9})\])?"
_FIELD = re.compile(rf"[ \t]*{_TYPE}[ \t]+(?P<name>[A-Za-z]\w*)(?:[ \t]+[^ \t#=].*|[ \t]*(?:#.*)?)", re.ASCII)
_CONSTANT = re.compile(rf"[ \t]*(?P<kind>{_BASES})[ \t]+(?P<name>[A-Za-z]\w*)[ \t]*=(?P<value>.*)", re.ASCII)
_NAME = re.compile(r"[A-Za-z]\w*(?:/\w+)+", re.ASCII)
_SHORT = {
    "time": "builtin_interfaces/msg/Time",
    "duration": "builtin_interfaces/msg/Duration",
    "Header": "std_msgs/msg/Header",
}
_UNKNOWN = ("wstring", "wchar", "float128")


class UnsupportedText(ValueError):
    """The text is not in the plain form."""


@dataclass
class ParsedTypes:
    """Types defined in one text, by full name.

    Attributes:
        fields: Fields by type.
        lines: Input of each type's ROS 1 hash, constants first: a line and the type of its field; for a message type,
            its hash precedes the line.
    """

    fields: dict[str, Fields] = field(default_factory=dict)
    lines: dict[str, list[tuple[str, str]]] = field(default_factory=dict)

    def digest(self, kind: str) -> str:
        """Return the hash that identifies a definition in ROS 1."""
        lines = [f"{self.digest(of)} {line}" if of in self.lines else line for line, of in self.lines[kind]]
        return hashlib.md5("\n".join(lines).encode(), usedforsecurity=False).hexdigest()


def read_text(text: str, kind: str, known: Mapping[str, Fields] = TIMES) -> ParsedTypes:
    """Return the types defined in a text.

    Args:
        text: The definition of `kind`, followed by those of the types in it.
        kind: Full name, `package/msg/Type`.
        known: Types that may be used without definition.

    Raises:
        UnsupportedText: The text is not in the plain form, or uses an undefined type.
    """
    found = ParsedTypes(dict(known))
    for number, part in enumerate(_RULE.split(text.replace("\r\n", "\n"))):
        name, body = (kind, part) if number == 0 else _headed(part)
        if not _NAME.fullmatch(name):
            raise UnsupportedText(f"{name!r} is not the name of a type")
        found.fields[name], found.lines[name] = _read_part(name, body)
    for name, fields in found.fields.items():
        for _, description in fields:
            item = item_of(description)
            if item[0] == Nodetype.NAME and item[1] not in found.fields:
                raise UnsupportedText(f"{name} has a {item[1]}, which is not defined")
    return found


def item_of(description: Description) -> Description:
    """Return the item type of an array or sequence; any other description unchanged."""
    return description[1][0] if description[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE) else description


def _headed(part: str) -> tuple[str, str]:
    head, _, body = part.partition("\n")
    if not head.startswith("MSG: "):
        raise UnsupportedText("a part without its name")
    return _full(head[5:].strip(), ""), body


def _read_part(owner: str, body: str) -> tuple[Fields, list[tuple[str, str]]]:
    fields: Fields = []
    constants, lines = [], []
    for line in body.split("\n"):
        bare = line.strip()
        if not bare or bare.startswith("#"):
            continue
        if constant := _CONSTANT.fullmatch(line):
            constants.append((f"{constant['kind']} {constant['name']}={_value(constant)}", ""))
        elif match := _FIELD.fullmatch(line):
            name = match["name"]
            description = _field(owner, match)
            fields.append((f"{name}_" if keyword.iskeyword(name) else name, description))
            kind = item_of(description)[1]
            named = item_of(description)[0] == Nodetype.NAME and kind not in TIMES
            written = f"{match['kind']}{match['limit'] or ''}{match['many'] or ''} {name}"
            lines.append((name, kind) if named else (written, ""))
        else:
            raise UnsupportedText(f"{bare[:60]!r} is not a field")
    if len({name for name, _ in fields}) < len(fields):
        raise UnsupportedText(f"{owner} has two fields with the same name")
    return fields or list(_NOTHING), constants + lines


def _value(constant: re.Match[str]) -> str:
    """Return a constant as hashed by ROS 1: a text is kept complete, a number loses its comment."""
    value = constant["value"]
    return value.strip() if constant["kind"] == "string" else value.partition("#")[0].strip()


def _field(owner: str, match: re.Match[str]) -> Description:
    kind, limit = match["kind"], int((match["limit"] or "<=0")[2:])
    if (limit and kind != "string") or kind in _UNKNOWN:
        raise UnsupportedText(f"a field of type {kind}")
    item: Description
    item = (Nodetype.BASE, (kind, limit)) if _BASE.fullmatch(kind) else (Nodetype.NAME, _full(kind, owner))
    if match["many"] is None:
        return item
    fixed = match["most"] is None and match["count"]
    return (Nodetype.ARRAY if fixed else Nodetype.SEQUENCE, (item, int(match["count"] or 0)))


def _full(kind: str, owner: str) -> str:
    """Return the full name of a type used by `owner`."""
    if kind in _SHORT:
        return _SHORT[kind]
    *packages, name = kind.split("/")
    if not packages:
        return f"{owner.rpartition('/')[0]}/{name}"
    return kind if packages[-1] in ("msg", "action") else "/".join((*packages, "msg", name))
