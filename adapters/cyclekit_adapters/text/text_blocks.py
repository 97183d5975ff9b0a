"""Text logs as blocks of whole lines in UTF-8, whatever their encoding, line ends or compression.

Logs may have a BOM, be in UTF-16, use the line ends of old machines (a bare CR), be compressed by gzip or zstd, and
exceed memory. `delimited` interprets the lines.
"""

from __future__ import annotations

import codecs
import gzip
import io
import os
import re
import stat
import sys
import zlib
from functools import lru_cache
from typing import TYPE_CHECKING, cast

from cyclekit.errors import DamagedLog, LogError

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from typing import BinaryIO

HEAD_BYTES = 16384
BLOCK_BYTES = 12 << 20
"""Size of a block parsed at once, bytes: large enough to use both cores, small enough for any machine."""
LONGEST_LINE = 16 << 20
"""Maximum length of a line, bytes: above that of any logger, headers of 17,000 columns included."""
_SMALL = 1 << 17
"""Maximum size, bytes, of a file that is read only once, for its head and its rows."""
_STEP = 1 << 16
_PIECE = 1 << 19
_GZIP, _ZSTD = b"\x1f\x8b", b"\x28\xb5\x2f\xfd"
_BOMS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
_MAX_RATIO = 1000
"""Maximum compression ratio: no log reaches it, so a file beyond it is a decompression bomb."""
_CELL = b"\x1f"
_BARE_CR = re.compile(r"(?<!\r)\r++(?=[^\n])")
"""Carriage returns without a line feed: line ends of old machines, possibly mixed with others."""


class _Bomb(OSError):
    """The decompressed data exceeds the maximum ratio to the file's size."""


def encoding_of(first: bytes) -> str | None:
    """Return the encoding indicated by the first bytes of a file; None for a binary file."""
    for mark, encoding in _BOMS:
        if first.startswith(mark):
            return encoding
    line = first.partition(b"\n")[0]  # a binary part or an unwritten disk block may follow the first line
    if b"\0" not in line:
        return "utf-8"
    for encoding, high, low in (("utf-16-le", line[1::2], line[0::2]), ("utf-16-be", line[0::2], line[1::2])):
        if len(line) >= 4 and high.count(0) > 0.9 * len(high) and 0 not in low:
            return encoding
    return None


def file_encoding(path: Path) -> str | None:
    """Return the encoding of a text file; None for a binary one.

    Raises:
        LogError: The file cannot be opened.
    """
    return encoding_of(_first(path, HEAD_BYTES))


def head_of(path: Path, size: int = HEAD_BYTES, encoding: str | None = None) -> str:
    """Return the first `size` bytes of a text file, decoded; empty for a binary, unreadable or missing file."""
    try:
        about = path.stat()
        if not stat.S_ISREG(about.st_mode):
            return ""
        return _decoded_first(path, size, encoding, about.st_size, about.st_mtime_ns)
    except OSError:
        return ""


@lru_cache(maxsize=16)
def _decoded_first(path: Path, size: int, encoding: str | None, _bytes: int, _changed: int) -> str:
    first = _read_first(path, size, _bytes, _changed)
    encoding = encoding or encoding_of(first)
    if not encoding:
        return ""
    return _with_line_feeds(first.decode(encoding, "replace").removeprefix("\ufeff"))


def head_lines(path: Path, count: int = 1, encoding: str | None = None) -> list[str]:
    """Return the first `count` lines of a text file without their line ends, fewer if the file has fewer.

    Lines may be of any length up to LONGEST_LINE. Empty for a binary, unreadable or missing file.
    """
    size, text = HEAD_BYTES, head_of(path, encoding=encoding)
    while text.count("\n") < count and len(text) >= size // 4 and size < LONGEST_LINE:
        size = min(8 * size, LONGEST_LINE)
        longer = head_of(path, size, encoding)
        if len(longer) == len(text):
            break
        text = longer
    return [line.rstrip("\r") for line in text.split("\n")[:count]]


