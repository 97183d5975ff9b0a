"""Logs that hold two clocks, their device's and their host's, are placed by both, whichever side has them."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from log_cards import log_card

from cyclekit.adapter import Recording
from cyclekit.alignment.recording_clocks import place_in_time
from cyclekit.config import Cell, Source, load_cell
from cyclekit.dataset.cards import ClockCard, LogCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.dataset.sessions import LogGroup
from cyclekit.ingest.ingest import ingest
from cyclekit.ingest.pseudonymise import Nameless
from cyclekit_sim import simulate

pytestmark = pytest.mark.tests_clocks

EPOCH_S, UPTIME_S = 1_700_000_000.0, 152.5
DRIFT = 40e-6


def entry(name: str, kind: Any, first_s: float, *tables: Any) -> LogCard:
    return log_card(f"{name}.csv", *tables, id=name, kind=kind, first_s=first_s, last_s=first_s + 600.0)


def stamps(zero_s: float, drift: float, *, seed: int = 1, least_s: float = 0.001) -> pl.DataFrame:
    """A device that shows `zero_s` at the epoch's EPOCH_S and drifts; its host receives every message late."""
    rng = np.random.default_rng(seed)
    elapsed = np.arange(0.0, 600.0, 0.02)
    late = least_s + rng.exponential(0.005, elapsed.size)
    return pl.DataFrame({"t_s": zero_s + elapsed * (1 + drift), "host_s": EPOCH_S + elapsed + late})


def placed(master: LogCard, other: LogCard, tables: dict[str, pl.DataFrame], **sources: Source) -> ClockCard:
    session = LogGroup("s", (master, other))
    known = {one.id: sources.get(one.id) for one in session.logs}

    def no_robot(name: str, columns: Any) -> Any:
        raise AssertionError(name)

    def stamps_alone(name: str, table: str) -> pl.DataFrame | None:
        return tables.get(name) if table == "stamps" else None

    return place_in_time(session, known, stamps_alone, no_robot)[1].clock


def worst_s(clock: ClockCard, log_s: Any, session_s: Any) -> float:
    elapsed = np.linspace(0.0, 600.0, 50)
    told = clock.rate * log_s(elapsed) + clock.offset_s
    return float(np.abs(told - session_s(elapsed)).max())


def test_a_device_with_stamps_is_placed_among_logs_in_epoch_time() -> None:
    robot, people = entry("r", "epoch", EPOCH_S + 10.0, "robot"), entry("p", "uptime", 77.0, "people", "stamps")
    clock = placed(robot, people, {"p": stamps(77.0, DRIFT)})
    assert clock.method == "lower-envelope"
    assert worst_s(clock, lambda e: 77.0 + e * (1 + DRIFT), lambda e: e - 10.0) < 0.002
    assert clock.residual_s == pytest.approx(0.005 * np.log(2), rel=0.2)
    assert clock.events == 30_000
    assert clock.warnings == ()


def test_a_log_in_epoch_time_is_placed_by_the_stamps_of_the_robot() -> None:
    first_s = UPTIME_S + 20.0
    robot, people = entry("r", "uptime", first_s, "robot", "stamps"), entry("p", "epoch", EPOCH_S, "people")
    clock = placed(robot, people, {"r": stamps(UPTIME_S, DRIFT)})
    assert clock.method == "lower-envelope"
    assert worst_s(clock, lambda e: EPOCH_S + e, lambda e: UPTIME_S + e * (1 + DRIFT) - first_s) < 0.002
    assert clock.rate == pytest.approx(1 + DRIFT, abs=2e-6)


def test_two_devices_with_stamps_meet_in_the_time_of_their_hosts() -> None:
    robot, people = (entry("r", "uptime", UPTIME_S, "robot", "stamps"), entry("p", "uptime", 5.0, "people", "stamps"))
    clock = placed(robot, people, {"r": stamps(UPTIME_S, DRIFT), "p": stamps(5.0, -DRIFT, seed=2)})
    assert clock.method == "lower-envelope"
    assert worst_s(clock, lambda e: 5.0 + e * (1 - DRIFT), lambda e: e * (1 + DRIFT)) < 0.002


@pytest.mark.parametrize("kinds", [("uptime", "epoch"), ("epoch", "uptime"), ("uptime", "relative")])
def test_without_stamps_on_the_side_that_needs_them_nothing_is_gained(kinds: tuple[str, str]) -> None:
    robot, people = entry("r", kinds[0], 5.0, "robot"), entry("p", kinds[1], EPOCH_S, "people")
    assert placed(robot, people, {}).method == "assumed-common-start"


def test_the_cell_file_comes_first_then_epoch_time_then_the_stamps() -> None:
    both = {"p": stamps(77.0, DRIFT)}
    robot, people = entry("r", "epoch", EPOCH_S, "robot"), entry("p", "uptime", 77.0, "people", "stamps")
    assert placed(robot, people, both, p=Source("p", clock_offset_s=1.0)).method == "cell-file"
    assert placed(robot, people, both, p=Source("p", sync_events=((0.0, 1.0), (9.0, 10.0)))).method == "event-pairs"
    in_epoch = entry("p", "epoch", EPOCH_S + 3.0, "people", "stamps")
    assert placed(entry("r", "epoch", EPOCH_S, "robot"), in_epoch, {"p": stamps(EPOCH_S, 0.0)}).method == "epoch"


