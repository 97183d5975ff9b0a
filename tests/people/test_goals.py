"""What the operator goes for: buttons say it, or the stays of his track do."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest

from cyclekit.dataset.dataset import Dataset, Place
from cyclekit.ingest.ingest import ingest
from cyclekit.people.tracks import (
    find_operator_places,
    find_operator_standstills,
    goals_from_events,
    goals_from_standstills,
)

if TYPE_CHECKING:
    from simulated_cells import SimulatedCell


def test_a_goal_is_in_force_from_its_button_on():
    goals = goals_from_events(np.array([1.0, 2.0]), ["shelf", "desk"], np.array([0.5, 1.0, 1.9, 2.0, 9.0]))
    assert goals == [None, "shelf", "shelf", "desk", "desk"]


def staying() -> tuple[np.ndarray, np.ndarray]:
    """Stand 3 s at x = 0, walk 2 s to x = 2, stand 3 s, walk back, stand 3 s."""
    t_s = np.arange(0.0, 13.0, 0.1)
    x = np.interp(t_s, [0, 3, 5, 8, 10, 13], [0, 0, 2, 2, 0, 0])
    return t_s, np.column_stack([x, 0 * x, 0 * x + 0.2])


def test_a_stay_is_found_where_the_operator_stands_and_not_where_they_walk_or_are_not_seen():
    t_s, human = staying()
    stays = find_operator_standstills(t_s, human)
    edges = [float(t_s[row]) for stay in stays for row in stay]
    assert edges == pytest.approx([0.0, 3.0, 5.0, 8.0, 10.0, 12.9], abs=0.11)
    human[70:] = np.nan
    assert len(find_operator_standstills(t_s, human)) == 2


def test_a_person_who_sways_and_reaches_at_a_bench_stays_there_until_the_next_walk():
    t_s, human = staying()
    rng = np.random.default_rng(4)
    for axis in (0, 1):  # up to 0.2 m aside, often faster than a standstill
        human[:, axis] += 0.08 * np.sin(2.2 * t_s + axis) + rng.normal(0.0, 0.02, len(t_s))
    stays = find_operator_standstills(t_s, human)
    edges = [float(t_s[row]) for stay in stays for row in stay]
    assert edges == pytest.approx([0.0, 3.0, 5.0, 8.0, 10.0, 12.9], abs=0.5)


@pytest.mark.parametrize(("lost_s", "stays"), [(0.5, 1), (2.5, 1), (4.5, 1), (6.0, 2)])
def test_a_stay_continues_where_the_tracker_loses_the_operator_for_seconds(lost_s: float, stays: int):
    t_s = np.arange(0.0, 20.0, 0.1)
    human = np.tile([1.0, 2.0, 0.2], (len(t_s), 1)) + np.random.default_rng(3).normal(0.0, 0.005, (len(t_s), 3))
    human[(t_s > 5.0) & (t_s < 5.0 + lost_s)] = np.nan
    found = find_operator_standstills(t_s, human)
    assert len(found) == stays
    assert [found[0][0], found[-1][1]] == pytest.approx([0, len(t_s) - 1], abs=1)


def test_a_stay_does_not_continue_where_the_operator_was_elsewhere_when_seen_again():
    t_s, human = staying()
    human[25:55] = np.nan  # from the first place to the second
    stays = find_operator_standstills(t_s, human)
    assert len(stays) == 3
    assert float(t_s[stays[0][1]]) < 3.0


def test_without_buttons_the_goal_is_the_spot_of_the_stay_that_runs_or_comes_next():
    t_s, human = staying()
    stays = find_operator_standstills(t_s, human)
    spots = find_operator_places(np.array([np.median(human[a : b + 1], axis=0) for a, b in stays]))
    assert list(spots) == ["spot_1"]  # a spot needs two stays, and x = 2 has one
    assert spots["spot_1"].xyz_m == pytest.approx((0.0, 0.0, 0.2))
    spots["spot_2"] = Place("spot_2", (2.0, 0.0, 0.2), 0.4, inferred=True)
    at_m = np.array([np.median(human[a : b + 1], axis=0) for a, b in stays])
    goals = goals_from_standstills(stays, at_m, len(human), spots)
    assert [goals[int(10 * t)] for t in (1.0, 4.0, 6.0, 9.0, 12.0)] == [
        "spot_1",
        "spot_2",
        "spot_2",
        "spot_1",
        "spot_1",
    ]
    assert goals_from_standstills(stays[:1], at_m[:1], len(human), spots)[60] is None


def test_a_stay_cut_by_the_start_or_the_end_of_the_log_has_its_place_and_a_cut_walk_has_none():
    t_s, human = staying()
    swayed = human.copy()
    swayed[:5, 0] = 0.1 * np.array([1, -1, 1, -1, 1])  # reaches quickly as the log begins, and as it ends
    swayed[-5:, 0] = 0.1 * np.array([1, -1, 1, -1, 1])
    places = {"bench": Place("bench", (0.0, 0.0, 0.2), 0.4, inferred=True)}
    for until, known in ((len(t_s), True), (95, False)):  # the second log ends on the way back
        cut = swayed[:until]
        stays = find_operator_standstills(t_s[:until], cut)
        at_m = np.array([np.median(cut[a : b + 1], axis=0) for a, b in stays])
        goals = goals_from_standstills(stays, at_m, until, places)
        assert goals[0] == "bench"
        assert goals[-1] == ("bench" if known else None)


def test_the_operators_task_and_goal_are_those_of_the_buttons(boxes: SimulatedCell):
    found, start = boxes.dataset.samples(), boxes.executions["start_s"][0]
    truth = boxes.samples.select(t_s=pl.col("t_s") - start, true="human_task").sort("t_s")
    both = found.sort("t_s").join_asof(truth, on="t_s", strategy="nearest", tolerance=0.06)
    agree = (both["human_task"] == both["true"]).mean()
    assert agree > 0.99  # type: ignore[operator]
    goal = found.filter(pl.col("human_task") == "inbound").select("human_goal_x_m", "human_goal_y_m").unique()
    assert goal.row(0) == pytest.approx((3.1, 0.0))


def test_where_buttons_name_goals_and_no_file_places_them_they_lie_where_the_operator_stayed(
    boxes: SimulatedCell, tmp_path: Path
):
    text = (boxes.logs / "cell.toml").read_text(encoding="utf-8")
    cell = tmp_path / "cell.toml"
    cell.write_text(text[: text.index("[human_places")], encoding="utf-8")
    found = Dataset.open(ingest([boxes.logs], tmp_path / "dataset", cell=cell).dataset)
    for name, place in boxes.dataset.human_places.items():
        if name != "rest":  # few executions see the operator rest
            assert found.human_places[name].inferred
            assert found.human_places[name].xyz_m[:2] == pytest.approx(place.xyz_m[:2], abs=0.15)


def test_without_buttons_and_places_the_spots_are_where_the_operator_works(boxes: SimulatedCell, tmp_path: Path):
    logs = tmp_path / "logs" / "session_000"
    logs.mkdir(parents=True)
    for name in ("robot.csv", "operator.csv"):
        (logs / name).write_bytes((boxes.logs / "session_000" / name).read_bytes())
    text = (boxes.logs / "cell.toml").read_text(encoding="utf-8")
    (tmp_path / "logs" / "cell.toml").write_text(text[: text.index("[human_places")], encoding="utf-8")
    found = Dataset.open(ingest([tmp_path / "logs"], tmp_path / "dataset").dataset)
    assert len(found.human_places) >= 5
    stations = [np.array(place.xyz_m[:2]) for place in boxes.dataset.human_places.values()]
    for spot in found.human_places.values():
        assert min(np.linalg.norm(np.array(spot.xyz_m[:2]) - at) for at in stations) < 0.4
    assert found.samples()["human_task"].null_count() < 0.3 * found.samples().height
