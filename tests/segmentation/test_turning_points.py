"""A robot that never rests, or not at one end: its turns are its places, and nothing else is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from cyclekit.config import Cell
from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit_sim.arm import forward


def found_in(tmp_path: Path, log: Path) -> Dataset:
    return Dataset.open(ingest([log], tmp_path / "dataset", cell=Cell()).dataset)


def eased(log: Path) -> Path:
    """Make the corners of a log's motion at constant speed parabolic: speed falls to nearly zero in 0.1 s."""
    rows = pl.read_csv(log, separator=" ")
    x = rows["actual_TCP_pose_0"]
    smooth = x.rolling_mean(25, center=True, min_samples=1)
    speed = (smooth.shift(-1) - smooth.shift(1)).fill_null(0.0) / 0.016
    columns = {"actual_TCP_pose_0": smooth, "actual_q_0": smooth, "actual_TCP_speed_0": speed}
    rows.with_columns(**columns).write_csv(log, separator=" ")
    return log


def test_the_turns_of_a_robot_that_never_rests_are_its_places(tmp_path: Path, robot_log: Any):
    doing = [("move", 1.0), ("move", 0.0)] * 3
    found = found_in(tmp_path, eased(robot_log(tmp_path / "run.csv", doing, scaling=False)))
    assert sorted(place.xyz_m[0] for place in found.places.values()) == pytest.approx([0.025, 0.975], abs=0.02)
    tasks = found.tasks()
    assert tasks["task"].to_list()[-3:-1] in (
        ["place_1->place_2", "place_2->place_1"],
        ["place_2->place_1", "place_1->place_2"],
    )
    assert (tasks["arrival_s"] - tasks["start_s"]).to_list()[1:3] == pytest.approx([2.0] * 2, abs=0.05)
    assert tasks["dwell_s"].abs().max() < 0.05


def test_where_it_rests_a_turn_is_a_waypoint(tmp_path: Path, robot_log: Any):
    doing: list[tuple[str, float]] = [("stand", 1.0)]
    for _ in range(4):
        doing += [("move", 0.5), ("move", 0.3), ("move", 1.0), ("stand", 0.6), ("move", 0.0), ("stand", 0.6)]
    found = found_in(tmp_path, eased(robot_log(tmp_path / "run.csv", doing)))
    assert len(found.places) == 2


def test_a_turn_that_is_seen_once_is_no_place(tmp_path: Path, robot_log: Any):
    doing = [("stand", 1.0), ("move", 1.0), ("move", 0.4), ("move", 2.0)]
    found = found_in(tmp_path, eased(robot_log(tmp_path / "run.csv", doing, scaling=False)))
    assert found.tasks().height == 0


A_RAD = np.array([0.0, -1.6, 1.5, -1.5, -1.57, 0.0])
VIA_RAD, B_RAD = A_RAD + np.array([[0.7, -0.3, 0.1, 0.3, 0.0, 0.2], [1.4, 0.3, -0.4, 0.2, 0.1, 0.5]])
HOLD_S = np.arange(68) / 125  # 0.54 s
DISTURBED = {
    "not at all": 0 * HOLD_S,
    "pushed": 2e-3 * np.sin(np.pi * HOLD_S / HOLD_S[-1]),
    "ringing": 2e-3 * np.exp(-HOLD_S / 0.15) * np.sin(12 * np.pi * HOLD_S),
}


def to_and_fro(file: Path, motions: int, each: int, disturbed_rad: np.ndarray) -> Path:
    """Write an arm's log at 125 Hz without outputs and override: motions with blends, and 0.54 s at both ends.

    At B, each `each`-th time, the joints are off by these angles (68,) in turn, more and less.
    """
    noise = np.random.default_rng(0)
    s = np.linspace(0, 1, 250, endpoint=False)[:, None]
    s = 10 * s**3 - 15 * s**4 + 6 * s**5
    there = (1 - s) ** 2 * A_RAD + 2 * s * (1 - s) * VIA_RAD + s**2 * B_RAD
    parts = [np.repeat(A_RAD[None], 125, axis=0)]
    for number in range(motions):
        at_b = number % 2 == 0
        parts += [there if at_b else there[::-1], np.repeat((B_RAD if at_b else A_RAD)[None], 68, axis=0)]
        if at_b and number // 2 % each == 0:
            parts[-1] = parts[-1] + noise.uniform(0.5, 1.5) * disturbed_rad[:, None]
    q_rad = np.concatenate(parts)
    q_rad = q_rad + noise.normal(0.0, 2e-5, q_rad.shape)
    columns = {"timestamp": 100 + np.arange(len(q_rad)) / 125}
    columns |= {f"actual_q_{i}": q_rad[:, i] for i in range(6)}
    columns |= {f"actual_TCP_pose_{i}": forward(q_rad)[0][:, i] for i in range(3)}
    columns |= {f"actual_TCP_pose_{i}": np.zeros(len(q_rad)) for i in range(3, 6)}
    pl.DataFrame(columns).write_csv(file, float_precision=6)
    return file


@pytest.mark.parametrize("motions", [4, 10])
@pytest.mark.parametrize(("how", "each"), [("not at all", 1), ("pushed", 1), ("ringing", 1), ("ringing", 2)])
def test_both_ends_of_a_robot_that_goes_to_and_fro_are_places_also_if_it_is_disturbed_at_one(
    how: str, each: int, motions: int, tmp_path: Path
):
    found = found_in(tmp_path, to_and_fro(tmp_path / "run.csv", motions, each, DISTURBED[how]))
    ends = forward(np.array([A_RAD, B_RAD]))[0]
    places = np.array([place.xyz_m for place in found.places.values()])
    assert len(places) == 2
    assert np.linalg.norm(places - ends, axis=1).max() < 0.006
    tasks = found.tasks()
    assert tasks["task"].to_list() == ["place_1->place_2", "place_2->place_1"] * (motions // 2)
    assert tasks["start_s"].diff().to_list()[1:] == pytest.approx([2.54] * (motions - 1), abs=0.1)
