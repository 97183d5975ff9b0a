"""A write that fails leaves the old result whole, ends with 1, and says which path it was."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl
import pytest
from fabricated import fabricate_dataset

from cyclekit.cli import run

if TYPE_CHECKING:
    from collections.abc import Callable

UNDER_A_LIMIT = """
import json, resource, sys
from cyclekit.cli import main

words, limit = json.loads(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
main(words)
"""


@pytest.mark.slow  # quick: every call that writes fails once, below
@pytest.mark.skipif(os.name == "nt", reason="needs a limit on the size of files")
@pytest.mark.parametrize(
    ("command", "limit"),
    [("ingest", 1), ("ingest", 5_000), ("estimate", 200), ("simulate", 50_000), ("replay", 40_000)],
)
def test_a_disk_that_is_full_leaves_the_old_result_and_one_message_that_names_it(
    command: str, limit: int, victims: dict[str, Any], terminal: Any, kill_nine: Any
):
    victim = victims[command]
    terminal.run(victim.words[0])
    before = kill_nine.state_of(victim.target)
    typed = [sys.executable, "-c", UNDER_A_LIMIT, json.dumps([victim.words[1], limit])]
    done = subprocess.run(typed, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 1, done.stderr
    assert done.stderr.startswith("error: ")
    assert str(victim.target) in done.stderr
    assert "Traceback" not in done.stderr
    assert kill_nine.state_of(victim.target) == before
    assert [entry for entry in victim.target.parent.iterdir() if entry != victim.target] == []


class Faults:
    """Counts the calls that write, and lets one of them fail as a broken disk does."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.calls, self.failing = 0, -1
        for owner, name in (
            *((Path, name) for name in ("mkdir", "rename", "replace", "touch", "unlink")),
            *((os, name) for name in ("fsync", "link")),
            (pl.DataFrame, "write_parquet"),
        ):
            monkeypatch.setattr(owner, name, self._counted(getattr(owner, name)))
        opened = Path.open
        faulty = self._counted(opened)

        def open_(path: Path, mode: str = "r", *args: Any, **options: Any) -> Any:
            return (opened if mode in ("r", "rb") else faulty)(path, mode, *args, **options)

        monkeypatch.setattr(Path, "open", open_)

    def _counted(self, call: Callable[..., Any]) -> Callable[..., Any]:
        def counted(*args: Any, **options: Any) -> Any:
            self.calls += 1
            if self.calls == self.failing:
                raise OSError(errno.EIO, "Input/output error")
            return call(*args, **options)

        return counted


@pytest.fixture
def old_and_new(tmp_path: Path) -> tuple[Path, list[str], list[str]]:
    """A folder for results, and two ingests whose results differ."""
    logs = []
    for name, rows in (("a", 300), ("b", 200)):
        (tmp_path / name).mkdir()
        for number in range(2):
            lines = [f"{10 + i / 125:.3f} {0.3 * (i % 100 > 50):.1f} 0 0.4" for i in range(rows + number)]
            text = "\n".join(["timestamp " + " ".join(f"actual_TCP_pose_{k}" for k in range(3)), *lines, ""])
            (tmp_path / name / f"run_{number}.csv").write_text(text, encoding="utf-8")
        logs.append(str(tmp_path / name))
    (tmp_path / "out").mkdir()
    out = ["--out", str(tmp_path / "out" / "dataset"), "--quiet"]
    return tmp_path / "out", ["ingest", logs[0], *out], ["ingest", logs[1], *out]


def each_call_fails_once(
    folder: Path, old: list[str], new: list[str], faults: Faults, state: Callable[[], object], capsys: Any
) -> int:
    assert run(old) == 0
    before = state()
    faults.calls = 0
    assert run(new) == 0
    calls, after = faults.calls, state()
    assert before != after
    refused, is_old = 0, False
    for number in range(1, calls + 1):
        faults.failing = -1
        assert is_old or run(old) == 0
        capsys.readouterr()
        faults.calls, faults.failing = 0, number
        code = run(new)
        faults.failing = -1
        said = capsys.readouterr().err
        is_old = code != 0
        if code == 0:
            assert state() == after, f"call {number}: said to be done"
        else:
            refused += 1
            assert code == 1
            assert state() == before, f"call {number}: {said}"
            assert str(folder) in said, f"call {number}: {said}"
            assert "Input/output error" in said
    assert run(new) == 0
    assert state() == after
    return refused


@pytest.mark.slow  # quick: the replay below
def test_every_call_of_an_ingest_that_writes_fails_once(
    old_and_new: tuple[Path, list[str], list[str]], monkeypatch: pytest.MonkeyPatch, kill_nine: Any, capsys: Any
):
    folder, old, new = old_and_new
    faults = Faults(monkeypatch)
    refused = each_call_fails_once(folder, old, new, faults, lambda: kill_nine.state_of(folder / "dataset"), capsys)
    assert refused >= 20


@pytest.mark.slow
def test_every_call_of_a_replay_that_writes_fails_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kill_nine: Any, capsys: Any
):
    data = fabricate_dataset(tmp_path / "dataset", executions=2, rounds=1)
    (tmp_path / "out").mkdir()
    replay = tmp_path / "out" / "x.rrd"
    old, new = (["replay", str(data.path), "--execution", n, "--out", str(replay), "--quiet"] for n in ("1", "2"))
    state = lambda: kill_nine.state_of(replay)  # noqa: E731
    assert each_call_fails_once(tmp_path / "out", old, new, Faults(monkeypatch), state, capsys) >= 3


def test_a_target_that_can_be_read_only_is_named(old_and_new: tuple[Path, list[str], list[str]], capsys: Any):
    _, ingest, _ = old_and_new
    place = Path("/proc/dataset")
    if not place.parent.is_dir():
        pytest.skip("no file system here that nobody may write")
    assert run([*ingest[:2], "--out", str(place)]) == 1
    assert "error: /proc/dataset: cannot be written" in capsys.readouterr().err
