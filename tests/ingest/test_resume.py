"""An ingest that was interrupted or killed: the next one goes on from there, and nothing stays beside the dataset."""

from __future__ import annotations

import errno
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from ingested import ROUND_TRIP, only_bytes

from cyclekit.cli import run
from cyclekit.config import Cell, Executions
from cyclekit.errors import CyclekitError, UnknownName
from cyclekit.ingest.discover import Log
from cyclekit.ingest.ingest import ingest
from cyclekit.ingest.read.read_logs import Digests
from cyclekit.ingest.registry import Registered

if TYPE_CHECKING:
    pass


def stop_at(monkeypatch: pytest.MonkeyPatch, name: str, reads: list[str]) -> None:
    """Let the next ingest be interrupted when it comes to a log."""
    parts = Registered.parts

    def interrupted(entry: Registered, path: Path, *options: Any) -> Any:
        if path.name == name:
            monkeypatch.setattr(Registered, "parts", parts)
            raise KeyboardInterrupt
        return parts(entry, path, *options)

    monkeypatch.setattr(Registered, "parts", interrupted)


@pytest.mark.usefixtures("large")
def test_an_interrupted_ingest_goes_on_where_it_was(
    three_runs: Path, tmp_path: Path, reads: list[str], monkeypatch: pytest.MonkeyPatch
):
    out = tmp_path / "out" / "dataset"
    stop_at(monkeypatch, "run_2.csv", reads)
    with pytest.raises(KeyboardInterrupt):
        ingest([three_runs], out)
    assert not out.exists()
    assert reads == ["run_0.csv", "run_1.csv"]
    reads.clear()
    report = ingest([three_runs], out)
    assert reads == ["run_2.csv"]
    assert (report.recordings_new, report.recordings_kept) == (1, 2)
    assert only_bytes(out) == only_bytes(Path(ingest([three_runs], tmp_path / "afresh").dataset))
    assert [entry.name for entry in out.parent.iterdir()] == ["dataset"]


@pytest.mark.usefixtures("large")
def test_what_an_interrupted_ingest_had_read_is_not_taken_for_a_log_that_has_changed_since(
    three_runs: Path, tmp_path: Path, reads: list[str], monkeypatch: pytest.MonkeyPatch, robot_log: Any
):
    out = tmp_path / "dataset"
    stop_at(monkeypatch, "run_2.csv", reads)
    with pytest.raises(KeyboardInterrupt):
        ingest([three_runs], out)
    robot_log(three_runs / "run_0.csv", [*ROUND_TRIP, ("move", 0.3), ("stand", 1.0)])
    reads.clear()
    ingest([three_runs], out)
    assert reads == ["run_0.csv", "run_2.csv"]
    assert only_bytes(out) == only_bytes(Path(ingest([three_runs], tmp_path / "afresh").dataset))


@pytest.mark.usefixtures("large")
def test_a_cell_file_that_was_wrong_costs_no_second_reading(three_runs: Path, tmp_path: Path, reads: list[str]):
    with pytest.raises(UnknownName):
        ingest([three_runs], tmp_path / "dataset", cell=Cell(executions=Executions(home="nowhere")))
    assert len(reads) == 3
    reads.clear()
    assert ingest([three_runs], tmp_path / "dataset").recordings_kept == 3
    assert reads == []


@pytest.mark.usefixtures("large")
def test_nothing_that_names_a_person_stays_beside_an_interrupted_ingest(
    three_runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reads: list[str]
):
    stop_at(monkeypatch, "run_2.csv", reads)
    with pytest.raises(KeyboardInterrupt):
        ingest([three_runs], tmp_path / "out" / "dataset", pseudonymise=True)
    assert [entry.name for entry in (tmp_path / "out").iterdir()] == ["dataset.key"]  # it holds no name


