"""The operator in the samples: never invented, the nearest of several, with the goal of what they do."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
import pytest
from examples import at_most
from hypothesis import example, given
from hypothesis import strategies as st

from cyclekit.config import Cell, Executions, NamedPlace, Source
from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.people.tracks import (
    REASONS,
    PersonTrack,
    at_times,
    gap_reasons,
    ids_are_real,
    link_by_motion,
    nearest_person,
    without_jumps,
)

if TYPE_CHECKING:
    from simulated_cells import Cells


def walk(t_s: np.ndarray, y_m: float = 0.0, person: str = "1") -> PersonTrack:
    """Walk along x at 1 m/s."""
    return PersonTrack(person, t_s, np.column_stack([t_s, np.full_like(t_s, y_m), np.full_like(t_s, 0.2)]))


def with_holes(track: PersonTrack, holes: list[tuple[float, float]]) -> PersonTrack:
    xyz = track.xyz_m.copy()
    for begin, end in holes:
        xyz[(track.t_s > begin) & (track.t_s < end)] = np.nan
    return PersonTrack(track.person, track.t_s, xyz)


def test_a_short_gap_is_bridged_in_a_straight_line_and_a_long_one_stays_unknown():
    track = with_holes(walk(np.arange(0, 10, 0.02)), [(1.99, 2.19), (4.99, 6.01)])
    t_s = np.arange(0.05, 9.9, 0.1)
    found = at_times(track, t_s, bridge_s=0.3)
    unknown = np.isnan(found[:, 0])
    assert t_s[unknown] == pytest.approx(np.arange(5.05, 6.0, 0.1))
    assert found[~unknown, 0] == pytest.approx(t_s[~unknown])


def test_the_frames_of_a_slow_tracker_are_no_gaps():
    found = at_times(walk(np.arange(0.0, 10.0, 1.0)), np.arange(0.0, 9.0, 0.25), bridge_s=0.3)
    assert found[:, 0] == pytest.approx(np.arange(0.0, 9.0, 0.25))


def test_before_and_after_the_recording_nobody_knows():
    found = at_times(walk(np.arange(2.0, 5.0, 0.02)), np.array([1.9, 2.0, 4.9, 5.1]), bridge_s=0.3)
    assert np.isnan(found[:, 0]).tolist() == [True, False, False, True]


@pytest.mark.parametrize("frames", [0, 1])
def test_a_tracker_that_never_saw_anybody_says_nothing(frames: int):
    assert np.isnan(at_times(walk(np.arange(float(frames))), np.array([0.0, 1.0]), bridge_s=0.3)).all()


def test_of_two_people_the_one_nearer_to_the_tool_counts_and_the_other_when_that_one_is_lost():
    t_s = np.arange(0.0, 4.0, 0.1)
    near = with_holes(walk(np.arange(0, 5, 0.02), y_m=1.0, person="a"), [(2.0, 3.0)])
    far = walk(np.arange(0, 5, 0.02), y_m=-2.0, person="b")
    tcp = np.column_stack([t_s, 0 * t_s, 0 * t_s])
    found, several = nearest_person([far, near], t_s, tcp, bridge_s=0.3)
    assert sorted(set(found[:, 1].round(6).tolist())) == [-2.0, 1.0]
    assert found[(t_s > 2.05) & (t_s < 2.95), 1] == pytest.approx(-2.0)
    assert found[t_s < 1.95, 1] == pytest.approx(1.0)
    assert several.tolist() == ((t_s < 2.05) | (t_s > 2.95)).tolist()


def test_a_person_of_a_planar_tracker_counts_by_the_distance_on_the_floor():
    t_s = np.arange(0.0, 1.0, 0.1)
    flat = PersonTrack("1", t_s, np.column_stack([t_s * 0 + 1.0, t_s * 0, t_s * np.nan]))
    found, several = nearest_person([flat], t_s, np.zeros((10, 3)), bridge_s=0.3)
    assert found[:, 0] == pytest.approx(1.0)
    assert np.isnan(found[:, 2]).all()
    assert not several.any()


def test_where_the_tool_is_unknown_whoever_is_seen_counts():
    t_s = np.arange(0.0, 1.0, 0.1)
    found, several = nearest_person([walk(t_s, 1.0), walk(t_s, 0.7)], t_s, np.full((10, 3), np.nan), bridge_s=0.3)
    assert found[:, 1] == pytest.approx(1.0)
    assert not several.any()  # so near that both may be of one body


@given(st.lists(st.tuples(st.floats(0.0, 90.0), st.floats(0.0, 20.0), st.floats(-3.0, 3.0)), max_size=8))
def test_a_track_counts_while_it_lasts_and_is_not_looked_at_otherwise(spans: list[tuple[float, float, float]]):
    """A tracker that loses its ids leaves thousands of tracks; each at every time took the square of the log."""
    t_s, tcp_m = np.arange(20.0, 70.0, 0.1), np.zeros((500, 3))
    tracks = [walk(np.arange(begin, begin + lasts, 0.04), y_m, f"{n}") for n, (begin, lasts, y_m) in enumerate(spans)]
    every = [at_times(track, t_s, bridge_s=0.5, width_s=0.1) for track in tracks]
    best, far = np.full((500, 3), np.nan), np.full(500, np.inf)
    for here in every:
        nearer = np.linalg.norm(here, axis=1) < far
        best[nearer], far[nearer] = here[nearer], np.linalg.norm(here, axis=1)[nearer]
    asked: list[int] = []

    def counted(track: PersonTrack, at_s: np.ndarray, **how: Any) -> np.ndarray:
        asked.append(len(at_s))
        return at_times(track, at_s, **how)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cyclekit.people.tracks.at_times", counted)
        found, _ = nearest_person(tracks, t_s, tcp_m, bridge_s=0.5, width_s=0.1)
        why = gap_reasons(tracks, t_s, (0.0, 110.0), bridge_s=0.5)
    assert np.array_equal(found, best, equal_nan=True)
    seen = [np.isfinite(here[:, 0]) for here in (at_times(track, t_s, bridge_s=0.5) for track in tracks)]
    assert ((why == 0) == (np.any(seen, axis=0) if seen else np.zeros(500, bool))).all()
    assert sum(asked) <= 2 * sum(int(10 * (lasts + 0.2)) + 1 for _, lasts, _ in spans)


def circling(frames: int = 900) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two people at 30 Hz, walking in circles that come within 0.2 m; times, positions and who it is."""
    t = np.arange(frames) / 30
    first = np.column_stack([1.5 * np.cos(t), 1.5 * np.sin(t), 0 * t + 1.0])
    second = np.column_stack([3.2 + 1.5 * np.cos(1.3 * t), 1.5 * np.sin(1.3 * t), 0 * t + 1.0])
    both = np.stack([first, second], axis=1).reshape(-1, 3)
    return np.repeat(t, 2), both, np.tile([0, 1], frames)


