"""Who may import whom: the house has floors, and a room looks only downwards."""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).parents[1]

FLOORS = [
    {"cli"},
    {"fleet"},
    {"api"},
    {"inspect", "report"},
    {"estimate", "ingest", "replay"},
    {"derive", "learning"},
    {"people", "scaling"},
    {"alignment", "segmentation"},
    {"dataset"},
    {"adapter", "config", "parallel", "plots"},
    {"extras", "schema", "storage"},
    {"errors", "text"},
]
"""Rooms of cyclekit, the last stage of the data's way first; a room is a module or a folder right under `cyclekit`."""

ROOMS_OF = {
    "torch": {"learning"},
    "rerun": {"replay"},
    "sklearn": {"learning"},
    "typer": {"cli"},
    "rich": {"cli"},
    "jinja2": {"report"},
    "matplotlib": {"plots", "report"},
    "onnx": {"learning"},
    "onnxruntime": {"learning"},
    "pyarrow": {"storage"},
    "ray": {"parallel"},
    "fastexcel": set(),
    "xlsxwriter": {"storage"},
    "rosbags": set(),
    "mcap": set(),
    "cyclekit_adapters": set(),
    "cyclekit_sim": {"api"},
}
"""The only rooms of cyclekit that may import each of these."""

OF_ADAPTERS = {"cyclekit.adapter", "cyclekit.errors", "cyclekit.schema", "cyclekit.text.numbers"}


@dataclass(frozen=True)
class Import:
    """One import statement: by which file and line, of which module, and whether only for the type checker."""

    file: Path
    line: int
    module: str
    typing_only: bool

    def __str__(self) -> str:
        return f"{self.file.relative_to(ROOT)}:{self.line} imports {self.module}"

    @property
    def top(self) -> str:
        return self.module.partition(".")[0]


@cache
def parsed(package: Path) -> dict[Path, ast.Module]:
    return {file: ast.parse(file.read_text(encoding="utf-8")) for file in sorted(package.rglob("*.py"))}


def imports_of(package: Path) -> list[Import]:
    found = []
    for file, tree in parsed(package).items():
        every = list(_statements(tree))
        for_types = {inner for node in every if _is_typing_block(node) for inner in _statements(node)}
        for node in every:
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                module = node.module or ""
                names = [f"{module}.{alias.name}" if module == "cyclekit" else module for alias in node.names]
            assert not (isinstance(node, ast.ImportFrom) and node.level), f"{file}: relative import"
            found += [Import(file, node.lineno, name, node in for_types) for name in dict.fromkeys(names)]
    return found


def _statements(inside: ast.AST) -> Iterator[ast.stmt]:
    """All statements inside another one or a module: a tenth of what `ast.walk` finds, and imports are among them."""
    for node in ast.iter_child_nodes(inside):
        if isinstance(node, ast.stmt):
            yield node
        if isinstance(node, ast.stmt | ast.ExceptHandler | ast.match_case):
            yield from _statements(node)


def _is_typing_block(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def room(file: Path) -> str:
    first = file.relative_to(ROOT / "cyclekit").parts[0]
    return first.removesuffix(".py").replace("__main__", "cli")  # which is the command line, called by its module


@cache
def of_cyclekit() -> list[Import]:
    """Imports of every room; read when a test asks, as every process of the tests collects this file."""
    return [entry for entry in imports_of(ROOT / "cyclekit") if room(entry.file) != "__init__"]


FLOOR = {name: level for level, names in enumerate(FLOORS) for name in names}


def test_every_room_stands_on_a_floor() -> None:
    rooms = {
        path.stem for path in (ROOT / "cyclekit").iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()
    }
    assert rooms - {"__init__", "__main__"} == set(FLOOR), (
        "say in FLOORS where the new room stands, and in docs/architecture.md"
    )


def test_the_page_of_the_architecture_shows_these_floors_and_modules_that_exist() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| \d+ \| (.*?) \|", page, re.MULTILINE)
    assert [set(re.findall(r"`(\w+)/?`", row)) for row in rows] == FLOORS
    asked = page.partition("## Where is")[2].partition("\n## ")[0]
    named = {name for name in re.findall(r"`([\w/]+(?:\.py|/))`", asked) if "/" in name}
    assert named
    assert [name for name in sorted(named) if not any((ROOT / top / name).exists() for top in ("", "cyclekit"))] == []


def test_the_house_stays_small() -> None:
    assert len(FLOORS) <= 12
    assert len(FLOOR) <= 24


def _folders() -> list[Path]:
    roots = (ROOT / "cyclekit", ROOT / "adapters" / "cyclekit_adapters")
    return [file.parent for root in roots for file in sorted(root.rglob("__init__.py"))]


@pytest.mark.parametrize("folder", _folders(), ids=lambda folder: str(folder.relative_to(ROOT)))
def test_a_folder_says_what_it_is_for(folder: Path) -> None:
    words = ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8")))
    assert words
    assert words.splitlines()[0].endswith(".")


def test_a_room_imports_only_from_floors_below() -> None:
    upwards = []
    for entry in of_cyclekit():
        if entry.top != "cyclekit" or entry.typing_only or entry.module == "cyclekit":
            continue
        ours, theirs = room(entry.file), entry.module.split(".")[1]
        if theirs not in FLOOR:  # a public name of the package itself
            upwards.append(f"{entry}: import it from its room")
        elif (ours, theirs) == ("errors", "text"):  # the ground: a message shows names out of logs
            continue
        elif ours != theirs and FLOOR[theirs] <= FLOOR[ours]:
            upwards.append(str(entry))
    assert upwards == []


@pytest.mark.parametrize("library", ROOMS_OF)
def test_a_library_is_known_only_in_its_rooms(library: str) -> None:
    strangers = [str(e) for e in of_cyclekit() if e.top == library and room(e.file) not in ROOMS_OF[library]]
    assert strangers == []


def test_adapters_know_the_contract_and_nothing_else_of_cyclekit() -> None:
    found = imports_of(ROOT / "adapters" / "cyclekit_adapters")
    assert found
    assert [str(e) for e in found if e.top == "cyclekit" and not _is_contract(e.module)] == []
    assert [str(e) for e in found if e.top == "cyclekit_sim"] == []


def _is_contract(module: str) -> bool:
    return any(module == known or module.startswith(f"{known}.") for known in OF_ADAPTERS)


def test_the_simulator_knows_nothing_of_cyclekit() -> None:
    found = imports_of(ROOT / "sim_fixtures" / "cyclekit_sim")
    assert found
    assert [str(e) for e in found if e.top in {"cyclekit", "cyclekit_adapters"}] == []


def test_no_room_is_called_after_nothing() -> None:
    names = {path.name for folder in ("cyclekit", "adapters", "sim_fixtures") for path in (ROOT / folder).rglob("*.py")}
    assert names.isdisjoint({"utils.py", "common.py", "helpers.py", "base.py"})


def test_the_folders_around_the_packages_are_no_packages() -> None:
    assert [name for name in ("adapters", "sim_fixtures", "tests") if (ROOT / name / "__init__.py").exists()] == []


@pytest.mark.parametrize("package", ["cyclekit", "adapters/cyclekit_adapters", "sim_fixtures/cyclekit_sim"])
def test_nothing_rests_on_an_assert(package: str) -> None:
    """With `python -O` there is none, so whatever input it guarded against would come in."""
    asserts = [
        f"{file.relative_to(ROOT)}:{node.lineno}"
        for file, tree in parsed(ROOT / package).items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Assert)
    ]
    assert asserts == []
