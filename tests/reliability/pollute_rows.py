"""Single rows, cells, columns and names of a log spoiled; whole files are the business of `pollute`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from reliability.pollute import Polluted, of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from reliability.clean_logs import Cells, Kind

Spoil = "Callable[[Cells], str]"


def _places(kind: Kind) -> tuple[tuple[str, int], ...]:
    return ("first", 0), ("second", 1), ("middle", len(kind.rows) // 2), ("last", len(kind.rows) - 1)


def _with_lines(kind: Kind, lines: dict[int, str]) -> str:
    """Return the log with some rows written otherwise."""
    body = [lines.get(i, kind.line(cells)) for i, cells in enumerate(kind.rows)]
    return kind.text([]) + "".join(line + kind.end for line in body)


def _quoted(cells: Cells, quote: str = '"') -> Cells:
    return [f"{quote}{cell}{quote}" for cell in cells]


def _row_spoilers(kind: Kind) -> dict[str, Callable[[Cells], str]]:
    d, width = kind.delimiter, len(kind.names)
    other = ";" if d != ";" else ","
    return {
        "no fields": lambda cells: "",
        "blanks only": lambda cells: "  ",
        "delimiters only": lambda cells: d * (width - 1),
        "one field too few": lambda cells: d.join(cells[:-1]),
        "its first field missing": lambda cells: d.join(cells[1:]),
        "half of its fields": lambda cells: d.join(cells[: width // 2]),
        "one field too many": lambda cells: d.join([*cells, "7"]),
        "twice its fields": lambda cells: d.join(cells * 2),
        "a delimiter at its end": lambda cells: d.join(cells) + d,
        "a delimiter at its begin": lambda cells: d + d.join(cells),
        "a delimiter doubled": lambda cells: d.join([*cells[:2], "", *cells[2:]]),
        "a delimiter doubled and a field missing": lambda cells: d.join([*cells[:1], "", *cells[1:-1]]),
        "a delimiter missing": lambda cells: d.join([cells[0] + cells[1], *cells[2:]]),
        "another delimiter": lambda cells: other.join(cells),
        "another delimiter once": lambda cells: d.join([cells[0] + other + cells[1], *cells[2:]]),
        "an empty line before it": lambda cells: kind.end + d.join(cells),
        "log text before it": lambda cells: f"[WARN] 12:00:01 packet lost{kind.end}{d.join(cells)}",
        "log text with delimiters before it": lambda cells: d.join(["WARN"] * width) + kind.end + d.join(cells),
        "log text in its midst": lambda cells: d.join([*cells[:2], "[WARN] lost", *cells[2:]]),
        "log text in place of a cell": lambda cells: d.join([*cells[:-2], "WARN", cells[-1]]),
        "a progress line in it": lambda cells: f"10 %\r20 %\r{d.join(cells)}",
        "torn and written again": lambda cells: d.join(cells)[:9] + d.join(cells),
        "torn over two lines": lambda cells: d.join(cells)[:9] + kind.end + d.join(cells)[9:],
        "a hash before it": lambda cells: "#" + d.join(cells),
        "quotes": lambda cells: d.join(_quoted(cells)),
        "single quotes": lambda cells: d.join(_quoted(cells, "'")),
        "a quote in a number": lambda cells: d.join(_at(cells, kind.measured, cells[kind.measured] + '"')),
        "a quote that is not closed": lambda cells: d.join([*cells[:-1], '"' + cells[-1]]),
        "a first quote that is not closed": lambda cells: '"' + d.join(cells),
    }


_UNDECIDABLE = ("a delimiter doubled and a field missing", "log text in place of a cell")
"""Where a cell may be empty or any text, such a row is one like the others: docs/reliability.md says so."""


def _at(cells: Cells, index: int, cell: str) -> Cells:
    return [*cells[:index], cell, *cells[index + 1 :]]


def rows(kind: Kind) -> Iterator[Polluted]:
    for name, spoil in _row_spoilers(kind).items():
        if name in _UNDECIDABLE and (kind.texts or kind.delimiter != " "):
            continue
        for where, at in _places(kind):
            yield of(kind, "rows", f"{where} row: {name}", _with_lines(kind, {at: spoil(kind.rows[at])}))
        if name in (
            "quotes",
            "single quotes",
            "a delimiter at its end",
            "an empty line before it",
            "one field too many",
        ):
            every = {i: spoil(cells) for i, cells in enumerate(kind.rows)}
            yield of(kind, "rows", f"every row: {name}", _with_lines(kind, every))


def quotes(kind: Kind) -> Iterator[Polluted]:
    say = "quotes and escapes"
    if not kind.above:
        for name, quote in (("quotes", '"'), ("single quotes", "'"), ("quotes and a blank", '" ')):
            names = kind.delimiter.join(_quoted(kind.names, quote)) + kind.end
            body = "".join(kind.delimiter.join(_quoted(cells, quote)) + kind.end for cells in kind.rows)
            yield of(kind, say, f"{name} everywhere", names + body)
            yield of(kind, say, f"{name} in the header", names + kind.text().partition(kind.end)[2])
    for column in kind.texts[:1]:
        for name, meant, written in (
            ("a delimiter inside quotes", f"left{kind.delimiter} upper", f'"left{kind.delimiter} upper"'),
            ("a doubled quote", 'the "upper"', '"the ""upper"""'),
            ("an escaped quote", 'the "upper"', '"the \\"upper\\""'),
            ("an escaped delimiter", f"left{kind.delimiter} upper", f"left\\{kind.delimiter} upper"),
            ("a quote in its midst", 'a 5" pipe', 'a 5" pipe'),
            ("text behind its quotes", "upper and left", '"upper"left'),
            ("a line end inside quotes", f"left{kind.end}upper", f'"left{kind.end}upper"'),
            ("a backslash at its end", "c:\\", "c:\\"),
            ("a backslash before its closing quote", "c:\\", '"c:\\"'),
            ("blanks around it", "upper", "  upper  "),
            ("blanks around its quotes", "upper", ' "upper" '),
        ):
            for where, at in _places(kind):
                true = [*kind.rows[:at], _at(kind.rows[at], column, meant), *kind.rows[at + 1 :]]
                line = kind.delimiter.join(_at(kind.rows[at], column, written))
                yield of(kind, say, f"{where} row: {name}", _with_lines(kind, {at: line}), rows=true)
        swallowed = kind.delimiter.join(_at(kind.rows[5], column, '"' + kind.rows[5][column]))
        closing = kind.delimiter.join(_at(kind.rows[9], column, kind.rows[9][column] + '"'))
        yield of(kind, say, "a quote open over four rows", _with_lines(kind, {5: swallowed, 9: closing}))