@pytest.mark.usefixtures("large")
@pytest.mark.parametrize("again", [{}, {"pseudonymise": True}])
def test_what_a_killed_ingest_left_of_its_readings_is_removed_by_the_next(
    three_runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, again: dict[str, bool]
):
    from cyclekit.ingest.read import resume as shelf

    out, rmtree = tmp_path / "out" / "dataset", shelf.shutil.rmtree

    def killed(path: Path, **how: Any) -> None:
        if path.exists() and path.name.startswith(".dataset.read"):
            next(file for file in sorted(path.rglob("*")) if file.suffix == ".parquet").unlink()
            monkeypatch.setattr(shelf.shutil, "rmtree", rmtree)
            raise KeyboardInterrupt
        rmtree(path, **how)

    monkeypatch.setattr(shelf.shutil, "rmtree", killed)
    with pytest.raises(KeyboardInterrupt):
        ingest([three_runs], out)
    assert sorted(entry.name for entry in out.parent.iterdir()) != ["dataset"]
    first = only_bytes(out)
    ingest([three_runs], out, **again)
    assert sorted(entry.name for entry in out.parent.iterdir()) == ["dataset", *(["dataset.key"] if again else [])]
    assert again or only_bytes(out) == first


@pytest.mark.usefixtures("large")
def test_a_recording_that_lost_a_table_while_it_was_removed_is_never_used(
    three_runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    from cyclekit.ingest.read import resume as shelf

    out, rmtree = tmp_path / "out" / "dataset", shelf.shutil.rmtree

    def killed(path: Path, **how: Any) -> None:
        if path.exists() and path.name.startswith(".dataset.read"):
            for file in path.rglob("robot.parquet"):
                file.unlink()
            raise KeyboardInterrupt
        rmtree(path, **how)

    monkeypatch.setattr(shelf.shutil, "rmtree", killed)
    with pytest.raises(KeyboardInterrupt):
        ingest([three_runs], out)
    monkeypatch.undo()
    first = only_bytes(out)
    rmtree(out)
    ingest([three_runs], out)
    assert only_bytes(out) == first


@pytest.mark.usefixtures("large")
def test_after_a_full_disk_nothing_that_was_read_stays_beside_the_dataset(
    three_runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def full(*_: Any) -> None:
        assert (tmp_path / "out" / ".dataset.read").is_dir()
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("cyclekit.ingest.ingest.write_parquet", full)
    with pytest.raises(CyclekitError, match="No space left"):
        ingest([three_runs], tmp_path / "out" / "dataset")
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.usefixtures("large")
def test_a_disk_on_which_nothing_can_be_renamed_keeps_no_readings_either(
    three_runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    rename = Path.rename

    def refused(path: Path, target: Path) -> Path:
        if path.name.endswith("dataset.read"):
            raise OSError(errno.ENOSPC, "No space left on device")
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", refused)
    ingest([three_runs], tmp_path / "out" / "dataset")
    assert [entry.name for entry in (tmp_path / "out").iterdir()] == ["dataset"]


@pytest.mark.usefixtures("large")
def test_what_is_kept_of_an_interrupted_ingest_is_said_and_goes_when_names_shall(
    three_runs: Path, tmp_path: Path, reads: list[str], monkeypatch: pytest.MonkeyPatch, capsys: Any
):
    out = tmp_path / "out" / "dataset"
    stop_at(monkeypatch, "run_2.csv", reads)
    assert run(["ingest", str(three_runs), "--out", str(out)]) == 130
    left = out.with_name(".dataset.read")
    assert f"{left}: what was read, people included, is kept" in capsys.readouterr().err
    assert left.is_dir()
    stop_at(monkeypatch, "run_0.csv", reads)
    assert run(["ingest", str(three_runs), "--out", str(out), "--pseudonymise"]) == 130
    assert "is kept" not in capsys.readouterr().err
    assert [entry.name for entry in out.parent.iterdir()] == ["dataset.key"]  # it holds no name


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="a file without an end is a thing of Unix")
def test_one_who_interrupts_does_not_wait_for_the_checksum_of_a_large_log():
    endless = Log("a", Path("/dev/zero"), "zero", "csv", "cyclekit", "1", None, "")

    def interrupted() -> None:
        with Digests() as digests:
            digests.sources(endless)
            raise KeyboardInterrupt

    before = set(threading.enumerate())
    with pytest.raises(KeyboardInterrupt):
        interrupted()
    for thread in set(threading.enumerate()) - before:
        thread.join(20.0)
        assert not thread.is_alive()
