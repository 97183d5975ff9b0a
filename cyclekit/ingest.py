"""Logs of any supported kind -> one dataset.

Finds the logs, lets each adapter read its own, keeps the native-rate tables with their provenance, puts recordings
that belong together into sessions and has `derive` compute samples and tasks. What is unchanged since the last ingest
is not read again. Everything is built beside the dataset and swapped in at the end, so a killed ingest leaves the old
dataset or the new one.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl

from cyclekit import schema
from cyclekit.adapter import Recording
from cyclekit.config import Cell, NamedPlace, Source
from cyclekit.dataset import CARD, Dataset, settle, staged, write_parquet, write_text
from cyclekit.derive import Derived, derive
from cyclekit.discover import Log, cell_for, files_of, find_all, matches, options_of
from cyclekit.errors import DatasetError, LogError
from cyclekit.registry import adapter_named
from cyclekit.session import group_sessions

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    Progress = Callable[[float, str], None]

TABLES = {"robot": schema.ROBOT, "people": schema.PEOPLE, "events": schema.EVENTS}


@dataclass(frozen=True)
class IngestReport:
    """What an ingest did.

    Attributes:
        recordings_new: Recordings read now.
        recordings_kept: Recordings taken over from the old dataset without reading their logs.
        not_read: Files that were found and not used, with the reason.
        unchanged: The dataset was up to date; nothing was read or written.
    """

    dataset: Path
    recordings_new: int
    recordings_kept: int
    executions: int
    tasks: int
    samples: int
    not_read: tuple[tuple[str, str], ...]
    warnings: tuple[str, ...]
    unchanged: bool

    def to_json(self) -> dict[str, Any]:
        """Return the report as plain JSON values."""
        not_read = [{"path": path, "reason": reason} for path, reason in self.not_read]
        return {**vars(self), "dataset": str(self.dataset), "not_read": not_read, "warnings": list(self.warnings)}


def ingest(
    logs: Sequence[Path | str],
    out: Path | str,
    *,
    cell: Path | Cell | None = None,
    jobs: int = 1,
    progress: Progress | None = None,
) -> IngestReport:
    """Read logs into the dataset `out`, replacing what was there.

    Args:
        logs: Files and folders, any mix.
        out: Folder of the dataset.
        cell: Cell file; by default `cell.toml` beside the logs, if there is one.
        jobs: Logs read at the same time, in processes of their own.
        progress: Told the fraction done and what is being done.

    Raises:
        LogError: A log named explicitly cannot be used, or nothing in the folders can.
        ConfigError: The cell file cannot be followed.
        CyclekitError: The dataset cannot be written.
    """
    tell = progress or (lambda fraction, text: None)
    roots, out = [Path(path) for path in logs], Path(out)
    _check(roots, out)
    settings = cell if isinstance(cell, Cell) else cell_for(roots, cell)
    found, not_read = find_all(roots, settings)
    fingerprint = _fingerprint(settings, found, not_read)
    settle(out)
    old = _old(out)
    if old is not None and old.card.get("fingerprint") == fingerprint:
        return _report(out, old.card, new=0, kept=len(found), unchanged=True)
    explicit = {path for path in roots if path.is_file()}
    with staged(out) as staging:
        entries, failed, kept = _read_all(found, staging, old, jobs, lambda f, text: tell(0.6 * f, text))
        shown = {log.path: log.shown for log in found}
        for error in failed:
            if error.path in explicit or not entries:
                raise error
            not_read.append((shown.get(error.path, str(error.path)), error.cause))
        sources = {log.id: log.source for log in found}
        sessions = group_sessions(entries, partial(_is_reference, settings))
        derived = derive(sessions, sources, partial(_native, staging), settings, lambda f, t: tell(0.6 + 0.4 * f, t))
        derived.warnings.extend(_unmatched(settings, found))
        card = _card(settings, entries, derived, not_read, fingerprint)
        for name, frame in derived.samples.items():
            write_parquet(frame, staging / "samples" / f"{name}.parquet")
        write_parquet(derived.tasks, staging / "tasks.parquet")
        write_text(staging / CARD, json.dumps(card, indent=1, ensure_ascii=False) + "\n")
    return _report(out, card, new=len(entries) - kept, kept=kept, unchanged=False)


def _check(roots: Sequence[Path], out: Path) -> None:
    for path in roots:
        if not path.exists():
            raise LogError(path, "no such file or folder", cure="Check the path.")
        if path.is_dir() and out.resolve() == path.resolve():
            raise LogError(path, "is both the logs and the dataset", cure="Give --out a folder of its own.")
    if out.is_file() or (out.is_dir() and any(out.iterdir()) and not (out / CARD).is_file()):
        msg = f"{out}: exists and is no cyclekit dataset, so it is not replaced"
        raise DatasetError(msg, cure="Give --out a new folder.")


def _fingerprint(cell: Cell, logs: Sequence[Log], not_read: Sequence[tuple[str, str]]) -> str:
    facts = [repr(cell), version("cyclekit"), schema.SCHEMA_VERSION, [log.key for log in logs], list(not_read)]
    return hashlib.sha256(json.dumps(facts).encode()).hexdigest()


def _old(out: Path) -> Dataset | None:
    try:
        return Dataset.open(out)
    except DatasetError:
        return None  # absent, or of another version: everything is read again


def _read_all(
    logs: Sequence[Log], staging: Path, old: Dataset | None, jobs: int, tell: Progress
) -> tuple[list[dict[str, Any]], list[LogError], int]:
    known = {entry["key"]: entry for entry in old.card["recordings"]} if old else {}
    entries: dict[str, dict[str, Any]] = {}
    failed: list[LogError] = []
    todo = []
    for log in logs:
        if old is not None and log.key in known and (old.path / "recordings" / known[log.key]["id"]).is_dir():
            entries[log.id] = _take_over(known[log.key], log, old.path, staging)
        else:
            todo.append(log)
    kept = len(entries)
    for number, (log, result) in enumerate(_read_each(todo, staging, jobs), 1):
        tell(number / len(todo), f"read {log.shown}")
        if isinstance(result, LogError):
            failed.append(result)
        else:
            entries[log.id] = result
    return [entries[log.id] for log in logs if log.id in entries], failed, kept


def _read_each(logs: Sequence[Log], staging: Path, jobs: int) -> Iterable[tuple[Log, dict[str, Any] | LogError]]:
    work = partial(_read_or_error, staging=staging)
    if jobs <= 1 or len(logs) <= 1:
        yield from ((log, work(log)) for log in logs)
        return
    with ProcessPoolExecutor(min(jobs, len(logs)), mp_context=get_context("spawn")) as pool:
        yield from zip(logs, pool.map(work, logs), strict=True)


def _read_or_error(log: Log, staging: Path) -> dict[str, Any] | LogError:
    try:
        return _read(log, staging)
    except LogError as error:
        return LogError(error.path, error.cause, nearest=error.nearest, cure=error.cure)
    except OSError as error:
        return LogError(log.path, f"cannot be read ({error.strerror or error})", cure="Check the file.")


def _read(log: Log, staging: Path) -> dict[str, Any]:
    recording = adapter_named(log.adapter).adapter.read(log.path, options_of(log.source))
    frames = {name: frame for name, frame in _tables(recording).items() if frame is not None}
    if not frames:
        raise LogError(log.path, "holds neither robot, people nor events", cure="Check what was recorded.")
    main = next((frame for frame in frames.values() if frame.height), None)
    if main is None:
        raise LogError(log.path, "holds a header and no data", cure="Record again, or remove the file.")
    for name, frame in frames.items():
        write_parquet(schema.conform(frame, TABLES[name]), staging / "recordings" / log.id / f"{name}.parquet")
    first, last = (float(main["t_s"].min()), float(main["t_s"].max()))  # type: ignore[arg-type]
    rows = max(main["t_s"].n_unique() - 1, 1)
    return {
        "id": log.id,
        "session": "",
        "tables": list(frames),
        "sources": _provenance(log),
        "adapter": log.adapter,
        "adapter_package": log.package,
        "adapter_version": log.version,
        "clock": {"kind": recording.clock},
        "frame": _frame_card(log.source, recording),
        "up": recording.up,
        "joint_names": list(recording.joint_names),
        "rows": {name: frame.height for name, frame in frames.items()},
        "rows_read": recording.rows_read,
        "rows_set_aside": _set_aside(recording, staging / "recordings" / log.id),
        "first_s": first,
        "last_s": last,
        "duration_s": last - first,
        "rate_hz": round(rows / (last - first), 3) if last > first else None,
        "warnings": list(recording.warnings),
        "facts": dict(recording.facts),
        "key": log.key,
    }


def _tables(recording: Recording) -> dict[str, pl.DataFrame | None]:
    return {"robot": recording.robot, "people": recording.people, "events": recording.events}


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


def _set_aside(recording: Recording, folder: Path) -> list[dict[str, Any]]:
    rows = recording.set_aside
    if rows is None or rows.height == 0:
        return []
    write_parquet(rows, folder / "set_aside.parquet")
    return rows.group_by("reason", maintain_order=True).agg(count=pl.len()).to_dicts()


def _take_over(entry: dict[str, Any], log: Log, old: Path, staging: Path) -> dict[str, Any]:
    target = staging / "recordings" / log.id
    target.mkdir(parents=True)
    for file in sorted((old / "recordings" / entry["id"]).iterdir()):
        try:
            os.link(file, target / file.name)
        except OSError:  # another file system, or one without hard links
            shutil.copy2(file, target / file.name)
    clock = {"kind": entry["clock"]["kind"]}
    warnings = [text for text in entry["warnings"] if "clock relates" not in text]
    return {**entry, "id": log.id, "session": "", "clock": clock, "warnings": warnings}


def _native(staging: Path, recording: str, table: str) -> pl.DataFrame | None:
    file = staging / "recordings" / recording / f"{table}.parquet"
    return pl.read_parquet(file, glob=False) if file.is_file() else None


def _is_reference(cell: Cell, shown: str) -> bool:
    return any(matches(shown, Path(shown), pattern) for pattern in cell.reference)


def _unmatched(cell: Cell, logs: Sequence[Log]) -> list[str]:
    """Say which sources of the cell file mean no log: a slip there would silently change what the logs mean."""
    used = {id(log.source) for log in logs}
    unused = [source.path for source in cell.sources if id(source) not in used]
    unused += [glob for glob in cell.reference if not any(matches(log.shown, log.path, glob) for log in logs)]
    return [f"the cell file speaks of {path!r}, and no log is meant by it" for path in unused]


def _card(
    cell: Cell, entries: list[dict[str, Any]], derived: Derived, not_read: list[tuple[str, str]], fingerprint: str
) -> dict[str, Any]:
    return {
        "schema_version": schema.SCHEMA_VERSION,
        "cyclekit_version": version("cyclekit"),
        "name": cell.name,
        "fingerprint": fingerprint,
        "settings": json.loads(json.dumps(cell, default=lambda value: vars(value))),
        "rate_hz": cell.rate_hz,
        "recordings": entries,
        "not_read": [{"path": path, "reason": reason} for path, reason in not_read],
        "executions": derived.executions,
        "places": {name: _without_name(place) for name, place in derived.places.items()},
        "human_places": {name: _without_name(place) for name, place in derived.human_places.items()},
        "levels": list(derived.levels),
        "scaling_origin": derived.origin,
        "rows": {"samples": sum(f.height for f in derived.samples.values()), "tasks": derived.tasks.height},
        "warnings": derived.warnings,
    }


def _without_name(place: object) -> dict[str, Any]:
    return {key: value for key, value in vars(place).items() if key != "name"}


def _report(out: Path, card: dict[str, Any], *, new: int, kept: int, unchanged: bool) -> IngestReport:
    warnings = [*card["warnings"], *(f"{e['id']}: {text}" for e in card["recordings"] for text in e["warnings"])]
    return IngestReport(
        dataset=out,
        recordings_new=new,
        recordings_kept=kept,
        executions=len(card["executions"]),
        tasks=card["rows"]["tasks"],
        samples=card["rows"]["samples"],
        not_read=tuple((entry["path"], entry["reason"]) for entry in card["not_read"]),
        warnings=tuple(warnings),
        unchanged=unchanged,
    )


def suggest_cell(paths: Sequence[Path]) -> Cell:
    """Return the cell file that an ingest of these paths would work with, for a person to complete.

    A dataset gives its places as well; logs give one source each.

    Raises:
        CyclekitError: As `ingest`, for paths that cannot be used.
    """
    if len(paths) == 1 and (paths[0] / CARD).is_file():
        dataset = Dataset.open(paths[0])
        return Cell(
            name=str(dataset.card["name"]),
            places={name: NamedPlace(p.xyz_m, max(p.radius_m, 0.01)) for name, p in dataset.places.items()},
            human_places={name: NamedPlace(p.xyz_m, p.radius_m) for name, p in dataset.human_places.items()},
        )
    cell = cell_for(paths, None)
    logs, _ = find_all(paths, cell)
    sources = {source.path: source for log in logs for source in [log.source or Source(log.shown, log.adapter)]}
    return replace(cell, sources=tuple(sources.values()))
