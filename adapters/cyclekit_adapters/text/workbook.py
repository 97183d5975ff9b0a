"""Size check of an Excel workbook: its sheets are unpacked, measured, and packed again for the reader.

A workbook is a zip of XML. A few KiB of it can hold gigabytes of blanks, a single cell in the last row makes a reader
allocate a billion empty ones, and a million cells can refer to one long text. So the content is counted while it is
unpacked, and only counted content reaches the reader. `sheets` interprets the cells.
"""

from __future__ import annotations

import io
import re
import zipfile
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.errors import DamagedLog, LogError
from cyclekit.text.numbers import count

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from typing import IO

ZIP = b"PK\x03\x04"
MAX_RATIO = 200
"""Maximum compression ratio: sheets of numbers reach about 10; a workbook beyond this is no log."""
MAX_CELLS = 10_000_000
"""Maximum number of filled cells of a sheet, which is held in memory as a whole; export a longer log as text."""
_SPARSE = 8  # maximum ratio of spanned to filled cells, for a sheet that is not small
_SMALL = 2_000_000
_MAX_TEXT = 1 << 28
_LONGEST_TAG = 1 << 20
_CHUNK = 1 << 20
_MAX_PARTS = 10_000
_KEPT = re.compile(
    r"\[Content_Types\]\.xml|_rels/.*|xl/(?:_rels/.*|worksheets/[^/]+|[^/]+)\.(?:xml|rels)", re.IGNORECASE
)
_SHARED_INDEX = re.compile(rb"""\bt="s"[^<>]*><(?:\w+:)?v>(\d{1,9})<""")
_ITEM = re.compile(rb"<(?:\w+:)?si\b.*?</(?:\w+:)?si>", re.DOTALL)
_AROUND_EQUALS = re.compile(rb"\s*=\s*")
_MAX_LETTERS, _MAX_DIGITS = 3, 7


@dataclass
class _Weighed:
    """Sizes counted in one sheet."""

    cells: int = 0
    rows: int = 0
    columns: int = 0
    shared: int = 0

    def add(self, text: bytes) -> None:
        """Count the cells in a piece of the sheet that consists of whole tags."""
        if any(mark in text for mark in (b" =", b"= ", b"\t=", b"=\t", b"\n=", b"=\n", b"\r=", b"=\r")):
            text = _AROUND_EQUALS.sub(b"=", text)
        text = text.replace(b"'", b'"')
        self.cells += text.count(b"<c ") + text.count(b"<c>") + text.count(b":c ") + text.count(b":c>")
        self.shared += text.count(b't="s"')
        rows, columns = _farthest(text)
        self.rows, self.columns = max(self.rows, rows), max(self.columns, columns)


def _farthest(text: bytes) -> tuple[int, int]:
    """Return the greatest row and column in attributes `r="C7"` or `r="7"`; 0 if there is none."""
    raw = np.frombuffer(text + b" " * (_MAX_LETTERS + _MAX_DIGITS + 3), np.uint8)
    at = np.flatnonzero((raw[2:] == ord('"')) & (raw[1:-1] == ord("=")) & (raw[:-2] == ord("r"))) + 3
    columns, rows = np.zeros(len(at), np.int64), np.zeros(len(at), np.int64)
    for _ in range(_MAX_LETTERS):
        letter = raw[at] & 0xDF  # upper case
        is_letter = (letter >= ord("A")) & (letter <= ord("Z"))
        columns = np.where(is_letter, 26 * columns + letter - 64, columns)
        at = at + is_letter
    for _ in range(_MAX_DIGITS):
        is_digit = (raw[at] >= ord("0")) & (raw[at] <= ord("9"))
        rows = np.where(is_digit, 10 * rows + raw[at] - ord("0"), rows)
        at = at + is_digit
    return int(rows.max(initial=0)), int(columns.max(initial=0))


def is_workbook(path: Path) -> bool:
    """Return whether a file is a zip that holds a workbook."""
    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            if file.read(4) != ZIP:
                return False
        with zipfile.ZipFile(path) as archive:
            return any(name.lower() == "xl/workbook.xml" for name in archive.namelist()[:_MAX_PARTS])
    except (OSError, zipfile.BadZipFile, ValueError, NotImplementedError):
        return False


