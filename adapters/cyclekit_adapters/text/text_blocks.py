"""Text logs as blocks of whole lines in UTF-8, whatever their encoding, line ends or compression.

Logs may use the line ends of old machines (a bare CR), be packed (`unpack`), and exceed memory. `encodings` finds the
encoding, `delimited` interprets the lines.
"""

from __future__ import annotations

import codecs
import io
import os
import re
import stat
from functools import lru_cache, partial
from typing import TYPE_CHECKING

from cyclekit.errors import DamagedLog, LogError
from cyclekit_adapters.text.encodings import (
    GUESSED,
    UTF_8,
    WINDOWS,
    declared_in,
    decoded,
    encoding_of,
    is_known,
    is_windows,
)
from cyclekit_adapters.text.unpack import BROKEN, NoLog, unpacked

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
_CELL = b"\x1f"
_BARE_CR = re.compile(r"(?<!\r)\r++(?=[^\n])")
"""Carriage returns without a line feed: line ends of old machines, possibly mixed with others."""

_assumed: dict[Path, tuple[int, int]] = {}
"""Logs read so far whose encoding is a guess, with their size and time of change."""


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
    text = "".join(decoded([first], encoding)).removesuffix("\ufffd" if len(first) == size else "")
    return _with_line_feeds(text.removeprefix("\ufeff"))


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
    except NoLog as error:
        raise DamagedLog(path, str(error.strerror), cure=error.cure) from error
    except OSError as error:
        raise LogError(path, f"cannot be read: {error.strerror}", cure="Check the path and its permissions.") from error


@lru_cache(maxsize=16)  # each adapter reads the head of each file
def _read_first(path: Path, size: int, _bytes: int, _changed: int) -> bytes:
    with _opened(path, _bytes, _changed) as file, unpacked(file, path) as log:
        try:
            return log.read(size)
        except BROKEN:
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
    with _opened(path, about.st_size, about.st_mtime_ns) as file, unpacked(file, path) as log:
        first = _first(path, HEAD_BYTES)
        bare_cr = b"\r" in first and bool(_BARE_CR.search(first.decode(encoding, "replace")))
        plain = log is file and encoding in UTF_8 and not bare_cr
        blocks = _utf8_blocks(file, path) if plain else _decoded_blocks(log, path, encoding, bare_cr=bare_cr)
        try:
            for number, block in enumerate(blocks):
                text = block.removeprefix(codecs.BOM_UTF8) if number == 0 else block
                while skip_lines and text:
                    text = text.partition(b"\n")[2]
                    skip_lines -= 1
                if text:
                    yield _with_one_delimiter(text, delimiter)
        except NoLog as error:
            raise DamagedLog(path, str(error.strerror), cure=error.cure) from error
        except BROKEN as error:
            raise DamagedLog(path, f"its compressed data is damaged ({error})", cure="Copy it again.") from error


def characters_of(path: Path) -> Iterator[str]:
    """Yield the text of a log that is not organised by lines, in pieces of some hundred thousand characters.

    Raises:
        OSError: The file cannot be read.
        DamagedLog: It is not text, declares an encoding that nobody knows, or its compressed data is damaged or a
            decompression bomb.
    """
    first = _first(path, HEAD_BYTES)
    encoding = encoding_of(first)
    if encoding is None:
        raise DamagedLog(path, "not a text file: it begins with NUL bytes", cure="Check the copy.")
    if (declared := declared_in(first)) is not None and not is_known(declared):
        raise DamagedLog(path, f"it declares the unknown encoding {declared!r}", cure="Export it again in UTF-8.")
    with path.open("rb") as file, unpacked(file, path) as log:
        try:
            yield from decoded(iter(partial(log.read, _PIECE), b""), encoding, partial(_assume, path))
        except NoLog as error:
            raise DamagedLog(path, str(error.strerror), cure=error.cure) from error
        except BROKEN as error:
            raise DamagedLog(path, f"its compressed data is damaged ({error})", cure="Copy it again.") from error


def _with_line_feeds(text: str) -> str:
    if text.count("\r") == text.count("\r\n"):  # true for nearly all logs
        return text
    return _BARE_CR.sub(lambda found: "\n" * len(found[0]), text)


def begins_in_windows(path: Path) -> bool:
    """Return whether the first bytes of a text log, which declares no encoding, are most likely Windows-1252."""
    first = _first(path, HEAD_BYTES)
    return encoding_of(first) in UTF_8 and not first.isascii() and is_windows(first)


def _assume(path: Path) -> None:
    _assumed[path] = _state(path)


def _state(path: Path) -> tuple[int, int]:
    about = path.stat()
    return about.st_size, about.st_mtime_ns


def encoding_notes(path: Path) -> tuple[str, ...]:
    """Return a sentence if the encoding of a log that was read is a guess: neither UTF-8 nor declared."""
    return (GUESSED,) if path in _assumed and _assumed[path] == _state(path) else ()


def _utf8_blocks(log: BinaryIO, path: Path) -> Iterator[bytes]:
    windows = None
    for block in _plain_blocks(log, path):
        if windows is None and not block.isascii():
            windows = is_windows(block)
            if windows:
                _assume(path)
        yield block.decode(WINDOWS, "replace").encode() if windows else block


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
    for number, text in enumerate(
        decoded(iter(partial(log.read, BLOCK_BYTES // 4), b""), encoding, partial(_assume, path))
    ):
        text = rest + (text if number else text.removeprefix("\ufeff"))
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
