"""Registry of adapters, and selection of the adapter for a file.

All adapters, built-in and third-party, are found through the entry-point group `cyclekit.adapters`; cyclekit imports
none by name. Adapters interpret the content. An adapter that fails affects only its own logs.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections import Counter
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, cast

from cyclekit import schema
from cyclekit.adapter import DraftingAdapter, Recording, StreamingAdapter
from cyclekit.dataset.dataset import CARD
from cyclekit.errors import BrokenAdapter, CyclekitError, LogError, UnknownFormat, UnknownName, command_line
from cyclekit.ingest.activities import with_activities
from cyclekit.storage.identify import MODEL_CARD, kind_of_toml
from cyclekit.storage.prefetch import prefetch
from cyclekit.storage.safe_path import leads_out

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from cyclekit.adapter import Adapter, Draft, ReadOptions
    from cyclekit.config.cells import Activity

GROUP = "cyclekit.adapters"
SMALL_BYTES = 1 << 20
_CURE = "Check the file."
_BY_HAND = 'Map its columns in cell.toml, with adapter = "csv" (tasks: "task-list")'
_OLE = b"\xd0\xcf\x11\xe0"
_JSON = re.compile(rb"[\xef\xbb\xbf\s]*(?:\{|\[\s*[\[{\"\d-])")
_ZIP = b"PK\x03\x04"
_PACKED = (_ZIP, b"\x1f\x8b", b"\x28\xb5\x2f\xfd", b"PAR1")
"""First bytes of zip, gzip, zstd and Parquet files."""
_LFS = b"version https://git-lfs.github.com/spec/"


@dataclass(frozen=True)
class Registered:
    """An adapter and its package."""

    name: str
    package: str
    version: str
    summary: str
    adapter: Adapter

    def parts(self, path: Path, options: ReadOptions, activities: Sequence[Activity] = ()) -> Iterator[Recording]:
        """Yield a log in consecutive parts, each read while the previous one is processed, or as one part.

        A small file is read without a thread, because starting one takes time and there may be ten thousand files.

        Args:
            path: The log.
            options: For its adapter.
            activities: States of its signals that become a task list.

        Raises:
            LogError, ConfigError: As the adapter's `read`.
            BrokenAdapter: The adapter raised another error, or did not return a recording.
        """
        try:
            yield from with_activities(map(_proven, self._parts(path, options)), activities, path)
        except CyclekitError:
            raise
        except MemoryError as error:
            raise LogError(path, "too large for the memory", cure=_CURE) from error
        except Exception as error:
            if isinstance(error, OSError) and _is_about(error, path):
                raise LogError(path, f"cannot be read ({error.strerror or error})", cure=_CURE) from error
            raise BrokenAdapter(path, self.name, self.package, _told(error)) from error

    def _parts(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        if not isinstance(self.adapter, StreamingAdapter):
            yield self.adapter.read(path, options)
            return
        parts = self.adapter.stream(path, options)
        yield from parts if path.is_file() and path.stat().st_size < SMALL_BYTES else prefetch(parts)


def _proven(part: object) -> Recording:
    if not isinstance(part, Recording):
        msg = f"returned {type(part).__name__}, not a Recording"
        raise TypeError(msg)
    for name, frame in part.tables().items():
        known, have = schema.OF_LOGS[name], getattr(frame, "columns", ())
        if unknown := [column for column in have if column not in known and not schema.is_joint(column)]:
            msg = f"returned a table {name!r} with unknown columns {', '.join(unknown)}"
            raise ValueError(msg)
        if "t_s" in known and "t_s" not in have:
            msg = f"returned a table {name!r} without column t_s"
            raise ValueError(msg)
    return part


@dataclass(frozen=True)
class LeftOut:
    """An installed adapter that is not used, and the reason."""

    name: str
    package: str
    reason: str

    def __str__(self) -> str:
        """Return the warning as text."""
        return f"adapter {self.name!r} of package {self.package!r} is left out: {self.reason}"


_broken: dict[str, LeftOut] = {}
"""Adapters whose `recognises` raised, by name; not called again in this process."""


def adapters() -> dict[str, Registered]:
    """Return the usable adapters by name, in order of name; `left_out` returns the others."""
    return {name: entry for name, entry in _loaded()[0].items() if name not in _broken}


def left_out() -> tuple[LeftOut, ...]:
    """Return the installed adapters that are not usable: their import failed, or their `recognises`."""
    return (*_loaded()[1], *_broken.values())


def noticed() -> tuple[LeftOut, ...]:
    """Return `left_out()` if this process has loaded adapters, else nothing; loads none."""
    return left_out() if _loaded.cache_info().currsize else ()


@cache
def _loaded() -> tuple[dict[str, Registered], tuple[LeftOut, ...]]:
    found, failed = dict[str, Registered](), list[LeftOut]()
    for point in sorted(entry_points(group=GROUP), key=lambda point: (point.name, _package(point))):
        if point.name in found:
            failed.append(
                LeftOut(point.name, _package(point), f"{found[point.name].package!r} has an adapter of that name")
            )
            continue
        try:
            found[point.name] = _load(point)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # an import may even call sys.exit
            failed.append(LeftOut(point.name, _package(point), f"it cannot be loaded ({_told(error)})"))
    return found, tuple(failed)


def _load(point: EntryPoint) -> Registered:
    adapter = cast("Adapter", point.load())
    if isinstance(adapter, type) or not all(callable(getattr(adapter, name, None)) for name in ("recognises", "read")):
        msg = f"{point.value} is not an adapter: an object with recognises and read"
        raise TypeError(msg)
    doc = inspect.getdoc(sys.modules.get(point.module)) or ""
    version = point.dist.version if point.dist else "unknown"
    return Registered(point.name, _package(point), version, doc.partition("\n")[0].rstrip("."), adapter)


def _package(point: EntryPoint) -> str:
    return point.dist.name if point.dist else point.module


def _told(error: BaseException) -> str:
    """Return an exception as one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}".rstrip(": ")