def safe_copy(path: Path) -> bytes:
    """Return a workbook with only its sheets, after a check of their real sizes.

    Raises:
        DamagedLog: It is damaged, encrypted or malicious.
        LogError: It cannot be opened, or is larger than any sheet of a log.
    """
    copy = io.BytesIO()
    try:
        with (
            zipfile.ZipFile(path) as archive,
            zipfile.ZipFile(copy, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as kept,
        ):
            _copy_parts(path, archive, kept)
    except OSError as error:
        raise LogError(path, f"cannot be read: {error.strerror}", cure="Check the path and its permissions.") from error
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError) as error:
        raise DamagedLog(
            path, f"its compressed data is damaged or encrypted ({error})", cure="Save it again."
        ) from error
    return copy.getvalue()


def _copy_parts(path: Path, archive: zipfile.ZipFile, kept: zipfile.ZipFile) -> None:
    parts = {info.filename: info for info in archive.infolist() if _KEPT.fullmatch(info.filename)}
    most = max(path.stat().st_size, 1 << 16) * MAX_RATIO
    if len(archive.infolist()) > _MAX_PARTS or sum(info.file_size for info in parts.values()) > most:
        cause = f"it unpacks to more than {MAX_RATIO} times its size: it is not a log"
        raise DamagedLog(path, cause, cure="Check where the file comes from.")
    texts, sheets = list[int](), dict[str, _Weighed]()
    for name, info in parts.items():
        weighed, is_sheet = _Weighed(), name.lower().startswith("xl/worksheets/")
        is_texts = name.lower().endswith("sharedstrings.xml")
        with archive.open(info) as source, kept.open(name, "w", force_zip64=True) as target:
            for text in _whole_tags(path, source, b"si>" if is_texts else b">"):
                if is_sheet:
                    weighed.add(text)
                elif is_texts:
                    texts += map(len, _ITEM.findall(text))
                target.write(text)
        if is_sheet:
            sheets[name] = weighed
    for name, sheet in sheets.items():
        _require_size(path, sheet)
        if max(texts, default=0) * sheet.shared > _MAX_TEXT:
            with archive.open(name) as source:
                indices = [int(at) for text in _whole_tags(path, source, b">") for at in _SHARED_INDEX.findall(text)]
            _require_texts(path, sheet, indices, texts)


def _whole_tags(path: Path, source: IO[bytes], end: bytes) -> Iterator[bytes]:
    """Yield XML in pieces that end at the end of a tag."""
    rest = b""
    while piece := source.read(_CHUNK):
        rest += piece
        cut = rest.rfind(end) + len(end)
        if cut >= len(end):
            yield rest[:cut]
            rest = rest[cut:]
        if len(rest) > _LONGEST_TAG + _CHUNK:
            raise DamagedLog(path, "a tag of more than 1 MiB: no spreadsheet writes that", cure="Save it again.")
    if rest:
        yield rest


def _require_size(path: Path, sheet: _Weighed) -> None:
    """Refuse a sheet that would need more memory than any log."""
    span = max(sheet.rows, 1) * max(sheet.columns, 1)
    if sheet.cells > MAX_CELLS or span > max(_SMALL, min(_SPARSE * sheet.cells, 2 * MAX_CELLS)):
        cause = (
            f"a sheet of {count(sheet.rows)} rows and {count(sheet.columns)} columns with {count(sheet.cells)} cells"
        )
        raise LogError(path, f"{cause} filled: too large", cure="Export the sheet as CSV, which is read at any size.")


def _require_texts(path: Path, sheet: _Weighed, indices: list[int], texts: list[int]) -> None:
    """Refuse a sheet whose cells refer to long texts so often that they fill the memory."""
    known = len(indices) == sheet.shared and max(indices, default=-1) < len(texts)
    if not known or sum(texts[index] for index in indices) > _MAX_TEXT:
        cause = "its texts are longer than those of any log"
        raise LogError(path, cause, cure="Export the sheet as CSV, which is read at any size.")