def header(kind: Kind) -> Iterator[Polluted]:
    say, names, d = "header", kind.names, kind.delimiter
    if kind.above:
        return
    units = ["s", *["m"] * (len(names) - 1)]
    apart = [f"unit{i}" for i in range(len(names))]
    for name, line in (("a row of units", units), ("units all different", apart), ("the names once more", names)):
        yield of(kind, say, name, kind.text([line, *kind.rows]))
        yield of(kind, say, f"{name}, above", d.join(line) + kind.end + kind.text())
    yield of(kind, say, "a rule below it", kind.text([["---"] * len(names), *kind.rows]))
    yield of(kind, say, "an empty row below it", kind.text([[""] * len(names), *kind.rows]))
    yield of(kind, say, "missing", "".join(kind.line(cells) + kind.end for cells in kind.rows))
    if kind.is_mapped:
        plain = "".join(kind.line(cells) + kind.end for cells in kind.rows)
        yield of(kind, say, "missing, columns said", plain, map={"columns": names})
        yield of(kind, say, "columns said, and there as well", kind.text(), map={"columns": names})
        turned = [names[0], *names[:0:-1]]
        yield of(kind, say, "columns said in another order than there", kind.text(), map={"columns": turned}, rows=[])
    for column in dict.fromkeys((kind.time, kind.measured)):
        which = names[column]
        for name, cell in (
            ("empty", ""),
            ("another", "HEADER"),
            ("odd", "HEAD/%R"),
            ("600 kB long", "HEADER" * 100_000),
            ("with a NUL", "HEA\0DER"),
            ("like another", next(cell for cell in names[::-1] if cell != which)),
            ("in capitals", which.swapcase()),
        ):
            yield of(kind, say, f"{which}: {name}", kind.text(names=_at(names, column, cell)))
        yield of(kind, say, f"{which}: blanks around it", kind.text(names=_at(names, column, f"  {which} ")))
        twice = kind.text([[*cells, "7"] for cells in kind.rows], [*names, which])
        yield of(kind, say, f"{which}: twice", twice, rows=[])
        before = kind.text([["7", *cells] for cells in kind.rows], [which, *names])
        yield of(kind, say, f"{which}: twice, the other first", before, rows=[])
        lost = kind.text(names=[cell for i, cell in enumerate(names) if i != column])
        yield of(kind, say, f"{which}: lost from the header", lost)
    extra = "HEADER" * 100_000
    yield of(kind, say, "a name of 600 kB more", kind.text([[*cells, "7"] for cells in kind.rows], [*names, extra]))
    yield of(kind, say, "an empty name more", kind.text([[*cells, "7"] for cells in kind.rows], [*names, ""]))