def test_people_whose_ids_change_every_frame_are_linked_again_by_motion():
    t, xyz, who = circling()
    mixed = np.random.default_rng(1).permuted(np.arange(len(t)).reshape(-1, 2), axis=1).ravel()  # in any order
    found = link_by_motion(t[mixed], xyz[mixed])
    assert len(np.unique(found)) == 2
    same = found == who[mixed]
    assert same.all() or (~same).all()


def test_somebody_who_was_away_is_somebody_new_and_nobody_is_linked_across_the_cell():
    t, xyz, _ = circling()
    away = (t > 10) & (t < 12)
    linked = link_by_motion(t[~away], xyz[~away])
    assert len(np.unique(linked)) == 4
    near, far = np.array([[0.0, 0, 0], [6.0, 0, 0]])
    assert link_by_motion(np.array([0.0, 0.05]), np.array([near, far])).tolist() == [0, 1]
    assert link_by_motion(np.array([0.0, 0.05]), np.array([near, near + 0.2])).tolist() == [0, 0]


def test_rows_without_a_position_belong_to_nobody():
    assert link_by_motion(np.arange(3.0), np.full((3, 3), np.nan)).tolist() == [-1, -1, -1]
    assert link_by_motion(np.empty(0), np.empty((0, 3))).tolist() == []


