"""Temporary folders: gone with the work, and of a killed process with the next run; never those of a living one."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from cyclekit.storage.scratch import Scratch

WORK = """
import sys
from cyclekit.storage.scratch import Scratch
with Scratch() as scratch:
    (scratch.path / "rows").write_bytes(bytes(1000))
    print(scratch.path, flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def aged(folder: Path, by_s: float) -> None:
    os.utime(folder, (time.time() - by_s,) * 2)


def test_a_folder_goes_with_its_work(temporary: Path):
    with Scratch() as scratch:
        (scratch.path / "rows").write_text("1")
        assert scratch.path.parent == temporary
    assert list(temporary.iterdir()) == []


def test_the_folder_of_a_living_process_stays_and_of_a_killed_one_goes(temporary: Path):
    environment = {**os.environ, "TMPDIR": str(temporary), "TEMP": str(temporary), "TMP": str(temporary)}
    words = [sys.executable, "-c", WORK]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment) as living:
        assert living.stdout is not None
        folder = Path(living.stdout.readline().strip())
        aged(folder, 100_000)
        with Scratch():
            assert (folder / "rows").stat().st_size == 1000
        living.kill()
        living.wait()
        assert folder.is_dir()
    with Scratch() as scratch:
        assert [entry.name for entry in temporary.iterdir()] == [scratch.path.name]


def test_what_may_not_be_ours_or_is_just_begun_stays(temporary: Path):
    (temporary / "cyclekit-new").mkdir()
    (temporary / "cyclekit-young").mkdir()
    (temporary / "cyclekit-young" / ".lock").touch()
    (temporary / "elsewhere").mkdir()
    (temporary / "elsewhere" / ".lock").touch()
    aged(temporary / "elsewhere", 100_000)
    (temporary / "cyclekit-notes.txt").write_text("mine")
    if os.name != "nt":
        (temporary / "cyclekit-link").symlink_to(temporary / "elsewhere")
    before = sorted(temporary.rglob("*"))
    Scratch().remove()
    assert sorted(temporary.rglob("*")) == before


def test_a_folder_of_a_version_without_locks_goes_after_a_day(temporary: Path):
    (temporary / "cyclekit-old").mkdir()
    aged(temporary / "cyclekit-old", 90_000)
    Scratch().remove()
    assert list(temporary.iterdir()) == []
