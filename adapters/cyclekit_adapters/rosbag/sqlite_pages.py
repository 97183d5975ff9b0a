"""Rows of a sqlite3 file that sqlite cannot open: cut, or damaged in a page that leads to others.

Sqlite finds a row through a tree of pages. The pages at its top are often written last, so sqlite reads little or
nothing of a truncated file. But every leaf page is self-contained: it lists its rows, each with its number and columns.
This module reads the leaf pages one by one, at any position. Rows of missing pages stay missing.

Format: the database file format of sqlite 3, limited to its row tables, which are all that a bag needs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BufferedReader

Value = int | float | str | bytes | None
_LEAF, _INNER = 13, 5
_INT_SIZES = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8}
_MAX_ROW = 64 << 20
"""Maximum size of a row, bytes; no usable message is larger."""
_HEAD = 100  # bytes at the start of the first page that are not part of its tree
_AT_ONCE = 1 << 20  # bytes per read


class NoPages(ValueError):
    """The first page is not that of a sqlite3 database."""


@dataclass
class Pages:
    """Complete pages of a database.

    Attributes:
        log: The file, open for reading.
        size: Bytes per page; `usable`: those in use.
        count: Number of complete pages; `missing`: further pages according to the file header.
    """

    log: BufferedReader
    size: int = field(init=False)
    usable: int = field(init=False)
    count: int = field(init=False)
    missing: int = field(init=False)
    _read: bytes = b""
    _first: int = 0  # first page in `_read`

    def __post_init__(self) -> None:
        self.log.seek(0)
        head = self.log.read(_HEAD)
        if len(head) < _HEAD or not head.startswith(b"SQLite format 3\0"):
            raise NoPages("the head of the database is not whole")
        size = int.from_bytes(head[16:18], "big")
        self.size = 65536 if size == 1 else size
        if self.size < 512 or self.size & (self.size - 1):
            raise NoPages(f"pages of {self.size} bytes")
        self.usable = self.size - head[20]
        self.count = self.log.seek(0, 2) // self.size
        self.missing = max(0, int.from_bytes(head[28:32], "big") - self.count)

    def _page(self, number: int) -> bytes:
        """Return the bytes of a page; optimised for consecutive pages."""
        if not 1 <= number <= self.count:
            raise ValueError("a page is missing")
        at = (number - self._first) * self.size
        if not self._first or not 0 <= at <= len(self._read) - self.size:
            self.log.seek((number - 1) * self.size)
            self._read, self._first, at = self.log.read(_AT_ONCE), number, 0
        return self._read[at : at + self.size]

    def tables(self) -> dict[str, int]:
        """Return the first page of each table listed in page 1."""
        found = {}
        for _, row in self._rows(1) if self.count else ():
            if len(row) >= 4 and row[0] == "table" and isinstance(row[1], str) and isinstance(row[3], int):
                found[row[1]] = row[3]
        return found

    def below(self, root: int) -> Iterator[tuple[int, list[Value]]]:
        """Yield number and columns of every row of a table, as far as its pages exist."""
        for page in self.pages_below(root):
            yield from self._rows(page)

    def pages_below(self, root: int) -> list[int]:
        """Return the leaf pages of a table that can be reached from its first page."""
        found, todo, seen = [], [root], set[int]()
        while todo:
            page = todo.pop()
            if page in seen or not 1 <= page <= self.count:
                continue
            seen.add(page)
            raw = self._page(page)
            kind, cells = self._cells(page, raw)
            if kind == _LEAF:
                found.append(page)
            elif kind == _INNER:
                at = (_HEAD if page == 1 else 0) + 8
                todo += [int.from_bytes(raw[cell : cell + 4], "big") for cell in (*cells, at)]
        return sorted(found)

    def everywhere(self, but: set[int]) -> Iterator[tuple[int, list[Value]]]:
        """Yield number and columns of every row on all leaf pages of the file, except pages in `but` and free ones."""
        unused = but | self._free()
        for page in range(2, self.count + 1):
            if page not in unused:
                yield from self._rows(page)

    def _free(self) -> set[int]:
        """Return the free pages, as far as their list exists."""
        found = set[int]()
        page = int.from_bytes(self._page(1)[32:36], "big") if self.count else 0
        while 1 <= page <= self.count and page not in found:
            raw = self._page(page)
            count = min(int.from_bytes(raw[4:8], "big"), self.size // 4 - 2)
            found |= {page, *(int.from_bytes(raw[8 + 4 * n : 12 + 4 * n], "big") for n in range(count))}
            page = int.from_bytes(raw[:4], "big")
        return found

    def _cells(self, page: int, raw: bytes) -> tuple[int, list[int]]:
        """Return the kind of a page and the offsets of its cells."""
        head = _HEAD if page == 1 else 0
        kind = raw[head]
        count = int.from_bytes(raw[head + 3 : head + 5], "big")
        if kind not in (_LEAF, _INNER) or count > self.size // 4:
            return kind, []
        first = head + (8 if kind == _LEAF else 12)
        pointers = raw[first : first + 2 * count]
        cells = [pointers[n] << 8 | pointers[n + 1] for n in range(0, len(pointers), 2)]
        return kind, [cell for cell in cells if first + 2 * count <= cell < self.usable - 4]

    def _rows(self, page: int) -> Iterator[tuple[int, list[Value]]]:
        raw = self._page(page)
        kind, cells = self._cells(page, raw)
        for cell in cells if kind == _LEAF else ():
            try:
                yield self._row(raw, cell)
            except (IndexError, ValueError):  # a garbled cell, or one that continues on a missing page
                continue

    def _row(self, raw: bytes, at: int) -> tuple[int, list[Value]]:
        size, at = _varint(raw, at)
        number, at = _varint(raw, at)
        if size > _MAX_ROW:
            raise ValueError("a row larger than any")
        here = self._here(size)
        if at + here > self.usable:
            raise ValueError("a row that reaches beyond its page")
        payload = raw[at : at + here]
        if here < size:
            payload += self._rest(int.from_bytes(raw[at + here : at + here + 4], "big"), size - here)
        return number, _columns(payload)

    def _here(self, size: int) -> int:
        """Return how many bytes of a row of this size are on its own page; the rest is a chain of other pages."""
        most, least = self.usable - 35, (self.usable - 12) * 32 // 255 - 23
        if size <= most:
            return size
        kept = least + (size - least) % (self.usable - 4)
        return kept if kept <= most else least

    def _rest(self, page: int, size: int) -> bytes:
        parts: list[bytes] = []
        while size > 0:
            raw = self._page(page)
            page = int.from_bytes(raw[:4], "big")
            parts.append(raw[4 : 4 + min(size, self.usable - 4)])
            size -= len(parts[-1])
        return b"".join(parts)


def _varint(raw: bytes, at: int) -> tuple[int, int]:
    value = 0
    for _ in range(8):
        byte = raw[at]
        at += 1
        value = value << 7 | byte & 127
        if byte < 128:
            return value, at
    return value << 8 | raw[at], at + 1


def _columns(payload: bytes) -> list[Value]:
    """Return the columns of a row."""
    size, at = _varint(payload, 0)
    kinds = []
    while at < size:
        kind, at = _varint(payload, at)
        kinds.append(kind)
    at, found = size, list[Value]()
    for kind in kinds:
        width = _INT_SIZES.get(kind, 8 if kind == 7 else (kind - 12) // 2 if kind >= 12 else 0)
        part = payload[at : at + width]
        if len(part) < width:
            raise ValueError("a column that reaches beyond its row")
        at += width
        if kind in _INT_SIZES:
            found.append(int.from_bytes(part, "big", signed=True))
        elif kind >= 12:
            found.append(part.decode() if kind % 2 else part)
        else:
            found.append({8: 0, 9: 1}.get(kind))  # null, and numbers that do not occur in a bag
    return found
