"""The public names: all there, where the type checker says, and nothing heavy imported before one is used."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import cyclekit

NAMES = sorted(set(cyclekit.__all__) - {"__version__"})


@pytest.mark.parametrize("name", NAMES)
def test_a_public_name_is_there_and_documented(name: str) -> None:
    found = getattr(cyclekit, name)
    assert found.__doc__, f"{name} has no docstring"
    assert found.__module__.startswith("cyclekit.")


@pytest.mark.parametrize("name", NAMES)
def test_a_public_name_is_no_module_so_that_importing_a_module_never_shadows_it(name: str) -> None:
    assert find_spec(f"cyclekit.{name}") is None


def test_what_the_type_checker_sees_is_what_is_given() -> None:
    tree = ast.parse(Path(cyclekit.__file__).read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    seen = {
        alias.asname or alias.name: f"{node.module}:{alias.name}"
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == cyclekit._HOMES
    assert set(cyclekit.__all__) == {*seen, "__version__"}


def test_a_name_that_is_not_there_is_missed_as_in_any_module() -> None:
    with pytest.raises(AttributeError, match="no attribute 'engest'"):
        cyclekit.engest  # noqa: B018


def test_importing_cyclekit_imports_nothing_else_of_ours_and_no_library() -> None:
    before_and_after = (
        "import sys, json; before = set(sys.modules); import cyclekit; dir(cyclekit);"
        "print(json.dumps(sorted(set(sys.modules) - before)))"
    )
    done = subprocess.run([sys.executable, "-c", before_and_after], capture_output=True, text=True, check=True)
    loaded = json.loads(done.stdout)
    assert [name for name in loaded if name.startswith("cyclekit")] == ["cyclekit"]
    heavy = {"numpy", "polars", "torch", "sklearn", "rerun", "scipy", "matplotlib", "typer", "rich"}
    assert heavy.isdisjoint(loaded)
