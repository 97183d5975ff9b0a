"""Logs of any supported kind -> one dataset.

Finds the logs, lets each adapter read its own, keeps the native-rate tables with their provenance, puts recordings
that belong together into sessions and has `derive` compute samples and tasks. What is unchanged since the last ingest
is not read again. Everything is built beside the dataset and swapped in at the end, so a killed ingest leaves the old
dataset or the new one.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import polars as pl

from cyclekit import schema
from cyclekit.config import Cell
from cyclekit.dataset.dataset import CARD, TASKS, Dataset
from cyclekit.dataset.guard import check_output
from cyclekit.dataset.sessions import WITHOUT_PLACES, group_sessions, unpaired
from cyclekit.derive.passes import Derived, derive
from cyclekit.errors import ConfigError, DatasetError, LogError
from cyclekit.ingest.discover import Log, cell_for, find_all, matches
from cyclekit.ingest.pseudonymise import Names, numbered_logs, take_out
from cyclekit.ingest.read.read_logs import Digests, How, check_shared, read_all
from cyclekit.ingest.read.resume import Shelf
from cyclekit.ingest.read.reuse import gather_quarantine
from cyclekit.parallel.engine import LOCAL, Engine
from cyclekit.parallel.one_thread import one_thread
from cyclekit.storage.atomic import built, locked, settle, unsettled, write_parquet, write_text
from cyclekit.storage.checksums import listed, sealed
from cyclekit.storage.parquet import StoredTable
from cyclekit.storage.remote.cache import cached, of_file_url
from cyclekit.storage.remote.folders import is_url, mirrored, published
from cyclekit.text.plain_json import finite

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class IngestReport:
    """What an ingest did.

    Attributes:
        dataset: Its folder on this machine.
        place: Where it was asked for: that folder, or a URL.
        recordings_new: Recordings read now.
        recordings_kept: Recordings taken over from the old dataset without reading their logs.
        not_read: Files that were found and not used, with the reason.
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
    warnings: tuple[str, ...]
    unchanged: bool

    def to_json(self) -> dict[str, Any]:
        """Return the report as plain JSON values."""
        not_read = [{"path": path, "reason": reason} for path, reason in self.not_read]
        return {**vars(self), "dataset": self.place, "not_read": not_read, "warnings": list(self.warnings)}


@one_thread()
def ingest(
    logs: Sequence[Path | str],
    out: Path | str,
    *,
    cell: Path | Cell | None = None,
    engine: Engine = LOCAL,
    rate_hz: float | None = None,
    pseudonymise: bool = False,
    keep_skeletons: bool = False,
    checksums: bool = True,
    align_clocks: Literal["coarse"] | None = None,
    follow_links: bool = False,
    progress: Progress | None = None,
) -> IngestReport:
    """Read logs into the dataset `out`, replacing what was there.

    Args:
        logs: Files and folders, by path or URL, any mix.
        out: Folder of the dataset, or the URL where it is published when it is complete.
        cell: Cell file; by default `cell.toml` beside the logs, if there is one.
        engine: Where logs are read, and how many at the same time.
        rate_hz: Rate of the samples, in place of the cell file's.
        pseudonymise: Keep neither the names that trackers give nor wall-clock time (docs/privacy.md).
        keep_skeletons: Keep every joint of every person, where a tracker has them; no estimate needs it.
        checksums: Keep the BLAKE3 of each log: what was read can then be told from what was not.
        align_clocks: "coarse" = where nothing says how a log's clock relates to the robot's, align on the operator
            being near while the robot slows. Hides the reaction delay, and says so (docs/clocks.md).
        follow_links: Read what links in a folder of logs lead to outside of it; else they are among `not_read`.
        progress: Told the fraction done and what is being done.

    Raises:
        LogError: A log named explicitly cannot be used, or nothing in the folders can.
        ConfigError: The cell file cannot be followed.
        OutputError: The dataset would replace the logs, or what is no dataset.
        BusyPlace: Another process is writing the dataset.
        CyclekitError: The dataset cannot be written.
    """
    check_output(out, "dataset", [*logs, cell if isinstance(cell, Path) else None])
    roots = [mirrored(place) for place in logs]
    _check_logs(roots)
    settings = cell if isinstance(cell, Cell) else cell_for(roots, cell)
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
    report = _report(out, card, new=len(card["recordings"]) - kept, kept=kept, unchanged=False)
    return replace(report, warnings=(*repaired, *report.warnings))


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


def _up_to_date(out: Path, wanted: _Wanted) -> dict[str, Any] | None:
    old = _old(out)
    same = old is not None and old.card.get("fingerprint") == wanted.fingerprint
    return old.card if old is not None and same and not old.damaged() else None


def _repaired(old: Dataset | None, there: bool) -> list[str]:
    """Say what of the dataset that is replaced was damaged: it was made anew, and the disk may be failing."""
    if old is None:
        return ["the dataset that was there was damaged, or of another version, and was made anew"] if there else []
    damaged = list(old.damaged().items())
    some = ", ".join(f"{name} ({what})" for name, what in damaged[:3]) + (" and more" if len(damaged) > 3 else "")
    return [f"made anew, since the dataset was not as it was written: {some}"] if damaged else []


