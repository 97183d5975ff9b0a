"""Every lost second has a cause: found in mixed cells, and in samples made by hand."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit import schema
from cyclekit.cli import run
from cyclekit.dataset.dataset import Dataset
from cyclekit.derive.causes.cause_samples import Rows, TwoStateSignal, joined
from cyclekit.derive.causes.causes import Evidence, Input, find_evidence, lost_shares
from cyclekit.derive.causes.path_limits import Limit
from cyclekit.derive.causes.path_limits import find_limits as limits_of
from cyclekit.derive.causes.usual_levels import usual_levels
from cyclekit.ingest.ingest import ingest
from cyclekit.schema import LOST_CAUSES, SCALING_CAUSES
from cyclekit_sim import MixedCauses, SimulationOptions, simulate

COLUMNS = [f"lost_{cause}_s" for cause in LOST_CAUSES]
LEVELS = (0.0, 0.5, 1.0)


def rows(
    scaling: Any,
    distance: Any,
    *,
    execution: Any = 0,
    at_m: Any = 0.0,
    switches: dict[str, TwoStateSignal] | None = None,
) -> Rows:
    """Return a robot that moves at 10 Hz along x, and an operator at some distance from it."""
    s = np.asarray(scaling, np.float64)
    count = len(s)
    number = np.broadcast_to(execution, count).astype(np.int64)
    robot_m = np.column_stack([np.broadcast_to(at_m, count), np.zeros(count), np.zeros(count)]).astype(np.float64)
    human_m = robot_m + np.column_stack([np.zeros(count), np.broadcast_to(distance, count), np.zeros(count)])
    return Rows(
        t_s=np.arange(count) / 10.0,
        execution=number,
        task=np.zeros(count, np.int64),
        tasks=("a->b",),
        robot_m=robot_m,
        human_m=human_m,
        absent=np.zeros(count, np.bool_),
        moving=np.ones(count, np.bool_),
        scaling=s,
        deviation=np.zeros(count),
        step=np.searchsorted(LEVELS, s - 0.01).astype(np.int64),
        breaks=np.diff(number, prepend=-1) != 0,
        switches=switches or {},
    )


def halves(distance: np.ndarray) -> np.ndarray:
    """Return the scaling of a cell that halves its speed below 1 m."""
    return np.where(distance < 1.0, 0.5, 1.0)


def walked(count: int = 2000) -> tuple[np.ndarray, np.ndarray]:
    """Return distances of somebody who comes and goes, and the execution of each sample."""
    return 1.5 + np.sin(np.arange(count) / 31.0), np.arange(count) // 200


def by_cause(found: Rows, evidence: Evidence) -> dict[str, float]:
    return dict(zip(SCALING_CAUSES, (lost_shares(found, evidence).sum(axis=0) / 10.0).tolist(), strict=True))


def test_slow_where_people_slow_the_robot_is_the_persons_and_nothing_else():
    distance, execution = walked()
    logged = rows(halves(distance), distance, execution=execution)
    lost = by_cause(logged, find_evidence(logged, LEVELS))
    assert lost["person"] == pytest.approx((1.0 - logged.scaling).sum() / 10.0)
    assert sum(lost.values()) == pytest.approx(lost["person"])


def test_a_standstill_midway_with_nobody_near_is_a_protective_stop():
    distance, execution = walked()
    scaling = halves(distance)
    far = int(np.flatnonzero(distance > 2.4)[40])
    scaling[far : far + 20] = 0.0
    logged = rows(scaling, distance, execution=execution)
    lost = by_cause(logged, find_evidence(logged, LEVELS))
    assert lost["stop"] == pytest.approx(2.0)
    assert lost["person"] == pytest.approx((1.0 - halves(distance)).sum() / 10.0)


def test_what_an_input_slows_is_not_the_persons_and_the_person_has_what_is_added():
    distance, execution = walked()
    on = (np.arange(2000) // 137) % 5 == 0
    scaling = np.minimum(halves(distance), np.where(on, 0.8, 1.0))
    edges = np.flatnonzero(np.diff(on.astype(int))) + 1
    switch = TwoStateSignal(edges / 10.0, on[edges])
    logged = rows(scaling, distance, execution=execution, switches={"reduced": switch})
    evidence = find_evidence(logged, LEVELS)
    assert evidence.inputs == {"reduced": Input(True, 0.8)}
    lost = by_cause(logged, evidence)
    person = np.where(distance < 1.0, np.where(on, 1.0 - 0.5 / 0.8, 0.5), 0.0).sum() / 10.0
    assert lost["person"] == pytest.approx(person, rel=0.02)
    assert sum(lost.values()) == pytest.approx((1.0 - scaling).sum() / 10.0)


def recovering(slow: np.ndarray, *, per_sample: float = 0.02) -> np.ndarray:
    """Return a scaling of 0.5 where `slow`, which then rises slowly."""
    scaling = [1.0]
    for now in slow:
        scaling.append(0.5 if now else min(1.0, scaling[-1] + per_sample))
    return np.array(scaling[1:])


def test_where_every_pass_recovers_from_people_is_no_limit_of_the_path():
    """The operator always comes when the robot leaves a place; later passes are slow where he has gone again."""
    sample, execution = np.arange(3000) % 200, np.arange(3000) // 200
    near = (sample >= 20) & (sample < 60) | (execution % 3 == 1) & (sample >= 130) & (sample < 150)
    logged = rows(recovering(near), np.where(near, 0.7, 3.0), execution=execution, at_m=0.02 * sample)
    lost = by_cause(logged, find_evidence(logged, LEVELS))
    assert lost["limits"] == 0.0
    assert lost["person"] == pytest.approx((1.0 - logged.scaling).sum() / 10.0, rel=0.03)


def test_a_recovery_from_a_limit_of_the_path_is_of_the_limit():
    sample, execution = np.arange(3000) % 200, np.arange(3000) // 200
    near = (execution % 3 == 1) & (sample >= 130) & (sample < 150)
    limited = (sample >= 20) & (sample < 60)
    logged = rows(recovering(near | limited), np.where(near, 0.7, 3.0), execution=execution, at_m=0.02 * sample)
    lost = by_cause(logged, find_evidence(logged, LEVELS))
    of_limit = (1.0 - recovering(limited)).sum() / 10.0
    assert lost["limits"] == pytest.approx(of_limit, rel=0.05)


def test_an_execution_that_begins_in_a_recovery_is_slow_because_of_people():
    sample, execution = np.arange(3000) % 200, np.arange(3000) // 200
    near = (execution % 3 == 1) & (sample >= 100) & (sample < 130)
    begins = (execution % 4 == 2) & (sample == 0)  # slow until just now
    logged = rows(recovering(near | begins), np.where(near, 0.7, 3.0), execution=execution, at_m=0.02 * sample)
    lost = by_cause(logged, find_evidence(logged, LEVELS))
    assert lost["unknown"] < 0.3
    assert lost["person"] == pytest.approx((1.0 - logged.scaling).sum() / 10.0, rel=0.03)


def test_a_button_pressed_near_the_robot_does_not_slow_it():
    distance, execution = walked()
    near = distance < 1.0
    rises = np.flatnonzero(np.diff(near.astype(int)) > 0)
    pressed = (rises[:, None] + np.arange(20, 28)).ravel()  # 0.8 s, while the operator is near
    on = np.zeros(2000, np.bool_)
    on[pressed] = True
    edges = np.flatnonzero(np.diff(on.astype(int))) + 1
    button = TwoStateSignal(edges / 10.0, on[edges])
    assert halves(distance)[on].max() == 0.5
    unseen = np.full(2000, np.nan)
    for seen in (distance, unseen):
        logged = rows(halves(distance), seen, execution=execution, switches={"button": button})
        assert find_evidence(logged, LEVELS).inputs == {}


def test_a_button_after_which_the_operator_goes_away_does_not_slow_the_robot():
    distance, execution = walked()
    near = distance < 1.0
    leaves = np.flatnonzero(np.diff(near.astype(int)) < 0)
    on = np.zeros(2000, np.bool_)
    on[(leaves[leaves > 12][:, None] - np.arange(3, 11)).ravel()] = True  # 0.8 s, until shortly before he leaves
    edges = np.flatnonzero(np.diff(on.astype(int))) + 1
    button = TwoStateSignal(edges / 10.0, on[edges])
    logged = rows(halves(distance), distance, execution=execution, switches={"button": button})
    assert find_evidence(logged, LEVELS).inputs == {}


def test_a_signal_that_watches_the_operator_is_no_input():
    distance, execution = walked()
    on = distance < 1.0
    edges = np.flatnonzero(np.diff(on.astype(int))) + 1
    logged = rows(
        halves(distance), distance, execution=execution, switches={"field": TwoStateSignal(edges / 10.0, on[edges])}
    )
    evidence = find_evidence(logged, LEVELS)
    assert (dict(evidence.inputs), evidence.watching) == ({}, ("field",))
    assert by_cause(logged, evidence)["person"] == pytest.approx(on.sum() * 0.05)


def test_slow_at_the_same_place_of_every_pass_is_a_limit():
    distance, execution = walked(4000)
    at_m = (np.arange(4000) % 20) * 0.1
    limited = (at_m > 0.72) & (at_m < 1.18)
    scaling = np.minimum(halves(distance), np.where(limited, 0.7, 1.0))
    logged = rows(scaling, distance, execution=execution, at_m=at_m)
    evidence = find_evidence(logged, LEVELS)
    limit = evidence.limits["a->b"]
    inside = (limit.at_m[:, 0] > 0.72) & (limit.at_m[:, 0] < 1.18)
    assert limit.cap == pytest.approx(np.where(inside, 0.7, 1.0))
    lost = by_cause(logged, evidence)
    assert lost["limits"] == pytest.approx(
        np.where(limited, np.where(distance < 1, 0.5 / 0.7 - 0.5, 0.3), 0).sum() / 10
    )
    assert lost["stop"] == lost["input"] == 0.0


def test_a_place_that_every_pass_takes_at_another_speed_has_no_limit():
    execution = np.arange(4000) // 200
    scaling = np.where(execution % 2 == 0, 0.65, 0.75)
    logged = rows(scaling, 5.0, execution=execution, at_m=(np.arange(4000) % 20) * 0.1)
    everywhere = np.ones(4000, np.bool_)
    assert limits_of(logged, everywhere, everywhere, ~everywhere, 1.0) == {}


def test_beside_a_limit_all_of_a_slow_down_is_the_persons():
    distance, execution = walked(4000)
    at_m = (np.arange(4000) % 40) * 0.05
    limited = (at_m > 0.72) & (at_m < 1.18)
    scaling = np.minimum(halves(distance), np.where(limited, 0.7, 1.0))
    logged = rows(scaling, distance, execution=execution, at_m=at_m)
    shares = lost_shares(logged, find_evidence(logged, LEVELS))
    assert shares[~limited, SCALING_CAUSES.index("limits")].sum() == 0.0
    assert shares[limited, SCALING_CAUSES.index("limits")].min() > 0.15


def test_a_ramp_that_began_while_the_robot_stood_goes_on_in_its_next_motion():
    apart = np.concatenate([np.full(30, 0.5), np.full(60, 2.5)])
    ramp = np.concatenate([np.full(30, 0.5), np.linspace(0.5, 1.0, 30), np.full(30, 1.0)])
    distance, scaling = np.tile(apart, 30), np.tile(ramp, 30)
    logged = rows(scaling, distance, execution=np.arange(len(distance)) // 90)
    logged.moving[:] = (np.arange(len(distance)) % 90 < 20) | (np.arange(len(distance)) % 90 > 45)
    lost = by_cause(logged, find_evidence(logged, LEVELS))
    assert lost["person"] == pytest.approx((1.0 - scaling)[logged.moving].sum() / 10.0, rel=0.02)


def test_a_zone_that_people_only_walk_through_is_learned_from_ramps_too():
    """They are on no level for long, since the scaling falls and rises slowly."""
    far = np.full(60, 2.5)
    distance = np.concatenate([far, np.linspace(2.4, 0.6, 9), np.linspace(0.6, 2.4, 9), far])
    slowing = np.concatenate([np.ones(65), [0.9, 0.7, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5], np.linspace(0.55, 1.0, 10)])
    scaling = np.concatenate([slowing, np.ones(len(distance) - len(slowing))])
    logged = rows(np.tile(scaling, 40), np.tile(distance, 40), execution=np.arange(40 * len(distance)) // len(distance))
    lost = by_cause(logged, find_evidence(logged, LEVELS))
    assert lost["person"] > 0.95 * (1.0 - logged.scaling).sum() / 10.0


def test_a_standstill_that_begins_and_ends_as_the_persons_is_all_theirs():
    """In the middle the operator stood where nobody was seen to stop the robot."""
    distance, execution = walked()
    seen = rows(np.where(distance < 1.0, 0.0, 1.0), distance, execution=execution)
    evidence = find_evidence(seen, (0.0, 1.0))
    where = np.repeat([0.7, 2.4, 0.7], [20, 40, 20])
    assert by_cause(rows(np.zeros(80), where), evidence)["person"] == pytest.approx(8.0)
    went_on = np.where(np.arange(80) == 30, 1.0, 0.0)
    assert by_cause(rows(went_on, where), evidence)["stop"] > 2.0


def test_a_brief_dip_between_slower_motion_for_a_person_is_the_persons():
    distance, execution = walked()
    evidence = find_evidence(rows(halves(distance), distance, execution=execution), LEVELS)
    dip = np.concatenate([np.full(10, 0.5), np.linspace(0.45, 0.3, 5), np.linspace(0.3, 0.45, 5), np.full(10, 0.5)])
    assert by_cause(rows(dip, np.full(30, 0.7)), evidence)["unknown"] == 0.0
    long = np.concatenate([np.full(10, 0.5), np.full(60, 0.3), np.full(10, 0.5)])
    assert by_cause(rows(long, np.full(80, 0.7)), evidence)["unknown"] > 3.0


def test_a_ramp_goes_on_after_a_pause_with_the_cause_it_had_before():
    distance, execution = walked()
    evidence = find_evidence(rows(halves(distance), distance, execution=execution), LEVELS)
    ramp = np.linspace(0.55, 0.95, 8)
    paused = np.concatenate([np.full(20, 0.5), np.full(15, np.nan), ramp, np.ones(10)])
    gone = np.concatenate([np.full(20, 0.7), np.full(33, 2.4)])
    lost = by_cause(rows(paused, gone), evidence)
    assert lost["unknown"] == 0.0
    assert lost["person"] == pytest.approx((10.0 + (1.0 - ramp).sum()) / 10.0)


def test_slow_where_nothing_tells_why_stays_unknown():
    distance, execution = walked()
    scaling = halves(distance)
    far = np.flatnonzero(distance > 2.4)[::7]
    scaling[far] = 0.6
    logged = rows(scaling, distance, execution=execution)
    lost = by_cause(logged, find_evidence(logged, LEVELS))
    assert lost["unknown"] == pytest.approx(0.4 * len(far) / 10.0)
    unseen = rows(np.full(300, 0.5), np.nan)
    assert by_cause(unseen, find_evidence(unseen, LEVELS))["person"] == 0.0


@given(
    st.lists(st.tuples(st.floats(0, 1), st.floats(0, 3)), min_size=1, max_size=40), st.floats(0.05, 1), st.booleans()
)
def test_no_second_counts_twice_and_none_is_lost(pairs: list[tuple[float, float]], cap: float, on: bool):
    scaling, distance = np.array(pairs).T
    logged = rows(scaling, distance, switches={"reduced": TwoStateSignal(np.array([1.0]), np.array([on]))})
    limit = Limit(np.zeros((1, 3)), np.array([cap]))
    tree = usual_levels(
        np.column_stack([distance, distance, distance, distance]), logged.step.clip(0, 2), 3, np.arange(len(distance))
    )
    for usual in (None, tree):
        evidence = Evidence(1.0, np.array(LEVELS), usual, {"reduced": Input(True, cap)}, (), {"a->b": limit})
        shares = lost_shares(logged, evidence)
        assert shares.min() >= -1e-9
        assert shares.sum(axis=1) == pytest.approx(1.0 - scaling)


def test_sessions_are_joined_apart_from_each_other():
    one = rows(np.ones(5), 1.0, execution=1, switches={"a": TwoStateSignal(np.array([0.2]), np.array([True]))})
    both = joined([one, one])
    assert np.diff(both.t_s).min() > 0
    assert both.execution.tolist() == [1] * 5 + [2] * 5
    assert both.switches["a"].at(both.t_s).tolist() == 2 * [False, False, True, True, True]


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Dataset, pl.DataFrame]:
    """A simulated cell with all causes, and its true tasks."""
    folder = tmp_path_factory.mktemp("mixed")
    options = SimulationOptions(causes=MixedCauses(pauses_per_hour=60.0), robot_rate_hz=125)
    simulate("laser-zones", folder / "logs", executions=12, seed=21, options=options)
    ingest([folder / "logs"], folder / "dataset")
    return Dataset.open(folder / "dataset"), pl.read_parquet(folder / "logs" / "truth" / "tasks.parquet")


@pytest.mark.slow
def test_lost_seconds_of_a_mixed_cell_have_their_causes(mixed: tuple[Dataset, pl.DataFrame]):
    dataset, true = mixed
    tasks = dataset.tasks()
    assert tasks.height == true.height
    right = sum(np.minimum(tasks[name], true[name]).sum() for name in COLUMNS if name in true.columns)
    assert right / true.select(pl.sum_horizontal(pl.selectors.starts_with("lost_"))).sum().item() > 0.95
    assert tasks["lost_pause_s"].sum() == pytest.approx(true["lost_pause_s"].sum(), rel=0.02)
    assert true["lost_pause_s"].sum() > 5.0


@pytest.mark.slow
def test_the_causes_add_up_to_the_account_of_time(mixed: tuple[Dataset, pl.DataFrame]):
    tasks = mixed[0].tasks()
    lost = tasks.select(pl.sum_horizontal(COLUMNS)).to_series()
    rest = tasks.select(pl.col("end_s") - pl.col("start_s") - pl.col("nominal_s") - pl.col("dwell_s")).to_series()
    assert lost.to_list() == pytest.approx(rest.to_list(), abs=1e-9)
    scaled = tasks.select(pl.sum_horizontal(f"lost_{cause}_s" for cause in SCALING_CAUSES)).to_series()
    assert scaled.to_list() == pytest.approx(tasks["safety_loss_s"].to_list(), abs=1e-9)
    causes = mixed[0].samples(columns=["lost_to"])["lost_to"].drop_nulls().unique().to_list()
    assert set(causes) <= set(schema.LOST_CAUSES)


@pytest.mark.slow
def test_inspect_shows_seconds_and_how_often_by_cause(mixed: tuple[Dataset, pl.DataFrame], capsys: Any):
    path = str(mixed[0].path)
    assert run(["inspect", path, "--json"]) == 0
    lost = json.loads(capsys.readouterr().out)["lost"]
    assert list(lost["seconds"]) == list(LOST_CAUSES)
    assert lost["seconds"]["pause"] == pytest.approx(mixed[0].tasks()["lost_pause_s"].sum())
    assert lost["changes_per_hour"] > 0.0
    assert run(["inspect", path]) == 0
    assert "program paused" in capsys.readouterr().out


def test_who_stands_where_a_robot_stopped_at_its_threshold_is_its_cause() -> None:
    """The robot stops as soon as it is so near, so it stands for seconds just inside the threshold."""
    rng = np.random.default_rng(2)
    distance, execution = [], []
    for number in range(30):
        come = np.concatenate([np.arange(2.5, 0.4, -0.04), np.arange(0.4, 2.5, 0.04)]) + rng.uniform(0.0, 0.03)
        waits = np.full(40, 1.2 - rng.uniform(0.0002, 0.001)) if number % 3 == 0 else np.empty(0)
        part = np.concatenate([come, np.linspace(2.5, 1.21, 20), waits, np.linspace(1.21, 2.5, 20)])
        distance.append(part)
        execution.append(np.full(len(part), number))
    apart, number = np.concatenate(distance), np.concatenate(execution)
    seen = rows(np.where(apart < 1.2, 0.0, 1.0), apart, execution=number)
    shares = lost_shares(seen, find_evidence(seen, LEVELS))
    stop = SCALING_CAUSES.index("stop")
    assert shares[:, stop].sum() == 0.0


def test_a_signal_of_many_sessions_counts_in_each_for_its_own_time():
    weeks = TwoStateSignal(np.array([0.0, 4.0, 8.0, 1e6, 1e6 + 4.0]), np.array([False, True, False, True, False]))
    one = weeks.during(-60.0, 70.0)
    assert one.t_s.tolist() == [-60.0, 0.0, 4.0, 8.0]
    assert one.at(np.array([-1.0, 5.0, 9.0, 60.0])).tolist() == weeks.at(np.array([-1.0, 5.0, 9.0, 60.0])).tolist()
    later = weeks.during(1e6 + 1.0, 1e6 + 60.0)
    assert later.on.tolist() == [True, False]
