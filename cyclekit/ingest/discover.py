"""Discovery of logs: walks files and folders, matches them with the cell file, finds their adapters by content.

Only the first bytes of a file are read here; `ingest` reads the logs.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections import Counter
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING

from cyclekit import schema
from cyclekit.adapter import ReadOptions
from cyclekit.config import Cell, NamedPlace, Robot, Source, load_cell
from cyclekit.config.arms import model_by_joints
from cyclekit.dataset.dataset import CARD, Dataset
from cyclekit.errors import ConfigError, CyclekitError, LogError
from cyclekit.ingest.merge_sources import kind_of, merge_similar
from cyclekit.ingest.registry import Registered, adapter_named, drafted, find_logs, why_unknown, without_draft
from cyclekit.storage.files import resolved
from cyclekit.storage.identify import kind_of_path
from cyclekit.storage.safe_path import leads_out, real_path, valid_name
from cyclekit.text.plain_text import one_line

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from cyclekit.adapter import Draft
    from cyclekit.config.cells import Activity

CELL_FILE = "cell.toml"
_MAX_ALIKE, _MAX_TRIED = 5, 500
_READ_BYTES = 100_000_000
"""Maximum size of a log that is read for the names of its joints: a second."""
_OF_USE = {"x", "joints", "scaling", "signal", "tags", "task"}
"""Keys of which a draft for a table in a folder must have at least one; otherwise the table is probably no log."""


@dataclass(frozen=True)
class Log:
    """One log to read: path, adapter, options, and a key that changes when any of these does."""

    id: str
    path: Path
    shown: str
    adapter: str
    package: str
    version: str
    source: Source | None
    key: str
    size: int = 0
    robot: Robot | None = None

    @property
    def activities(self) -> tuple[Activity, ...]:
        """The states of its signals that are tasks."""
        return self.source.activities if self.source else ()


@dataclass(frozen=True)
class Suggested:
    """A cell file to start from.

    Attributes:
        cell: Its content.
        drafts: Path -> draft, for sources that no adapter recognises.
    """

    cell: Cell
    drafts: Mapping[str, Draft] = field(default_factory=dict)


def cell_for(roots: Sequence[Path], given: Path | None) -> Cell:
    """Return the given cell file, else the one next to the logs, else the defaults.

    Raises:
        ConfigError: The file is invalid, or there are two.
    """
    if given is not None:
        return load_cell(given)
    folders = dict.fromkeys(path if path.is_dir() else path.parent for path in roots)
    files = [folder / CELL_FILE for folder in folders if (folder / CELL_FILE).is_file()]
    if len(files) > 1:
        msg = f"two cell files beside the logs: {files[0]} and {files[1]}"
        raise ConfigError(msg, cure="Choose one with --cell.")
    return load_cell(files[0]) if files else Cell(name=resolved(roots[0]).stem)


def suggest_cell(paths: Sequence[Path], *, follow_links: bool = False) -> Suggested:
    """Return the cell file that an ingest of these paths would use, for the user to complete.

    A dataset also gives its places. Logs give one source each; unknown tables give a draft of one.

    Raises:
        CyclekitError: As `ingest`, for paths that cannot be used.
    """
    if len(paths) == 1 and (paths[0] / CARD).is_file():
        dataset = Dataset.open(paths[0])
        known = Cell(
            name=dataset.card.name,
            places={name: NamedPlace(p.xyz_m, max(p.radius_m, 0.01)) for name, p in dataset.places.items()},
            human_places={name: NamedPlace(p.xyz_m, p.radius_m) for name, p in dataset.human_places.items()},
        )
        return Suggested(known)
    cell = cell_for(paths, None)
    drafts, unread = _drafts(paths, cell, follow_links=follow_links)
    try:
        logs, _ = find_all(paths, cell, follow_links=follow_links)
    except LogError:
        if not drafts:
            raise
        logs = []
    named = {source.path: source for log in logs for source in [log.source or Source(log.shown, log.adapter)]}
    sources, drafts_of = merge_similar(list(named.values()), drafts, unread)
    robot = cell.robot or next((Robot(model) for model in map(model_by_joints, _arms(logs, drafts)) if model), None)
    return Suggested(replace(cell, sources=tuple(sources), robot=robot), drafts_of)


def _arms(logs: Sequence[Log], drafts: Mapping[str, tuple[str, Draft]]) -> Iterator[Sequence[str]]:
    """Yield the names of the joints of logs that hold joint angles without a TCP, of one log of each kind."""
    for _, draft in drafts.values():
        keys = {line.key: line.value for line in draft.map if line.sure}
        if isinstance(joints := keys.get("joints"), list) and "x" not in keys:
            yield joints
    for log in {kind_of(log.shown): log for log in reversed(logs) if log.size <= _READ_BYTES}.values():
        try:
            part = next(iter(adapter_named(log.adapter).parts(log.path, options_of(log.source))), None)
        except CyclekitError:  # `ingest` says it
            continue
        if (
            part is not None
            and part.robot is not None
            and not schema.conform(part.robot, schema.ROBOT)["tcp_x_m"].count()
        ):
            yield part.joint_names


def _drafts(roots: Sequence[Path], cell: Cell, *, follow_links: bool) -> tuple[dict[str, tuple[str, Draft]], list[str]]:
    """Return drafts for files that no adapter reads, with the proposing adapter, and the names of all such files.

    Only the first few files of each kind are drafted.
    """
    found: dict[str, tuple[str, Draft]] = {}
    prefixes, tried = _prefixes(roots), 0
    kinds: Counter[str] = Counter()
    unread: list[str] = []
    for root in roots:
        base = root if root.is_dir() else root.parent
        for path, registered in _candidates(root, prefixes[base], cell, follow_links=follow_links):
            shown, is_text = _as_text(prefixes[base] + path.relative_to(base).as_posix())
            known = registered is not None or _source(cell, path, root, prefixes[base]) is not None
            away = not follow_links and leads_out(path, root)
            if known or away or not is_text or not path.is_file() or not path.stat().st_size:
                continue
            unread.append(shown)
            if tried >= _MAX_TRIED or kinds[kind_of(shown)] >= _MAX_ALIKE:
                continue
            tried += 1
            try:
                proposed = drafted(path)
            except CyclekitError:  # an error for a file given explicitly; other files are just no logs
                if path in roots:
                    raise
                continue
            if proposed is None and path in roots and (none := without_draft(path)):
                raise none
            if proposed is not None and (path in roots or any(p.key in _OF_USE and p.value for p in proposed[1].map)):
                found[shown] = (proposed[0].name, proposed[1])
                kinds[kind_of(shown)] += 1
    return found, unread


def find_all(
    roots: Sequence[Path], cell: Cell, *, follow_links: bool = False
) -> tuple[list[Log], list[tuple[str, str]]]:
    """Return the logs in files and folders, and the files that no adapter reads with reasons.

    Args:
        roots: Files and folders.
        cell: Cell file, with files to ignore and adapters to use.
        follow_links: Follow links that lead out of a folder; otherwise they are listed as not read.

    Raises:
        UnknownFormat: A file given explicitly is no log.
        LogError: There is no log.
        UnknownName: The cell file names an unknown adapter.
    """
    logs: dict[str, Log] = {}
    not_read: list[tuple[str, str]] = []
    unknown: LogError | None = None
    prefixes = _prefixes(roots)
    seen: set[str] = set()
    for root in roots:
        if (kind := kind_of_path(root)) in ("a dataset", "a model"):
            raise LogError(root, f"is {kind}, and no log", cure="Give the logs, as they came from robot and tracker.")
        base = root if root.is_dir() else root.parent
        for path, registered in _candidates(root, prefixes[base], cell, follow_links=follow_links):
            if (here := real_path(path)) in seen:  # given as a file, and again by its folder
                continue
            seen.add(here)
            source = _source(cell, path, root, prefixes[base])
            shown, is_text = _as_text(prefixes[base] + _within(path, root))
            reader = adapter_named(source.adapter) if source and source.adapter else registered
            try:
                away = not follow_links and _leads_out(path, root)
                known = reader if is_text and not away and (path.is_file() or path.is_dir()) else None
                log = _log(path, shown, known, source, logs, cell.robot) if known else None
                if log is None:
                    unknown = _no_text(path) if not is_text else _no_way_out(path) if away else why_unknown(path)
            except OSError as error:  # removed, or unreadable, since its folder was listed
                log, unknown = None, LogError(path, f"cannot be read ({error.strerror})", cure="Check the file.")
            if log is not None:
                logs[log.id] = log
            elif unknown is not None:
                if path in roots:
                    raise unknown
                not_read.append((shown, unknown.cause))
    if not logs:
        cure = "Give files, or a folder that holds logs; `cyclekit adapters` lists what can be read."
        cause = f"holds no log that can be read ({_some(not_read)})" if not_read else "holds no file"
        if not not_read and roots[0].suffix == ".toml" and roots[0].is_file():
            cause, cure = "is a cell file, and no log", f"Give the folder of logs, and --cell {roots[0]}."
        raise unknown if unknown and len(not_read) == 1 else LogError(roots[0], cause, cure=cure)
    return list(logs.values()), not_read


def _as_text(name: str) -> tuple[str, bool]:
    """Return a name in printable form, in one line, and whether it is valid text."""
    text = name.encode("utf-8", "backslashreplace").decode()
    return one_line(text), text == name


def _leads_out(path: Path, root: Path) -> bool:
    """Return whether a log is outside of the given folder, completely or in part."""
    if leads_out(path, root):
        return True
    return path.is_dir() and any(leads_out(file, path) and leads_out(file, root) for file in files_of(path))


def _no_way_out(path: Path) -> LogError:
    return LogError(path, "a link leads out of the folder of logs; --follow-links reads it too")


def _no_text(path: Path) -> LogError:
    return LogError(path, "its name is not text in UTF-8 and cannot be stored", cure="Rename it.")


def _some(not_read: Sequence[tuple[str, str]], count: int = 3) -> str:
    """Return the first few files that no adapter reads, with reasons."""
    shown = "; ".join(f"{name}: {reason}" for name, reason in not_read[:count])
    more = len(not_read) - count
    return f"{shown}; and {more} more" if more > 0 else shown


def _prefixes(roots: Sequence[Path]) -> dict[Path, str]:
    """Return the prefix that distinguishes the logs of each folder: its path below the common parent."""
    bases = dict.fromkeys(root if root.is_dir() else root.parent for root in roots)
    whole = {base: resolved(base) for base in bases}
    if len(set(whole.values())) == 1:
        return dict.fromkeys(bases, "")
    common = Path(os.path.commonpath(whole.values())) if len({path.drive for path in whole.values()}) == 1 else None
    below = {base: path.relative_to(common) if common else Path(path.name) for base, path in whole.items()}
    return {base: "" if path == Path() else f"{path.as_posix()}/" for base, path in below.items()}


def _candidates(root: Path, prefix: str, cell: Cell, *, follow_links: bool) -> Iterable[tuple[Path, Registered | None]]:
    for path, registered in find_logs(root, follow_links=follow_links):
        if path.name != CELL_FILE and not any(_means(pattern, path, root, prefix) for pattern in cell.ignore):
            yield path, registered


def _within(path: Path, root: Path) -> str:
    """Return the name of a log within the folder that was given, or whose file was."""
    base = root if root.is_dir() else root.parent
    return path.relative_to(base).as_posix() if path != base else path.name


def _source(cell: Cell, path: Path, root: Path, prefix: str) -> Source | None:
    """Return the first source of the cell file that means a log."""
    return next((source for source in cell.sources if _means(source.path, path, root, prefix)), None)


def _means(pattern: str, path: Path, root: Path, prefix: str) -> bool:
    """Return whether a path or glob of the cell file means a log, found in `root` and shown with a prefix.

    It is relative to the folder of logs. Of a log that was given itself, that may be any folder above it.
    """
    within = _within(path, root)
    if any(matches(name, path, pattern) for name in (within, prefix + within)):
        return True
    return path == root and fnmatchcase(resolved(path).as_posix(), f"*/{Path(pattern).as_posix()}")


def matches(shown: str, path: Path, pattern: str) -> bool:
    """Return whether a path or glob of the cell file matches a log by the name that is shown of it."""
    wanted = Path(pattern).as_posix()
    return shown == wanted or shown.startswith(f"{wanted}/") or fnmatchcase(shown, wanted) or str(path) == pattern


def _log(
    path: Path, shown: str, reader: Registered, source: Source | None, taken: dict[str, Log], robot: Robot | None
) -> Log:
    slug = valid_name(re.sub(r"[^A-Za-z0-9_.-]+", "_", Path(shown).with_suffix("").as_posix().replace("/", ".")))
    name, number = slug, 1
    while name in taken:
        number += 1
        name = f"{slug}-{number}"
    log = Log(name, path, shown, reader.name, reader.package, reader.version, source, "", robot=robot)
    return replace(log, key=key_of(log), size=sum(file.stat().st_size for file in files_of(log.path)))


def key_of(log: Log) -> str:
    """Return a hash that changes with the log, its adapter or its options.

    Raises:
        OSError: A file of the log has gone.
    """
    facts = [str(resolved(log.path)), log.adapter, log.version, repr(options_of(log.source)), schema.SCHEMA_VERSION]
    facts += [repr(each) for each in (log.robot, log.activities) if each]
    if log.source is not None and log.source.role == "robot":
        facts += [repr((log.source.clock_offset_s, log.source.clock_rate))]  # its stored times depend on them
    stats = [(file.name, file.stat().st_size, file.stat().st_mtime_ns) for file in files_of(log.path)]
    return hashlib.sha256(json.dumps([facts, stats]).encode()).hexdigest()


def files_of(path: Path) -> list[Path]:
    """Return the files of a log: itself, or all files in a folder that is one log."""
    return sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]


def options_of(source: Source | None, *, skeletons: bool = False) -> ReadOptions:
    """Return the adapter options for a source of the cell file."""
    if source is None:
        return ReadOptions(skeletons=skeletons)
    return ReadOptions(
        role=source.role,
        map=source.map,
        body=source.body,
        flange=source.sees_as,
        rate_hz=source.rate_hz,
        frame_given=source.frame is not None,
        skeletons=skeletons,
    )