def _first(path: Path, size: int) -> bytes:
    try:
        about = path.stat()
        if not stat.S_ISREG(about.st_mode):
            raise LogError(path, "is not a file", cure="Name the file itself.")
        return _read_first(path, size, about.st_size, about.st_mtime_ns)
    except OSError as error:
        raise LogError(path, f"cannot be read: {error.strerror}", cure="Check the path and its permissions.") from error


@lru_cache(maxsize=16)  # each adapter reads the head of each file
def _read_first(path: Path, size: int, _bytes: int, _changed: int) -> bytes:
    with _opened(path, _bytes, _changed) as file, _unpacked(file, path) as log:
        try:
            return log.read(size)
        except (zlib.error, zstd.ZstdError, gzip.BadGzipFile, EOFError):
            return b""


def _opened(path: Path, size: int, changed: int) -> BinaryIO:
    return io.BytesIO(_content(path, size, changed)) if size <= _SMALL else path.open("rb")


@lru_cache(maxsize=2)
def _content(path: Path, _bytes: int, _changed: int) -> bytes:
    with path.open("rb") as file:
        return file.read(_bytes)


def blocks_of(path: Path, encoding: str, *, skip_lines: int = 0, delimiter: str = ",") -> Iterator[bytes]:
    r"""Yield a text log as UTF-8 in blocks of whole lines; only the last line of all may lack its line end.

    Args:
        path: The log.
        encoding: Encoding of the log.
        skip_lines: Number of lines to skip at the start.
        delimiter: If longer than one character, each occurrence becomes the unit separator U+001F; `\s+` stands for a
            run of blanks.

    Raises:
        OSError: The file cannot be read.
        DamagedLog: It holds a line longer than any logger writes, or is a decompression bomb.
    """
    about = path.stat()
    with _opened(path, about.st_size, about.st_mtime_ns) as file, _unpacked(file, path) as log:
        first = _first(path, HEAD_BYTES)
        bare_cr = b"\r" in first and bool(_BARE_CR.search(first.decode(encoding, "replace")))
        plain = log is file and encoding in ("utf-8", "utf-8-sig") and not bare_cr
        blocks = _plain_blocks(file, path) if plain else _decoded_blocks(log, path, encoding, bare_cr=bare_cr)
        try:
            for number, block in enumerate(blocks):
                text = block.removeprefix(codecs.BOM_UTF8) if number == 0 else block
                while skip_lines and text:
                    text = text.partition(b"\n")[2]
                    skip_lines -= 1
                if text:
                    yield _with_one_delimiter(text, delimiter)
        except _Bomb as error:
            raise DamagedLog(path, str(error.strerror), cure="Check where the file comes from.") from error
        except (zlib.error, zstd.ZstdError, gzip.BadGzipFile, EOFError) as error:
            raise DamagedLog(path, f"its compressed data is damaged ({error})", cure="Copy it again.") from error


def characters_of(path: Path) -> Iterator[str]:
    """Yield the text of a log that is not organised by lines, in pieces of some hundred thousand characters.

    Raises:
        OSError: The file cannot be read.
        DamagedLog: It is not text, or its compressed data is damaged or a decompression bomb.
    """
    encoding = file_encoding(path)
    if encoding is None:
        raise DamagedLog(path, "not a text file: it begins with NUL bytes", cure="Check the copy.")
    decoder = codecs.getincrementaldecoder(encoding)("replace")
    with path.open("rb") as file, _unpacked(file, path) as log:
        try:
            while raw := log.read(_PIECE):
                yield decoder.decode(raw)
            yield decoder.decode(b"", final=True)
        except _Bomb as error:
            raise DamagedLog(path, str(error.strerror), cure="Check where the file comes from.") from error
        except (zlib.error, zstd.ZstdError, gzip.BadGzipFile, EOFError) as error:
            raise DamagedLog(path, f"its compressed data is damaged ({error})", cure="Copy it again.") from error


