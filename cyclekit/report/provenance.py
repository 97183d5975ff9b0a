"""Provenance of the numbers: recordings, clocks, frames, rows set aside, warnings, versions.

A dataset can come from thousands of files: similar recordings are grouped. Reads the dataset's card only.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from cyclekit.dataset.dataset import Dataset

MOST_WARNINGS = 12
MOST_FILES = 12


@dataclass(frozen=True)
class Source:
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

    sources: tuple[Source, ...]
    files: tuple[tuple[str, str], ...]
    more_files: int
    set_aside: tuple[tuple[str, int], ...]
    warnings: tuple[tuple[str, int], ...]
    more_warnings: int
    not_read: tuple[tuple[str, str], ...]
    versions: tuple[tuple[str, str], ...]


def provenance(dataset: Dataset, versions: Mapping[str, str]) -> Provenance:
    """Gather the provenance of `dataset`."""
    card = dataset.card
    groups: dict[tuple[str, ...], list[dict[str, Any]]] = defaultdict(list)
    for record in dataset.recordings:
        groups[_kind(record)].append(record)
    aside: Counter[str] = Counter()
    warned: Counter[str] = Counter(str(text) for text in card.get("warnings", ()))
    files: list[tuple[str, str]] = []
    for record in dataset.recordings:
        for entry in _set_aside(record):
            aside[str(entry.get("reason", "no reason given"))] += int(entry.get("count", 1))
        warned.update(str(text) for text in record.get("warnings", ()))
        files.extend((str(f.get("path", "")), _checksum(f)) for f in record.get("sources", ()))
    unread = card.get("not_read", ())
    common = warned.most_common()
    return Provenance(
        sources=tuple(_source(kind, records) for kind, records in sorted(groups.items())),
        files=tuple(files[:MOST_FILES]),
        more_files=max(0, len(files) - MOST_FILES),
        set_aside=tuple(aside.most_common()),
        warnings=tuple(common[:MOST_WARNINGS]),
        more_warnings=max(0, len(common) - MOST_WARNINGS),
        not_read=tuple((str(e.get("path", "")), str(e.get("reason", ""))) for e in unread),
        versions=tuple(versions.items()),
    )


def _checksum(source: Mapping[str, Any]) -> str:
    """Return the checksum of a log with the name of its hash function; empty without one."""
    return next((f"{kind}:{source[kind]}" for kind in ("blake3", "sha256") if source.get(kind)), "")


def _kind(record: Mapping[str, Any]) -> tuple[str, ...]:
    name, version = record.get("adapter", "unknown"), record.get("adapter_version")
    package = record.get("adapter_package")
    made = f"{name} ({package} {version})" if package and version else str(name)
    tables = ", ".join(record.get("tables", ()))
    return made, tables, _clock(record.get("clock", {})), _frame(record.get("frame", {}))


def _clock(clock: Mapping[str, Any]) -> str:
    """Kind of clock and method of relating it; `_clock_fits` summarises what differs per recording."""
    return ", ".join(str(clock[key]) for key in ("kind", "method") if clock.get(key)) or "not stated"


def _clock_fits(records: Iterable[Mapping[str, Any]]) -> str:
    """Quality of the clock fits of a group: common offset, range of rates, largest residual, doubts."""
    clocks = [record.get("clock", {}) for record in records]
    parts = []
    offsets = [float(clock["offset_s"]) for clock in clocks if clock.get("offset_s") is not None]
    if len(offsets) == 1 and clocks[0].get("method") not in ("own", "same-log"):
        parts.append(f"offset {offsets[0]:.3f} s")
    rates = [float(clock.get("rate", 1.0)) for clock in clocks]
    low, high = min(rates, default=1.0), max(rates, default=1.0)
    if max(abs(low - 1.0), abs(high - 1.0)) > 1e-9:
        parts.append(f"rate {low:.6f}" if high - low < 5e-7 else f"rate {low:.6f} to {high:.6f}")
    residuals = [float(clock["residual_s"]) for clock in clocks if clock.get("residual_s") is not None]
    if residuals:
        parts.append(f"residual {'up to ' if len(residuals) > 1 else ''}{1000 * max(residuals):.1f} ms")
    events = [int(clock["events"]) for clock in clocks if clock.get("events") is not None]
    if events:
        counted = "stamps" if all(clock.get("method") == "lower-envelope" for clock in clocks) else "events"
        parts.append(f"{min(events)} {counted}" + (" or more" if len(events) > 1 else ""))
    doubts = [clock for clock in clocks if clock.get("second_best") is not None]
    if doubts:
        worst = max(doubts, key=lambda clock: float(clock["second_best"]))
        parts.append(f"second-best fit {100 * worst['second_best']:.0f} % at {float(worst['second_best_s']):+.2f} s")
    return ", ".join(parts)


def _frame(frame: Mapping[str, Any]) -> str:
    parts = [str(frame["method"])] if frame.get("method") else []
    xyz = frame.get("xyz_m")
    if xyz and any(abs(float(v)) > 0 for v in xyz):
        parts.append("origin at (" + ", ".join(f"{float(v):g}" for v in xyz) + ") m")
    if frame.get("yaw_deg"):
        parts.append(f"turned by {float(frame['yaw_deg']):g}°")
    return ", ".join(parts) or "not stated"


def _source(kind: tuple[str, ...], records: Iterable[Mapping[str, Any]]) -> Source:
    records = list(records)
    rates = [float(r["rate_hz"]) for r in records if r.get("rate_hz")]
    return Source(
        adapter=kind[0],
        tables=kind[1],
        recordings=len(records),
        files=sum(len(r.get("sources", ())) for r in records),
        rows=sum(int(r.get("rows_read") or sum((r.get("rows") or {}).values())) for r in records),
        set_aside=sum(int(e.get("count", 1)) for r in records for e in _set_aside(r)),
        rate_hz=sum(rates) / len(rates) if rates else None,
        hours=sum(float(r.get("duration_s") or 0.0) for r in records) / 3600,
        clock=", ".join(part for part in (kind[2], _clock_fits(records)) if part),
        frame=kind[3],
    )


def _set_aside(record: Mapping[str, Any]) -> list[dict[str, Any]]:
    return list(record.get("rows_set_aside") or ())
