"""What came of a spoiled log: a right table, one without some rows that are listed, a refusal; or a wrong one."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.errors import ConfigError, LogError
from cyclekit.ingest.validate.validate import examined

if TYPE_CHECKING:
    from pathlib import Path

    from reliability.clean_logs import Kind
    from reliability.pollute import Polluted

    from cyclekit.adapter import Recording

RIGHT, PARTLY, REFUSED, NAMED, WRONG, FOREIGN = (
    "right",
    "right, rows set aside",
    "refused",
    "wrong, and said so",
    "silently wrong",
    "foreign exception",
)


@dataclass(frozen=True)
class Verdict:
    """An outcome, and the message or the first value that shows it."""

    outcome: str
    why: str = ""


def judge(spoiled: Polluted, folder: Path) -> Verdict:
    """Read a spoiled log as a command does, and hold what comes out against the clean one."""
    path = folder / spoiled.file_name
    path.write_bytes(spoiled.data)
    try:
        spoiled.kind.adapter.recognises(path)
        log = examined(spoiled.kind.adapter.read(path, spoiled.kind.options(**spoiled.map)))
    except (LogError, ConfigError) as error:
        return Verdict(REFUSED, str(error))
    except Exception as error:
        return Verdict(FOREIGN, f"{type(error).__name__}: {error}")
    finally:
        path.unlink()
    if not spoiled.rows:
        return Verdict(WRONG, "it should have been refused")
    clean = _clean(spoiled, folder)
    return _compared(spoiled, log, clean)


def _clean(spoiled: Polluted, folder: Path) -> Recording:
    path = folder / "clean.csv"
    path.write_text(spoiled.kind.text(spoiled.rows, spoiled.names), encoding="utf-8", newline="")
    return examined(spoiled.kind.adapter.read(path, spoiled.kind.options()))


def _table(kind: Kind, log: Recording) -> pl.DataFrame:
    table = log.tables()[kind.role if kind.is_mapped else next(iter(log.tables()))]
    return table.with_columns(when=(pl.col("t_s") * 1e6).round().cast(pl.Int64, strict=False))


def _compared(spoiled: Polluted, log: Recording, clean: Recording) -> Verdict:
    found, true = _table(spoiled.kind, log), _table(spoiled.kind, clean)
    said = [text for text in log.warnings if text not in clean.warnings]
    wrong, unknown = _differences(found, true)
    if wrong:
        if spoiled.named and any(spoiled.named in text for text in said):
            return Verdict(NAMED, f"{wrong[0]}; {said}")
        return Verdict(WRONG, f"{len(wrong)} values, the first: {wrong[0]}")
    if unknown and not said:
        return Verdict(WRONG, f"{len(unknown)} values vanish without a word, the first: {unknown[0]}")
    missing = _missing(found, true)
    aside = 0 if log.set_aside is None else log.set_aside.height
    if found.height + aside != log.rows_read:
        return Verdict(WRONG, f"{log.rows_read} rows read, {found.height} returned, {aside} set aside")
    if lost := _unlisted(spoiled, log, missing):
        return Verdict(WRONG, f"{len(lost)} rows vanish without a word, the first: {lost[0]}")
    if missing or unknown:
        first = log.set_aside["reason"][0] if log.set_aside is not None and log.set_aside.height else str(said)
        return Verdict(PARTLY, f"{len(missing)} rows, {len(unknown)} values; {first}")
    return Verdict(RIGHT)


def _keys(table: pl.DataFrame) -> list[str]:
    return ["when", *(name for name in ("person", "signal") if name in table.columns)]


def _differences(found: pl.DataFrame, true: pl.DataFrame) -> tuple[list[str], list[str]]:
    """Return the values that are not those of the clean table at that time, and those that are unknown instead."""
    keys, number = _keys(true), pl.int_range(pl.len()).alias("number")
    both = found.with_columns(number).join(true, on=keys, how="left", suffix=" true", nulls_equal=True)
    wrong, unknown = pl.lit(value=False), pl.lit(value=False)
    alone = pl.col("t_s true").is_null()
    for name in true.columns:
        if name in (*keys, "source_row", "t_s"):
            continue
        here, there = pl.col(name), pl.col(f"{name} true")
        same = (here - there).abs() <= 1e-9 * (1 + there.abs()) if true[name].dtype.is_float() else here == there
        wrong |= here.is_not_null() & ~same.fill_null(value=False)
        unknown |= here.is_null() & there.is_not_null()
    marked = both.with_columns(bad=(wrong | alone).cast(pl.Int8) * 2 + unknown.cast(pl.Int8))
    best = marked.sort("bad", maintain_order=True).unique("number", keep="first", maintain_order=True)
    told = [name for name in found.columns if name in best.columns and name != "when"]
    return (
        [str(row) for row in best.filter(pl.col("bad") >= 2).select(told).head(50).rows(named=True)],
        [str(row) for row in best.filter(pl.col("bad") == 1).select(told).head(50).rows(named=True)],
    )


def _missing(found: pl.DataFrame, true: pl.DataFrame) -> list[int]:
    """Return the rows of the clean table, from 0, that did not come out."""
    keys = _keys(true)
    nth = pl.int_range(pl.len()).over(keys).alias("nth")
    lost = (
        true.with_row_index("row")
        .with_columns(nth)
        .join(found.with_columns(nth), on=[*keys, "nth"], how="anti", nulls_equal=True)
    )
    return sorted(lost["row"].to_list())


def _unlisted(spoiled: Polluted, log: Recording, missing: list[int]) -> list[int]:
    """Return the missing rows that are in the file, most of their cells in one line, and in no line set aside."""
    lines = _lines(spoiled.data)
    aside = set() if log.set_aside is None else set(log.set_aside["source_row"].to_list())
    lost = []
    for row in missing:
        cells = spoiled.rows[row] if row < len(spoiled.rows) else [""]
        there = [n for n, line in enumerate(lines, 1) if _holds(line, cells, cells[spoiled.kind.time])]
        if there and not aside.intersection(there):
            lost.append(row)
    return lost


def _holds(line: str, cells: list[str], time: str) -> bool:
    return time in line and 2 * sum(cell in line for cell in cells) > len(cells)


@lru_cache(maxsize=2)
def _lines(data: bytes) -> list[str]:
    text = data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8", "replace")
    alone = r"\r(?=\r*[^\r\n])"
    return re.split(f"\r*\n|{alone}" if re.search(alone, text[:16384]) else "\n", text)