def test_ids_that_last_are_kept_and_ids_of_a_frame_or_two_are_none():
    assert ids_are_real(np.repeat([0, 1, 2, 3, 4], 50))
    assert not ids_are_real(np.arange(200))
    assert not ids_are_real(np.repeat(np.arange(100), 2))
    assert ids_are_real(np.array([0, 0, 1]))  # too few to say
    assert ids_are_real(np.concatenate([np.zeros(500, int), np.arange(1, 100)]))  # one person, and false sightings


def test_a_false_sighting_at_the_other_end_of_the_hall_is_not_believed_and_the_track_goes_on():
    track = walk(np.arange(0, 10, 0.02))
    track.xyz_m[200:205, 1] += 12.0
    parts, dropped = without_jumps(track)
    assert dropped == 5
    assert len(parts) == 1
    found = at_times(parts[0], np.arange(0.05, 9.9, 0.1), bridge_s=0.3)
    assert np.abs(found[:, 1]).max() == 0.0


def test_a_track_that_flickers_keeps_the_place_where_it_mostly_is():
    track = walk(np.arange(0, 100, 0.02))
    wrong = np.random.default_rng(1).random(5000) < 0.3
    track.xyz_m[wrong, 1] += 15.0
    parts, dropped = without_jumps(track)
    assert dropped >= 0.95 * wrong.sum()
    kept = np.vstack([part.xyz_m for part in parts])
    assert np.nanmean(np.abs(kept[:, 1]) > 1) < 0.05


def test_a_false_start_does_not_cost_the_track():
    track = walk(np.arange(0, 10, 0.02))
    track.xyz_m[0, 0] -= 30.0
    parts, dropped = without_jumps(track)
    assert (len(parts), dropped) == (1, 1)


def test_a_track_is_taken_out_of_many_hours_without_a_copy_and_is_never_written_to():
    track = walk(np.arange(0, 10, 0.02))
    track.xyz_m[300:, 0] += 20.0
    parts, _ = without_jumps(track)
    assert [len(part.t_s) for part in parts] == [300, 200]
    assert all(np.shares_memory(part.xyz_m, track.xyz_m) and np.shares_memory(part.t_s, track.t_s) for part in parts)
    track.xyz_m[200:205, 1] += 12.0
    before = track.xyz_m.copy()
    assert without_jumps(track)[1] == 5
    np.testing.assert_array_equal(track.xyz_m, before)


def test_nothing_is_interpolated_across_a_lasting_jump():
    track = walk(np.arange(0, 10, 0.1))
    track.xyz_m[50:, 0] += 20.0
    parts, dropped = without_jumps(track)
    assert (len(parts), dropped) == (2, 0)
    between = np.array([4.95])
    assert all(np.isnan(at_times(part, between, bridge_s=0.3)).all() for part in parts)


@given(st.integers(0, 1000), st.floats(0.2, 3.0), st.sampled_from([10.0, 30.0, 120.0]))
def test_no_position_of_somebody_who_walks_is_disbelieved(seed: int, speed_m_s: float, rate_hz: float):
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(0, 20, int(20 * rate_hz)))
    heading = np.cumsum(rng.normal(0.0, 0.1, len(t)))
    step = np.diff(t, prepend=0.0)[:, None] * speed_m_s * np.column_stack([np.cos(heading), np.sin(heading), 0 * t])
    xyz = np.cumsum(step, axis=0) + rng.normal(0.0, 0.01, (len(t), 3))
    parts, dropped = without_jumps(PersonTrack("1", t, xyz))
    assert (len(parts), dropped) == (1, 0)


