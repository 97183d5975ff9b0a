"""What the tests of reliability share: the benchmark that kills, and a small cell, made once."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(scope="session")
def kill_nine() -> Any:
    """The module `benchmarks/kill_nine.py`."""
    sys.path.insert(0, str(BENCHMARKS))
    import kill_nine

    return kill_nine


@pytest.fixture(scope="session")
def terminal(kill_nine: Any) -> Any:
    return kill_nine.Terminal()


@pytest.fixture(scope="session")
def victims(kill_nine: Any, terminal: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """Every command that writes, by its name, with its result written once."""
    with kill_nine.victims(tmp_path_factory.mktemp("cell"), terminal, few=True) as found:
        yield {victim.name: victim for victim in found}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if os.name == "nt" and "kill" in item.name:
            item.add_marker(pytest.mark.skip(reason="processes are started too slowly to be killed in tests"))