def formats(kind: Kind) -> Iterator[Polluted]:
    """A column is written otherwise from some row on, in one row or in all."""
    say, half = "column formats", len(kind.rows) // 2
    spans = {
        "one cell": range(half, half + 1),
        "from the middle": range(half, len(kind.rows)),
        "all": range(len(kind.rows)),
    }
    comma = kind.decimal_comma

    def plain(cell: str) -> float:
        return float(cell.replace(",", "."))

    def there(text: str) -> str:
        return text.replace(".", ",") if comma else text

    numbers: dict[str, tuple[Callable[[str], str], Callable[[str], str] | None]] = {
        "decimal comma": (lambda c: c.replace(",", ".") if comma else c.replace(".", ","), None),
        "scientific": (lambda c: there(f"{plain(c):.9e}"), lambda c: there(f"{float(f'{plain(c):.9e}')!r}")),
        "Fortran exponents": (lambda c: f"{plain(c):.9e}".replace("e", "D"), None),
        "a plus sign": (lambda c: c if c.startswith("-") else f"+{c}", None),
        "a Unicode minus": (lambda c: c.replace("-", "−"), None),
        "blanks around": (lambda c: f"  {c} ", None),
        "a unit behind it": (lambda c: f"{c} mm", None),
        "text": (lambda c: "high", None),
        "true and false": (lambda c: "true", None),
        "empty": (lambda c: "", lambda c: "nan"),
        "n/a": (lambda c: "n/a", lambda c: "nan"),
        "NaN": (lambda c: "NaN", lambda c: "nan"),
        "an infinity": (lambda c: "inf", lambda c: "nan"),
        "an error of a spreadsheet": (lambda c: "#DIV/0!", None),
        "hexadecimal": (lambda c: "0x1F", None),
        "a number of 400 digits": (lambda c: "1" * 400, lambda c: "nan"),
        "a cell of 1 MB": (lambda c: "x" * 1_000_000, None),
        "a date": (lambda c: "2025-03-06", None),
    }
    for name, (write, meant) in numbers.items():
        for span, which in spans.items():
            if name == "a cell of 1 MB" and span != "one cell":
                continue
            wrong = [
                _at(c, kind.measured, write(c[kind.measured])) if i in which else c for i, c in enumerate(kind.rows)
            ]
            truth = wrong if meant is None else [
                _at(c, kind.measured, meant(c[kind.measured])) if i in which else c for i, c in enumerate(kind.rows)
            ]  # fmt: skip
            true = truth if meant is not None else kind.rows
            yield of(kind, say, f"{name}, {span}", kind.text(wrong), rows=true)


def thousands(kind: Kind) -> Iterator[Polluted]:
    """Numbers over a thousand in groups of three: what the mark means cannot be told from one cell."""
    if kind.texts or kind.name == "motive":
        return
    big = [_at(cells, kind.measured, kind.number(1234.5 + i)) for i, cells in enumerate(kind.rows)]
    for name, mark in (
        ("comma", ","),
        ("dot", "."),
        ("blank", " "),
        ("apostrophe", "'"),
        ("narrow blank", "\u202f"),
        ("underscore", "_"),
    ):
        wrong = [_at(c, kind.measured, c[kind.measured][0] + mark + c[kind.measured][1:]) for c in big]
        yield of(kind, "thousands", f"{name}, with decimals", kind.text(wrong), rows=big)
        whole = [_at(c, kind.measured, str(1234 + i)) for i, c in enumerate(kind.rows)]
        wrong = [_at(c, kind.measured, f"1{mark}{234 + i}") for i, c in enumerate(kind.rows)]
        if mark == ("," if kind.decimal_comma else "."):
            continue  # 1.234 is a number: only the cell file could say otherwise
        yield of(kind, "thousands", f"{name}, whole numbers", kind.text(wrong), rows=whole)


def dates(kind: Kind) -> Iterator[Polluted]:
    """Times written otherwise from some row on."""
    if kind.name != "people-dated":
        return
    say, half = "dates", len(kind.rows) // 2
    for name, date in (
        ("ISO", "2025-03-06"),
        ("slashes", "06/03/2025"),
        ("two digits of the year", "06.03.25"),
        ("a word", "today"),
        ("the 31st of February", "31.02.2025"),
        ("month before day, impossible", "03.16.2025"),
    ):
        wrong = [_at(c, 0, date) if i >= half else c for i, c in enumerate(kind.rows)]
        yield of(kind, say, name, kind.text(wrong))
    swapped = [_at(c, 0, "03.06.2025") if i >= half else c for i, c in enumerate(kind.rows)]
    yield of(kind, say, "month before day", kind.text(swapped), named="jumps ahead by")
    one = [_at(c, 0, "03.06.2025") if i == half else c for i, c in enumerate(kind.rows)]
    yield of(kind, say, "month before day, once", kind.text(one))
    for name, write in (
        ("12 hours", lambda c: c + " AM"),
        ("without seconds", lambda c: c[:5]),
        ("a decimal comma", lambda c: c.replace(".", ",")),
    ):
        yield of(
            kind, say, name, kind.text([_at(c, 1, write(c[1])) if i >= half else c for i, c in enumerate(kind.rows)])
        )


ROW_POLLUTERS = (rows, quotes, header, formats, thousands, dates)