def test_the_reason_of_a_gap_is_what_the_log_shows_around_it():
    track = with_holes(walk(np.arange(0, 60, 0.02)), [(10.0, 12.0), (20.0, 40.0)])
    t_s = np.arange(-5.0, 65.0, 0.1)
    why = np.array(REASONS)[gap_reasons([track], t_s, (0.0, 59.98), bridge_s=0.3)]
    inside = (t_s > 0.05) & (t_s < 59.9)
    assert set(why[(t_s < -0.05) | (t_s > 60.05)]) == {"outside"}
    assert set(why[(t_s > 10.05) & (t_s < 11.95)]) == {"occluded"}
    assert set(why[(t_s > 20.05) & (t_s < 39.95)]) == {"absent"}
    assert (why[inside & ~((t_s > 9.9) & (t_s < 12.1)) & ~((t_s > 19.9) & (t_s < 40.1))] == "seen").all()


@pytest.mark.parametrize("shaking_hz", [7.0, 10.0, 13.0])
def test_a_tracker_that_shakes_faster_than_the_samples_makes_no_slow_motion_of_it(shaking_hz: float):
    t = np.arange(0.0, 30.0, 1 / 120)
    xyz = np.column_stack([0.5 * t, 0.1 * np.sin(2 * np.pi * shaking_hz * t), 0 * t])
    t_s = np.arange(1.0, 29.0, 0.1)
    sampled = at_times(PersonTrack("1", t, xyz), t_s, bridge_s=0.3)
    averaged = at_times(PersonTrack("1", t, xyz), t_s, bridge_s=0.3, width_s=0.1)
    assert np.abs(averaged[:, 1]).max() < 0.041  # what is left of a box of a tenth of a second at 7 Hz
    assert np.abs(averaged[:, 1]).max() < 0.5 * max(np.abs(sampled[:, 1]).max(), 0.05)
    assert averaged[:, 0] == pytest.approx(0.5 * t_s)  # and a walk is where it was, not earlier or later


def test_noise_of_a_fast_tracker_is_averaged_out():
    rng, t = np.random.default_rng(2), np.arange(0.0, 60.0, 1 / 100)
    xyz = np.column_stack([1.0 * t, 0 * t, 0 * t]) + rng.normal(0.0, 0.05, (len(t), 3))
    t_s = np.arange(0.5, 59.5, 0.1)
    off = at_times(PersonTrack("1", t, xyz), t_s, bridge_s=0.3, width_s=0.1)[:, 1]
    assert off.std() == pytest.approx(0.05 / np.sqrt(10), rel=0.15)


def test_an_average_never_looks_across_a_gap_or_beyond_the_log():
    track = with_holes(walk(np.arange(0, 10, 0.02)), [(4.99, 6.01)])
    jump = PersonTrack("1", track.t_s, track.xyz_m + np.where(track.t_s > 5.5, 100.0, 0.0)[:, None])
    t_s = np.array([0.0, 0.03, 4.9, 4.96, 4.98, 6.021, 6.05, 6.5, 9.97, 9.98])
    found = at_times(jump, t_s, bridge_s=0.3, width_s=0.1)[:, 0]
    assert found == pytest.approx(t_s + np.where(t_s > 5.5, 100.0, 0.0))


@at_most(60)
@given(st.lists(st.floats(0.001, 0.5), min_size=2, max_size=60), st.lists(st.floats(0, 10), min_size=1, max_size=30))
def test_the_average_of_a_straight_walk_is_the_walk_whatever_the_frames_and_times(steps: list[float], at: list[float]):
    t = np.cumsum(steps)
    found = at_times(walk(t), np.array(at), bridge_s=0.3, width_s=0.1)[:, 0]
    known = np.isfinite(found)
    assert found[known] == pytest.approx(np.array(at)[known], abs=1e-6)
    assert (known == np.isfinite(at_times(walk(t), np.array(at), bridge_s=0.3)[:, 0])).all()


def test_a_sample_without_an_operator_says_why(tmp_path: Path, robot_log: Any, motive_log: Any):
    robot_log(tmp_path / "logs" / "robot.csv", [("stand", 1.0), ("move", 4.0), ("stand", 11.0)])
    seen = [(2.0, 0.01 * i, 0.0) for i in range(300)]
    seen[100:200] = [None] * 100
    motive_log(tmp_path / "logs" / "take.csv", seen)
    found = Dataset.open(ingest([tmp_path / "logs"], tmp_path / "dataset").dataset).samples()
    why = dict(zip(found["t_s"].round(1).to_list(), found["human_gap"].to_list(), strict=True))
    assert (why[1.5], why[3.0], why[5.0], why[7.0]) == (None, "occluded", None, "outside")
    assert (found["human_gap"].is_null() == found["human_x_m"].is_not_null()).all()


