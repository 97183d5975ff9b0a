"""The fleet file: which cells there are, where their logs lie, and where results go."""

from __future__ import annotations

import re
from dataclasses import dataclass, fields, replace
from glob import glob, has_magic
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclekit.config.toml_file import list_at, read_toml
from cyclekit.errors import ConfigError, UnknownName
from cyclekit.storage.files import resolved
from cyclekit.storage.inside import unfit
from cyclekit.storage.remote.folders import is_url, join

if TYPE_CHECKING:
    from collections.abc import Mapping

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


@dataclass(frozen=True)
class FleetCell:
    """One cell, everything resolved, so that it can be worked on anywhere.

    Attributes:
        name: Its name, which is also its folder's.
        sources: Its logs: paths, paths with wildcards, or URLs.
        folder: Where its results go, a path or a URL.
        cell_file: Its cell file, None for the one beside the logs.
        sequences: Sequence file whose estimates go into its report.
        pseudonymise: Keep neither names nor times of day; then no day is kept of a log either.
        checksums: Keep the BLAKE3 of each log.
        follow_links: Read what links in a folder of logs lead to outside of it.
        seed: Of training and split.
        epochs: Passes of the training, None for as many as the rows need.
    """

    name: str
    sources: tuple[str, ...]
    folder: str = ""
    cell_file: str | None = None
    sequences: str | None = None
    pseudonymise: bool = False
    checksums: bool = True
    follow_links: bool = False
    seed: int = 0
    epochs: int | None = None

    @property
    def dataset(self) -> str:
        """Where its dataset stands."""
        return join(self.folder, "dataset")

    @property
    def model(self) -> str:
        """Where its model stands."""
        return join(self.folder, "model")

    def logs(self) -> list[str]:
        """Return its sources as they are now, wildcards resolved.

        Raises:
            ConfigError: A source with wildcards means nothing.
        """
        found: list[str] = []
        for source in self.sources:
            if is_url(source) or not has_magic(source) or Path(source).exists():
                found.append(source)
                continue
            matching = sorted(glob(source, recursive=True))  # noqa: PTH207 - the pattern may be absolute
            if not matching:
                raise ConfigError(f"cell {self.name!r}: nothing is called {source!r}", cure="Check its sources.")
            found += matching
        return found


@dataclass(frozen=True)
class Fleet:
    """All cells, in the order of the file.

    Attributes:
        name: Title of the page.
        out: Where results go, a path or a URL.
        cells: The cells.
    """

    name: str
    out: str
    cells: tuple[FleetCell, ...]


def load_fleet(path: Path) -> Fleet:
    """Read a fleet file; paths in it are relative to its folder.

    Raises:
        ConfigError: It cannot be read, names no cell, or says something that cannot be followed.
        UnknownName: A key is not known.
    """
    raw, here = read_toml(path), resolved(path).parent
    _only(str(path), raw, ("fleet", "cell"))
    shared = raw.get("fleet", {})
    if not isinstance(shared, dict):
        raise ConfigError(f"{path}: [fleet] must be a table", cure='[fleet]\n  out = "fleet"')
    settings = [field.name for field in fields(FleetCell) if field.name not in ("name", "sources", "folder")]
    _only(f"{path} [fleet]", shared, ("name", "out", *settings))
    out = _place(here, str(shared.get("out", path.stem)))
    entries = list_at(str(path), raw, "cell")
    if not entries:
        cure = 'Add them:\n  [[cell]]\n  name = "press-1"\n  sources = ["logs/press-1"]'
        raise ConfigError(f"{path}: no [[cell]] in it", cure=cure)
    common = {name: shared[name] for name in settings if name in shared}
    cells = [_cell(f"{path} cell[{number}]", {**common, **entry}, here) for number, entry in enumerate(entries)]
    names = [cell.name for cell in cells]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ConfigError(f"{path}: cell name {twice[0]!r} is used twice", cure="Each needs a name of its own.")
    return Fleet(
        str(shared.get("name", path.stem)), out, tuple(replace(cell, folder=join(out, cell.name)) for cell in cells)
    )


def _cell(where: str, raw: Mapping[str, Any], here: Path) -> FleetCell:
    kinds: dict[str, type] = {
        "name": str, "sources": list, "cell_file": str, "sequences": str, "pseudonymise": bool, "checksums": bool,
        "follow_links": bool, "seed": int, "epochs": int,
    }  # fmt: skip
    _only(where, raw, tuple(kinds))
    for key, value in raw.items():
        if type(value) is not kinds[key]:
            raise ConfigError(f"{where}: {key} = {value!r} is not of the right kind", cure="See docs/fleet.md.")
    name, sources = raw.get("name", ""), raw.get("sources", [])
    if not _NAME.fullmatch(name) or unfit(name):
        cure = "It names a folder: letters, digits, '.', '_' and '-', the first a letter or digit, no '.' last."
        raise ConfigError(f"{where}: name = {name!r}", cure=cure)
    if not sources or not all(isinstance(source, str) and source for source in sources):
        raise ConfigError(f"{where}: sources = {sources!r}", cure='Say where its logs lie: sources = ["logs/press-1"]')
    if raw.get("epochs", 1) < 1 or raw.get("seed", 0) < 0:
        raise ConfigError(f"{where}: a training of fewer than one epoch, or a seed below 0", cure="See docs/fleet.md.")
    paths = {key: _place(here, raw[key]) for key in ("cell_file", "sequences") if key in raw}
    return FleetCell(**{**raw, **paths, "sources": tuple(_place(here, source) for source in sources)})


def _place(here: Path, text: str) -> str:
    return text if is_url(text) else str(here / text)


def _only(where: str, raw: object, known: tuple[str, ...]) -> None:
    if not isinstance(raw, dict):
        raise ConfigError(f"{where}: must be a table", cure="See docs/fleet.md.")
    for key in raw:
        if key not in known:
            raise UnknownName(where, "key", str(key), known)
