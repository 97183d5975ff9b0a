"""Implausible values of a recording: found, reported with the likely cure, and removed.

Many containers have no checksum, so only the values reveal a flipped bit or a wrong unit. A row with an impossible time
or position relative to its neighbours is set aside. A column that looks wrong as a whole (millimetres read as metres)
is reported and left unchanged, because only the user knows. The thresholds are far beyond what people and robots do. A
recording may come in parts; the result does not depend on how it was split. Adapters read; `derive` handles time and
frame.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import concat_parts
from cyclekit.ingest.validate.checks import Checks, PeopleChecks, RobotChecks
from cyclekit.ingest.validate.lost_rows import LostRows
from cyclekit.ingest.validate.task_lists import TaskChecks
from cyclekit.ingest.validate.window import SlidingWindow, kept_rows
from cyclekit.text.columns import in_one_line
from cyclekit.text.plain_text import one_line

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from cyclekit.adapter import Recording

_TEXTS = {
    "people": ("person",),
    "events": ("signal", "value"),
    "skeletons": ("person", "joint"),
    "task_list": ("agent", "agent_name", "task", "execution", "outcome"),
    "safety": ("execution",),
}
"""Text columns from logs."""


def examined(recording: Recording) -> Recording:
    """Return the recording without impossible rows and values; rows set aside and warnings are added to it.

    Args:
        recording: As returned by an adapter; columns may be absent.
    """
    return concat_parts(examined_parts([recording]))


def examined_parts(parts: Iterable[Recording]) -> Iterator[Recording]:
    """Yield the parts of a recording without impossible rows and values; the last part has the warnings.

    A row is in the part in which it could be judged, which may be the next one.
    """
    checks: dict[str, Checks]
    checks = {"robot": RobotChecks(), "people": PeopleChecks(), "events": Checks("an event"), "task_list": TaskChecks()}
    checks["safety"] = Checks("the safety system")
    sliding = {name: SlidingWindow(check.neighbours) for name, check in checks.items()}
    lost_rows, parts = LostRows(), iter(parts)
    part = next(parts, None)
    while part is not None:
        part = _named_in_lines(part)
        after = next(parts, None)
        tables, aside = {}, [] if part.set_aside is None or part.set_aside.is_empty() else [_reasons(part.set_aside)]
        for name, check in checks.items():
            table = part.tables().get(name)
            if table is not None:
                check.unit_shown = not part.time_units
                window = sliding[name].with_neighbours(_numbered(table), last=after is None)
                window = check.check(window)
                tables[name], dropped = kept_rows(window), check.take_set_aside()
                aside += [_reasons(rows) for rows in dropped]
        lost_rows.add(replace(part, **tables), aside)  # type: ignore[arg-type]  # the names are those of the fields
        judges: tuple[Checks | LostRows, ...] = (*checks.values(), lost_rows) if after is None else ()
        messages = tuple(text for judge in judges for text in judge.warnings())
        new = tuple(text for text in messages if text not in part.warnings)
        cannot = tuple(text for judge in judges for text in judge.impossible())
        yield replace(
            part,
            **tables,  # type: ignore[arg-type]  # the names are those of the fields
            set_aside=pl.concat(aside) if aside else None,
            warnings=(*part.warnings, *new),
            impossible=(*part.impossible, *cannot),
        )
        part = after


def _named_in_lines(part: Recording) -> Recording:
    """Return a part with single-line names and values, control characters escaped, because messages may quote them."""
    changed = {}
    for table, columns in _TEXTS.items():
        frame = part.tables().get(table)
        if frame is not None:
            changed[table] = in_one_line(frame, columns)
    messages = tuple(map(one_line, part.warnings))
    return replace(part, warnings=messages, **changed)  # type: ignore[arg-type]  # the names are those of the fields


def _reasons(set_aside: pl.DataFrame) -> pl.DataFrame:
    return set_aside.select(pl.col("source_row").cast(pl.Int64), pl.col("reason").cast(pl.String))


def _numbered(frame: pl.DataFrame) -> pl.DataFrame:
    return frame if "source_row" in frame.columns else frame.with_columns(source_row=pl.lit(None, pl.Int64))