@pytest.mark.parametrize("turned", [False, True])
def test_a_height_that_changes_by_metres_is_an_axis_that_does_not_point_up(
    tmp_path: Path, robot_log: Any, motive_log: Any, turned: bool
):
    robot_log(tmp_path / "logs" / "robot.csv", [("stand", 1.0), ("move", 4.0), ("stand", 9.0)])
    walk = [(2.0, 3.0 * np.sin(0.02 * i), 1.0 + 0.02 * np.cos(i)) for i in range(500)]
    points = [(x, -z, y) if turned else (x, y, z) for x, y, z in walk]
    motive_log(tmp_path / "logs" / "operator.csv", points)
    report = ingest([tmp_path / "logs"], tmp_path / "dataset")
    said = [text for text in report.warnings if "height of a person" in text]
    assert len(said) == turned
    assert all("frame in cell.toml" in text for text in said)


def test_ids_that_change_every_frame_still_make_one_operator_in_the_samples(tmp_path: Path, robot_log: Any):
    doing = [("move", 0.5), ("move", 0.0)] * 8
    robot_log(tmp_path / "logs" / "robot.csv", [("stand", 1.0), *doing, ("stand", 1.0)])
    t = np.arange(0.0, 18.0, 0.05)
    near, far = np.column_stack([0 * t + 1.0, np.sin(t)]), np.column_stack([0 * t - 4.0, np.cos(t)])
    lines = ["frame,id,x,y"]
    for number in range(len(t)):
        places = [far[number], near[number]] if number % 3 else [near[number], far[number]]
        lines += [f"{t[number]:.3f},{2 * number + k},{p[0]:.4f},{p[1]:.4f}" for k, p in enumerate(places)]
    (tmp_path / "logs" / "people.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    columns = {"time": "frame", "time_unit": "s", "person": "id", "x": "x", "y": "y", "length_unit": "m"}
    people = Source("people.csv", adapter="csv", role="people", clock_offset_s=10.0, map=columns)
    ingest([tmp_path / "logs"], tmp_path / "d", cell=Cell(sources=(people,)))
    dataset = Dataset.open(tmp_path / "d")
    (entry,) = [record for record in dataset.recordings if "people" in record.tables]
    assert any("linked by motion into 2 tracks" in text for text in entry.said)
    seen = dataset.samples().filter(pl.col("human_x_m").is_not_null())
    assert seen.height > 100
    assert seen["human_x_m"].to_numpy() == pytest.approx(1.0, abs=1e-6)  # the nearer one, never a mix of both


def test_an_operator_lost_for_seconds_at_his_place_has_not_left_it(tmp_path: Path, robot_log: Any):
    doing = [("move", 0.5), ("stand", 0.6), ("move", 0.0), ("stand", 0.6)] * 4
    robot_log(tmp_path / "logs" / "robot.csv", [("stand", 1.0), *doing, ("stand", 1.0)])
    t = np.arange(0.0, 18.0, 0.1)
    x = np.interp(t, [0.0, 3.0, 4.5, 11.0, 12.5, 18.0], [2.5, 2.5, 1.0, 1.0, 2.5, 2.5])
    seen = (t < 6.0) | (t > 8.0)  # then under another id
    lines = [
        "frame,id,x,y",
        *(f"{s:.3f},{1 + (s > 7.0)},{x_m:.4f},0.9" for s, x_m in zip(t[seen], x[seen], strict=True)),
    ]
    (tmp_path / "logs" / "people.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    columns = {"time": "frame", "time_unit": "s", "person": "id", "x": "x", "y": "y", "length_unit": "m"}
    people = Source("people.csv", adapter="csv", role="people", clock_offset_s=10.0, map=columns)
    whole = Executions("file")
    places = {"bench": NamedPlace((2.5, 0.9, 0.0)), "fixture": NamedPlace((1.0, 0.9, 0.0))}
    ingest([tmp_path / "logs"], tmp_path / "d", cell=Cell(sources=(people,), executions=whole, human_places=places))
    his = Dataset.open(tmp_path / "d").every_task().filter(pl.col("agent") == "operator")
    assert his["goal_place"].to_list()[:2] == ["bench", "fixture"]
    assert his["end_s"][1] - his["arrival_s"][1] == pytest.approx(6.5, abs=0.5)


@pytest.fixture
def two_people(tmp_path: Path, robot_log: Any, motive_log: Any) -> Path:
    robot_log(tmp_path / "logs" / "robot.csv", [("stand", 5.9)])
    motive_log(
        tmp_path / "logs" / "first.csv", [(2.0, 0.0, 0.2)] * 100 + [None] * 100 + [(2.0, 0.0, 0.2)] * 100, name="A"
    )
    motive_log(tmp_path / "logs" / "second.csv", [(4.0, 0.0, 0.2)] * 300, name="B")
    return tmp_path / "logs"


def test_two_trackers_of_one_session_give_the_nearer_person(two_people: Path, tmp_path: Path):
    sources = tuple(Source(name, clock_offset_s=10.0) for name in ("first.csv", "second.csv"))
    found = Dataset.open(ingest([two_people], tmp_path / "dataset", cell=Cell(sources=sources)).dataset)
    t_s, x_m = found.samples()["t_s"].to_numpy(), found.samples()["human_x_m"].to_numpy()
    assert x_m[(t_s > 2.01) & (t_s < 3.97)] == pytest.approx(4.0)
    assert x_m[(t_s < 1.97) | (t_s > 4.03)] == pytest.approx(2.0)


def test_dropouts_leave_unknown_positions_never_invented_ones(cells: Cells):
    cell = cells("laser-zones", 2, dropout=0.3)
    found = cell.dataset.samples()
    first = cell.executions["start_s"][0]
    lost = found["human_x_m"].null_count() / found.height
    assert 0.05 < lost < 0.35
    seen = found.filter(pl.col("human_x_m").is_not_null())
    t, truth = (cell.samples["t_s"] - first).to_numpy(), cell.samples.select("human_x_m", "human_y_m").to_numpy()
    at = np.column_stack([np.interp(seen["t_s"].to_numpy(), t, truth[:, k]) for k in range(2)])
    apart = np.linalg.norm(seen.select("human_x_m", "human_y_m").to_numpy() - at, axis=1)
    assert apart.max() < 0.08  # bridged over at most 0.3 s of walking


def test_nobody_in_the_cell_is_nobody_in_the_samples(cells: Cells):
    cell = cells("laser-zones", 2, with_operator=False)
    found = cell.dataset.samples()
    assert found["human_x_m"].null_count() == found.height
    assert found["scaling"].unique().to_list() == [1.0]
    assert cell.dataset.tasks()["safety_loss_s"].abs().max() < 0.02


@at_most(60)
@given(seed=st.integers(0, 10_000), width_s=st.sampled_from([0.0, 0.1]))
@example(seed=244, width_s=0.0)  # a time that is that of the first row after a gap
@example(seed=194, width_s=0.0)  # of the only row between two gaps
def test_a_few_times_of_a_long_track_are_told_as_all_of_them_are(seed: int, width_s: float):
    random = np.random.default_rng(seed)
    t = np.cumsum(random.choice([0.02, 0.02, 0.02, 0.25, 2.0], 300))
    xyz = random.normal(size=(300, 3))
    xyz[random.random(300) < 0.1] = np.nan
    track, at = PersonTrack("1", t, xyz), np.arange(0.0, t[-1] + 1.0, 0.1)
    whole = at_times(track, at, bridge_s=0.3, width_s=width_s)
    parts = [at_times(track, some, bridge_s=0.3, width_s=width_s) for some in np.array_split(at, 40)]
    assert np.concatenate(parts) == pytest.approx(whole, abs=1e-9, nan_ok=True)
