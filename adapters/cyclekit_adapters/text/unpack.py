"""The text of a log that is packed: gzip, zstd, a zip or tar of one file, and the rows of a Parquet table as CSV.

Found by the first bytes, never by the name. Output is limited as a protection against decompression bombs.
"""

from __future__ import annotations

import gzip
import io
import sys
import tarfile
import zipfile
import zlib
from typing import TYPE_CHECKING, cast

import polars as pl

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path
    from typing import BinaryIO

BROKEN = (zlib.error, zstd.ZstdError, gzip.BadGzipFile, zipfile.BadZipFile, tarfile.TarError, EOFError)
"""Errors of damaged compressed data."""
_GZIP, _ZSTD, _ZIP, _PARQUET = b"\x1f\x8b", b"\x28\xb5\x2f\xfd", b"PK\x03\x04", b"PAR1"
_TAR, _TAR_AT = b"ustar", 257
_MAX_RATIO = 1000
"""Maximum compression ratio: no log reaches it, so a file beyond it is a decompression bomb."""
_ROWS, _FIRST_ROWS = 50_000, 500
"""Rows of a Parquet table that are written at once: a size; few at first, for the head of a file."""


class NoLog(OSError):
    """What is packed cannot be one log: it is larger than any, or it is several files."""

    def __init__(self, cause: str, cure: str) -> None:
        super().__init__(0, cause)
        self.cure = cure


def unpacked(file: BinaryIO, path: Path) -> BinaryIO:
    """Return a file itself, or a stream of its unpacked content.

    Args:
        file: The file, at its start.
        path: Its path.
    """
    first = file.read(_TAR_AT + len(_TAR))
    file.seek(0)
    stream: object = file
    if first.startswith(_GZIP):
        stream = _of_tar(cast("BinaryIO", gzip.GzipFile(fileobj=file)), path)
    elif first.startswith(_ZSTD):
        stream = _of_tar(cast("BinaryIO", zstd.ZstdFile(file)), path)
    elif first[_TAR_AT:] == _TAR:
        stream = _Stream(_only_member(file, path), path)
    elif first.startswith(_ZIP) and (member := _only_file(file)) is not None:
        stream = _Stream(member.read, path)
    elif first.startswith(_PARQUET):
        stream = _Stream(_pieces(_csv_of(path)), path)
    return cast("BinaryIO", stream)


def _of_tar(packed: BinaryIO, path: Path) -> _Stream:
    """Return a decompressed stream; if it is a tar, that of its only file."""
    try:
        first = packed.read(_TAR_AT + len(_TAR))
        packed.seek(0)
    except BROKEN:
        first = b""
    plain = _Stream(packed.read, path)
    return _Stream(_only_member(cast("BinaryIO", plain), path), path) if first[_TAR_AT:] == _TAR else plain


def _only_member(file: BinaryIO, path: Path) -> Callable[[int], bytes]:
    """Return the function that reads the first file of a tar; at its end it refuses a second one."""
    archive = tarfile.open(fileobj=file, mode="r|")  # noqa: SIM115 - open as long as its member is read
    files = (archive.extractfile(member) for member in archive if member.isreg() and not _of_mac(member.name))
    member = next(files, None)

    def read(size: int) -> bytes:
        data = b"" if member is None else member.read(size)
        if not data and next(files, None) is not None:
            raise NoLog("an archive of several files", f"Unpack it: python -m tarfile -e {path} {path.stem}")
        return data

    return read


def _only_file(file: BinaryIO) -> BinaryIO | None:
    """Return the only file of a zip; None if it holds several, such as a workbook, or is encrypted or damaged."""
    try:
        archive = zipfile.ZipFile(file)
        found = [one for one in archive.infolist() if not one.is_dir() and not _of_mac(one.filename)]
        return cast("BinaryIO", archive.open(found[0])) if len(found) == 1 else None
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, ValueError):
        return None


def _of_mac(name: str) -> bool:
    """Return whether a member is what macOS adds beside a file."""
    return name.rpartition("/")[2].startswith("._")


def _csv_of(path: Path) -> Iterator[bytes]:
    """Yield a Parquet table as CSV: lists in brackets, fields of a struct as columns of their own."""
    try:
        table = pl.scan_parquet(path, glob=False)
        columns = [one for name, kind in table.collect_schema().items() for one in _as_text(pl.col(name), name, kind)]
        begin, count = 0, _FIRST_ROWS
        while (rows := table.slice(begin, count).select(columns).collect()).height or not begin:
            yield rows.write_csv(include_header=not begin).encode()
            begin, count = begin + count, _ROWS
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise NoLog(f"not a Parquet table that can be read ({str(error)[:80]})", "Write it again.") from error


def _as_text(column: pl.Expr, name: str, kind: pl.DataType) -> list[pl.Expr]:
    """Return what is written of a column; nothing of one whose cells are no text, such as pictures."""
    if isinstance(kind, pl.Struct):
        inner = ((field, column.struct.field(field.name), f"{name}.{field.name}") for field in kind.fields)
        return [one for field, part, title in inner for one in _as_text(part, title, cast("pl.DataType", field.dtype))]
    if isinstance(kind, pl.Array):
        column, kind = column.arr.to_list(), pl.List(kind.inner)
    if isinstance(kind, pl.List):
        if kind.inner.is_nested() or kind.inner == pl.Binary:
            return []
        column = pl.format("[{}]", column.list.eval(pl.element().cast(pl.String).fill_null("")).list.join(", "))
    elif isinstance(kind, pl.Duration):
        column = column.dt.total_nanoseconds() * 1e-9
    return [] if kind in (pl.Binary, pl.Object) else [column.alias(name)]


def _pieces(parts: Iterator[bytes]) -> Callable[[int], bytes]:
    """Return a function that reads up to a number of bytes of consecutive parts."""
    rest = b""

    def read(size: int) -> bytes:
        nonlocal rest
        while (size < 0 or len(rest) < size) and (part := next(parts, b"")):
            rest += part
        data, rest = (rest, b"") if size < 0 else (rest[:size], rest[size:])
        return data

    return read


class _Stream(io.RawIOBase):
    """A stream of unpacked bytes that raises when the output exceeds the maximum ratio."""

    def __init__(self, read: Callable[[int], bytes], path: Path) -> None:
        super().__init__()
        self._read, self._given, self._most = read, 0, max(path.stat().st_size, 1 << 16) * _MAX_RATIO

    def readable(self) -> bool:
        return True

    def read(self, size: int = -1) -> bytes:
        data = self._read(size)
        self._given += len(data)
        if self._given > self._most:
            cause = f"it unpacks to more than {_MAX_RATIO} times its size: it is not a log"
            raise NoLog(cause, "Check where the file comes from.")
        return data
