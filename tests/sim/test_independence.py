"""The simulator may not share a computation with what it tests."""

from __future__ import annotations

import ast
from pathlib import Path

import cyclekit_sim


def test_the_simulator_imports_nothing_of_cyclekit() -> None:
    for path in Path(cyclekit_sim.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            assert not any(name.split(".")[0] in ("cyclekit", "cyclekit_adapters") for name in names), path.name
