"""Harm done to a log in ways that nobody planned: at random places, of random size; the same seed does the same harm.

Text logs are harmed in their lines and cells as well, binary ones in their bytes only. What should come of it is not
known, so only this is asked: one of our tables or one of our refusals, soon, and no other exception.
"""

from __future__ import annotations

import random
import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

Harm = "Callable[[bytes, random.Random], bytes]"
WORD = re.compile(rb"[\w.+-]+")
_MARKS = [b",", b";", b"\t", b" ", b"|"]
TOKENS = [
    b"nan", b"inf", b"-inf", b"1e308", b"-1e309", b"9" * 400, b"0x1F", b"true", b"null", b"", b'"', b'""', b"'", b"\\",
    b"-", b"--1", b"1.2.3", b"1,5", b"\xff\xfe", b"\xef\xbb\xbf", b"\xe2\x80\xa8", b"\x1f", b"{}", b"[]", b"[[", b"}",
    b"18446744073709551616", b"-9223372036854775809", b"1e-400", b"2025-02-31", b"\xc0\x80", b"\r", b"\n", b"\0",
    b"-5", b"0", b"-0", b"1e300", b"9999999999999999999", "²".encode(), "٣".encode(), "½".encode(), b"Infinity",
    b"-Infinity", b"NaN", b'"\\ud800"', b'"\\udfff\\ud800"', b"\\ud800", b"\xed\xa0\x80", b"1_000", b"9" * 5000,
    b" 7 ", b"+-5", b"1e19", b"t", b"source_row",
    b"9999-12-31T23:59:60Z", b"0000-00-00", b"&#xD800;", b"&amp;", b"<![CDATA[", b'{"$date": {"$numberLong": "x"}}',
]  # fmt: skip


def mutants(data: bytes, seed: int, count: int, *, large: bool = True) -> list[tuple[str, bytes]]:
    """Return `count` harmed copies, each with what was done to it.

    Args:
        data: The log.
        seed: Of the chance.
        count: How many.
        large: Cells of 1 MB and lines of 20 MB, too.
    """
    chance = random.Random(seed)
    harms = BYTES if _is_binary(data) else {**BYTES, **TEXT}
    if large:
        harms = {**harms, **LARGE}
    names = list(harms)
    found = []
    for number in range(count):
        name = names[number % len(names)]
        harmed = harms[name](data, chance) if data else data
        if chance.random() < 0.15:
            second = chance.choice([other for other in names if other not in LARGE])
            name, harmed = f"{name}, then {second}", harms[second](harmed, chance) if harmed else harmed
        found.append((name, harmed))
    return found


def _is_binary(data: bytes) -> bool:
    return b"\0" in data[:4096] or data[:4] in (b"#ROS", b"\x89MCA", b"SQLi") or b"DOUBLE" in data[:4096]


def _span(data: bytes, chance: random.Random, most: int = 1 << 20) -> tuple[int, int]:
    begin = chance.randrange(len(data))
    size = min(int(2 ** chance.uniform(0, 20)), most, len(data) - begin)
    return begin, begin + size


def _cut(data: bytes, chance: random.Random) -> bytes:
    return data[: chance.randrange(len(data))]


def _headless(data: bytes, chance: random.Random) -> bytes:
    return data[chance.randrange(len(data)) :]


def _flip(data: bytes, chance: random.Random) -> bytes:
    broken = bytearray(data)
    for _ in range(chance.choice([1, 1, 1, 8, 64])):
        broken[chance.randrange(len(broken))] ^= 1 << chance.randrange(8)
    return bytes(broken)


def _zeroed(data: bytes, chance: random.Random) -> bytes:
    begin, end = _span(data, chance)
    return data[:begin] + bytes(end - begin) + data[end:]


def _inserted(data: bytes, chance: random.Random) -> bytes:
    at = chance.randrange(len(data) + 1)
    return data[:at] + chance.randbytes(int(2 ** chance.uniform(0, 12))) + data[at:]


def _overwritten(data: bytes, chance: random.Random) -> bytes:
    begin, end = _span(data, chance, 4096)
    return data[:begin] + chance.randbytes(end - begin) + data[end:]


def _deleted(data: bytes, chance: random.Random) -> bytes:
    begin, end = _span(data, chance)
    return data[:begin] + data[end:]


def _repeated(data: bytes, chance: random.Random) -> bytes:
    begin, end = _span(data, chance)
    return data[:end] + data[begin:end] * chance.choice([1, 1, 20]) + data[end:]


def _twice(data: bytes, chance: random.Random) -> bytes:
    return data + data[chance.choice([0, 0, chance.randrange(len(data))]) :]


def _sizes(data: bytes, chance: random.Random) -> bytes:
    """Put a size that lies where one may stand: the largest, the least, one too many."""
    width = chance.choice([1, 2, 4, 8])
    at = chance.randrange(max(1, min(len(data), 4096) if chance.random() < 0.5 else len(data)))
    lie = chance.choice([b"\xff" * width, b"\x7f" + b"\xff" * (width - 1), bytes(width), b"\x01" + bytes(width - 1)])
    return data[:at] + (lie if chance.random() < 0.5 else lie[::-1]) + data[at + width :]


