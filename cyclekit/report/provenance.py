"""Provenance of the numbers: recordings, clocks, frames, rows set aside, warnings, versions.

A dataset can come from thousands of files: similar recordings are grouped. Reads the dataset's card only.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cyclekit.text.numbers import compact, fixed, percent, signed, span

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.cards import ClockCard, FrameCard, RecordingCard, SourceFile
    from cyclekit.dataset.dataset import Dataset

MAX_WARNINGS = 12
MAX_FILES = 12


@dataclass(frozen=True)
class LogSource:
    """A group of recordings read in the same way.

    Attributes:
        adapter: Its name, package and version.
        tables: Their tables, as text.
        recordings: Number of recordings.
        rows, set_aside: Rows read and rows set aside.
        rate_hz, hours: Mean rate where known; total duration.
        clock, frame: How clock and frame were related to the robot's.
    """

    adapter: str
    tables: str
    recordings: int
    files: int
    rows: int
    set_aside: int
    rate_hz: float | None
    hours: float
    clock: str
    frame: str


@dataclass(frozen=True)
class Provenance:
    """Provenance of a dataset.

    Attributes:
        sources: Groups of similar recordings.
        files: Path and checksum of the first files; `more_files` others are in the dataset's card.
        set_aside: Reason and number of rows, most frequent first.
        warnings: Text and how often, most frequent first; `more_warnings` others.
        not_read: Path and reason.
        versions: Versions that made dataset and model.
    """

    sources: tuple[LogSource, ...]
    files: tuple[tuple[str, str], ...]
    more_files: int
    set_aside: tuple[tuple[str, int], ...]
    warnings: tuple[tuple[str, int], ...]
    more_warnings: int
    not_read: tuple[tuple[str, str], ...]
    versions: tuple[tuple[str, str], ...]


def provenance(dataset: Dataset, versions: Mapping[str, str], *, advise: bool = True) -> Provenance:
    """Gather the provenance of `dataset`; without `advise`, warnings do not say how to train."""
    groups: dict[tuple[str, ...], list[RecordingCard]] = defaultdict(list)
    for record in dataset.recordings:
        groups[_kind(record)].append(record)
    aside: Counter[str] = Counter()
    warned = Counter(one.text if advise else one.finding for one in dataset.card.warnings)
    files: list[tuple[str, str]] = []
    for record in dataset.recordings:
        for part in record.rows_set_aside:
            aside[part.reason] += part.count
        warned.update(record.said)
        files.extend((one.path, _checksum(one)) for one in record.sources)
    common = warned.most_common()
    return Provenance(
        sources=tuple(_source(kind, records) for kind, records in sorted(groups.items())),
        files=tuple(files[:MAX_FILES]),
        more_files=max(0, len(files) - MAX_FILES),
        set_aside=tuple(aside.most_common()),
        warnings=tuple(common[:MAX_WARNINGS]),
        more_warnings=max(0, len(common) - MAX_WARNINGS),
        not_read=tuple((one.path, one.reason) for one in dataset.card.not_read),
        versions=tuple(versions.items()),
    )


def _checksum(source: SourceFile) -> str:
    """Return the checksum of a log and by which function it was made; empty without one."""
    kind = "blake3" if source.blake3 else "sha256"
    return f"{kind}:{source.checksum}" if source.checksum else ""


def _kind(record: RecordingCard) -> tuple[str, ...]:
    package, version = record.adapter_package, record.adapter_version
    made = f"{record.adapter} ({package} {version})" if package and version else record.adapter
    return made, ", ".join(record.tables), _clock(record.clock), _frame(record.frame)


def _clock(clock: ClockCard) -> str:
    """The kind of clock and how it was related; what differs per recording follows from all of them together."""
    return f"{clock.kind}, {clock.method}"


def _clock_fits(clocks: Sequence[ClockCard]) -> str:
    """How good the fits of like clocks are: offset where they share it, range of rates, worst residual, doubts."""
    parts = []
    if len(clocks) == 1 and clocks[0].method not in ("own", "same-log"):
        parts.append(f"offset {fixed(clocks[0].offset_s, 3)} s")
    rates = [clock.rate for clock in clocks]
    low, high = min(rates, default=1.0), max(rates, default=1.0)
    if max(abs(low - 1.0), abs(high - 1.0)) > 1e-9:
        parts.append(f"rate {span(low, high, 6)}")
    residuals = [clock.residual_s for clock in clocks if clock.residual_s is not None]
    if residuals:
        parts.append(f"residual {'up to ' if len(residuals) > 1 else ''}{fixed(1000 * max(residuals), 1)} ms")
    events = [clock.events for clock in clocks if clock.events is not None]
    if events:
        counted = "stamps" if all(clock.method == "lower-envelope" for clock in clocks) else "events"
        parts.append(f"{min(events)} {counted}" + (" or more" if len(events) > 1 else ""))
    doubts = [(clock.second_best, clock.second_best_s or 0.0) for clock in clocks if clock.second_best is not None]
    if doubts:
        height, away_s = max(doubts, key=lambda doubt: doubt[0])
        parts.append(f"second-best fit {percent(height)} at {signed(away_s, 2)} s")
    return ", ".join(parts)


def _frame(frame: FrameCard) -> str:
    xyz = frame.xyz_m
    if xyz is None or not any(xyz):
        return frame.method
    return f"{frame.method}, origin at ({', '.join(compact(value) for value in xyz)}) m"


def _source(kind: tuple[str, ...], records: Sequence[RecordingCard]) -> LogSource:
    rates = [record.rate_hz for record in records if record.rate_hz is not None]
    return LogSource(
        adapter=kind[0],
        tables=kind[1],
        recordings=len(records),
        files=sum(len(record.sources) for record in records),
        rows=sum(record.rows_read or sum(record.rows.values()) for record in records),
        set_aside=sum(part.count for record in records for part in record.rows_set_aside),
        rate_hz=sum(rates) / len(rates) if rates else None,
        hours=sum(record.duration_s for record in records) / 3600,
        clock=", ".join(part for part in (kind[2], _clock_fits([record.clock for record in records])) if part),
        frame=kind[3],
    )
