"""What is an extra of the installation is missing without harm to the rest, and is named where it is needed."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from cyclekit.extras import EXTRAS

if TYPE_CHECKING:
    from .conftest import Shell

ROOT = Path(__file__).parents[2]
_BLOCK = "import sys; sys.modules.update(dict.fromkeys({packages!r})); "


def without(packages: tuple[str, ...], code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run code in an interpreter in which these packages cannot be imported."""
    words = [sys.executable, "-c", _BLOCK.format(packages=packages) + code]
    return subprocess.run(words, capture_output=True, text=True, check=False, cwd=folder, timeout=60)


@pytest.mark.parametrize(
    ("words", "packages", "extras"),
    [
        (["train", "dataset", "--out", "model"], ("torch",), "train"),
        (["replay", "dataset", "--execution", "1", "--out", "x.rrd"], ("rerun",), "replay"),
        (["simulate", "box-picking", "--out", "logs"], ("ruckig",), "simulate"),
        (["simulate", "box-picking", "--out", "logs", "--logs", "mcap"], ("mcap",), "simulate"),
        (["demo"], ("torch", "rerun", "mcap", "ruckig"), "simulate,train,replay"),
        (["demo"], ("rerun",), "replay"),
    ],
)
def test_a_command_without_its_extra_names_the_command_that_installs_it(
    words: list[str],
    packages: tuple[str, ...],
    extras: str,
    cyclekit: Shell,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    for package in packages:
        monkeypatch.setitem(sys.modules, package, None)
    for name in [name for name in sys.modules if name.startswith(("cyclekit.replay", "cyclekit.api.replay"))]:
        monkeypatch.delitem(sys.modules, name)  # an extra is looked for when these are imported
    done = cyclekit(*words)
    assert done.code == 1, done.err
    assert f'pip install "cyclekit[{extras}]"' in done.err
    assert "Traceback" not in done.err
    assert list(tmp_path.iterdir()) == []  # refused before any work


def test_a_library_call_without_its_extra_names_it_too(tmp_path: Path) -> None:
    done = without(("rerun",), "from cyclekit import write_replay", tmp_path)
    assert (
        'MissingExtra: a replay needs rerun: not installed\n  Install it: pip install "cyclekit[replay]"' in done.stderr
    )


@pytest.mark.slow  # a process of its own
def test_everything_else_works_without_any_extra(tmp_path: Path) -> None:
    packages = tuple(name for names in EXTRAS.values() for name in names)
    code = """
import cyclekit
from importlib import import_module
from importlib.metadata import entry_points
for point in entry_points(group="cyclekit.adapters"): point.load()
for name in set(cyclekit.__all__) - {"write_replay"}: getattr(cyclekit, name)
for name in (
    *("estimate.rollout", "learning.evaluation.evaluate", "estimate.plan", "learning.safety_function"),
    *("estimate.whatif", "report", "fleet.run", "ingest.convert", "alignment.calibrate"),
):
    import_module("cyclekit." + name)
from cyclekit.cli import app
app()
"""
    done = without(packages, f"exec({code!r})", tmp_path)
    assert done.returncode == 0, done.stderr


def test_the_table_of_extras_is_that_of_the_project_file() -> None:
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    optional = stated["optional-dependencies"]
    assert set(EXTRAS) == set(optional) - {"all", "dev"}
    assert optional["all"] == [f"cyclekit[{','.join(sorted(EXTRAS))}]"]
