"""Logs of any supported kind -> one dataset.

Finds the logs, lets each adapter read its own, keeps the native-rate tables with their provenance, puts recordings
that belong together into sessions and has `derive` compute samples and tasks. What is unchanged since the last ingest
is not read again. Everything is built beside the dataset and swapped in at the end, so a killed ingest leaves the old
dataset or the new one.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import polars as pl
from msgspec import structs

from cyclekit import schema
from cyclekit.config import Cell
from cyclekit.dataset.cards import (
    DatasetCard,
    DynamicsCard,
    PlaceCard,
    RowCounts,
    UnreadCard,
    checked,
    note,
    plain,
    texts,
)
from cyclekit.dataset.checksums import listed, sealed
from cyclekit.dataset.dataset import CARD, TASKS, Dataset
from cyclekit.dataset.guard import check_output
from cyclekit.dataset.sessions import WITHOUT_PLACES, group_sessions, unpaired
from cyclekit.dataset.shared_index import shared_rows
from cyclekit.dataset.shared_tables import SharedTable, shared_frame
from cyclekit.derive.passes import Derived, derive
from cyclekit.errors import ConfigError, DatasetError, LogError
from cyclekit.ingest.discover import Log, cell_for, find_all, matches
from cyclekit.ingest.pseudonymise import Names, numbered_logs, take_out
from cyclekit.ingest.read.read_logs import Digests, How, check_shared, read_all
from cyclekit.ingest.read.resume import Shelf
from cyclekit.ingest.read.reuse import gather_quarantine
from cyclekit.ingest.shared_events import apart, may_be_shared
from cyclekit.learning.coupling.learn import learn_executions
from cyclekit.learning.coupling.visits import courses_of
from cyclekit.learning.coupling.waits import with_waits_named
from cyclekit.parallel.engine import LOCAL, Engine
from cyclekit.parallel.one_thread import one_thread
from cyclekit.storage.atomic import built, locked, settle, unsettled, write_parquet, write_text
from cyclekit.storage.parquet import StoredTable
from cyclekit.storage.remote.cache import cached, of_file_url
from cyclekit.storage.remote.folders import is_url, mirrored, published
from cyclekit.text.plain_json import finite
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cyclekit.dataset.cards import CouplingCard, LogCard, Note, RecordingCard
    from cyclekit.dataset.dataset import Place
    from cyclekit.dataset.signals import Read

Progress = Callable[[float, str], None]


@dataclass(frozen=True, repr=False)
class IngestReport(Result):
    """What an ingest did.

    Attributes:
        dataset: Its folder on this machine.
        place: Where it was asked for: that folder, or a URL.
        recordings_new: Recordings read now.
        recordings_kept: Recordings taken over from the old dataset without reading their logs.
        not_read: Files that were found and not used, with the reason.
        said: What a person must know before trusting the dataset: name of a recording, empty where it is about all of
            them, and a sentence.
        unchanged: The dataset was up to date; nothing was read or written.
    """

    dataset: Path
    place: str
    recordings_new: int
    recordings_kept: int
    executions: int
    tasks: int
    samples: int
    not_read: tuple[tuple[str, str], ...]
    said: tuple[tuple[str, str], ...]
    unchanged: bool

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a person must know before trusting the dataset, one sentence each."""
        return tuple(f"{name}: {text}" if name else text for name, text in self.said)

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain JSON values."""
        not_read = [{"path": path, "reason": reason} for path, reason in self.not_read]
        found = {name: value for name, value in vars(self).items() if name != "said"}
        return {**found, "dataset": self.place, "not_read": not_read, "warnings": list(self.warnings)}

    def to_frame(self) -> pl.DataFrame:
        """One row per file that was not read."""
        return pl.DataFrame(list(self.not_read), schema={"path": pl.String, "reason": pl.String}, orient="row")

    def _said(self) -> list[str]:
        counts = f"{self.executions} executions, {self.tasks} tasks, {self.samples} samples"
        read = (
            f"{self.recordings_new} recordings read, {self.recordings_kept} kept, {len(self.not_read)} files not read"
        )
        return [f"{self.place}: {counts}", read]


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
    align_clocks: Literal["coarse"] | None = None,
    follow_links: bool = False,
    progress: Progress | None = None,
) -> IngestReport:
    """Read logs into the dataset `out`; what has not changed since the last time is not read again.

    Args:
        logs: Files and folders, by path or URL, one or any mix.
        out: Folder of the dataset, or the URL where it is published when it is complete.
        cell: Cell file; by default `cell.toml` beside the logs, if there is one.
        engine: Where logs are read, and how many at the same time.
        rate_hz: Rate of the samples; by default that of the cell file, or 10 Hz.
        pseudonymise: Keep neither the names that trackers give nor wall-clock time (docs/privacy.md).
        keep_skeletons: Keep every joint of every person, where a tracker has them; no estimate needs it.
        checksums: Keep the BLAKE3 of each log: what was read can then be told from what was not.
        align_clocks: "coarse": last resort for unrelated clocks; hides the reaction time (docs/clocks.md).
        follow_links: Read what links in a folder of logs lead to outside of it; else they are among `not_read`.
        progress: Told the fraction done and what is being done.

    Raises:
        LogError: A log named explicitly cannot be used, or nothing in the folders can.
        ConfigError: The cell file cannot be followed.
        OutputError: The dataset would replace the logs, or what is no dataset.
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
    found, not_read = find_all(roots, settings, follow_links=follow_links)
    how = How(pseudonymise=pseudonymise, skeletons=keep_skeletons, checksums=checksums)
    logs_found = numbered_logs(found) if pseudonymise else found
    wanted = _Wanted(settings, tuple(logs_found), tuple(not_read), engine, how, align_clocks)
    with published(out) as path:
        report = _ingest(roots, path, wanted, progress or (lambda fraction, text: None))
    return replace(report, place=str(out))


