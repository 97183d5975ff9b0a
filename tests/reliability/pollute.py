"""Logs spoiled in the ways that befall tables on their way from a controller to us, each with what is still true in it.

The ways are the categories of Pollock (Vitagliano et al., "Pollock: A Data Loading Benchmark", VLDB 2023), a survey of
what is wrong with published CSV files, as far as a logger, a copy or a spreadsheet can do it to a log; and what else
loggers do: NUL blocks after a power cut, a cut last line, log text between the rows, two runs in one file. This module
spoils whole files, `pollute_rows` single rows, cells and columns.
"""

from __future__ import annotations

import gzip
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from backports import zstd

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from reliability.clean_logs import Cells, Kind


@dataclass(frozen=True)
class Polluted:
    """One spoiled file.

    Attributes:
        kind: The log that it was.
        category: Of Pollock, or ours.
        name: What was done to it.
        data: The file.
        rows: The rows that it still holds, as a clean log would have them.
        map: What its cell file says otherwise than that of the clean log.
        named: What nobody can decide is at least said: part of a warning that excuses wrong values.
        names: Header of the clean log that holds the same, where columns are gone.
        file_name: As it lies on the disk.
    """

    kind: Kind
    category: str
    name: str
    data: bytes
    rows: list[Cells]
    map: dict[str, object] = field(default_factory=dict)
    named: str | None = None
    names: Cells | None = None
    file_name: str = "log.csv"

    @property
    def id(self) -> str:
        return f"{self.kind.name}-{self.category}-{self.name}".replace(" ", "_")


def every_polluted_file(kinds: Sequence[Kind], *, large_too: bool = False) -> Iterator[Polluted]:
    """Yield all of these kinds, always the same in the same order."""
    from reliability.pollute_rows import ROW_POLLUTERS

    for kind in kinds:
        for polluter in (*FILE_POLLUTERS, *ROW_POLLUTERS, *([large] if large_too else [])):
            yield from polluter(kind)


def of(kind: Kind, category: str, name: str, text: str | bytes, **more: object) -> Polluted:
    """Return a file that holds the rows of its kind, unless `rows` says otherwise."""
    data = text.encode() if isinstance(text, str) else text
    return Polluted(kind, category, name, data, **({"rows": kind.rows} | more))  # type: ignore[arg-type]


def file_size(kind: Kind) -> Iterator[Polluted]:
    say = "file size"
    header = kind.text([])
    yield of(kind, say, "0 bytes", "", rows=[])
    yield of(kind, say, "an empty line", kind.end, rows=[])
    yield of(kind, say, "header only", header, rows=[])
    yield of(kind, say, "header without its end", header.rstrip("\r\n"), rows=[])
    yield of(kind, say, "1 row", kind.text(kind.rows[:1]), rows=kind.rows[:1])


def encoding(kind: Kind) -> Iterator[Polluted]:
    say, text = "encoding", kind.text()
    yield of(kind, say, "utf-8 with BOM", text.encode("utf-8-sig"))
    yield of(kind, say, "utf-16 LE", b"\xff\xfe" + text.encode("utf-16-le"))
    yield of(kind, say, "utf-16 BE", b"\xfe\xff" + text.encode("utf-16-be"))
    yield of(kind, say, "utf-16 LE without BOM", text.encode("utf-16-le"))
    yield of(kind, say, "utf-16 BE without BOM", text.encode("utf-16-be"))
    yield of(kind, say, "utf-16 cut inside a character", (b"\xff\xfe" + text.encode("utf-16-le"))[:-1])
    yield of(kind, say, "utf-32", text.encode("utf-32"))
    told = {"encoding": "latin-1"} if kind.is_mapped else {}
    yield of(kind, say, "latin-1, said", text.encode("latin-1"), map=told)
    yield of(kind, say, "latin-1, not said", text.encode("latin-1"))
    if kind.is_mapped:
        yield of(kind, say, "utf-8 called latin-1", text, map=told)
        yield of(kind, say, "utf-8 called utf-16", text, map={"encoding": "utf-16"})
    if kind.texts:
        umlauts = [[cell.replace("o", "ö") if i in kind.texts else cell for i, cell in enumerate(r)] for r in kind.rows]
        spoiled = kind.text(umlauts)
        yield of(kind, say, "umlauts in cells", spoiled, rows=umlauts)
        yield of(kind, say, "umlauts in cells in latin-1, said", spoiled.encode("latin-1"), rows=umlauts, map=told)
        yield of(kind, say, "umlauts in cells in latin-1, not said", spoiled.encode("latin-1"), rows=umlauts)
    yield of(kind, "packed", "gzip", gzip.compress(text.encode()))
    yield of(kind, "packed", "zstd", zstd.compress(text.encode()))
    yield of(kind, "packed", "gzip, cut", gzip.compress(kind.text(kind.more(3000)).encode())[:-900])
    yield of(kind, "packed", "gzip of gzip", gzip.compress(gzip.compress(text.encode())))


