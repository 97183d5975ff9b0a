"""One writer at a time, and the old result or the new one, whatever happens to logs and places meanwhile."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from cyclekit.errors import BusyPlace, CyclekitError
from cyclekit.ingest.ingest import ingest
from cyclekit.storage.atomic import locked, replaced, staged, write_text

if TYPE_CHECKING:
    from collections.abc import Iterator


def test_a_log_that_goes_away_between_finding_and_reading_is_named(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    from cyclekit.ingest.read import read_logs as intake

    read_all = intake.read_all

    def after_a_moment(*args: Any, **options: Any) -> Any:
        (logs / "b.csv").unlink()
        return read_all(*args, **options)

    monkeypatch.setattr("cyclekit.ingest.ingest.read_all", after_a_moment)
    report = ingest([logs], tmp_path / "dataset")
    assert [path for path, _ in report.not_read] == ["b.csv"]
    assert report.recordings_new == 1


def test_a_log_that_grows_while_it_is_read_is_named(logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from cyclekit.ingest.read.log_checksums import Digests

    sources = Digests.sources

    def and_the_logger_writes_on(digests: Digests, log: Any) -> Any:
        found = sources(digests, log)
        with log.path.open("ab") as file:
            file.write(b"0\r\n")
        return found

    monkeypatch.setattr(Digests, "sources", and_the_logger_writes_on)
    report = ingest([logs / "a.csv"], tmp_path / "dataset")
    assert any("changed while it was read" in text for text in report.warnings)


HOLD = """
import sys, time
from pathlib import Path
from cyclekit.storage.atomic import staged

with staged(Path(sys.argv[1])) as folder:
    print("held", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def held(tmp_path: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A process that is writing at `tmp_path/dataset`."""
    words = [sys.executable, "-c", HOLD, str(tmp_path / "dataset")]
    with subprocess.Popen(words, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        other.stdout.readline()
        yield other
        other.kill()


def test_a_second_ingest_into_one_dataset_is_refused_with_the_process_that_is_at_work(
    held: subprocess.Popen[bytes], logs: Path, tmp_path: Path
):
    with pytest.raises(BusyPlace, match=rf"dataset: another cyclekit \(process {held.pid}\) is writing there"):
        ingest([logs], tmp_path / "dataset")
    assert held.poll() is None


def test_a_lock_of_a_killed_process_does_not_block(held: subprocess.Popen[bytes], logs: Path, tmp_path: Path):
    held.kill()
    held.wait()
    assert (tmp_path / ".dataset.lock").exists()
    assert ingest([logs], tmp_path / "dataset").recordings_new == 2
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["dataset", "logs"]


def test_one_place_has_one_writer_and_the_next_has_its_turn(tmp_path: Path):
    with locked(tmp_path / "x"):
        with pytest.raises(BusyPlace), locked(tmp_path / "x", wait_s=0.05):
            pass
        with locked(tmp_path / "y"):
            pass
    with locked(tmp_path / "x"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_what_a_lock_file_holds_is_never_the_reason_to_refuse(tmp_path: Path):
    (tmp_path / ".x.lock").write_text("of an older version, whose process is gone\n", encoding="utf-8")
    with locked(tmp_path / "x", wait_s=0.0):
        assert f"{os.getpid()}" in (tmp_path / ".x.lock").read_text(encoding="utf-8")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name == "nt", reason="its file systems all know locks")
def test_where_a_file_system_knows_no_locks_the_writer_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def flock(*_: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", flock)
    write_text(tmp_path / "page.html", "new")
    assert [entry.name for entry in tmp_path.iterdir()] == ["page.html"]


def test_a_folder_at_the_place_of_the_lock_is_named(tmp_path: Path):
    (tmp_path / ".x.lock").mkdir()
    with pytest.raises(CyclekitError, match=r"x: cannot be written"), locked(tmp_path / "x", wait_s=0.0):
        pass


TAKE_TURNS = """
import sys, time
from pathlib import Path
from cyclekit.storage.atomic import locked

inside = Path(sys.argv[1])
for _ in range(150):
    with locked(inside, wait_s=20):
        inside.touch(exist_ok=False)
        inside.unlink()
"""


def test_two_processes_are_never_inside_together(tmp_path: Path):
    words = [sys.executable, "-c", TAKE_TURNS, str(tmp_path / "inside")]
    both = [subprocess.Popen(words, stderr=subprocess.PIPE) for _ in range(2)]
    assert [(one.communicate(timeout=300)[1], one.returncode) for one in both] == [(b"", 0), (b"", 0)]


def test_a_page_that_fails_in_the_middle_leaves_the_old_one(tmp_path: Path):
    page = tmp_path / "page.html"
    write_text(page, "old")

    def fail() -> None:
        with replaced(page) as temporary:
            temporary.write_text("half", encoding="utf-8")
            raise OSError(28, "No space left on device")

    with pytest.raises(CyclekitError, match=r"page\.html: cannot be written"):
        fail()
    assert [entry.name for entry in tmp_path.iterdir()] == ["page.html"]
    assert page.read_text(encoding="utf-8") == "old"


def test_what_a_killed_process_left_of_a_page_is_swept_by_the_next(tmp_path: Path):
    (tmp_path / ".page.html.tmp-1-abc").write_text("half", encoding="utf-8")
    write_text(tmp_path / "page.html", "new")
    assert [entry.name for entry in tmp_path.iterdir()] == ["page.html"]


def test_a_place_below_a_file_cannot_be_written_and_is_named(tmp_path: Path):
    (tmp_path / "file").write_text("here", encoding="utf-8")
    for below in ("file/dataset", "file/more/dataset"):
        with pytest.raises(CyclekitError, match=r"dataset: cannot be written"), staged(tmp_path / below):
            pass
        with pytest.raises(CyclekitError, match=r"cannot be written"):
            write_text(tmp_path / below, "text")


def test_the_swap_that_fails_brings_the_old_folder_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    with staged(tmp_path / "d") as folder:
        write_text(folder / "a", "old")
    rename = Path.rename

    def failing(self: Path, target: Path) -> Path:
        if Path(target).name == "d" and ".new-" in self.name:
            raise OSError(5, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", failing)
    with pytest.raises(CyclekitError, match="Input/output error"), staged(tmp_path / "d") as folder:
        write_text(folder / "a", "new")
    assert (tmp_path / "d" / "a").read_text(encoding="utf-8") == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["d"]
