"""Which adapters exist, and which one reads this file.

Adapters are found through the entry-point group `cyclekit.adapters`, ours and third parties' alike; cyclekit imports
none by name. What a file contains is the adapters' business.
"""

from __future__ import annotations

import inspect
import sys
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, cast

from cyclekit.adapter import StreamingAdapter
from cyclekit.ahead import ahead
from cyclekit.dataset import CARD
from cyclekit.errors import CyclekitError, UnknownFormat, UnknownName
from cyclekit.inside import leads_out

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from cyclekit.adapter import Adapter, ReadOptions, Recording

GROUP = "cyclekit.adapters"
SMALL_BYTES = 1 << 20
_LFS = b"version https://git-lfs.github.com/spec/"


@dataclass(frozen=True)
class Registered:
    """An adapter and where it comes from."""

    name: str
    package: str
    version: str
    summary: str
    adapter: Adapter

    def parts(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        """Yield a log in consecutive parts, each read while the one before it is worked on; one part if need be.

        Of a small file no thread reads ahead: to begin one takes a while, and there may be ten thousand of them.

        Raises:
            LogError, ConfigError: As the adapter's `read`.
        """
        if not isinstance(self.adapter, StreamingAdapter):
            yield self.adapter.read(path, options)
            return
        parts = self.adapter.stream(path, options)
        yield from parts if path.is_file() and path.stat().st_size < SMALL_BYTES else ahead(parts)


@cache
def adapters() -> dict[str, Registered]:
    """Return all adapters by name, in order of name.

    Raises:
        CyclekitError: An installed adapter cannot be imported; the message names its package.
    """
    return {point.name: _load(point) for point in sorted(entry_points(group=GROUP), key=lambda p: p.name)}


def _load(point: EntryPoint) -> Registered:
    package = point.dist.name if point.dist else point.module
    try:
        adapter = cast("Adapter", point.load())
    except Exception as error:
        msg = f"adapter {point.name!r} of package {package!r} cannot be loaded: {error}"
        raise CyclekitError(msg, cure="Install that package again, or uninstall it.") from error
    doc = inspect.getdoc(sys.modules[point.module]) or ""
    version = point.dist.version if point.dist else "unknown"
    return Registered(point.name, package, version, doc.partition("\n")[0].rstrip("."), adapter)


def adapter_named(name: str) -> Registered:
    """Return the adapter called `name`.

    Raises:
        UnknownName: There is none.
    """
    known = adapters()
    if name not in known:
        raise UnknownName("adapters", "adapter", name, known)
    return known[name]


def find_adapter(path: Path) -> Registered | None:
    """Return the adapter that recognises `path` (file or folder) by its content, or None."""
    return next((entry for entry in adapters().values() if entry.adapter.recognises(path)), None)


def find_logs(path: Path, *, follow_links: bool = True) -> Iterator[tuple[Path, Registered | None]]:
    """Walk `path`; yield each log with the adapter that reads it, None for what nobody reads.

    A folder that is itself a log (a ROS 2 bag, a folder of one file per signal) is yielded as one. Below `path`,
    hidden files and datasets are passed over, and so is a folder that was seen already: links may lead in circles.
    Nothing is opened but files: a pipe or a device would wait for ever, or never end.

    Args:
        path: A file or a folder.
        follow_links: Follow links below `path` that lead out of it; else each is what nobody reads.
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
        except OSError:  # a name that is too long, a folder that may not be listed
            yield here, None


def why_unknown(path: Path) -> UnknownFormat:
    """Return the error for a file that no adapter recognises, with the likeliest reason first."""
    if path.is_dir():
        return UnknownFormat(path, "the folder cannot be listed", cure="Check its rights.")
    if not path.is_file():
        return UnknownFormat(path, "neither a file nor a folder: a pipe, a socket, a device or a broken link")
    if not path.stat().st_size:  # of a file of the system (/proc) too, which may take long to read
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
    if head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith((b"{", b"[")):
        return UnknownFormat(path, "JSON of a kind that no adapter recognises", cure=cure)
    cells = max(head.count(separator) for separator in (b",", b";", b"\t")) + 1
    if len(head) < 4096 and b"\0" not in head and cells > 3 and len(head.strip().splitlines()) == 1:
        return UnknownFormat(path, "a single line: a header and no rows", cure="Record again, or remove the file.")
    if b"\0" not in head and (b"," in head or b";" in head or b"\t" in head):
        cure += ' For a table of your own, map its columns in cell.toml with adapter = "csv".'
    return UnknownFormat(path, "no adapter recognises this content", cure=cure)