def test_a_device_that_was_switched_off_and_on_is_not_placed_by_one_line() -> None:
    robot, people = entry("r", "epoch", EPOCH_S, "robot"), entry("p", "uptime", 77.0, "people", "stamps")
    first, second = stamps(77.0, 0.0), stamps(3.0, 0.0)
    clock = placed(robot, people, {"p": pl.concat([first, second])})
    assert clock.method == "assumed-common-start"
    assert [one.code for one in clock.warnings] == ["clock-restarted", "clock-assumed"]


def test_stamps_without_a_row_do_not_drift() -> None:
    robot, people = entry("r", "epoch", EPOCH_S, "robot"), entry("p", "uptime", 77.0, "people", "stamps")
    clock = placed(robot, people, {"p": stamps(77.0, 0.0).clear()})
    assert [one.code for one in clock.warnings] == ["clock-assumed"]


def test_stamps_that_lie_far_above_their_line_are_worth_a_warning() -> None:
    robot, people = entry("r", "epoch", EPOCH_S, "robot"), entry("p", "uptime", 77.0, "people", "stamps")
    late = stamps(77.0, 0.0).with_columns(pl.col("host_s") + pl.Series(np.random.default_rng(3).uniform(0, 1, 30_000)))
    assert [one.code for one in placed(robot, people, {"p": late}).warnings] == ["clock-stamps-late"]


@pytest.mark.slow
def test_a_kuka_with_the_seconds_of_its_pc_is_placed_beside_a_tracker_in_epoch_time(tmp_path: Path) -> None:
    """The simulated cell, its robot as an RSI client writes it: the PC's time in whole seconds, a cycle of 12 ms."""
    logs = tmp_path / "logs"
    simulate("box-picking", logs, executions=2, seed=3)
    session = logs / "session_000"
    write_kuka(session)
    people = write_people(session)
    for name in ("robot.csv", "operator.csv", "events.csv"):
        (session / name).unlink(missing_ok=True)
    cell = load_cell(logs / "cell.toml")
    columns = {"delimiter": ",", "time": "t", "time_unit": "s", "clock": "epoch", "person": "who"}
    sources = (
        Source("session_*/kuka.csv", map={"time_zone": "Europe/Rome"}),
        Source("session_*/people.csv", adapter="csv", role="people", map=columns | {"x": "x", "y": "y", "z": "z"}),
    )
    kept = Cell(sources=sources, places=cell.places, ignore=("*.toml", "*.json", "*.tsv", "*.parquet"))
    ingest([logs], tmp_path / "d", cell=kept)
    clock = next(r.clock for r in Dataset.open(tmp_path / "d").recordings if r.id.endswith("people"))
    assert clock.method == "lower-envelope"
    told = clock.rate * people + clock.offset_s
    assert np.abs(told - (people - people[0])).max() < 0.013  # early by a cycle at most: that is how far RSI can tell
    hidden = Dataset.open(ingest([logs], tmp_path / "hidden", cell=kept, pseudonymise=True).dataset)
    assert not list(hidden.path.rglob("stamps.parquet"))
    assert [r.clock.method for r in hidden.recordings] == ["own", "lower-envelope"]


def test_the_joints_of_a_person_get_the_number_of_the_person() -> None:
    people = pl.DataFrame({"t_s": [0.0, 0.0], "person": ["Ann", "Bob"]})
    joints = pl.DataFrame({"t_s": [0.0, 0.0], "person": ["Bob", "Cy"], "joint": ["head", "head"]})
    hidden = Nameless().part(Recording(people=people, skeletons=joints))
    assert hidden.people is not None
    assert hidden.skeletons is not None
    assert hidden.people["person"].to_list() == ["person_1", "person_2"]
    assert hidden.skeletons["person"].to_list() == ["person_2", "person_3"]


def write_kuka(session: Path) -> None:
    columns = ["timestamp", *(f"actual_TCP_pose_{i}" for i in range(3))]
    robot = pl.read_csv(session / "robot.csv", separator=" ", columns=columns).select(columns).to_numpy()
    at = np.arange(0.0, robot[-1, 0] - robot[0, 0], 0.012)
    xyz = np.column_stack([np.interp(at, robot[:, 0] - robot[0, 0], robot[:, 1 + k]) for k in range(3)]) * 1000
    from zoneinfo import ZoneInfo

    rome = ZoneInfo("Europe/Rome")
    lines = ["Timestamp,X_RIst,Y_RIst,Z_RIst,IPOC"]
    for t, (x, y, z) in zip(at.tolist(), xyz.tolist(), strict=True):
        shown = datetime.fromtimestamp(int(EPOCH_S + 0.4 + t), UTC).astimezone(rome).strftime("%Y-%m-%d %H:%M:%S")
        lines.append(f"{shown},{x:.1f},{y:.1f},{z:.1f},{round(t * 1000) + 7_000_000}")
    (session / "kuka.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_people(session: Path) -> np.ndarray:
    """Somebody who walks to and fro; returns the times, the first of which is the robot's first."""
    t = EPOCH_S + 0.4 + np.arange(0.0, 100.0, 0.05)
    lines = ["t,who,x,y,z", *(f"{a:.4f},1,{2 + np.sin(a):.3f},0.5,1.0" for a in t.tolist())]
    (session / "people.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return t