def columns(kind: Kind) -> Iterator[Polluted]:
    if kind.above:
        return
    say = "number of columns"
    one = kind.text([[row[kind.time]] for row in kind.rows], [kind.names[kind.time]])
    yield of(kind, say, "1 column", one, rows=[])
    yield _wide(kind, 1_024)
    before = kind.text([["7", *row] for row in kind.rows], ["number", *kind.names])
    yield of(kind, say, "a column before", before)
    nameless = kind.text([["7", *row] for row in kind.rows], ["", *kind.names])
    yield of(kind, say, "a nameless column before", nameless)
    yield of(kind, say, "one name too few", kind.text([["7", *row] for row in kind.rows]), rows=[])


def _wide(kind: Kind, count: int) -> Polluted:
    names = [*kind.names, *(f"signal_{i}" for i in range(count))]
    rows = [[*row, *(["0"] * count)] for row in kind.rows]
    return of(kind, "number of columns", f"{count:,} columns more", kind.text(rows, names))


def large(kind: Kind) -> Iterator[Polluted]:
    """The few that take long."""
    many = kind.more(70_000)
    yield of(kind, "file size", "70,000 rows", kind.text(many), rows=many)
    if not kind.above:
        yield _wide(kind, 17_000)


def preamble(kind: Kind) -> Iterator[Polluted]:
    say, text = "preamble", kind.text()
    d = kind.delimiter
    for name, lines in (
        ("3 lines", ["Station 4", "recorded by night shift", "checked"]),
        ("3 lines with delimiters", [d.join(["Station", "4", "", "x"])] * 3),
        ("3 lines, empty ones among them", ["Station 4", "", ""]),
        ("comment lines", ["# Station 4", "# 500 Hz, 1.5 m", "#"]),
        ("1 line with as many cells", [d.join(f"note{i}" for i in range(len(kind.names)))]),
    ):
        spoiled = "".join(line + kind.end for line in lines) + text
        yield of(kind, say, name, spoiled)
        if kind.is_mapped:
            yield of(kind, say, f"{name}, skip_rows said", spoiled, map={"skip_rows": len(lines)})
            yield of(kind, say, f"{name}, skip_rows one too many", spoiled, map={"skip_rows": len(lines) + 1})


def footnote(kind: Kind) -> Iterator[Polluted]:
    say, text, d, width = "footnote", kind.text(), kind.delimiter, len(kind.names)
    unread = None if kind.time == 0 or kind.above else "steps back"  # the word is no time only where one stands first
    for name, lines in (
        ("3 lines", ["end of recording", "40 samples", "ok"]),
        ("3 lines with delimiters", [d.join(["sum", *["1.5"] * (width - 1)])] * 3),
        ("after an empty line", ["", "# EOF"]),
        ("a count alone", ["40"]),
        ("a count with delimiters", [d.join(["40", *[""] * (width - 1)])]),
        ("sums with an empty time", [d.join("" if i == kind.time else "1.5" for i in range(width))]),
        ("empty cells", [d * (width - 1)] * 2),
    ):
        yield of(kind, say, name, text + "".join(line + kind.end for line in lines), named=unread)


def record_delimiter(kind: Kind) -> Iterator[Polluted]:
    say, lines = "record delimiter", kind.text().replace("\r\n", "\n").split("\n")[:-1]
    head, middle = len(kind.above) + 1, len(lines) // 2
    for end in ("\n", "\r", "\r\n", "\r\r\n", "\n\r", "\n\n", "\r\n\r\n"):
        yield of(kind, say, repr(end)[1:-1], "".join(line + end for line in lines))
    for name, ends in (
        ("\\n and \\r\\n in turn", ["\n", "\r\n"]),
        ("\\n and \\r in turn", ["\n", "\r"]),
        ("\\r and \\n in turn", ["\r", "\n"]),
    ):
        yield of(kind, say, name, "".join(line + ends[i % 2] for i, line in enumerate(lines)))
    for name, first, then in (
        ("\\n, then \\r", "\n", "\r"),
        ("\\r, then \\n", "\r", "\n"),
        ("\\r\\n, then \\n", "\r\n", "\n"),
    ):
        yield of(kind, say, name, "".join(line + (first if i < middle else then) for i, line in enumerate(lines)))
    for name, at in (("first", head), ("second", head + 1), ("middle", middle), ("last", len(lines) - 1)):
        for wrong in ("\n", "\r", "", "\f\n", "\x0b", "\u2028"):
            text = "".join(line + (wrong if i == at else kind.end) for i, line in enumerate(lines))
            yield of(kind, say, f"{name} row ends with {wrong!r}", text)


