"""Links in a folder of logs: followed within it, left out and told where they lead out of it, followed when asked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from cyclekit.cli import run
from cyclekit.cli.groups import grouped, regrouped
from cyclekit.config import Cell
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import LogError
from cyclekit.ingest.discover import find_all
from cyclekit.ingest.ingest import ingest
from cyclekit.inspect.describe import describe

TRIP = [("stand", 0.5), ("move", 0.3), ("stand", 0.5), ("move", 0.0)]


@pytest.fixture
def linked(tmp_path: Path, robot_log: Any) -> Path:
    """A folder with a log, a link to another in it, and links to a log, a folder and a folder log outside."""
    logs, outside = tmp_path / "logs", tmp_path / "outside"
    robot_log(logs / "a" / "own.csv", TRIP)
    robot_log(logs / "b" / "near.csv", TRIP)
    robot_log(outside / "far" / "run.csv", TRIP)
    robot_log(outside / "one.csv", TRIP)
    (logs / "c").symlink_to(logs / "b", target_is_directory=True)
    (logs / "round").symlink_to(logs, target_is_directory=True)
    (logs / "self").symlink_to("self")
    (logs / "far").symlink_to(outside / "far", target_is_directory=True)
    (logs / "one.csv").symlink_to(outside / "one.csv")
    return logs


def found(root: Path, **options: bool) -> tuple[list[str], list[str]]:
    logs, not_read = find_all([root], Cell(), **options)
    return sorted(log.shown for log in logs), sorted(name for name, why in not_read if "--follow-links" in why)


def test_links_that_lead_out_are_left_out_and_told(linked: Path):
    assert found(linked) == (["a/own.csv", "b/near.csv"], ["far", "one.csv"])


def test_links_are_followed_when_that_is_asked_for_and_circles_end(linked: Path):
    logs, left_out = found(linked, follow_links=True)
    assert (logs, left_out) == (["a/own.csv", "b/near.csv", "far/run.csv", "one.csv"], [])


def test_what_is_named_by_hand_may_be_a_link(linked: Path):
    assert found(linked / "one.csv")[0] == ["one.csv"]
    assert found(linked / "far")[0] == ["run.csv"]


def test_a_log_that_is_a_folder_is_left_out_with_what_it_borrows(tmp_path: Path):
    rows = "".join(f"{0.008 * i:.3f}, 0.1, 0.2, 0.3, 0, 0, 0\n" for i in range(20))
    log = tmp_path / "logs" / "movement"
    log.mkdir(parents=True)
    (tmp_path / "secret.csv").write_text(rows)
    (log / "log_q_actual.csv").write_text(rows)
    (log / "log_tool_vector.csv").symlink_to(tmp_path / "secret.csv")
    with pytest.raises(LogError, match="a link leads out of the folder of logs; --follow-links"):
        found(tmp_path / "logs")
    assert found(tmp_path / "logs", follow_links=True)[0] == ["movement"]


def test_ingest_and_inspect_leave_out_and_follow(linked: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "dataset"
    assert run(["ingest", str(linked), "--out", str(out)]) == 0
    assert "not read: far: a link leads out of the folder of logs" in capsys.readouterr().err
    assert len(Dataset.open(out).recordings) == 2
    assert run(["ingest", str(linked), "--out", str(out), "--follow-links", "--quiet"]) == 0
    assert len(Dataset.open(out).recordings) == 4
    assert len(describe(linked, follow_links=True).logs) == 4  # type: ignore[union-attr]
    assert run(["inspect", str(linked)]) == 0
    assert "a link leads out of the folder of logs" in capsys.readouterr().out.replace("\n  ", " ")


def test_what_is_said_of_many_files_is_said_once_with_how_many(tmp_path: Path, robot_log: Any, capsys):
    robot_log(tmp_path / "logs" / "run.csv", TRIP)
    for number in range(200):
        (tmp_path / "logs" / f"empty-{number:03}.csv").touch()
    report = ingest([tmp_path / "logs"], tmp_path / "dataset")
    assert len(report.not_read) == 200
    assert run(["ingest", str(tmp_path / "logs"), "--out", str(tmp_path / "dataset")]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "not read" in line]
    assert lines == ["not read: 200 files (empty-000.csv, empty-001.csv, empty-002.csv, …): the file is empty"]
    assert run(["inspect", str(tmp_path / "logs")]) == 0
    assert capsys.readouterr().out.count("the file is empty") == 1


def test_of_many_logs_inspect_shows_the_first_and_counts_the_rest(tmp_path: Path, robot_log: Any, capsys):
    for number in range(24):
        robot_log(tmp_path / "logs" / f"{number}.csv", TRIP)
    assert run(["inspect", str(tmp_path / "logs")]) == 0
    assert "and 4 more logs (4 by ur-rtde); --json has all" in capsys.readouterr().out


def test_few_are_named_and_many_kinds_are_cut():
    assert grouped([("a", "x"), ("b", "x"), ("c", "y")]) == ["a: x", "b: x", "c: y"]
    assert grouped((str(n), "x") for n in range(4)) == ["4 files (0, 1, 2, …): x"]
    lines = grouped((str(n), f"{n} rows") for n in range(2000))
    assert (len(lines), lines[-1]) == (21, "and 1980 more lines of this kind; --json has all")
    assert regrouped([*(f"{n}.csv: no speed" for n in range(4)), "the frame: unknown"]) == [
        "4 files (0.csv, 1.csv, 2.csv, …): no speed",
        "the frame: unknown",
    ]
    assert grouped([("", "no level was found"), ("a.csv", "cut: twice")]) == [
        "no level was found",
        "a.csv: cut: twice",
    ]
