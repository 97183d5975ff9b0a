"""A few of the inputs of `benchmarks/hostile_input.py`, which draws at least 10,000: none may end in a traceback."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from examples import drawn

if TYPE_CHECKING:
    from types import ModuleType

FILE = Path(__file__).parents[2] / "benchmarks" / "hostile_input.py"
EXAMPLES = {"dataset card": drawn(100), "name of a log": drawn(100), "sequence file": 300}
"""Number of inputs, else 100: few of the kinds that cost most, more where few are accepted. The slow tests below show
that half of them find what is not checked."""
KINDS = ("dataset card", "model card", "manifest", "cell file", "sequence file", "name of a log")


@pytest.fixture
def benchmark(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.setenv("CYCLEKIT_CACHE", "")  # the benchmark sets it; afterwards it is what it was
    spec = importlib.util.spec_from_file_location("hostile_input", FILE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(__import__("sys").modules, "hostile_input", module)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("kind", KINDS)
def test_hostile_input_is_accepted_or_refused_in_one_message(kind: str, benchmark: ModuleType):
    count = EXAMPLES.get(kind, 100)
    found = benchmark.run(count, 0, only=[kind])[kind]
    assert found.inputs >= 0.9 * count
    assert found.accepted > 0  # else nothing but the first check was tried
    assert found.tracebacks == {}
    assert (found.outside, found.raw) == (0, 0), found.examples


def _joined(folder: Path, *names: str, **_: Any) -> Path:
    return folder.joinpath(*names)


@pytest.mark.slow  # tests of the test above
@pytest.mark.parametrize(
    ("kind", "careless"),
    [
        ("dataset card", {"cyclekit.dataset.files.safe_path": _joined}),
        ("manifest", {"cyclekit.storage.remote.manifest.check": lambda _: None}),  # its parts are from anywhere
        (
            "manifest",
            {
                "cyclekit.storage.remote.manifest.check": lambda _: None,
                "cyclekit.storage.remote.parts.safe_path": _joined,
            },
        ),
    ],
    ids=["card", "parts", "names"],
)
def test_a_reader_without_checks_is_caught(
    kind: str, careless: dict[str, Any], benchmark: ModuleType, monkeypatch: pytest.MonkeyPatch
):
    for name, instead in careless.items():
        monkeypatch.setattr(name, instead)
    assert benchmark.run(50, 0, only=[kind])[kind].outside > 0


@pytest.mark.slow
def test_raw_control_characters_are_caught(benchmark: ModuleType, monkeypatch: pytest.MonkeyPatch):
    for name in ("cyclekit.cli.terminal.visible", "cyclekit.config.toml_file.all_in_one_line"):
        monkeypatch.setattr(name, lambda text: text)
    assert benchmark.run(400, 0, only=["sequence file"])["sequence file"].raw > 0
