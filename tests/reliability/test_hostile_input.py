"""A few of the inputs of `benchmarks/hostile_input.py`, which draws at least 10,000: none may end in a traceback."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

FILE = Path(__file__).parents[2] / "benchmarks" / "hostile_input.py"


@pytest.mark.parametrize("kind", ["model card", "cell file", "sequence file"])
def test_hostile_input_is_accepted_or_refused_in_one_message(kind: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("CYCLEKIT_CACHE", "")  # the benchmark sets it; afterwards it is what it was
    spec = importlib.util.spec_from_file_location("hostile_input", FILE)
    assert spec is not None
    assert spec.loader is not None
    benchmark = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(__import__("sys").modules, "hostile_input", benchmark)
    spec.loader.exec_module(benchmark)
    found = benchmark.run(200, 0, only=[kind])[kind]
    assert found.inputs >= 100
    assert found.tracebacks == {}
    assert found.outside == 0
