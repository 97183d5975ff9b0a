"""Parser of the lines of a delimited text log: complete rows, never shifted, and the lines that cannot be trusted.

A row is used only if it has as many fields as the header, every number in it parses, and it ends with a line end. A
block of lines is parsed at once. If that fails, it is halved repeatedly, and the lines around the fault are read one by
one, each in the context of its neighbours: another header of the table holds for the rows below it, a line of other
names ends the table, a fragment of a row makes the adjacent rows doubtful. `text_blocks` turns bytes into lines.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.adapter import CUT_LINE
from cyclekit_adapters.text.block_table import BlockTable, short_lines, table_of
from cyclekit_adapters.text.parallel_map import parallel_map
from cyclekit_adapters.text.single_lines import (
    as_texts,
    cells_of,
    is_fragment,
    is_name_line,
    miscounted,
    other_header,
)
from cyclekit_adapters.text.text_rows import (
    CELL,
    INDEX,
    SET_ASIDE,
    TextRows,
    Wanted,
    as_numbers,
    finite,
    not_finite,
    stripped,
    trusted,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from cyclekit_adapters.text.text_layout import TextLayout

ONE_BY_ONE = 1 << 17
"""Size, bytes, down to which a faulty block is halved; a smaller one is read line by line."""
_BYTES_A_COLUMN = 64
"""The same for each column, bytes: a wide table takes time for each of its columns, however few lines are read."""
_BLANKS = f"{CELL} \t"


@dataclass
class _Sorted:
    """Lines of a block read one by one: cells and positions (line, row) of the kept rows, and the lines set aside."""

    kept: list[str] = field(default_factory=list)
    places: list[tuple[int, int]] = field(default_factory=list)
    aside: list[tuple[int, str]] = field(default_factory=list)

    def reject_last(self, place: tuple[int, int], reason: str) -> None:
        """Set the last kept row aside if it is at this position (line, row)."""
        if self.places and self.places[-1] == place:
            self.kept.pop()
            self.aside.append((self.places.pop()[0], reason))


@dataclass
class RowParser:
    """Parser of consecutive blocks of lines, with the current position in the file.

    Attributes:
        layout: Format of the rows, by the last header.
        wanted: Columns to read, of those in the last header.
        line: Number of the next line in its file.
        skip: Number of lines still to skip.
        row: Number of the next data row.
        end_reason: Reason why the table has ended: another table began; empty before that.
        below_names: True if the next row is the first below a line of names, where a line of units may follow.
        after_fragment: True if the previous line was a fragment of a row, so the next one may be its remainder.
    """

    layout: TextLayout
    wanted: Wanted
    line: int = 1
    skip: int = 0
    row: int = field(default=0, init=False)
    end_reason: str = field(default="", init=False)
    below_names: bool = field(default=True, init=False)
    after_fragment: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        self._all = self.wanted

    def rows(self, blocks: Iterable[bytes]) -> Iterator[TextRows]:
        """Yield the rows of consecutive blocks of lines; only the last line of all may lack a line end."""
        for block, (layout, table) in parallel_map(self._pieces(blocks), self._table_of):
            yield from map(self._completed, self._parsed(block, table if layout is self.layout else None))

    def _pieces(self, blocks: Iterable[bytes]) -> Iterator[bytes]:
        """Yield the blocks without the skipped lines, split so that no row is separated from a fragment of it."""
        held = b""
        for block in blocks:
            block = self._below(block)
            line = block[: block.find(b"\n") + 1]
            fragment = bool(held) and self._is_fragment(line)  # stays with the row above
            if held:
                yield held + line if fragment else held
            held = block[len(line) :] if fragment else block
        if held:
            yield held

    def _below(self, block: bytes) -> bytes:
        while self.skip and block:
            _, _, block = block.partition(b"\n")
            self.skip, self.line = self.skip - 1, self.line + 1
        return block

    def _table_of(self, block: bytes) -> tuple[TextLayout, BlockTable | None]:
        """Return the rows of a block by the last header, and this; called in threads while the header may change."""
        layout = self.layout
        return layout, table_of(block[: block.rfind(b"\n") + 1], layout, self.wanted)

    def _completed(self, rows: TextRows) -> TextRows:
        """Return rows with all wanted columns; those that the last header lacks are unknown."""
        if self.wanted is self._all:
            return rows
        types = {name: pl.Float64() if name in self._all.numbers else pl.String() for name in self._all.columns}
        lacking = [pl.lit(None, types[name]).alias(name) for name in types if name not in rows.frame.columns]
        return replace(rows, frame=rows.frame.with_columns(lacking).select("source_row", INDEX, *types))

    def _parsed(self, block: bytes, table: BlockTable | None) -> Iterator[TextRows]:
        """Yield the rows of a block; `table` holds them if the block alone was parsed without a fault."""
        whole = block.rfind(b"\n") + 1
        if whole:
            yield from self._halved(block[:whole], table)
        if tail := block[whole:]:
            if tail.strip():
                yield self._rows(_Sorted(aside=[(self.line, CUT_LINE)]), rows_read=1)
                self.row += 1
            self.line += 1

    def _halved(self, block: bytes, table: BlockTable | None) -> Iterator[TextRows]:
        """Yield the rows of whole lines: at once if `table` is valid, otherwise half by half."""
        if block.isspace():
            self.line += block.count(b"\n")
            return
        if table is not None and not self.end_reason and not self.after_fragment:
            yield self._at_once(table)
            return
        middle = self._middle(block)
        few = max(ONE_BY_ONE, _BYTES_A_COLUMN * len(self.layout.names))
        if len(block) <= few or not 0 < middle < len(block):
            aside = self._all_aside(block)
            yield from self._one_by_one(block) if aside is None else [aside]
            return
        for half in (block[:middle], block[middle:]):
            yield from self._halved(half, None if self.end_reason or self.after_fragment else self._table_of(half)[1])

    def _middle(self, block: bytes) -> int:
        """Return the offset at which to halve a block: after a line end, and not between a row and a fragment of it."""
        middle = block.find(b"\n", len(block) // 2) + 1
        after = block.find(b"\n", middle) + 1
        return after if self._is_fragment(block[middle:after]) else middle

    def _is_fragment(self, line: bytes) -> bool:
        return is_fragment(line.decode("utf-8", "replace"), self.layout)

    def _at_once(self, table: BlockTable) -> TextRows:
        frame = table.placed(self.line, self.row)
        self.line, self.row = self.line + table.lines, self.row + frame.height
        self.below_names = self.below_names and not frame.height
        return trusted(frame, [], frame.height, self.wanted, table.not_finite)

    def _all_aside(self, block: bytes) -> TextRows | None:
        """Set all lines of a block aside at once if none can be a row or a header; else return None."""
        if any(name.encode() in block for name in (*self.wanted.required, *self.wanted.columns)[:1]):
            return None
        if (found := short_lines(block, self.layout)) is None:
            return None
        lines, fields = found
        width, counts = len(self.layout.names), np.unique(fields).tolist()
        reasons = {count: self.end_reason or miscounted(count, width) for count in counts}
        reason = pl.Series("reason", fields).replace_strict(reasons, return_dtype=pl.String)
        none = self._rows(_Sorted(), len(lines))
        aside = pl.DataFrame([pl.Series("source_row", lines + self.line), reason], schema=SET_ASIDE)
        above = block.rstrip()  # empty lines are between rows, too
        last = above[above.rfind(b"\n") + 1 :]
        self.after_fragment = not self.end_reason and self._is_fragment(last)
        self.line, self.row = self.line + block.count(b"\n"), self.row + len(lines)
        return replace(none, set_aside=aside)

    def _one_by_one(self, block: bytes) -> Iterator[TextRows]:
        found, begin = _Sorted(), self.row
        for content in block.split(b"\n")[:-1]:
            for piece in content.rstrip(b"\r").split(b"\r"):  # line end of old machines and progress bars
                if not piece.strip():
                    continue
                text = piece.decode("utf-8", "replace")
                if not self.below_names and (names := other_header(text, self.layout, self._all)):
                    yield self._rows(found, rows_read=self.row - begin)
                    found, begin = _Sorted(aside=[(self.line, self._continued(names))]), self.row
                    self.row += 1
                else:
                    self._sort_out(text, found)
            self.line += 1
        yield self._rows(found, rows_read=self.row - begin)

    def _continued(self, names: tuple[str, ...]) -> str:
        """Take another header for the rows below; return what is said of its line."""
        wanted = {kind: [name for name in columns if name in names] for kind, columns in vars(self._all).items()}
        self.wanted = Wanted(**wanted)
        self.layout = replace(self.layout, names=names)
        self.end_reason, self.below_names, self.after_fragment = "", True, False
        lacking = ", ".join(name for name in self._all.columns if name not in names)
        return f"another header: the rows below it are read by it{f', without {lacking[:60]}' if lacking else ''}"

    def _sort_out(self, text: str, found: _Sorted) -> None:
        """Add one line to the kept rows or to those set aside."""
        row, self.row = self.row, self.row + 1
        cells, reason = cells_of(text, self.layout)
        reason = self._as_names(cells, reason)
        if self.after_fragment and not reason:
            reason = "the line above it is a piece of a row, and this may be the rest of it"
        self.after_fragment = cells is None and is_fragment(text, self.layout)
        if self.after_fragment:
            found.reject_last((self.line - 1, row - 1), "the line below it is a piece of a row, perhaps of this one")
        if cells is None or reason:
            found.aside.append((self.line, reason))
            return
        found.kept.append(cells)
        found.places.append((self.line, row))
        self.below_names = False

    def _as_names(self, cells: str | None, reason: str) -> str:
        """Return why a line is no row: its fault, or that it holds column names; empty if it may be a row.

        The same names again mean that the recording was continued. Other names start another table, whose numbers must
        not be mixed in. Words directly below the names are units or descriptions.
        """
        if cells is None or not cells.strip(_BLANKS):
            return self.end_reason or reason
        fields = [cell.strip().lstrip("\ufeff").strip('"') for cell in cells.split(CELL)]
        if self.layout.is_header(fields):
            self.end_reason, self.below_names = "", True
            return "the header is repeated"
        if self.end_reason or not is_name_line(fields, self.layout, self.wanted.numbers):
            return self.end_reason or reason
        listed = ", ".join(fields)[:60]
        if self.below_names and not set(fields) & set(self.layout.names):
            return f"words where numbers are expected, units or a second line of names: {listed}"
        self.end_reason = f"another table begins in line {self.line} ({listed}): cut the file there to read it"
        return self.end_reason

    def _rows(self, found: _Sorted, rows_read: int) -> TextRows:
        table = as_texts(found.kept, self.layout).select(self.wanted.columns)
        where = pl.DataFrame(found.places, schema={"source_row": pl.Int64(), INDEX: pl.Int64()}, orient="row")
        table, garbled = as_numbers(pl.concat([where, table], how="horizontal"), self.layout, self.wanted)
        unknown = int(table.select(not_finite(self.wanted)).item() or 0) if table.height else 0
        table = table.select("source_row", INDEX, *finite(self.wanted), *stripped(self.wanted))
        return trusted(table, sorted(found.aside + garbled), rows_read, self.wanted, unknown)
