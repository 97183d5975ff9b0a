"""One log -> its native-rate tables on the disk and its entry of provenance; many logs, at the same time if asked.

Each adapter reads its own, what cannot be is taken out (`plausible`), and what is unchanged since the last ingest is
taken over from the old dataset without reading. What the recordings mean together is the business of `derive`.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import threading
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from functools import partial
from multiprocessing import get_context, parent_process
from typing import TYPE_CHECKING, Any

import polars as pl

from cyclekit import schema
from cyclekit.activity import OPERATOR
from cyclekit.align import CLOCK
from cyclekit.atomic import write_parquet
from cyclekit.discover import Log, files_of, key_of, options_of
from cyclekit.errors import LogError
from cyclekit.plausible import examined
from cyclekit.privacy import without_names
from cyclekit.registry import adapter_named

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

    from cyclekit.adapter import Recording
    from cyclekit.config import Source
    from cyclekit.dataset import Dataset

TABLES = {
    "robot": schema.ROBOT,
    "people": schema.PEOPLE,
    "events": schema.EVENTS,
    "skeletons": schema.SKELETONS,
    "stamps": schema.STAMPS,
}
QUARANTINE = "quarantine.parquet"
UNPROTECTED = "none: a flipped bit passes unnoticed unless it makes a value impossible"
"""What a recording's fact `checksum` says where its adapter knows of none."""


def read_all(
    logs: Sequence[Log],
    staging: Path,
    *,
    old: Dataset | None = None,
    jobs: int = 1,
    pseudonymise: bool = False,
    tell: Callable[[float, str], None],
) -> tuple[list[dict[str, Any]], list[LogError], int]:
    """Read the logs into `staging/recordings`.

    Args:
        logs: What to read.
        staging: Folder of the dataset in the making.
        old: Dataset to take unchanged recordings over from.
        jobs: Logs read at the same time, in processes of their own.
        pseudonymise: Replace the names that trackers give.
        tell: Told the fraction done and what is being done.

    Returns:
        Entries of the recordings in order of the logs; why the others could not be read; how many were taken over.
    """
    known = {entry["key"]: entry for entry in old.card["recordings"]} if old else {}
    entries: dict[str, dict[str, Any]] = {}
    failed: list[LogError] = []
    todo = []
    for log in logs:
        if old is not None and log.key in known and _is_whole(known[log.key], old.path):
            entries[log.id] = _take_over(known[log.key], log, old.path, staging)
        else:
            todo.append(log)
    kept = len(entries)
    for number, (log, result) in enumerate(
        _read_each(todo, partial(_read_or_error, staging=staging, pseudonymise=pseudonymise), jobs), 1
    ):
        tell(number / len(todo), f"read {log.shown}")
        if isinstance(result, LogError):
            failed.append(result)
        else:
            entries[log.id] = result
    return [entries[log.id] for log in logs if log.id in entries], failed, kept


def _is_whole(entry: dict[str, Any], old: Path) -> bool:
    folder = old / "recordings" / entry["id"]
    aside = not entry["rows_set_aside"] or (old / QUARANTINE).is_file()
    return aside and all((folder / f"{name}.parquet").is_file() for name in entry["tables"])


def _read_each(
    logs: Sequence[Log], work: Callable[[Log], dict[str, Any] | LogError], jobs: int
) -> Iterable[tuple[Log, dict[str, Any] | LogError]]:
    if jobs <= 1 or len(logs) <= 1:
        yield from ((log, work(log)) for log in logs)
        return
    context = get_context("spawn")
    with ProcessPoolExecutor(min(jobs, len(logs)), mp_context=context, initializer=_end_with_parent) as pool:
        yield from zip(logs, pool.map(work, logs), strict=True)


def _end_with_parent() -> None:
    """End this worker when its parent was killed; else it would wait for work for ever, or write where nobody asked."""
    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _read_or_error(log: Log, *, staging: Path, pseudonymise: bool) -> dict[str, Any] | LogError:
    try:
        recording = adapter_named(log.adapter).adapter.read(log.path, options_of(log.source))
        sources = _provenance(log)
    except LogError as error:
        return LogError(error.path, error.cause, nearest=error.nearest, cure=error.cure)
    except (OSError, MemoryError) as error:
        told = getattr(error, "strerror", None) or error or "too large for the memory"
        return LogError(log.path, f"cannot be read ({told})", cure="Check the file.")
    recording = examined(recording)
    if pseudonymise:
        recording = without_names(recording, keep=log.source.sees_as if log.source else None)
    try:
        return _keep(log, recording, sources, staging)
    except LogError as error:
        return LogError(error.path, error.cause, nearest=error.nearest, cure=error.cure)