def _build(
    wanted: _Wanted,
    staging: Path,
    digests: Digests,
    old: Dataset | None,
    explicit: set[Path],
    shelf: Shelf | None,
    names: Names | None,
    tell: Progress,
) -> tuple[dict[str, Any], int]:
    """Build the dataset in `staging`, without these names; return its card and how many recordings were taken over."""
    alike = old is not None and old.card.get("skeletons") == wanted.how.skeletons
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
    entries, kept = intake.entries, intake.kept
    shown = {log.path: log.shown for log in wanted.logs}
    not_read = list(wanted.not_read)
    for error in intake.failed:
        if error.path in explicit or not entries:
            raise error
        not_read.append((shown.get(error.path, str(error.path)), error.cause))
    gather_quarantine(entries, staging)
    cell = wanted.cell
    sources = {log.id: log.source for log in wanted.logs}
    sessions = group_sessions(entries, partial(_is_reference, cell), numbered=names is not None)
    later, coarse = (lambda fraction, text: tell(0.6 + 0.4 * fraction, text)), wanted.align_clocks == "coarse"
    native, stored = partial(_native, staging), partial(_stored, staging)
    derived = derive(
        sessions, sources, native, stored, cell, staging / "samples", later, engine=wanted.engine, coarse=coarse
    )
    derived.warnings.extend([*unpaired(sessions), *_unmatched(cell, wanted.logs), *_without_places(entries)])
    digests.settle(entries)
    if names is not None:
        take_out(entries, names, staging)
        derived.warnings[:] = map(names.said, derived.warnings)
        cell, not_read = names.settings(), names.not_read(not_read)
    write_parquet(derived.tasks, staging / TASKS)
    card = _card(cell, entries, derived, not_read, wanted) | {"files": listed(staging)}
    write_text(staging / CARD, sealed(json.dumps(finite(card), indent=1, ensure_ascii=False, allow_nan=False) + "\n"))
    return card, kept


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
    file = staging / "recordings" / recording / f"{table}.parquet"
    return pl.read_parquet(file, glob=False) if file.is_file() else None


def _stored(staging: Path, recording: str, columns: Sequence[str]) -> StoredTable:
    check_shared(staging)
    return StoredTable(staging / "recordings" / recording / "robot.parquet", columns)


def _is_reference(cell: Cell, shown: str) -> bool:
    return any(matches(shown, Path(shown), pattern) for pattern in cell.reference)


def _unmatched(cell: Cell, logs: Sequence[Log]) -> list[str]:
    """Say which sources of the cell file mean no log: a slip there would silently change what the logs mean."""
    used = {id(log.source) for log in logs}
    unused = [source.path for source in cell.sources if id(source) not in used]
    unused += [glob for glob in cell.reference if not any(matches(log.shown, log.path, glob) for log in logs)]
    return [f"the cell file speaks of {path!r}, and no log is meant by it" for path in unused]


def _card(
    cell: Cell, entries: list[dict[str, Any]], derived: Derived, not_read: list[tuple[str, str]], wanted: _Wanted
) -> dict[str, Any]:
    return {
        "schema_version": schema.SCHEMA_VERSION,
        "cyclekit_version": version("cyclekit"),
        "name": cell.name,
        "fingerprint": wanted.fingerprint,
        "pseudonymised": wanted.how.pseudonymise,
        "skeletons": wanted.how.skeletons,
        "settings": json.loads(json.dumps(cell, default=lambda value: vars(value))),
        "rate_hz": cell.rate_hz,
        "recordings": entries,
        "not_read": [{"path": path, "reason": reason} for path, reason in not_read],
        "executions": derived.executions,
        "places": {name: _without_name(place) for name, place in derived.places.items()},
        "human_places": {name: _without_name(place) for name, place in derived.human_places.items()},
        "positions": _placed(entries),
        "levels": list(derived.levels),
        "scaling_origin": derived.origin,
        "dynamics": asdict(derived.dynamics),
        "rows": {"samples": derived.samples, "tasks": derived.tasks.height},
        "warnings": derived.warnings,
    }


def _without_places(entries: list[dict[str, Any]]) -> list[str]:
    """Say so where nothing tells where the robot and the people were."""
    if all(set(entry["tables"]) <= WITHOUT_PLACES for entry in entries):
        return ["no positions: nothing tells where robot and people were, so no motion or safety can be learned"]
    return []


def _placed(entries: list[dict[str, Any]]) -> list[str]:
    """Return of whom the recordings hold places."""
    placed = [entry["tables"] for entry in entries if entry.get("positions") is not False]
    return [whose for whose in ("robot", "people") if any(whose in tables for tables in placed)]


def _without_name(place: object) -> dict[str, Any]:
    return {key: value for key, value in vars(place).items() if key != "name"}


def _shown(entry: dict[str, Any]) -> str:
    """How a message names a recording: by its file, or by its id where a folder is one log."""
    return str(entry["sources"][0]["path"] if len(entry["sources"]) == 1 else entry["id"])


def _report(out: Path, card: dict[str, Any], *, new: int, kept: int, unchanged: bool) -> IngestReport:
    warnings = [*card["warnings"], *(f"{_shown(e)}: {text}" for e in card["recordings"] for text in e["warnings"])]
    return IngestReport(
        dataset=out,
        place=str(out),
        recordings_new=new,
        recordings_kept=kept,
        executions=len(card["executions"]),
        tasks=card["rows"]["tasks"],
        samples=card["rows"]["samples"],
        not_read=tuple((entry["path"], entry["reason"]) for entry in card["not_read"]),
        warnings=tuple(warnings),
        unchanged=unchanged,
    )
