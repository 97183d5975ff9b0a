"""The fleet file: the cells, the paths of their logs, and the output folder."""

from __future__ import annotations

from dataclasses import dataclass, replace
from glob import glob, has_magic
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from msgspec import Meta

from cyclekit.config.cells import AlignClocks
from cyclekit.config.toml_file import read_toml, refuse_twice, require_list, require_table, to_dataclass
from cyclekit.errors import ConfigError, UnknownName
from cyclekit.storage.files import resolved
from cyclekit.storage.remote.folders import from_folder, is_url, join
from cyclekit.storage.safe_path import name_problem

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cyclekit.api.report import Looks, Searched

LEDGER, REPORT = "cell.json", "report.html"
_NAME = r"^[A-Za-z0-9][A-Za-z0-9._-]*$"
"""Pattern of a cell's name, as it names a folder: letters, digits, '.', '_' and '-', the first a letter or digit."""
_OF_A_CELL = ("name", "sources", "folder")
"""Fields that [fleet] cannot set for all cells."""


@dataclass(frozen=True)
class FleetCell:
    """One cell with all paths resolved, so that any worker can process it.

    Attributes:
        name: Its name, which is also that of its folder.
        sources: Its logs: paths, paths with wildcards, or URLs.
        folder: Folder of its results, a path or a URL.
        cell_file: Its cell file; None for the one in the folder of the logs.
        sequences: Sequence file whose estimates are part of its report.
        pseudonymise: Keep neither names nor times of day, nor the day of a log.
        checksums: Keep the BLAKE3 checksum of each log.
        follow_links: Follow links that lead out of a folder of logs.
        align_clocks: As in the cell file, which it overrides.
        seed: Seed of training and split.
        epochs: Number of training epochs; None: chosen by the number of rows.
    """

    name: Annotated[str, Meta(pattern=_NAME, examples=["press-1"])]
    sources: Annotated[tuple[Annotated[str, Meta(min_length=1)], ...], Meta(min_length=1, examples=[["logs/press-1"]])]
    folder: str = ""
    cell_file: str | None = None
    sequences: str | None = None
    pseudonymise: bool = False
    checksums: bool = True
    follow_links: bool = False
    align_clocks: AlignClocks | None = None
    seed: Annotated[int, Meta(ge=0, le=2**32 - 1)] = 0
    epochs: Annotated[int, Meta(ge=1, le=1_000_000)] | None = None

    @property
    def dataset(self) -> str:
        """Path or URL of its dataset."""
        return join(self.folder, "dataset")

    @property
    def model(self) -> str:
        """Path or URL of its model."""
        return join(self.folder, "model")

    @property
    def report(self) -> str:
        """Path or URL of its report."""
        return join(self.folder, REPORT)

    @property
    def ledger(self) -> str:
        """Path or URL of the ledger with the results of its stages."""
        return join(self.folder, LEDGER)

    @property
    def looks(self) -> Looks:
        """Further arguments of `write_report` for its report."""
        return {}

    @property
    def searched(self) -> Searched:
        """The work that its report orders and the changes that it prices."""
        return {}

    def logs(self) -> list[str]:
        """Return its current sources, with wildcards expanded.

        Raises:
            ConfigError: A source with wildcards matches nothing.
        """
        found: list[str] = []
        for source in self.sources:
            if is_url(source) or not has_magic(source) or Path(source).exists():
                found.append(source)
                continue
            matching = sorted(glob(source, recursive=True))  # noqa: PTH207 - the pattern may be absolute
            if not matching:
                raise ConfigError(f"cell {self.name!r}: nothing matches {source!r}", cure="Check its sources.")
            found += matching
        return found


@dataclass(frozen=True)
class Fleet:
    """All cells of a fleet.

    Attributes:
        name: Title of the page.
        out: Folder of the results, a path or a URL.
        cells: The cells, in the order of the file.
    """

    name: str
    out: str
    cells: tuple[FleetCell, ...]


def load_fleet(path: Path) -> Fleet:
    """Read a fleet file; paths in it are relative to its folder.

    Raises:
        ConfigError: It cannot be read, has no cell, or has an invalid value.
        UnknownName: A key is unknown.
    """
    raw, here = read_toml(path), resolved(path).parent
    for key in raw:
        if key not in ("fleet", "cell"):
            raise UnknownName(str(path), "key", key, ("fleet", "cell"))
    shared = dict(require_table(f"{path} [fleet]", raw.get("fleet", {})))
    name, out = (str(shared.pop(key, path.stem)) for key in ("name", "out"))
    to_dataclass(f"{path} [fleet]", shared, FleetCell, **dict.fromkeys(_OF_A_CELL))
    entries = require_list(str(path), raw, "cell")
    if not entries:
        cure = 'Add them:\n  [[cell]]\n  name = "press-1"\n  sources = ["logs/press-1"]'
        raise ConfigError(f"{path}: no [[cell]] in it", cure=cure)
    out = from_folder(here, out)
    cells = [_cell(f"{path} cell[{number}]", shared, entry, here) for number, entry in enumerate(entries)]
    refuse_twice(str(path), "cell", [cell.name for cell in cells])
    return Fleet(name, out, tuple(replace(cell, folder=join(out, cell.name)) for cell in cells))


def _cell(where: str, shared: Mapping[str, Any], entry: object, here: Path) -> FleetCell:
    cell = to_dataclass(where, {**shared, **require_table(where, entry)}, FleetCell, folder="")
    if name_problem(cell.name):
        raise ConfigError(
            f"{where}: name = {cell.name!r} is not a valid folder name on every system", cure="Choose another name."
        )
    paths = {
        key: from_folder(here, told) for key in ("cell_file", "sequences") if (told := getattr(cell, key)) is not None
    }
    return replace(cell, **paths, sources=tuple(from_folder(here, source) for source in cell.sources))  # type: ignore[arg-type]
