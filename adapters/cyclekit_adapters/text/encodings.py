"""Encoding of a text log: the declared one (byte order mark, XML declaration), else UTF-8, else Windows-1252.

Old exporters in western Europe write Windows-1252 and declare nothing. Text in it is hardly ever valid UTF-8, and text
in UTF-8 is valid except where it is damaged. So what declares nothing, is not valid UTF-8 and holds not one character
of UTF-8 is read as Windows-1252, and the reader of a log says so (`text_blocks.encoding_notes`).
"""

from __future__ import annotations

import codecs
import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

WINDOWS = "windows-1252"
UTF_8 = ("utf-8", "utf-8-sig")
GUESSED = (
    "its text is not in UTF-8 and declares no other encoding: read as Windows-1252; check the umlauts, or export it "
    "in UTF-8"
)
_BOMS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),  # before that of UTF-16, with which it begins
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
WIDE = {
    "utf-16": (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE),
    "utf-32": (codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE),
}
"""Encodings whose byte order a mark tells."""
_DECLARED = re.compile(rb"""\s*<\?xml\s[^>]{0,200}?\bencoding\s*=\s*["']([\w.:-]{1,40})["']""")
_WIDE = re.compile(r"utf-?(?:8|16|32)|ucs|unicode")
"""Encodings that a declaration in ASCII does not have (tools that write text from memory say UTF-16), and UTF-8."""
_OF_UTF_8 = re.compile("[^\x00-\x7f\udc80-\udcff]")
_ASCII = bytes(range(32, 127))


def encoding_of(first: bytes) -> str | None:
    """Return the encoding indicated by the first bytes of a file; None for a binary file.

    "utf-8" stands for undeclared text too: `decoded` and `is_windows` look at its bytes.
    """
    for mark, encoding in _BOMS:
        if first.startswith(mark):
            return encoding
    line = first.partition(b"\n")[0]  # a binary part or an unwritten disk block may follow the first line
    if b"\0" not in line:
        declared = declared_in(first)
        return declared if declared is not None and is_known(declared) else "utf-8"
    for encoding, high, low in (("utf-16-le", line[1::2], line[0::2]), ("utf-16-be", line[0::2], line[1::2])):
        if len(line) >= 4 and high.count(0) > 0.9 * len(high) and 0 not in low:
            return encoding
    return None


def declared_in(first: bytes) -> str | None:
    """Return the encoding that an XML declaration in ASCII gives, other than UTF-8 and what it cannot be; else None."""
    found = _DECLARED.match(first)
    name = found[1].decode("ascii", "replace").lower() if found else ""
    return None if not name or _WIDE.match(name) else name


def is_known(encoding: str) -> bool:
    """Return whether Python knows this encoding, and it is one of text that contains ASCII."""
    try:
        return _ASCII.decode(encoding) == _ASCII.decode("ascii")
    except (LookupError, UnicodeError, ValueError):
        return False


def is_windows(raw: bytes) -> bool:
    """Return whether bytes that are not all ASCII are more likely Windows-1252 than UTF-8."""
    text = codecs.getincrementaldecoder("utf-8")("surrogateescape").decode(raw)  # without a character cut at the end
    return not _OF_UTF_8.search(text) and not text.isascii()


def decoded(raws: Iterable[bytes], encoding: str, assume: Callable[[], None] = lambda: None) -> Iterator[str]:
    """Yield consecutive bytes of a text as text, U+FFFD where they cannot be decoded.

    Args:
        raws: The bytes, cut anywhere.
        encoding: Their encoding. If it is UTF-8, the first bytes beyond ASCII decide whether it is Windows-1252.
        assume: Called if so.
    """
    decoder = None
    for raw in raws:
        if decoder is None and encoding in WIDE and not raw.startswith(WIDE[encoding]):
            encoding = f"{encoding}-le"  # without a mark Python refuses to decode; Windows writes the low byte first
        if decoder is None and encoding in UTF_8 and not raw.startswith(codecs.BOM_UTF8):
            if raw.isascii():
                yield raw.decode("ascii")
                continue
            if is_windows(raw):
                encoding = WINDOWS
                assume()
        decoder = decoder or codecs.getincrementaldecoder(encoding)("replace")
        yield decoder.decode(raw)
    if decoder is not None:
        yield decoder.decode(b"", final=True)