def _is_about(error: OSError, path: Path) -> bool:
    """Return whether the log itself cannot be read, as opposed to another file of the adapter."""
    return error.filename is None or str(error.filename).startswith(str(path))


def adapter_named(name: str) -> Registered:
    """Return the adapter called `name`.

    Raises:
        UnknownName: There is none.
        CyclekitError: It is not usable.
    """
    known = adapters()
    for broken in left_out():
        if broken.name == name and name not in known:
            raise CyclekitError(str(broken), cure=f"Repair or update package {broken.package}.")
    if name not in known:
        raise UnknownName("adapters", "adapter", name, known)
    return known[name]


def find_adapter(path: Path) -> Registered | None:
    """Return the adapter that recognises `path` (file or folder) by its content; None if there is none."""
    return next((entry for entry in adapters().values() if _recognises(entry, path)), None)


def _recognises(entry: Registered, path: Path) -> bool:
    try:
        return bool(entry.adapter.recognises(path))
    except Exception as error:
        if not (isinstance(error, OSError) and _is_about(error, path)):
            _broken[entry.name] = LeftOut(
                entry.name, entry.package, f"its recognises() failed on {path} ({_told(error)})"
            )
        return False


def drafted(path: Path) -> tuple[Registered, Draft] | None:
    """Return the adapter and the draft map for a file that no adapter recognises; None if no adapter proposes one.

    Raises:
        LogError: The file cannot be read.
        BrokenAdapter: An adapter failed on it.
    """
    for entry in adapters().values():
        if not isinstance(entry.adapter, DraftingAdapter):
            continue
        try:
            draft = entry.adapter.draft(path)
        except CyclekitError:
            raise
        except Exception as error:
            raise BrokenAdapter(path, entry.name, entry.package, _told(error)) from error
        if draft is not None:
            return entry, draft
    return None


def find_logs(path: Path, *, follow_links: bool = True) -> Iterator[tuple[Path, Registered | None]]:
    """Walk `path`; yield each log with its adapter, or with None if no adapter reads it.

    A folder that is itself a log (a ROS 2 bag, a folder of one file per signal) is yielded as one. Below `path`, hidden
    files and datasets are skipped, and so is a folder that was already visited, because links may be circular. Only
    regular files are opened: a pipe or a device may block or never end.

    Args:
        path: A file or a folder.
        follow_links: Follow links below `path` that lead out of it; otherwise yield each with None.
    """
    waiting, seen = [path], set[tuple[int, int]]()
    while waiting:
        here = waiting.pop()
        try:
            if not follow_links and here != path and here.is_symlink() and leads_out(here, path):
                yield here, None
                continue
            is_folder = here.is_dir()
            found = find_adapter(here) if is_folder or (here.is_file() and here.stat().st_size) else None
            if found or not is_folder:
                yield here, found
                continue
            about = here.stat()
            children = sorted(here.iterdir(), reverse=True) if (about.st_dev, about.st_ino) not in seen else []
            seen.add((about.st_dev, about.st_ino))
            waiting += [c for c in children if not c.name.startswith(".") and not (c / CARD).is_file()]
        except OSError:  # a name that is too long, or a folder without permission
            yield here, None


