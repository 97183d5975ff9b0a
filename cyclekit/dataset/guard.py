"""Check of output paths: a command never overwrites an input, or a file that cyclekit did not write.

One rule for every command that writes. An output is refused if it is an input, lies in an input folder, or is a folder
that holds an input. Links are resolved, and another name of the same file (a hard link, another case on a
case-insensitive disk) counts as the file. An existing output is replaced only if cyclekit wrote it as that kind of
thing, which its content shows; an empty file or folder may always be replaced. A device or a pipe is written into
(`atomic.replaced`), so nothing is lost.
"""

from __future__ import annotations

import os
import re
import stat
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from cyclekit import schema
from cyclekit.errors import OutputError
from cyclekit.storage.outputs import check_writable, check_writable_folder
from cyclekit.storage.remote.cache import of_file_url
from cyclekit.storage.remote.folders import is_url
from cyclekit.storage.workbook import MARK

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    PathOrUrl = Path | str

_ENDS_BYTES = 1 << 16
"""Bytes read from both ends of a file, which contain all marks."""
_COLUMNS = "|".join([*schema.ROBOT, *schema.PEOPLE, *schema.EVENTS, *schema.SKELETONS])


@dataclass(frozen=True)
class _Kind:
    """A kind of output: its name in messages, and how it is recognised as written by cyclekit.

    Attributes:
        mark: Pattern in one of the ends of a file.
        holds: Name of a file in a folder; "" = any folder will do, since only single files in it are replaced.
    """

    name: str
    mark: bytes = b""
    holds: str = ""

    @property
    def is_folder(self) -> bool:
        return not self.mark


Kind = Literal[
    "dataset", "model", "logs", "folder", "page", "words", "report-json", "report-csv", "estimates-json",
    "estimates-csv", "what-if", "sequences", "table-csv", "table-parquet", "replay", "onnx", "rule", "picture", "pdf",
    "fleet", "cell", "workbook",
]  # fmt: skip
_KINDS: dict[Kind, _Kind] = {
    "dataset": _Kind("dataset", holds="dataset.json"),
    "model": _Kind("model", holds="model.json"),
    "logs": _Kind("simulation", holds="truth/truth.json"),
    "folder": _Kind("folder"),
    "page": _Kind("page", rb'name="generator" content="cyclekit|<!-- written by cyclekit'),
    "words": _Kind("report", rb"<!-- written by cyclekit"),
    "report-json": _Kind("report", rb'\A\s*\{\s*"cell":.{0,2000}?"made":'),
    "report-csv": _Kind("report", rb"\Asequence,order,task,expected_s,"),
    "estimates-json": _Kind("estimate", rb'\A\s*\{.{0,9000}?"sequences": ?\['),
    "estimates-csv": _Kind("estimate", rb"\Aname,expected_s,expected_low_s,"),
    "what-if": _Kind("what-if", rb'\A\s*\{\s*"safety":.{0,9000}?"answers": ?\['),
    "sequences": _Kind("file", rb"\A# Written by cyclekit"),
    "table-csv": _Kind("table", rf"\At_s(,({_COLUMNS}|q\d+_rad|qd\d+_rad_s))*\r?\n".encode()),
    "table-parquet": _Kind("table", rb"cyclekit convert"),
    "replay": _Kind("recording", rb"\ARRF.{0,400}?cyclekit"),
    "onnx": _Kind("ONNX file", rb"cyclekit"),
    "rule": _Kind("rule", rb'\A\s*\{\s*"rule":'),
    "picture": _Kind("picture", rb"written by cyclekit"),
    "cell": _Kind("note of a cell", rb'\A\s*\{\s*"stages":'),
    "fleet": _Kind("summary", rb'\A\s*\{\s*"fleet":'),
    "pdf": _Kind("page", rb"% written by cyclekit"),
    "workbook": _Kind("workbook", MARK.encode()),
}


