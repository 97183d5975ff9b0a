"""Escapes names from logs and files where they could act as commands: in a terminal, Markdown, or a spreadsheet.

There is one function per output format.
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
    r"\x00-\x08\x0b-\x1f\x7f-\x9f"  # terminal controls
    r"\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069"  # characters that change the reading direction
    r"\u2028\u2029\ufeff"  # other line ends, byte order mark
)
_HALVES = r"\ud800-\udfff"  # surrogates, which no encoding can write
CONTROL = re.compile(f"[{_UNSEEN}{_HALVES}]")
"""Characters that control a terminal or change the reading direction, except line ends and tabs."""
_CONTROL_OR_END = re.compile(f"[{_UNSEEN}{_HALVES}{_ENDS}]")
NOT_ONE_LINE = f"[{_UNSEEN}{_ENDS}]"
"""Pattern of the characters that `one_line` escapes, for columns of text."""
FORMULA = r"^[=+\-@\t\r\n＝＋－＠]"
"""Pattern of the start of a text that a spreadsheet treats as a formula, unless it is a number."""
_FORMULA = re.compile(FORMULA)
_MARKUP = re.compile(r"[\\`*\[\]|~]|(?<!\w)_|_(?!\w)|!(?=\[)")
_BLOCK = re.compile(r"^(\s*\d*)(>|[#+\-=.)](?=[#\-=\s]|$))")
_SCHEME = re.compile(r"(?i)\b(https?|ftp|mailto|xmpp|javascript|data|vbscript|file)(?=:)|\bwww(?=\.)|@(?=\w)")

Value = TypeVar("Value")


def visible(text: str) -> str:
    r"""Return a text with escapes for characters that control a terminal or the reading direction: `\x1b`, `\u202e`."""
    return CONTROL.sub(_escaped, text)


def one_line(text: str) -> str:
    """Return a text escaped as by `visible`, including line ends and tabs, because a name is one line."""
    return _CONTROL_OR_END.sub(_escaped, text)


def all_in_one_line(value: Value) -> Value:
    """Return plain values with every text, including keys, escaped by `one_line`; columns of a `map` are unchanged."""
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


def needs_escapes(document: str) -> bool:
    """Return whether texts in a JSON document may contain such characters, raw or as escapes."""
    return "\\" in document or CONTROL.search(document) is not None


def shown_task(task: str) -> str:
    """Return a task `a->b` for display."""
    return task.replace("->", " → ")


def markdown(text: str) -> str:
    """Return a text that Markdown shows unchanged, without HTML, links, pictures, emphasis, headings or lists."""
    plain = " ".join(one_line(line) for line in text.splitlines()) if "\n" in text else one_line(text)
    plain = _MARKUP.sub(lambda found: f"\\{found[0]}", plain)
    plain = plain.replace("&", "&amp;").replace("<", "&lt;")
    plain = _SCHEME.sub(lambda found: f"{found[0][:-1]}&#{ord(found[0][-1])};", plain)  # else a viewer makes it a link
    return _BLOCK.sub(r"\1\\\2", plain)


def csv_text(rows: Iterable[Sequence[object]]) -> str:
    """Return rows as CSV without formulas; an apostrophe precedes texts that a spreadsheet would treat as one.

    Args:
        rows: Rows of cells; a text that is a number stays one.
    """
    page = io.StringIO()
    csv.writer(page, lineterminator="\n").writerows([_cell(value) for value in row] for row in rows)
    return page.getvalue()


def _cell(value: object) -> object:
    if not isinstance(value, str):
        return value
    return visible(f"'{value}" if is_formula(value) else value)


def is_formula(text: str) -> bool:
    """Return whether a spreadsheet would treat a text as a formula."""
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
