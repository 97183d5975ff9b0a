"""A log written in any unit and from any epoch comes to the same table, or is refused with the units it may have.

The public functions are tried, as a user would: `draft_cell` for logs that no adapter knows, then `ingest_logs`.
"""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np
import pytest
from epochs import EPOCHS
from examples import at_most
from hypothesis import HealthCheck, assume, given
from hypothesis import strategies as st

import cyclekit
from cyclekit.errors import LogError

if TYPE_CHECKING:
    from pathlib import Path

BEGIN_S = datetime(2024, 5, 14, 6, 30, 0, 250_000, tzinfo=UTC).timestamp()
DAY_S = 86_400.0
COUNTED = {
    "ns": 1e-9, "10 ns": 1e-8, "100 ns": 1e-7, "us": 1e-6, "10 us": 1e-5, "ms": 1e-3, "1/100 s": 0.01,
    "1/10 s": 0.1, "s": 1.0, "min": 60.0, "h": 3600.0, "days": DAY_S, "4 ms": 0.004,
}  # fmt: skip
ROWS = "row number"
WHOLE = {"ns", "10 ns", "100 ns", "us", "10 us", "1/100 s", "1/10 s", "4 ms", "filetime", "ticks"}
WHOLE |= {"us since 1970", "ns since 1970"}
RESOLUTION_S = 2e-4
"""A float64 holds .NET ticks to 13 us, days since the year 0 to 10 us."""
T_S = np.arange(0.0, 40.0, 0.1)
"""Times of the robot, the tracker and a sampled safety log, s."""
CHANGED_S = np.array([0.0, 2.3, 4.1, 5.7, 9.9, 12.2, 17.6, 21.3, 26.8, 30.4, 33.3, 37.9, 39.6])
"""Times of events and of tasks, s."""


def written(unit: str, t_s: np.ndarray) -> list[str]:
    """Return times since BEGIN_S as a program writes them in a unit; relative counts begin at zero."""
    if unit == ROWS:
        return [str(row) for row in range(len(t_s))]
    seconds, ahead_s = (COUNTED[unit], 0.0) if unit in COUNTED else (EPOCHS[unit][0], BEGIN_S + EPOCHS[unit][1])
    counts = [(t + ahead_s) / seconds for t in t_s.tolist()]
    return [f"{math.floor(count + 1e-6)}" if unit in WHOLE else f"{count:.10f}" for count in counts]


def resolution_s(unit: str) -> float:
    return max(RESOLUTION_S, 1.01 * COUNTED.get(unit, 0.0) * (unit in WHOLE))


def lines(file: Path, header: str, rows: list[str]) -> None:
    file.write_text("\n".join([header, *rows, ""]), encoding="utf-8")


def robot(file: Path, name: str, times: list[str], length: str = "mm") -> None:
    place = zip(500 + 200 * np.cos(T_S), 200 * np.sin(T_S), strict=True)
    rows = [f"{time},{x:.3f},{y:.3f},300.5" for time, (x, y) in zip(times, place, strict=True)]
    lines(file, f"{name},tcp_x [{length}],tcp_y [{length}],tcp_z [{length}]", rows)


def people(file: Path, name: str, times: list[str]) -> None:
    rows = [f"{time},7,{x:.3f},1.5" for time, x in zip(times, 2.0 + np.sin(T_S / 3), strict=True)]
    lines(file, f"{name},person_id,x [m],y [m]", rows)


def events(file: Path, name: str, times: list[str]) -> None:
    lines(file, f"{name},signal,value", [f"{time},door,{k % 2}" for k, time in enumerate(times)])


def safety(file: Path, name: str, times: list[str]) -> None:
    lines(file, f"{name},override", [f"{time},{100 - 30 * (k % 3)}" for k, time in enumerate(times)])