def check_output(
    out: PathOrUrl | None,
    kind: Kind,
    inputs: Iterable[PathOrUrl | None],
    *,
    option: str = "--out",
    endings: Sequence[str] = (),
) -> None:
    """Refuse, before any work, an output that would overwrite something or cannot be written.

    Args:
        out: Output file or folder, a path or a URL; None = no output.
        kind: Kind of the output.
        inputs: Files, folders and URLs that the command reads; None is ignored.
        option: Option that gave `out`.
        endings: Allowed suffixes, such as `.json`; empty = any.

    Raises:
        ConfigError: The suffix is not allowed.
        CyclekitError: Nothing can be written there.
        OutputError: It is an input, lies in one, holds one, or is not cyclekit's to replace.
    """
    if out is None:
        return
    thing = _KINDS[kind]
    target = _real(out)
    for given in inputs:
        if given is not None and (how := _collides(target, _real(given), folder=bool(thing.holds))):
            seen = f"{out}: {how.format(given=given)}, so it is not written"
            raise OutputError(seen, cure=f"Give {option} another name, outside of what is read.")
    if isinstance(target, Path) and target.is_dir() and not thing.is_folder:
        raise OutputError(f"{out}: is a folder", cure="Give the name of a file in it.")
    if isinstance(target, Path) and not _is_replaceable(target, thing):
        seen = f"{out}: exists and is no {thing.name} of cyclekit's, so it is not replaced"
        raise OutputError(seen, cure=f"Give {option} a new name, or remove what is there.")
    if thing.is_folder:
        check_writable_folder(out)
    else:
        check_writable(out, endings)


def _real(place: PathOrUrl) -> Path | str:
    """Return a local path with links resolved, or a URL without query."""
    if is_url(place):
        path = of_file_url(str(place))
        if path is None:
            return str(place).partition("?")[0].rstrip("/")
        place = path
    return Path(os.path.realpath(place))  # `resolve` would raise for a link to itself


def _collides(out: Path | str, given: Path | str, *, folder: bool) -> str | None:
    """Return how an output conflicts with an input; None if it does not."""
    if isinstance(out, str) or isinstance(given, str):
        if type(out) is not type(given):
            return None
        a, b = str(out), str(given)
        if a == b:
            return "is an input"
        return "lies in the input {given}" if a.startswith(f"{b}/") else None
    if _same(out, given):
        return "is an input"
    if any(_same(above, given) for above in out.parents):
        return "lies in the input {given}"
    if folder and out.is_dir() and any(_same(out, above) for above in given.parents):
        return "holds the input {given}"
    return None


def _same(one: Path, other: Path) -> bool:
    """Return whether two paths are the same file."""
    if one == other:
        return True
    try:
        return one.samefile(other)
    except (OSError, ValueError):  # one of them does not exist
        return False


def _is_replaceable(out: Path, kind: _Kind) -> bool:
    try:
        mode = out.stat().st_mode
    except (OSError, ValueError):  # it does not exist; whether it can be written shows later
        return True
    if stat.S_ISDIR(mode):
        return kind.is_folder and (not kind.holds or (out / kind.holds).is_file() or not any(out.iterdir()))
    if kind.is_folder:
        return False
    if not stat.S_ISREG(mode):
        return True
    ends = _ends(out)
    return not ends or re.search(kind.mark, ends, re.DOTALL) is not None


def _ends(file: Path) -> bytes:
    """Return both ends of a file; an unreadable file counts as not written by cyclekit."""
    try:
        with file.open("rb") as handle:
            first = handle.read(_ENDS_BYTES)
            if first.startswith(b"PK"):  # a workbook: its properties are in a ZIP archive
                with zipfile.ZipFile(handle) as packed:
                    return packed.open("docProps/core.xml").read(_ENDS_BYTES)
            handle.seek(max(len(first), file.stat().st_size - _ENDS_BYTES))
            return first + b"\n" + handle.read() if first else b""
    except (OSError, zipfile.BadZipFile, KeyError, zlib.error, EOFError, NotImplementedError, RuntimeError):
        return b"?"
