"""Units of time that a log leaves open: proven by the other logs of its session, or refused with the candidates."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest

from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import LogError
from cyclekit.ingest.convert import convert
from cyclekit.ingest.ingest import ingest
from cyclekit.inspect.describe import describe

if TYPE_CHECKING:
    from pathlib import Path

SPAN_S = 300.0
PRESSED_S = np.array([0.0, 12.4, 61.7, 90.35, 120.0, 163.2, 188.8, 240.1, 297.3])


def robot(folder: Path, begin_s: float = 0.0, span_s: float = SPAN_S) -> Path:
    folder.mkdir(exist_ok=True)
    t_s = np.arange(0.0, span_s, 0.1)
    x = 0.5 + 0.2 * np.sin(t_s)
    rows = [f"{begin_s + t:.1f},{at:.4f},0.1,0.3" for t, at in zip(t_s.tolist(), x.tolist(), strict=True)]
    (folder / "robot.csv").write_text("\n".join(["t_s,tcp_x,tcp_y,tcp_z", *rows, ""]))
    lines = ["[[sources]]", 'path = "robot.csv"', 'adapter = "csv"', 'role = "robot"', "[sources.map]"]
    lines += ['time = "t_s"', 'x = "tcp_x"', 'y = "tcp_y"', 'z = "tcp_z"']
    (folder / "cell.toml").write_text("\n".join([*lines, ""]))
    return folder


def events(folder: Path, counts: list[str], name: str = "time") -> Path:
    rows = [f"{count},goal,{'AB'[k % 2]}" for k, count in enumerate(counts)]
    (folder / "plc.csv").write_text("\n".join([f"{name},signal,value", *rows, ""]))
    return folder


def safety(folder: Path, counts: list[str]) -> Path:
    rows = [f"{count},{100 - 50 * (k % 2)}" for k, count in enumerate(counts)]
    (folder / "speed_override.csv").write_text("\n".join(["time,override", *rows, ""]))
    return folder


def tasks(folder: Path, counts: list[str]) -> Path:
    spans = zip(["robot", "anna"] * len(counts), pairwise(counts), strict=False)
    rows = [f"{who},{who} task,{begin},{end}" for who, (begin, end) in spans]
    (folder / "tasks.csv").write_text("\n".join(["agent,task,start,end", *rows, ""]))
    return folder


def stored(folder: Path, out: Path, name: str) -> tuple[list[float], str]:
    dataset = Dataset.open(ingest(folder, out).place)
    (card,) = [card for card in dataset.recordings if card.shown == name]
    assert not any("changed while it was read" in text for text in card.said)
    rows = dataset.recorded(card.id, card.tables[0])
    assert rows is not None
    return rows["t_s"].to_list(), card.facts["time unit"]


WRITTEN = {
    "s": lambda t: f"{t:.2f}", "min": lambda t: f"{t / 60:.6f}", "ms": lambda t: f"{1000 * t:.0f}",
    "us": lambda t: f"{1e6 * t:.0f}", "1/10 s": lambda t: f"{10 * t:.0f}", "h": lambda t: f"{t / 3600:.8f}",
}  # fmt: skip


@pytest.mark.parametrize("unit", WRITTEN)
@pytest.mark.parametrize(("log", "name"), [(events, "plc.csv"), (safety, "speed_override.csv"), (tasks, "tasks.csv")])
def test_the_span_of_the_robot_proves_the_unit(tmp_path: Path, unit: str, log, name: str) -> None:
    folder = log(robot(tmp_path / "logs"), [WRITTEN[unit](t) for t in PRESSED_S.tolist()])
    t_s, why = stored(folder, tmp_path / "d", name)
    assert t_s == pytest.approx(PRESSED_S[: len(t_s)].tolist(), abs=0.06)
    assert why.startswith(f"{unit}: 29")
    assert "of robot" in why


def test_a_clock_that_both_logs_share_need_not_begin_at_zero(tmp_path: Path) -> None:
    folder = events(robot(tmp_path / "logs", 15_234.2), [f"{15_234.2 + t:.2f}" for t in PRESSED_S.tolist()])
    assert stored(folder, tmp_path / "d", "plc.csv")[0] == pytest.approx((15_234.2 + PRESSED_S).tolist())


@pytest.mark.parametrize("begin_s", [0.0, 1234.5, 86_400.0])
def test_minutes_of_a_clock_that_began_long_before_are_not_taken_for_seconds(tmp_path: Path, begin_s: float) -> None:
    folder = safety(robot(tmp_path / "logs"), [WRITTEN["min"](begin_s + t) for t in PRESSED_S.tolist()])
    if begin_s:
        with pytest.raises(LogError, match='"min"'):
            ingest(folder, tmp_path / "d")
    else:
        assert stored(folder, tmp_path / "d", "speed_override.csv")[1].startswith("min")


@pytest.mark.parametrize(
    "counts",
    [
        ["0.5", "1.5"],  # s at the beginning of the robot's log, or min
        ["0.0", "1.25", "3.5"],
        [f"{t:.1f}" for t in np.arange(0.3, 9000, 190.1).tolist()],  # s of a shift, or something shorter
    ],
)
def test_what_the_spans_leave_open_is_refused_with_the_candidates_and_the_line(tmp_path: Path, counts) -> None:
    folder = events(robot(tmp_path / "logs"), counts)
    with pytest.raises(LogError, match="the unit of its times is not stated") as refusal:
        ingest(folder, tmp_path / "d")
    assert all(unit in refusal.value.cause for unit in ('"s"', '"min"'))
    assert "robot.csv lasts 299.9 s" in refusal.value.cause
    cell = folder / "cell.toml"
    cell.write_text(
        cell.read_text() + '[[sources]]\npath = "plc.csv"\nadapter = "events"\n[sources.map]\ntime_unit = "s"\n'
    )
    assert "time unit" not in Dataset.open(ingest(folder, tmp_path / "d").place).recordings[1].facts


@pytest.mark.parametrize("log", [tasks, safety])
def test_a_log_alone_is_refused_with_the_line_that_states_its_unit(tmp_path: Path, log) -> None:
    (tmp_path / "logs").mkdir()
    folder = log(tmp_path / "logs", [WRITTEN["s"](t) for t in PRESSED_S.tolist()])
    with pytest.raises(LogError, match="the unit of its times is not stated") as refusal:
        ingest(folder, tmp_path / "d")
    assert '[sources.map] time_unit = "s"' in str(refusal.value.cure)


def test_one_file_is_read_in_the_likeliest_unit_and_marked(tmp_path: Path) -> None:
    folder = events(robot(tmp_path / "logs"), ["0", "61500", "290000"])
    (log,) = describe(folder / "plc.csv").logs
    (said,) = [text for text in log.warnings if "unit of its times is not stated" in text]
    assert "ms" in said
    assert any("unit of its times" in text for text in convert(folder / "plc.csv", tmp_path / "x.csv").warnings)


def test_a_log_that_was_proven_is_not_read_again(tmp_path: Path) -> None:
    folder = events(robot(tmp_path / "logs"), [WRITTEN["min"](t) for t in PRESSED_S.tolist()])
    first = stored(folder, tmp_path / "d", "plc.csv")
    (folder / "more.csv").write_text("time_s,signal,value\n1.0,x,1\n2.0,x,0\n")
    assert stored(folder, tmp_path / "d", "plc.csv") == first


def test_the_proof_holds_no_name_of_a_file_if_names_are_taken_out(tmp_path: Path) -> None:
    folder = events(robot(tmp_path / "logs"), [WRITTEN["min"](t) for t in PRESSED_S.tolist()])
    (folder / "robot.csv").rename(folder / "robot_of_annabell.csv")
    cell = folder / "cell.toml"
    cell.write_text(cell.read_text().replace("robot.csv", "robot_of_annabell.csv"))
    ingest(folder, tmp_path / "d", pseudonymise=True)
    dataset = Dataset.open(tmp_path / "d")
    assert "annabell" not in repr(dataset.card)
    (card,) = [card for card in dataset.recordings if "events" in card.tables]
    assert card.duration_s == pytest.approx(297.3, abs=0.1)


def test_a_long_log_that_runs_on_after_the_robot_is_proven_too(tmp_path: Path) -> None:
    counts = [f"{t:.2f}" for t in np.cumsum(np.random.default_rng(1).uniform(0.05, 0.3, 2600))]
    assert stored(safety(robot(tmp_path / "logs"), counts), tmp_path / "d", "speed_override.csv")[1].startswith("s: 4")