def _with_line_feeds(text: str) -> str:
    if text.count("\r") == text.count("\r\n"):  # true for nearly all logs
        return text
    return _BARE_CR.sub(lambda found: "\n" * len(found[0]), text)


def _plain_blocks(log: BinaryIO, path: Path) -> Iterator[bytes]:
    """Yield blocks that end at the next line end, without copying bytes."""
    end, begin = log.seek(0, os.SEEK_END), 0
    while begin < end:
        after = min(begin + BLOCK_BYTES, end)
        log.seek(after)
        while after < end:
            piece = log.read(_STEP)
            found = piece.find(b"\n")
            after += found + 1 if found >= 0 else len(piece)
            if after - begin > BLOCK_BYTES + LONGEST_LINE:
                raise _too_long(path)
            if found >= 0 or not piece:
                break
        log.seek(begin)
        block = log.read(after - begin)
        if not block:
            return  # the file was truncated meanwhile
        yield block
        begin += len(block)


def _decoded_blocks(log: BinaryIO, path: Path, encoding: str, *, bare_cr: bool) -> Iterator[bytes]:
    rest = ""
    for text in _decoded(log, encoding):
        text = rest + text
        if bare_cr:
            text = _with_line_feeds(text)  # a CR at the end of the text waits for the next character
        cut = text.rfind("\n") + 1
        if cut:
            yield text[:cut].encode("utf-8", "replace")
        rest = text[cut:]
        if len(rest) > LONGEST_LINE:
            raise _too_long(path)
    if rest:
        yield (rest.replace("\r", "\n") if bare_cr else rest).encode("utf-8", "replace")


def _decoded(log: BinaryIO, encoding: str) -> Iterator[str]:
    decoder = codecs.getincrementaldecoder(encoding)("replace")
    first = True
    while raw := log.read(BLOCK_BYTES // 4):
        text = decoder.decode(raw)
        yield text.removeprefix("\ufeff") if first else text
        first = False
    yield decoder.decode(b"", final=True)


def _too_long(path: Path) -> DamagedLog:
    cause = f"holds a line of more than {LONGEST_LINE >> 20} MiB: no logger writes that"
    return DamagedLog(path, cause, cure="Check what the file is.")


def _with_one_delimiter(block: bytes, delimiter: str) -> bytes:
    if len(delimiter) == 1:
        return block
    if delimiter == "\\s+":
        block = block.replace(b"\t", b" ")
        while b"  " in block:
            block = block.replace(b"  ", b" ")
        block = block.replace(b"\n ", b"\n").replace(b" \n", b"\n").replace(b" \r\n", b"\r\n")
        return block.strip(b" ").replace(b" ", _CELL)
    return block.replace(delimiter.encode(), _CELL)


def _unpacked(file: BinaryIO, path: Path) -> BinaryIO:
    """Return the file, or its decompressed content."""
    first = file.read(4)
    file.seek(0)
    if first.startswith(_GZIP):
        return cast("BinaryIO", _Counted(gzip.GzipFile(fileobj=file), path))
    if first == _ZSTD:
        return cast("BinaryIO", _Counted(zstd.ZstdFile(file), path))
    return file


class _Counted(io.RawIOBase):
    """A decompressing stream that raises when the output exceeds the maximum ratio."""

    def __init__(self, packed: io.BufferedIOBase, path: Path) -> None:
        super().__init__()
        self._packed, self._given, self._most = packed, 0, max(path.stat().st_size, 1 << 16) * _MAX_RATIO

    def readable(self) -> bool:
        return True

    def read(self, size: int = -1) -> bytes:
        data = self._packed.read(size)
        self._given += len(data)
        if self._given > self._most:
            raise _Bomb(0, f"it unpacks to more than {_MAX_RATIO} times its size: it is not a log")
        return data

    def close(self) -> None:
        self._packed.close()
        super().close()