def _ingest(roots: Sequence[Path], out: Path, wanted: _Wanted, tell: Progress) -> IngestReport:
    how, count = wanted.how, len(wanted.logs)
    shelf = Shelf(out, "skeletons" if how.skeletons else "plain")
    if not unsettled(out) and not shelf.is_left and (card := _up_to_date(out, wanted)):
        return _report(out, card, new=0, kept=count, unchanged=True)
    with locked(out):
        settle(out)
        if card := _up_to_date(out, wanted):
            shelf.clear()
            return _report(out, card, new=0, kept=count, unchanged=True)
        if how.pseudonymise:
            shelf.clear()  # what an earlier ingest left has names in it
        with shelf.while_making(), built(out) as staging, Digests(wanted=how.checksums) as digests:
            explicit = {path for path in roots if path.is_file()}
            shelved = None if how.pseudonymise else shelf
            names = Names(wanted.logs, roots, wanted.cell) if how.pseudonymise else None
            old = _old(out)
            card, kept = _build(wanted, staging, digests, old, explicit, shelved, names, tell)
            repaired = _repaired(old, (out / CARD).exists())
    report = _report(out, card, new=len(card.recordings) - kept, kept=kept, unchanged=False)
    return replace(report, said=(*(("", text) for text in texts(repaired)), *report.said))


def left_by(out: Path | str) -> Path | None:
    """Return where an ingest that did not come to its end keeps what it has read, None where it keeps nothing.

    Args:
        out: Where its dataset was to be made.
    """
    path = (of_file_url(str(out)) or cached(str(out))) if is_url(out) else Path(out)
    return Shelf(path, "").left


@dataclass(frozen=True)
class _Wanted:
    """What shall be in the dataset."""

    cell: Cell
    logs: tuple[Log, ...]
    not_read: tuple[tuple[str, str], ...]
    engine: Engine
    how: How
    align_clocks: Literal["coarse"] | None = None

    @property
    def fingerprint(self) -> str:
        keys = [log.key for log in self.logs]
        chosen = [*vars(self.how).values(), self.align_clocks]
        facts = [repr(self.cell), version("cyclekit"), schema.SCHEMA_VERSION, keys, self.not_read, chosen]
        return hashlib.sha256(json.dumps(facts).encode()).hexdigest()


def _up_to_date(out: Path, wanted: _Wanted) -> DatasetCard | None:
    old = _old(out)
    same = old is not None and old.card.fingerprint == wanted.fingerprint
    return old.card if old is not None and same and not old.damaged() else None


def _repaired(old: Dataset | None, there: bool) -> list[Note]:
    """Say what of the dataset that is replaced was damaged: it was made anew, and the disk may be failing."""
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
    shelf: Shelf | None,
    names: Names | None,
    tell: Progress,
) -> tuple[DatasetCard, int]:
    """Build the dataset in `staging`, without these names; return its card and how many recordings were taken over."""
    alike = old is not None and old.card.skeletons == wanted.how.skeletons
    intake = read_all(
        wanted.logs,
        staging,
        digests,
        old=None if wanted.how.pseudonymise or not alike else old,
        shelf=shelf,
        engine=wanted.engine,
        how=wanted.how,
        tell=lambda f, text: tell(0.6 * f, text),
    )
    read = intake.cards
    shown = {log.path: log.shown for log in wanted.logs}
    not_read = list(wanted.not_read)
    for error in intake.failed:
        if error.path in explicit or not read:
            raise error
        not_read.append((shown.get(error.path, str(error.path)), error.cause))
    gather_quarantine(read, staging)
    cell = wanted.cell
    sources = {log.id: log.source for log in wanted.logs}
    shares = partial(may_be_shared, sources=sources)
    groups = group_sessions(read, partial(_is_reference, cell), numbered=names is not None, shares=shares)
    shared = apart(groups, partial(_native, staging), staging)
    groups, sources = shared.groups, sources | {name: sources[log] for name, log in shared.copies.items()}
    later, coarse = (lambda fraction, text: tell(0.6 + 0.4 * fraction, text)), wanted.align_clocks == "coarse"
    native, stored = partial(_native, staging), partial(_stored, staging)
    derived = derive(
        groups, sources, native, stored, cell, staging / "samples", later, engine=wanted.engine, coarse=coarse
    )
    warnings = [*derived.warnings, *unpaired(groups), *_unmatched(cell, wanted.logs), *_without_places(read)]
    by_id = {one.id: one for one in digests.settle(derived.recordings)}
    for name, log in shared.copies.items():
        by_id[name] = structs.replace(by_id[name], sources=by_id[log].sources)
    recordings = [by_id[name] for name in (*(one.id for one in read), *shared.copies)]
    if names is not None:
        recordings = take_out(recordings, names, staging, shared.copies)
        warnings = names.notes(warnings)
        cell, not_read = names.settings(), names.not_read(not_read)
    tasks, coupling = _with_waits(derived, native, cell)
    write_parquet(tasks, staging / TASKS)
    derived = replace(derived, tasks=tasks, recordings=recordings, warnings=warnings)
    card = structs.replace(_card(cell, derived, not_read, wanted), coupling=coupling, files=listed(staging))
    values = finite(plain(card))
    write_text(staging / CARD, sealed(json.dumps(values, indent=1, ensure_ascii=False, allow_nan=False) + "\n"))
    return card, intake.kept


