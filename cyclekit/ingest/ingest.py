"""Logs of any supported format to one dataset.

Finds the logs, lets each adapter read its own, stores the tables at their native rates with their provenance, groups
recordings into sessions and lets `derive` compute samples and tasks. Logs unchanged since the last ingest are not read
again. Everything is built next to the dataset and swapped in at the end, so a killed ingest leaves either the old
dataset or the new one.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import polars as pl
from msgspec import structs

from cyclekit import schema
from cyclekit.config import Cell
from cyclekit.config.cells import AlignClocks
from cyclekit.dataset.cards import (
    DatasetCard,
    note,
    plain,
    texts,
)
from cyclekit.dataset.checksums import file_cards, with_checksum
from cyclekit.dataset.dataset import CARD, TASKS, Dataset
from cyclekit.dataset.guard import check_output
from cyclekit.dataset.sessions import WITHOUT_PLACES, group_sessions, unpaired, with_empty
from cyclekit.dataset.shared_index import shared_rows
from cyclekit.dataset.shared_tables import SharedTable, shared_frame
from cyclekit.dataset.signals import logged_bits
from cyclekit.derive.passes import Derived, derive
from cyclekit.derive.stage_progress import StageProgress
from cyclekit.errors import ConfigError, DatasetError, EmptyLog, LogError
from cyclekit.extras import version
from cyclekit.ingest.bad_logs import refuse_bad
from cyclekit.ingest.card import card_of
from cyclekit.ingest.discover import Log, cell_for, find_all, matches
from cyclekit.ingest.free_text import Words, kept_key, key_file
from cyclekit.ingest.log_spans import robots_at_once, with_span_notes
from cyclekit.ingest.open_units import prove_units
from cyclekit.ingest.pseudonymise import Names, numbered_logs, take_out
from cyclekit.ingest.read.read_logs import Digests, ReadSettings, check_shared, read_all
from cyclekit.ingest.read.resume import ResumeStore
from cyclekit.ingest.read.reuse import gather_quarantine
from cyclekit.ingest.report import IngestReport, report_of
from cyclekit.ingest.restarts import divide_restarted
from cyclekit.ingest.shared_logs import may_be_shared, split_shared
from cyclekit.learning.coupling.events.logged_visits import courses_of
from cyclekit.learning.coupling.learn import learn_executions
from cyclekit.learning.coupling.several_people import several_people
from cyclekit.learning.coupling.waits import with_waits_named
from cyclekit.learning.coupling.words import contradicted
from cyclekit.parallel.engine import LOCAL, Engine
from cyclekit.parallel.one_thread import one_thread
from cyclekit.storage.atomic import built, clean_up, locked, needs_clean_up, write_parquet, write_text
from cyclekit.storage.parquet import StoredTable
from cyclekit.storage.remote.cache import cached, of_file_url
from cyclekit.storage.remote.folders import is_url, mirrored, published
from cyclekit.text.numbers import given, percent
from cyclekit.text.plain_json import finite

if TYPE_CHECKING:
    from cyclekit.dataset.cards import CouplingCard, LogCard, Note
    from cyclekit.dataset.signals import Read, Stored

Progress = Callable[[float, str], None]


@one_thread()
def ingest(
    logs: str | Path | Sequence[str | Path],
    out: str | Path,
    *,
    cell: Cell | str | Path | None = None,
    engine: Engine = LOCAL,
    rate_hz: float | None = None,
    pseudonymise: bool = False,
    keep_skeletons: bool = False,
    checksums: bool = True,
    align_clocks: AlignClocks | None = None,
    accept_bad_logs: bool = False,
    follow_links: bool = False,
    progress: Progress | None = None,
) -> IngestReport:
    """Read logs into the dataset `out`; logs unchanged since the last ingest are not read again.

    Args:
        logs: Files and folders, by path or URL, one or several.
        out: Folder of the dataset, or the URL to which the complete dataset is published.
        cell: Cell file; by default `cell.toml` next to the logs, if there is one.
        engine: Where logs are read, and how many in parallel.
        rate_hz: Rate of the samples; by default that of the cell file, or 10 Hz.
        pseudonymise: Store neither tracker names nor wall-clock time (docs/privacy.md).
        keep_skeletons: Store all joints of all persons, if a tracker has them; no estimate needs them.
        checksums: Store the BLAKE3 checksum of each log, which later shows whether a file is the one that was read.
        align_clocks: "logs": align clocks by what the logs show, also in doubt and against what is stated
            (docs/clocks.md); by default that of the cell file.
        accept_bad_logs: Go on without the only log of its kind if it cannot be read, and with values that cannot be
            (a person 4 km away: millimetres); otherwise these are errors. Default: that of the cell file.
        follow_links: Read targets of links that lead out of a folder of logs; otherwise they are listed in `not_read`.
        progress: Called with the fraction done and a description.

    Raises:
        LogError: A log given explicitly cannot be used, nor the only one of its kind, or the folders hold none; or
            values of a log cannot be.
        ConfigError: The cell file is invalid.
        OutputError: The dataset would replace the logs, or something that is no dataset.
        BusyPlace: Another process is writing the dataset.
        CyclekitError: The dataset cannot be written.
    """
    places = [logs] if isinstance(logs, str | Path) else list(logs)
    file = None if cell is None or isinstance(cell, Cell) else Path(cell)
    check_output(out, "dataset", [*places, file])
    roots = [mirrored(place) for place in places]
    _check_logs(roots)
    settings = cell if isinstance(cell, Cell) else cell_for(roots, file)
    if rate_hz is not None:
        settings = replace(settings, rate_hz=_rate(rate_hz))
    if align_clocks is not None:
        settings = replace(settings, align_clocks=align_clocks)
    settings = replace(settings, accept_bad_logs=accept_bad_logs or settings.accept_bad_logs)
    found, not_read = find_all(roots, settings, follow_links=follow_links)
    words = Words.of(settings)
    reading = ReadSettings(pseudonymise=pseudonymise, words=words, skeletons=keep_skeletons, checksums=checksums)
    logs_found = numbered_logs(found) if pseudonymise else found
    wanted = _Wanted(settings, tuple(logs_found), tuple(not_read), engine, reading)
    with published(out) as path:
        report = _ingest(roots, path, wanted, progress or (lambda fraction, text: None))
    return replace(report, place=str(out))


def _ingest(roots: Sequence[Path], out: Path, wanted: _Wanted, tell: Progress) -> IngestReport:
    settings, count = wanted.settings, len(wanted.logs)
    store = ResumeStore(out, "skeletons" if settings.skeletons else "plain")
    if not needs_clean_up(out) and not store.is_left and (card := _up_to_date(out, wanted)):
        return report_of(out, card, new=0, kept=count, unchanged=True)
    with locked(out):
        clean_up(out)
        if card := _up_to_date(out, wanted):
            store.clear()
            return report_of(out, card, new=0, kept=count, unchanged=True)
        if settings.pseudonymise:
            store.clear()  # the files of an earlier ingest hold names
            settings = replace(settings, words=replace(settings.words, key=kept_key(key_file(out))))
            wanted = replace(wanted, settings=settings)
        with store.while_making(), built(out) as staging, Digests(wanted=settings.checksums) as digests:
            explicit = {path for path in roots if path.is_file()}
            resumable = None if settings.pseudonymise else store
            names = Names(wanted.logs, roots, wanted.cell) if settings.pseudonymise else None
            old = _old(out)
            card, kept = _build(wanted, staging, digests, old, explicit, resumable, names, tell)
            repaired = _repaired(old, (out / CARD).exists())
    report = report_of(out, card, new=len(card.recordings) - kept, kept=kept, unchanged=False)
    return replace(report, said=(*(("", text) for text in texts(repaired)), *report.said))


def left_by(out: Path | str) -> Path | None:
    """Return the folder in which an unfinished ingest keeps the recordings it has read; None if there is none.

    Args:
        out: Path or URL of its dataset.
    """
    path = (of_file_url(str(out)) or cached(str(out))) if is_url(out) else Path(out)
    return ResumeStore(path, "").left


@dataclass(frozen=True)
class _Wanted:
    """Content requested for the dataset."""

    cell: Cell
    logs: tuple[Log, ...]
    not_read: tuple[tuple[str, str], ...]
    engine: Engine
    settings: ReadSettings

    @property
    def fingerprint(self) -> str:
        keys = [log.key for log in self.logs]
        chosen = [value for name, value in vars(self.settings).items() if name != "words"]
        facts = [repr(self.cell), version(), schema.SCHEMA_VERSION, keys, self.not_read, chosen]
        return hashlib.sha256(json.dumps(facts).encode()).hexdigest()


def _up_to_date(out: Path, wanted: _Wanted) -> DatasetCard | None:
    old = _old(out)
    same = old is not None and old.card.fingerprint == wanted.fingerprint
    return old.card if old is not None and same and not old.damaged() else None


def _repaired(old: Dataset | None, there: bool) -> list[Note]:
    """Return notes about damage of the replaced dataset: it was rebuilt, and the disk may be failing."""
    if old is None:
        return [note("made-anew")] if there else []
    damaged = list(old.damaged().items())
    some = ", ".join(f"{name} ({what})" for name, what in damaged[:3]) + (" and more" if len(damaged) > 3 else "")
    return [note("repaired", files=some)] if damaged else []


def _build(
    wanted: _Wanted,
    staging: Path,
    digests: Digests,
    old: Dataset | None,
    explicit: set[Path],
    store: ResumeStore | None,
    names: Names | None,
    tell: Progress,
) -> tuple[DatasetCard, int]:
    """Build the dataset in `staging`, pseudonymised by `names`; return its card and number of reused recordings."""
    alike = old is not None and old.card.skeletons == wanted.settings.skeletons
    work = StageProgress(tell)
    result = read_all(
        wanted.logs,
        staging,
        digests,
        old=None if wanted.settings.pseudonymise or not alike else old,
        store=store,
        engine=wanted.engine,
        settings=wanted.settings,
        tell=work.read,
    )
    read = result.cards
    shown = {log.path: log.shown for log in wanted.logs}
    not_read = list(wanted.not_read)
    for error in result.failed:
        if error.path in explicit or not read:
            raise error
        not_read.append((shown.get(error.path, str(error.path)), error.cause))
    if not wanted.cell.accept_bad_logs:
        refuse_bad(wanted.logs, read, result.failed, not_read)
    cell = wanted.cell
    sources = {log.id: log.source for log in wanted.logs}
    shares = partial(may_be_shared, sources=sources)
    native, stored = partial(_native, staging), partial(_stored, staging)
    grouped = partial(
        group_sessions, is_reference=partial(_is_reference, cell), numbered=names is not None, shares=shares
    )
    groups = grouped(read)
    if proven := prove_units(wanted.logs, groups, native, digests, staging, wanted.settings):
        read = [proven.get(card.id, card) for card in read]
        groups = grouped(read)
    gather_quarantine(read, staging)
    groups = with_empty(groups, _empty_people(wanted.logs, read, result.failed))
    divided = divide_restarted(groups, sources, native, stored, staging)
    shared = split_shared(divided.groups, native, staging)
    groups, copies = shared.groups, {**divided.copies, **shared.copies}
    sources |= {name: sources[log] for name, log in copies.items()}
    by_logs = cell.align_clocks == "logs"
    derived = derive(
        groups, sources, native, stored, cell, staging / "samples", work, engine=wanted.engine, by_logs=by_logs
    )
    warnings = [*divided.notes, *derived.warnings, *unpaired(groups)]
    warnings += [*_unmatched(cell, wanted.logs), *_without_goals(cell, read, native), *_without_places(read)]
    by_id = {one.id: one for one in digests.settle(derived.recordings)}
    for name, log in copies.items():
        by_id[name] = structs.replace(by_id[name], sources=by_id[log].sources)
    files = {log.shown: log.path for log in wanted.logs}
    recordings = with_span_notes([by_id[name] for name in (*(one.id for one in read), *copies)], copies, files, sources)
    warnings += _copied([by_id[one.id] for one in read])
    warnings += robots_at_once([by_id[one.id] for one in read], sources)
    if names is not None:
        recordings = take_out(recordings, names, staging, copies)
        warnings = names.notes(warnings)
        cell, not_read = names.settings(), names.not_read(not_read)
    tasks, coupling = _with_waits(derived, native, stored, cell)
    work.at("waits", 1.0, "waits")
    write_parquet(tasks, staging / TASKS)
    derived = replace(derived, tasks=tasks, recordings=recordings, warnings=[*warnings, *contradicted(coupling)])
    card = structs.replace(
        card_of(cell, derived, not_read, wanted.settings, wanted.fingerprint),
        coupling=coupling,
        files=file_cards(staging),
    )
    values = finite(plain(card))
    write_text(staging / CARD, with_checksum(json.dumps(values, indent=1, ensure_ascii=False, allow_nan=False) + "\n"))
    return card, result.kept


def _empty_people(logs: Sequence[Log], read: Sequence[LogCard], failed: Sequence[LogError]) -> list[str]:
    """Return the paths of empty tracker logs: other logs of the same adapter and source hold people."""
    trackers = {card.id for card in read if "people" in card.tables and "robot" not in card.tables}
    kinds = [(log.adapter, log.source) for log in logs if log.id in trackers]
    empty = {error.path for error in failed if isinstance(error, EmptyLog)}
    return [log.shown for log in logs if log.path in empty and (log.adapter, log.source) in kinds]


def _with_waits(derived: Derived, read: Read, stored: Stored, cell: Cell) -> tuple[pl.DataFrame, CouplingCard | None]:
    """Return table TASKS with its waits, and the learned wait conditions; None where several people are taken for one.

    If an agent waits for the other, an execution ends when both are done, so the operator's tasks after the robot's
    last one are included.

    Raises:
        ConfigError: The cell file gives waits, and several people are taken for one.
    """
    if share := several_people(derived.recordings):
        if cell.waits:
            msg = (
                f"cell.toml [[waits]]: in {percent(share)} of the samples with people several are seen at "
                "once, who are "
                "taken for one, so it is not known whose visits end these waits"
            )
            raise ConfigError(msg, cure="Keep one person's track in the logs, or leave [[waits]] out.")
        return derived.tasks, None
    tasks, bits = derived.tasks, partial(logged_bits, stored=stored)
    fields = [name for one in derived.operator_signals for name in (one.signal, one.reset) if name]
    courses = courses_of(derived.executions, tasks, derived.recordings, read, bits, fields, cell.goal_signals)
    coupling = learn_executions(courses, tasks, cell.waits)
    if coupling is not None and coupling.coupled:
        tasks = derived.tasks_to_next
        courses = courses_of(derived.executions, tasks, derived.recordings, read, bits, fields, cell.goal_signals)
        coupling = learn_executions(courses, tasks, cell.waits)
    return (tasks if coupling is None else with_waits_named(tasks, courses, coupling)), coupling


def _rate(rate_hz: float) -> float:
    if not 0.1 <= rate_hz <= 1000.0:
        msg = f"a rate of {given(rate_hz)} samples a second"
        raise ConfigError(msg, cure="Give 0.1 to 1000; the networks of the paper have 10.")
    return rate_hz


def _check_logs(roots: Sequence[Path]) -> None:
    for path in roots:
        if not path.exists():
            raise LogError(path, "no such file or folder", cure="Check the path.")


def _old(out: Path) -> Dataset | None:
    try:
        return Dataset.open(out)
    except DatasetError:
        return None  # absent, or of another version: all logs are read again


def _native(staging: Path, recording: str, table: str) -> pl.DataFrame | None:
    check_shared(staging)
    if (rows := shared_rows(staging, recording, table)) is not None:
        return shared_frame(staging, rows)
    file = staging / "recordings" / recording / f"{table}.parquet"
    return pl.read_parquet(file, glob=False) if file.is_file() else None


def _stored(staging: Path, recording: str, columns: Sequence[str]) -> StoredTable:
    check_shared(staging)
    if (rows := shared_rows(staging, recording, "robot")) is not None:
        return SharedTable(staging, rows, columns)
    return StoredTable(staging / "recordings" / recording / "robot.parquet", columns)


def _is_reference(cell: Cell, shown: str) -> bool:
    return any(matches(shown, Path(shown), pattern) for pattern in cell.reference)


def _unmatched(cell: Cell, logs: Sequence[Log]) -> list[Note]:
    """Return notes for sources of the cell file that match no log: a typo there would silently change the result."""
    used = {id(log.source) for log in logs}
    unused = [source.path for source in cell.sources if id(source) not in used]
    unused += [glob for glob in cell.reference if not any(matches(log.shown, log.path, glob) for log in logs)]
    in_folders = {f"*{Path(path).name}" for path in unused if any(log.path.name == Path(path).name for log in logs)}
    return [
        note("source-in-folders", path=path, glob=glob)
        if (glob := f"*{Path(path).name}") in in_folders
        else note("source-without-log", path=path)
        for path in unused
    ]


def _without_goals(cell: Cell, logs: Sequence[LogCard], read: Read) -> list[Note]:
    """Return a note for each goal signal of the cell file that no log holds."""
    events = [read(log.id, "events") for log in logs if cell.goal_signals and "events" in log.tables]
    known = {name for one in events if one is not None for name in one["signal"].unique()}
    return [note("goal-signal-unknown", signal=name) for name in cell.goal_signals if name not in known]


def _copied(logs: Sequence[LogCard]) -> list[Note]:
    """Return a note if robot logs are copies of others; without checksums they are not known."""
    first: dict[str, str] = {}
    copies = []
    for log in logs:
        largest = max(log.sources, key=lambda source: source.size, default=None)
        if "robot" not in log.tables or largest is None or not largest.blake3:
            continue
        if (same := first.setdefault(largest.blake3, log.shown)) != log.shown:
            copies.append((log.shown, same))
    return [note("log-copied", copies=len(copies), copy=copies[0][0], of=copies[0][1])] if copies else []


def _without_places(logs: Sequence[LogCard]) -> list[Note]:
    """Return a note if no log holds positions, or none belongs to a robot."""
    if all(set(log.tables) <= WITHOUT_PLACES for log in logs):
        return [note("no-positions")]
    tables = {table for log in logs for table in log.tables}
    return [note("no-robot-log")] if "people" in tables and tables.isdisjoint(("robot", "safety", "task_list")) else []