def why_unknown(path: Path) -> UnknownFormat:
    """Return the error for a file that no adapter recognises, with the most likely reason."""
    if path.is_dir():
        return UnknownFormat(path, "the folder cannot be listed", cure="Check its permissions.")
    if not path.exists() and not path.is_symlink():
        return UnknownFormat(path, "no such file or folder", cure="Check the path.")
    if not path.is_file():
        return UnknownFormat(path, "neither a file nor a folder: a pipe, a socket, a device or a broken link")
    if not path.stat().st_size:  # also for system files (/proc), which may take long to read
        return UnknownFormat(path, "the file is empty", cure="Check the copy, or remove the file.")
    with path.open("rb") as file:
        head = file.read(4096)
    if (whose := find_adapter(path.parent)) is not None:
        cause = f"it is part of the folder {path.parent.name!r}, which is one log of adapter {whose.name!r}"
        return UnknownFormat(path, cause, cure="Name the folder.")
    known = ", ".join(adapters())
    cure = f"cyclekit reads: {known} (see `cyclekit adapters`)."
    if head.startswith(_LFS):
        return UnknownFormat(
            path, "this is a Git LFS pointer, not the log itself", cure="Fetch the content first: git lfs pull"
        )
    if path.suffix.lower() == ".toml":
        name, taken_by = kind_of_toml(path)
        return UnknownFormat(
            path, f"a TOML file, not a log; it looks like {name}", cure=f"Use it like this: {taken_by}"
        )
    if path.name in (CARD, MODEL_CARD):
        look = command_line("inspect", path.parent)
        return UnknownFormat(path, "part of a dataset or model, not a log", cure=f"Look at it: {look}")
    if _JSON.match(head):
        return UnknownFormat(path, "JSON that no adapter recognises", cure=_as_parquet(path, head) or cure)
    cells = max(head.count(separator) for separator in (b",", b";", b"\t")) + 1
    if len(head) < 4096 and b"\0" not in head and cells > 3 and len(head.strip().splitlines()) == 1:
        return UnknownFormat(path, "a single line: a header and no rows", cure="Record again, or remove the file.")
    if head.startswith(_OLE):
        cause = "an old Excel workbook (.xls), or one with a password"
        return UnknownFormat(path, cause, cure="Save it as .xlsx without a password, or as CSV.")
    if _is_table(head):
        cause = f"a table that no adapter recognises: {_BY_HAND[0].lower()}{_BY_HAND[1:]}"
        draft = command_line("inspect", path, "--write-cell", path.with_suffix(".toml"))
        return UnknownFormat(path, f"{cause} (docs/adapters.md)", cure=f"Draft the map: {draft}")
    if head.startswith(_PACKED):
        draft = command_line("inspect", path, "--write-cell", path.with_suffix(".toml"))
        cure = f"If it holds one table, draft its map: {draft}"
        return UnknownFormat(path, "packed, and no adapter recognises its content", cure=cure)
    return UnknownFormat(path, "no adapter recognises this content", cure=cure)


def _as_parquet(path: Path, head: bytes) -> str:
    """Return the command that makes a table of a file of JSON records; empty if it holds none."""
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    lines = len(text.splitlines()) > 1 and text.splitlines()[1].startswith(b"{")
    if not (lines or re.match(rb"\[\s*\{", text)):
        return ""
    read = "read_ndjson" if lines else "read_json"
    made = path.with_suffix(".parquet")
    code = f"import polars; polars.{read}({path.as_posix()!r}).write_parquet({made.as_posix()!r})"
    return f'Make a table of it, which is read or mapped: python -c "{code}"'


def without_draft(path: Path) -> UnknownFormat | None:
    """Return the error for a table of which no adapter proposes a map; None if the file is no table."""
    with path.open("rb") as file:
        head = file.read(4096)
    if head.startswith(_ZIP) and not _is_table(head):
        cure = f"Unpack it: python -m zipfile -e {path} {path.stem}"
        return UnknownFormat(path, "a zip archive of several files, or of one that is no table", cure=cure)
    if _JSON.match(head) or not (_is_table(head) or head.startswith(_PACKED)):
        return None
    cause = "no map can be drafted: it has no rows of numbers or times in as many cells as a line of names"
    return UnknownFormat(path, cause, cure=f"{_BY_HAND}, by hand (docs/adapters.md).")


def _is_table(head: bytes) -> bool:
    """Return whether data looks like a table: most lines with as many cells, rows of numbers, or a workbook."""
    if head.startswith(_ZIP):
        return b"[Content_Types].xml" in head or b"xl/" in head
    lines = head.strip().splitlines()[:12]
    if b"\0" in head or not lines:
        return False
    numbers = {len(line.split()) for line in lines[1:-1] or lines if re.fullmatch(rb"[\s\d.,eE+-]+", line)}
    often = {mark: Counter(line.count(mark) for line in lines).most_common(1)[0] for mark in (b",", b";", b"\t")}
    return (len(numbers) == 1 and max(numbers) > 2) or any(
        2 * rows > len(lines) and marks > (mark == b",") for mark, (marks, rows) in often.items()
    )
