"""What the tests share is made once, by whoever asks first, and who changes it is found out."""

from __future__ import annotations

import subprocess
import sys
import threading
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from made_once import SHARED, changed, made_once

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The folders of two processes of one run."""
    monkeypatch.setenv("PYTEST_XDIST_WORKER", "gw0")
    places = [tmp_path / f"popen-gw{number}" for number in range(2)]
    return [SimpleNamespace(getbasetemp=lambda place=place: place) for place in places]


def write(folder: Path) -> None:
    (folder / "a.txt").write_text("whole", encoding="utf-8")


def test_of_all_who_ask_one_makes_it_and_the_others_get_the_whole(workers: list[Any]) -> None:
    made, got, may_end = [], [], threading.Event()

    def make(folder: Path) -> None:
        made.append(folder)
        may_end.wait()
        write(folder)

    def ask(worker: Any) -> None:
        got.append((made_once(worker, "cell", make) / "a.txt").read_text(encoding="utf-8"))

    asking = [threading.Thread(target=ask, args=(worker,)) for worker in workers]
    for thread in asking:
        thread.start()
    may_end.set()
    for thread in asking:
        thread.join()
    assert got == ["whole", "whole"]
    assert len(made) == 1


def test_what_a_failed_process_left_is_made_anew(workers: list[Any]) -> None:
    def fail(folder: Path) -> None:
        (folder / "half.txt").touch()
        raise OSError("half")

    with pytest.raises(OSError, match="half"):
        made_once(workers[0], "cell", fail)
    assert [file.name for file in made_once(workers[1], "cell", write).iterdir()] == ["a.txt"]


def test_who_changes_what_others_read_is_found_out(workers: list[Any], tmp_path: Path) -> None:
    folder = made_once(workers[0], "cell", write)
    made_once(workers[0], "other", write)
    assert changed(tmp_path / SHARED) == []
    (folder / "b.txt").touch()
    (folder / "a.txt").write_text("longer now", encoding="utf-8")
    assert changed(tmp_path / SHARED) == ["cell: a.txt, b.txt"]


def test_processes_that_tests_start_compile_no_source_twice(tmp_path: Path) -> None:
    (tmp_path / "a_module.py").write_text("", encoding="utf-8")
    script = "import a_module, pathlib; print(pathlib.Path(a_module.__cached__).is_file())"
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "True"