def _with_waits(derived: Derived, read: Read, cell: Cell) -> tuple[pl.DataFrame, CouplingCard | None]:
    """Return table TASKS with its waits, and who waits for whom.

    Where anybody waits, an execution is over when both agents are done: the operator's tasks after the robot's last
    one count too.
    """
    tasks = derived.tasks
    courses = courses_of(derived.executions, tasks, derived.recordings, read)
    coupling = learn_executions(courses, tasks, cell.waits)
    if coupling is not None and coupling.coupled:
        tasks = derived.tasks_to_next
        courses = courses_of(derived.executions, tasks, derived.recordings, read)
        coupling = learn_executions(courses, tasks, cell.waits)
    return (tasks if coupling is None else with_waits_named(tasks, courses, coupling)), coupling


def _rate(rate_hz: float) -> float:
    if not 0.1 <= rate_hz <= 1000.0:
        msg = f"a rate of {rate_hz:g} samples a second"
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
        return None  # absent, or of another version: everything is read again


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
    """Say which sources of the cell file mean no log: a slip there would silently change what the logs mean."""
    used = {id(log.source) for log in logs}
    unused = [source.path for source in cell.sources if id(source) not in used]
    unused += [glob for glob in cell.reference if not any(matches(log.shown, log.path, glob) for log in logs)]
    return [note("source-without-log", path=path) for path in unused]


def _card(cell: Cell, derived: Derived, not_read: list[tuple[str, str]], wanted: _Wanted) -> DatasetCard:
    return DatasetCard(
        schema_version=schema.SCHEMA_VERSION,
        cyclekit_version=version("cyclekit"),
        name=cell.name,
        fingerprint=wanted.fingerprint,
        pseudonymised=wanted.how.pseudonymise,
        skeletons=wanted.how.skeletons,
        settings=checked(json.loads(json.dumps(cell, default=vars)), Cell),
        rate_hz=cell.rate_hz,
        recordings=tuple(derived.recordings),
        not_read=tuple(UnreadCard(path=path, reason=reason) for path, reason in not_read),
        executions=tuple(derived.executions),
        places=_places(derived.places),
        human_places=_places(derived.human_places),
        positions=_placed(derived.recordings),
        levels=derived.levels,
        scaling_origin=derived.origin,
        dynamics=DynamicsCard(**asdict(derived.dynamics)),
        operator_signals=derived.operator_signals,
        rows=RowCounts(samples=derived.samples, tasks=derived.tasks.height),
        warnings=tuple(derived.warnings),
    )


def _without_places(logs: Sequence[LogCard]) -> list[Note]:
    """Say so where nothing tells where the robot and the people were."""
    return [note("no-positions")] if all(set(log.tables) <= WITHOUT_PLACES for log in logs) else []


def _placed(recordings: Sequence[RecordingCard]) -> tuple[Literal["robot", "people"], ...]:
    """Return of whom the recordings hold places."""
    placed = {table for one in recordings if one.positions is not False for table in one.tables}
    whose: tuple[Literal["robot", "people"], ...] = ("robot", "people")
    return tuple(each for each in whose if each in placed)


def _places(places: Mapping[str, Place]) -> dict[str, PlaceCard]:
    return {
        name: PlaceCard(xyz_m=one.xyz_m, radius_m=one.radius_m, inferred=one.inferred) for name, one in places.items()
    }


def _shown(card: RecordingCard) -> str:
    """How a message names a recording: by its file, or by its id where a folder is one log."""
    return card.shown if len(card.sources) == 1 else card.id


def _report(out: Path, card: DatasetCard, *, new: int, kept: int, unchanged: bool) -> IngestReport:
    said = [("", text) for text in texts(card.warnings)]
    said += [(_shown(one), text) for one in card.recordings for text in one.said]
    return IngestReport(
        dataset=out,
        place=str(out),
        recordings_new=new,
        recordings_kept=kept,
        executions=len(card.executions),
        tasks=card.rows.tasks,
        samples=card.rows.samples,
        not_read=tuple((one.path, one.reason) for one in card.not_read),
        said=tuple(said),
        unchanged=unchanged,
    )