def tasks(file: Path, name: str, times: list[str]) -> None:
    who = ["robot", "anna"] * len(times)
    rows = [f"{one},{one} {k},{a},{b}" for k, (one, a, b) in enumerate(zip(who, times, times[1:], strict=False))]
    unit = re.search(r"\[.*\]", name)
    lines(file, f"agent,task,start{unit[0] if unit else ''},end{unit[0] if unit else ''}", rows)


KINDS = {
    "robot": (robot, "robot.csv", T_S),
    "people": (people, "people.csv", T_S),
    "events": (events, "plc.csv", CHANGED_S),
    "safety": (safety, "speed_override.csv", CHANGED_S),
    "sampled safety": (safety, "speed_override.csv", T_S),
    "tasks": (tasks, "tasks.csv", CHANGED_S),
}
DRAFTED = ("robot", "people")


def outcome(folder: Path, kind: str, unit: str, *, says: bool, beside: bool) -> str:
    """Return what comes of a log: its unit as read, or what asks for it; anything wrong fails."""
    write, file, t_s = KINDS[kind]
    name = f"Time [{unit}]" if says and unit in COUNTED else "gps_time" if unit == "gps" else "Timestamp"
    logs = folder / "logs"
    logs.mkdir()
    write(logs / file, name, written(unit, t_s))
    called = "frame" if unit == ROWS else EPOCHS[unit][2] if unit in EPOCHS else unit
    if beside and kind != "robot":
        robot(logs / "robot.csv", "Time [s]", written("s", T_S))
    if beside or kind in DRAFTED:
        draft = cyclekit.draft_cell(logs, out=logs / "cell.toml")
        asked = [line for line in draft.cell.splitlines() if line.startswith("# ?") and "time_unit" in line]
        if asked:
            assert called in asked[0] or called in EPOCHS
            return asked[0]
        assert not draft.unsure, draft.cell
    refusal: LogError | None = None
    try:
        dataset = cyclekit.Dataset.open(cyclekit.ingest_logs(logs, folder / "d").place)
    except LogError as error:
        refusal = error
    if refusal is not None:
        named = str(refusal.cure) if called == "4 ms" else refusal.cause
        assert f'"{called}"' in named or (kind == "tasks" and unit == ROWS), str(refusal)
        return str(refusal)
    (card,) = [card for card in dataset.recordings if card.shown == file]
    rows = dataset.recorded(card.id, card.tables[0])
    assert rows is not None
    got, true_s = rows["t_s"].to_numpy(), t_s[: rows.height]
    assert rows.height >= len(t_s) - 1
    assert got - got[0] == pytest.approx(true_s - true_s[0], abs=2 * resolution_s(unit))
    if unit in EPOCHS:
        assert got[0] == pytest.approx(BEGIN_S + true_s[0], abs=RESOLUTION_S)
        assert card.clock.kind == ("relative" if unit in ("excel", "wincc", "matlab", "ticks") else "epoch")
    return "read"


@at_most(60, suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(
    kind=st.sampled_from([*KINDS]),
    unit=st.sampled_from([*COUNTED, *EPOCHS, ROWS]),
    says=st.booleans(),
    beside=st.booleans(),
)
def test_a_log_in_any_unit_comes_to_one_table_or_is_refused_with_its_candidates(
    tmp_path_factory: pytest.TempPathFactory, kind: str, unit: str, says: bool, beside: bool
) -> None:
    assume(kind != "tasks" or unit != "gps")  # seconds of GPS are known by the name of their column alone
    outcome(tmp_path_factory.mktemp("log"), kind, unit, says=says, beside=beside)


@pytest.mark.parametrize("kind", ["events", "safety", "tasks"])
@pytest.mark.parametrize("unit", ["ms", "s", "min", "1/10 s", "filetime", "s since 1970"])
def test_a_unit_that_the_robot_beside_it_proves_is_not_asked_for(tmp_path: Path, kind: str, unit: str) -> None:
    assert outcome(tmp_path, kind, unit, says=False, beside=True) == "read"
