"""One public name, one class; and no module leads back to itself, be it only for the type checker."""

from __future__ import annotations

import ast
from collections import defaultdict
from dataclasses import fields
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

from cyclekit.learning.networks.spec import ModelSpec, RunSettings

ROOT = Path(__file__).parents[1]
UNTYPED = {
    "dataset/cards/read.py": "a card becomes JSON values here, and nowhere else",
    "report/answer.py": "a section of the page, read by the template and written as JSON",
    "report/helps.py": "a section of the page",
    "report/inputs.py": "the evaluation as `evaluate --json` prints it, which the page and its JSON show",
    "report/page.py": "the sections of the page, given to the template and to the JSON",
    "report/trust.py": "a section of the page",
    "report/where.py": "a section of the page",
    "report/why.py": "a section of the page",
    "report/play/both.py": "facts for the script in the page, as JSON",
    "report/play/lists.py": "facts for the script in the page, as JSON",
    "report/play/scaling_table.py": "facts for the script in the page, as JSON",
    "report/play/tables.py": "facts for the script in the page, as JSON",
}
"""Where `dict[str, Any]` may stand, and why: values that are read from or written to JSON, TOML or a template."""
PACKAGES = {"cyclekit": ROOT / "cyclekit", "cyclekit_adapters": ROOT / "adapters" / "cyclekit_adapters"}


@cache
def modules() -> dict[str, ast.Module]:
    found = {}
    for name, folder in PACKAGES.items():
        for file in sorted(folder.rglob("*.py")):
            parts = [name, *file.relative_to(folder).with_suffix("").parts]
            module = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            found[module] = ast.parse(file.read_text(encoding="utf-8"))
    return found


def imported(module: str) -> set[str]:
    """Modules that a module imports where it begins, those for the type checker included; not within functions."""
    pending, found = list(modules()[module].body), set[str]()
    while pending:
        node = pending.pop()
        if isinstance(node, ast.If | ast.Try):
            pending += [child for child in ast.iter_child_nodes(node) if isinstance(child, ast.stmt)]
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}.{alias.name}" for alias in node.names} | {str(node.module)}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    inner = {name.rpartition(".")[0] for name in found if name in modules()}  # `from package import module`
    return {name for name in found if name in modules() and name not in inner} - {module}


def test_no_module_leads_back_to_itself() -> None:
    try:
        TopologicalSorter({module: imported(module) for module in modules()}).prepare()
    except CycleError as error:
        raise AssertionError(" -> ".join(error.args[1])) from None


def test_no_room_leads_back_to_itself() -> None:
    """A drawing of the rooms of cyclekit shows one way down; imports within functions count too."""
    rooms = defaultdict[str, set[str]](set)
    for module in modules():
        package, _, path = module.partition(".")
        if package == "cyclekit" and path:
            imports = [node for node in ast.walk(modules()[module]) if isinstance(node, ast.ImportFrom)]
            names = [str(node.module).split(".") for node in imports]
            rooms[path.split(".")[0]] |= {name[1] for name in names if name[0] == "cyclekit" and len(name) > 1}
    graph = {room: {other for other in others if other != room} for room, others in rooms.items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        raise AssertionError(" -> ".join(error.args[1])) from None


def test_values_without_a_type_stay_where_files_are_read_and_written() -> None:
    folder = PACKAGES["cyclekit"]
    files = {file.relative_to(folder).as_posix(): file for file in folder.rglob("*.py")}
    found = {name for name, file in files.items() if "dict[str, Any]" in file.read_text(encoding="utf-8")}
    assert found == set(UNTYPED), "give values a dataclass or a TypedDict; of JSON `dict[str, object]` asks what it is"


def test_every_public_class_has_a_name_of_its_own() -> None:
    places = defaultdict(list)
    for module, tree in modules().items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(module)
    assert {name: where for name, where in places.items() if len(where) > 1} == {}


def test_every_number_of_a_training_run_can_be_given_and_is_typed() -> None:
    of_the_network = {"problem", "network", "horizon_s", "hidden", "norm"}
    types = {field.name: field.type for field in fields(ModelSpec) if field.name not in of_the_network}
    assert types == {name: kind.__forward_arg__ for name, kind in RunSettings.__annotations__.items()}