def _lines(data: bytes) -> list[bytes]:
    return data.splitlines(keepends=True) or [b""]


def _some(lines: list[bytes], chance: random.Random) -> list[int]:
    return [chance.randrange(len(lines)) for _ in range(chance.choice([1, 1, 3, max(1, len(lines) // 3)]))]


def _lines_doubled(data: bytes, chance: random.Random) -> bytes:
    lines = _lines(data)
    for at in sorted(_some(lines, chance), reverse=True):
        lines.insert(at, lines[at])
    return b"".join(lines)


def _lines_deleted(data: bytes, chance: random.Random) -> bytes:
    lines = _lines(data)
    gone = set(_some(lines, chance))
    return b"".join(line for i, line in enumerate(lines) if i not in gone)


def _lines_shuffled(data: bytes, chance: random.Random) -> bytes:
    lines = _lines(data)
    begin = chance.choice([0, 1, len(lines) // 2])
    rest = lines[begin:]
    chance.shuffle(rest)
    return b"".join(lines[:begin] + rest)


def _lines_joined(data: bytes, chance: random.Random) -> bytes:
    lines = _lines(data)
    for at in _some(lines, chance):
        lines[at] = lines[at].rstrip(b"\r\n")
    return b"".join(lines)


def _marks_swapped(data: bytes, chance: random.Random) -> bytes:
    mark = max(_MARKS, key=data.count)
    other = chance.choice([one for one in _MARKS if one != mark])
    if chance.random() < 0.4:
        return data.replace(mark, other)
    lines = _lines(data)
    for at in _some(lines, chance):
        lines[at] = lines[at].replace(mark, other, chance.choice([1, -1]))
    return b"".join(lines)


def _columns_swapped(data: bytes, chance: random.Random) -> bytes:
    mark, lines = max(_MARKS, key=data.count), _lines(data)
    rows = range(len(lines)) if chance.random() < 0.3 else _some(lines, chance)
    one, two = chance.randrange(12), chance.randrange(12)
    for at in rows:
        cells = lines[at].split(mark)
        if max(one, two) < len(cells):
            cells[one], cells[two] = cells[two], cells[one]
        lines[at] = mark.join(cells)
    return b"".join(lines)


def _cells_changed(data: bytes, chance: random.Random) -> bytes:
    mark, lines = max(_MARKS, key=data.count), _lines(data)
    for at in _some(lines, chance):
        cells = lines[at].split(mark)
        cells[chance.randrange(len(cells))] = chance.choice(TOKENS)
        lines[at] = mark.join(cells)
    return b"".join(lines)


def _words_changed(data: bytes, chance: random.Random) -> bytes:
    """Put other numbers and words where one stands, whatever separates them."""
    spans = [found.span() for found in WORD.finditer(data)]
    for begin, end in sorted(chance.choices(spans, k=chance.choice([1, 1, 2, 5])) if spans else [], reverse=True):
        data = data[:begin] + chance.choice(TOKENS) + data[end:]
    return data


def _ends_changed(data: bytes, chance: random.Random) -> bytes:
    ends = [b"\n", b"\r\n", b"\r", b"\r\r\n", b"\n\n", b""]
    lines = [line.rstrip(b"\r\n") for line in _lines(data)]
    if chance.random() < 0.5:
        return chance.choice(ends).join(lines)
    return b"".join(line + chance.choice(ends) for line in lines)


def _recoded(data: bytes, chance: random.Random) -> bytes:
    text = data.decode("utf-8", "replace")
    return text.encode(chance.choice(["utf-16", "utf-16-le", "utf-16-be", "utf-8-sig", "utf-32", "utf-7"]))


def _huge_cell(data: bytes, chance: random.Random) -> bytes:
    at = chance.randrange(len(data) + 1)
    return data[:at] + chance.choice([b"7", b"x", b'"', b"\xff", b"\0", b"[", b" "]) * 1_000_000 + data[at:]


def _huge_line(data: bytes, chance: random.Random) -> bytes:
    at = chance.randrange(len(data) + 1)
    return data[:at] + chance.choice([b"7", b"1.5,", b"1 2;", b"xy"]) * 7_000_000 + data[at:]


BYTES: dict[str, Callable[[bytes, random.Random], bytes]] = {
    "cut": _cut,
    "head missing": _headless,
    "bits flipped": _flip,
    "NUL block": _zeroed,
    "random bytes inserted": _inserted,
    "random bytes": _overwritten,
    "bytes deleted": _deleted,
    "bytes repeated": _repeated,
    "file twice": _twice,
    "lying sizes": _sizes,
}
TEXT: dict[str, Callable[[bytes, random.Random], bytes]] = {
    "lines doubled": _lines_doubled,
    "lines deleted": _lines_deleted,
    "lines shuffled": _lines_shuffled,
    "lines joined": _lines_joined,
    "delimiters swapped": _marks_swapped,
    "columns swapped": _columns_swapped,
    "cells changed": _cells_changed,
    "words changed": _words_changed,
    "line ends changed": _ends_changed,
    "another encoding": _recoded,
}
LARGE: dict[str, Callable[[bytes, random.Random], bytes]] = {"cell of 1 MB": _huge_cell, "line of 20 MB": _huge_line}
