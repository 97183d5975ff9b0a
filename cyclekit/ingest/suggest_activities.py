"""Adds the tasks that states are to a drafted cell file, where all logs are of signals: a plant without a robot log."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.errors import CyclekitError
from cyclekit.ingest.activities import SignalLog
from cyclekit.ingest.discover import Suggested, find_all, options_of
from cyclekit.ingest.find_activities import find_activities
from cyclekit.ingest.registry import adapter_named
from cyclekit.schema import EVENTS, empty

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from cyclekit.adapter import Recording
    from cyclekit.config import Source
    from cyclekit.ingest.discover import Log

MAX_ROWS = 2_000_000
"""A size: rows of one source that are read, which is two days of samples every 0.1 s, some seconds."""


def with_activities(suggested: Suggested, roots: Sequence[Path], *, follow_links: bool = False) -> Suggested:
    """Return a suggested cell file with the activities of its sources; as it is if a log holds more than signals.

    Args:
        suggested: The cell file.
        roots: Files and folders of logs.
        follow_links: As `find_all`.
    """
    cell = suggested.cell
    drafted = replace(cell, sources=tuple(_as_drafted(source, suggested) for source in cell.sources))
    try:
        logs, _ = find_all(roots, drafted, follow_links=follow_links)
        by_source: dict[str, list[Log]] = {}
        for log in logs:
            by_source.setdefault(log.source.path if log.source else log.shown, []).append(log)
        if {table for some in by_source.values() for table in next(_parts(some[0])).tables()} != {"events"}:
            return suggested
        events = {path: _signals_of(some) for path, some in by_source.items()}
    except CyclekitError:  # a draft that cannot be read yet: `ingest` says why
        return suggested
    found = {path: find_activities(SignalLog(one, roots[0])) for path, one in events.items()}
    sources = [replace(source, activities=source.activities or found.get(source.path, ())) for source in cell.sources]
    return replace(suggested, cell=replace(cell, sources=tuple(sources)))


def _as_drafted(source: Source, suggested: Suggested) -> Source:
    """Return a source with the keys of its draft, also the uncertain ones."""
    draft = suggested.drafts.get(source.path)
    if draft is None:
        return source
    keys = {line.key: line.value for line in draft.source}
    return replace(source, **keys, map={line.key: line.value for line in draft.map})  # type: ignore[arg-type]


def _parts(log: Log) -> Iterator[Recording]:
    return adapter_named(log.adapter).parts(log.path, options_of(log.source))


def _signals_of(logs: Sequence[Log]) -> pl.DataFrame:
    """Return table EVENTS of the logs of a source, one after the other."""
    found, rows, end_s = list[pl.DataFrame](), 0, 0.0
    for log in logs:
        mine = list[pl.DataFrame]()
        for part in _parts(log):
            mine += [] if part.events is None else [part.events]
            rows += part.rows_read
            if rows > MAX_ROWS:
                break
        one = pl.concat([empty(EVENTS), *mine])
        if one.height:
            found.append(one.with_columns(pl.col("t_s") - one["t_s"].min() + end_s))
            end_s = float(found[-1]["t_s"].max()) + 1.0  # type: ignore[arg-type]  # a number
        if rows > MAX_ROWS:
            break
    return pl.concat([empty(EVENTS), *found])
