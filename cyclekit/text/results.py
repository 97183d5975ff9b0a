"""Common behaviour of the library's results: short repr, HTML table, polars frame, JSON values.

A result is a frozen dataclass. Its class returns its text (`_lines`) and the rows of its frame, unless that is one row
of its scalar values (`_frame_rows`); `--json` prints `to_dict`.
"""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, cast

from cyclekit.text.numbers import compact
from cyclekit.text.plain_json import plain_values
from cyclekit.text.plain_text import one_line

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import polars as pl

SHOWN_ROWS, SHOWN_LINES = 20, 8
"""Maximum number of rows shown in a notebook, and of lines in a terminal; the frame has all."""


class Result:
    """Result of a library call."""

    def to_dict(self) -> dict[str, object]:
        """Return everything as plain JSON values, as `--json` prints it."""
        return cast("dict[str, object]", plain_values(self))

    def to_frame(self) -> pl.DataFrame:
        """Return the result as a table, with units in the names of its columns."""
        import polars as pl

        return pl.DataFrame(self._frame_rows(), infer_schema_length=None)

    def _frame_rows(self) -> Sequence[Mapping[str, object]]:
        """Return the rows of the frame by the names of its columns."""
        return [{name: value for name, value in self.to_dict().items() if not isinstance(value, list | dict)}]

    def _lines(self) -> Sequence[str]:
        """Return the result as a few lines of text."""
        raise NotImplementedError

    def __repr__(self) -> str:
        """Return the result as a few lines of text, as shown in a console."""
        lines = [one_line(line) for line in self._lines()]
        if len(lines) > SHOWN_LINES:
            lines[SHOWN_LINES - 1 :] = [f"... and {len(lines) - SHOWN_LINES + 1} more"]
        return f"{type(self).__name__}: " + "\n  ".join(lines)

    def _repr_html_(self) -> str:
        """Return the result as a small HTML table for a notebook; names from logs are escaped."""
        return html_table(self.__repr__().partition("\n")[0], self.to_frame())


def html_table(title: str, frame: pl.DataFrame) -> str:
    """Return a title and the first rows of a frame as escaped HTML; the title alone for an empty frame."""
    if frame.is_empty():
        return f"<p>{escape(title)}</p>"
    head = "".join(f"<th>{escape(name)}</th>" for name in frame.columns)
    rows = ["".join(f"<td>{escape(_cell(value))}</td>" for value in row) for row in frame.head(SHOWN_ROWS).rows()]
    more = f"<p>{frame.height - SHOWN_ROWS} more rows</p>" if frame.height > SHOWN_ROWS else ""
    body = "".join(f"<tr>{row}</tr>" for row in rows)
    return f"<p>{escape(title)}</p><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{more}"


def _cell(value: object) -> str:
    if value is None:
        return ""
    return compact(value, 4) if isinstance(value, float) else str(value)