def field_delimiter(kind: Kind) -> Iterator[Polluted]:
    say, text = "field delimiter", kind.text
    if kind.above:
        return
    said = {" ": "space", "\t": "tab", "||": "||", "::": "::"}
    for delimiter in (",", ";", "\t", "|", " ", "::", "||", ", ", ":", "\\t", "\t\t"):
        if delimiter == kind.delimiter or any(
            delimiter.strip() and delimiter in cell for row in kind.rows for cell in row
        ):
            continue
        if delimiter in (" ", ", ") and any(" " in cell for row in [kind.names, *kind.rows] for cell in row):
            continue
        spoiled = "".join(delimiter.join(cells) + kind.end for cells in [kind.names, *kind.rows])
        yield of(kind, say, f"{delimiter!r}", spoiled)
        if kind.is_mapped:
            told = said.get(delimiter, delimiter)
            yield of(kind, say, f"{delimiter!r}, said", spoiled, map={"delimiter": told})
            yield of(kind, say, f"{delimiter!r}, another said", spoiled, map={"delimiter": kind.delimiter})
    aligned = "".join("   ".join(cells) + kind.end for cells in [kind.names, *kind.rows])
    if kind.is_mapped and " " not in text():
        yield of(kind, say, "runs of blanks, said", aligned, map={"delimiter": "whitespace"})
    if kind.delimiter == " ":
        yield of(kind, say, "runs of blanks", aligned)
        yield of(kind, say, "padded with blanks", "".join(f" {line} {kind.end}" for line in text().splitlines()))


def tables(kind: Kind) -> Iterator[Polluted]:
    say, text, d, width = "several tables", kind.text(), kind.delimiter, len(kind.names)
    numbers = ["9.5" if not kind.decimal_comma else "9,5"] * width
    for name, header, cells in (
        ("of the same width", [f"force_{i}" for i in range(width)], numbers),
        ("narrower", [f"force_{i}" for i in range(width - 1)], numbers[1:]),
        ("wider", [f"force_{i}" for i in range(width + 1)], [*numbers, "9"]),
        ("whose names repeat", ["Time", *["Force"] * (width - 1)], numbers),
        ("with a nameless column", ["", *(f"force_{i}" for i in range(1, width))], numbers),
        ("with numbers for names", [*(str(i) for i in range(width))], numbers),
    ):
        below = "".join(d.join(line) + kind.end for line in [header, *[cells] * 5])
        in_doubt = "numbers" in name or ("nameless" in name and kind.role == "events")
        nobody_knows = ("increase" if kind.above else "back") if in_doubt else None
        yield of(kind, say, f"another {name}", text + below, named=nobody_knows)
        yield of(kind, say, f"another {name}, titled", f"{text}{kind.end}Table 2{kind.end}{below}", named=nobody_knows)
        yield of(kind, say, f"another {name}, above", below + text)
    yield of(kind, say, "a second run with its header", text + kind.text(), rows=kind.rows * 2)
    turned = "".join(kind.line(cells[::-1]) + kind.end for cells in [kind.names, *kind.rows])
    yield of(kind, say, "a second run with its header in another order", text + turned, rows=kind.rows * 2)
    bom = "\ufeff" + "".join(kind.line(c) + kind.end for c in [kind.names, *kind.rows])
    yield of(kind, say, "a second run with BOM and header", text + bom, rows=kind.rows * 2)
    rows = "".join(kind.line(cells) + kind.end for cells in kind.rows)
    yield of(kind, say, "a second run without its header", text + rows, rows=kind.rows * 2)
    yield of(kind, say, "a second run in UTF-16", text.encode() + kind.text().encode("utf-16"))


def nul_and_cuts(kind: Kind) -> Iterator[Polluted]:
    data, say = kind.text().encode(), "NUL block"
    begin = len(kind.text([]).encode())
    ends = [i for i, byte in enumerate(data) if byte == 10 and i > begin]
    for name, at, size in (
        ("inside a cell", ends[4] + 6, 3),
        ("over a row", ends[9] + 1, ends[10] - ends[9] - 1),
        ("over three rows", ends[9] + 4, 3 * (ends[10] - ends[9])),
        ("over the last rows", ends[-4], len(data) - ends[-4]),
        ("over the header", 3, 12),
    ):
        yield of(kind, say, name, data[:at] + bytes(size) + data[at + size :])
    yield of(kind, say, "appended", data + bytes(4096))
    yield of(kind, say, "a line of NULs", data[: ends[5] + 1] + bytes(512) + b"\n" + data[ends[5] + 1 :])
    yield of(kind, say, "in every cell of text", data.replace(b"o", b"\0"))
    for cut in (1, 2, 3, 5, 8, 13, len(data) - begin - 2, len(data) // 2, len(data) - begin + 1, len(data) - 4):
        yield of(kind, "cut last line", f"{cut} bytes missing", data[:-cut])


def file_name(kind: Kind) -> Iterator[Polluted]:
    for name in (
        "run[a].csv",
        "\u00a0.csv",
        "$.csv",
        ".csv",
        "log",
        "log.pdf",
        "*.csv",
        "a?b.csv",
        "log.tsv",
        "x" * 200,
    ):
        yield of(kind, "file name", name[:20], kind.text(), file_name=name)


FILE_POLLUTERS = (
    file_size,
    encoding,
    columns,
    preamble,
    footnote,
    record_delimiter,
    field_delimiter,
    tables,
    nul_and_cuts,
    file_name,
)