def _keep(log: Log, recording: Recording, sources: list[dict[str, Any]], staging: Path) -> dict[str, Any]:
    """Write the tables of a recording; return its entry."""
    frames = recording.tables()
    if not frames.keys() & {"robot", "people", "events"}:
        raise LogError(log.path, "holds neither robot, people nor events", cure="Check what was recorded.")
    main = next((frame for frame in frames.values() if frame.height), None)
    if main is None:
        raise LogError(log.path, "holds a header and no data", cure="Record again, or remove the file.")
    folder = staging / "recordings" / log.id
    for name, frame in frames.items():
        write_parquet(schema.conform(frame, TABLES[name]), folder / f"{name}.parquet")
    first, last = (float(main["t_s"].min()), float(main["t_s"].max()))  # type: ignore[arg-type]
    rows = max(main["t_s"].n_unique() - 1, 1)
    return {
        "id": log.id,
        "session": "",
        "tables": list(frames),
        "sources": sources,
        "adapter": log.adapter,
        "adapter_package": log.package,
        "adapter_version": log.version,
        "clock": {"kind": recording.clock},
        "frame": _frame_card(log.source, recording),
        "up": recording.up,
        "joint_names": list(recording.joint_names),
        "rows": {name: frame.height for name, frame in frames.items()},
        "rows_are": recording.rows_are,
        "rows_read": recording.rows_read,
        "rows_set_aside": _quarantined(recording, log, folder),
        "first_s": first,
        "last_s": last,
        "duration_s": last - first,
        "rate_hz": round(rows / (last - first), 3) if last > first else None,
        "warnings": [*recording.warnings, *_changed_meanwhile(log)],
        "facts": {"checksum": UNPROTECTED, **recording.facts},
        "key": log.key,
    }


def _provenance(log: Log) -> list[dict[str, Any]]:
    found = []
    for file in files_of(log.path):
        with file.open("rb") as handle:
            digest = hashlib.file_digest(handle, "sha256").hexdigest()
        shown = log.shown if file == log.path else f"{log.shown}/{file.relative_to(log.path).as_posix()}"
        found.append({"path": shown, "sha256": digest, "size": file.stat().st_size})
    return found


def _frame_card(source: Source | None, recording: Recording) -> dict[str, Any]:
    if recording.people is None:
        return {"method": "robot base"}
    if source is None or source.frame is None:
        return {"method": "assumed base frame", "up": recording.up}
    frame = source.frame
    return {"method": "cell-file", "up": recording.up, "xyz_m": list(frame.xyz_m), "rotation": list(frame.rotation)}


def _changed_meanwhile(log: Log) -> list[str]:
    with suppress(OSError):
        if key_of(log) == log.key:
            return []
    return ["the log changed while it was read: is it still being written? ingest again when it is complete"]


def _quarantined(recording: Recording, log: Log, folder: Path) -> list[dict[str, Any]]:
    rows = recording.set_aside
    if rows is None or rows.height == 0:
        return []
    rows = rows.with_columns(recording=pl.lit(log.id), file=pl.lit(log.shown), row_is=pl.lit(recording.rows_are))
    write_parquet(schema.conform(rows, schema.QUARANTINE), folder / QUARANTINE)
    return rows.group_by("reason", maintain_order=True).agg(count=pl.len()).to_dicts()


def gather_quarantine(entries: Sequence[dict[str, Any]], staging: Path) -> None:
    """Put what each recording set aside into one table of the dataset."""
    files = [staging / "recordings" / entry["id"] / QUARANTINE for entry in entries]
    files = [file for file in files if file.is_file()]
    parts = [pl.read_parquet(file, glob=False) for file in files]
    write_parquet(pl.concat([schema.empty(schema.QUARANTINE), *parts]), staging / QUARANTINE)
    for file in files:
        file.unlink()


def _take_over(entry: dict[str, Any], log: Log, old: Path, staging: Path) -> dict[str, Any]:
    target = staging / "recordings" / log.id
    target.mkdir(parents=True)
    for file in sorted((old / "recordings" / entry["id"]).iterdir()):
        try:
            os.link(file, target / file.name)
        except OSError:  # another file system, or one without hard links
            shutil.copy2(file, target / file.name)
    if entry["rows_set_aside"]:
        rows = pl.scan_parquet(old / QUARANTINE, glob=False).filter(pl.col("recording") == entry["id"]).collect()
        rows = rows.with_columns(recording=pl.lit(log.id), file=pl.lit(log.shown))
        write_parquet(schema.conform(rows, schema.QUARANTINE), target / QUARANTINE)
    clock = {"kind": entry["clock"]["kind"]}
    warnings = [text for text in entry["warnings"] if not text.startswith((CLOCK, OPERATOR))]
    return {**entry, "id": log.id, "session": "", "clock": clock, "warnings": warnings}
