"""Names out of logs and files, written where they could be taken for commands: a terminal, Markdown, a spreadsheet.

Each way of writing has one function here. What is written is the business of others.
"""

from __future__ import annotations

import csv
import io
import re
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

_ENDS = r"\n\t"
_UNSEEN = (
    r"\x00-\x08\x0b-\x1f\x7f-\x9f"  # controls of terminals
    r"\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069"  # what turns the direction of reading around
    r"\u2028\u2029\ufeff"  # other ends of lines, a mark of byte order
)
_HALVES = r"\ud800-\udfff"  # of characters: no encoding can write them
CONTROL = re.compile(f"[{_UNSEEN}{_HALVES}]")
"""What steers a terminal or turns a line around, other than ends of lines and tabs."""
_CONTROL_OR_END = re.compile(f"[{_UNSEEN}{_HALVES}{_ENDS}]")
NOT_ONE_LINE = f"[{_UNSEEN}{_ENDS}]"
"""The pattern of what `one_line` escapes, for columns of text."""
FORMULA = r"^[=+\-@\t\r\n＝＋－＠]"
"""How a text begins that a spreadsheet takes for a formula, if it is no number."""
_FORMULA = re.compile(FORMULA)
_MARKUP = re.compile(r"[\\`*\[\]|~]|(?<!\w)_|_(?!\w)|!(?=\[)")
_BLOCK = re.compile(r"^(\s*\d*)(>|[#+\-=.)](?=[#\-=\s]|$))")
_SCHEME = re.compile(r"(?i)\b(https?|ftp|mailto|xmpp|javascript|data|vbscript|file)(?=:)|\bwww(?=\.)|@(?=\w)")

Value = TypeVar("Value")


def visible(text: str) -> str:
    r"""Return a text in which characters that steer a terminal or turn a line around are escaped: `\x1b`, `\u202e`."""
    return CONTROL.sub(_escaped, text)


def one_line(text: str) -> str:
    """Return a text as `visible` does, with ends of lines and tabs escaped as well: a name is one line."""
    return _CONTROL_OR_END.sub(_escaped, text)


def all_in_one_line(value: Value) -> Value:
    """Return plain values with every text in them, keys included, as `one_line` does; columns of a `map` stay."""
    changed: Any = value
    if isinstance(value, str):
        changed = one_line(value)
    elif isinstance(value, dict):
        changed = {
            all_in_one_line(key): entry if key == "map" else all_in_one_line(entry)  # a delimiter there may be a tab
            for key, entry in value.items()
        }
    elif isinstance(value, list):
        changed = [all_in_one_line(entry) for entry in value]
    return changed  # type: ignore[no-any-return]


def needs_it(document: str) -> bool:
    """Tell whether texts in a JSON document could hold such characters: raw, or as escapes."""
    return "\\" in document or CONTROL.search(document) is not None


def spelt(task: str) -> str:
    """Write a task `a->b` for display."""
    return task.replace("->", " → ")


def markdown(text: str) -> str:
    """Return a text that Markdown shows as it is: no HTML, link, picture, emphasis, heading or list in it."""
    plain = " ".join(one_line(line) for line in text.splitlines()) if "\n" in text else one_line(text)
    plain = _MARKUP.sub(lambda found: f"\\{found[0]}", plain)
    plain = plain.replace("&", "&amp;").replace("<", "&lt;")
    plain = _SCHEME.sub(lambda found: f"{found[0][:-1]}&#{ord(found[0][-1])};", plain)  # a viewer would make it a link
    return _BLOCK.sub(r"\1\\\2", plain)


def csv_text(rows: Iterable[Sequence[object]]) -> str:
    """Return rows as CSV whose texts no spreadsheet takes for a formula (an apostrophe stands before those).

    Args:
        rows: Of cells; a text that is a number stays one.
    """
    page = io.StringIO()
    csv.writer(page, lineterminator="\n").writerows([_cell(value) for value in row] for row in rows)
    return page.getvalue()


def _cell(value: object) -> object:
    if not isinstance(value, str):
        return value
    return visible(f"'{value}" if is_formula(value) else value)


def is_formula(text: str) -> bool:
    """Tell whether a spreadsheet would take a text for a formula when it is typed into a cell."""
    return _FORMULA.match(text) is not None and not _is_number(text)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _escaped(found: re.Match[str]) -> str:
    number = ord(found[0])
    names = {"\n": "\\n", "\t": "\\t", "\r": "\\r"}
    return names.get(found[0]) or (f"\\x{number:02x}" if number < 0x100 else f"\\u{number:04x}")
