"""The walk of many rows at once is, row by row, the walk that its text describes."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.cards import TrainingCard
from cyclekit.estimate.cycle.engine import FINE_STEP_S, SUPPORT_EVERY_S, TIME_STEP_S, SimulatedCycles
from cyclekit.estimate.cycle.spread import logged_support
from cyclekit.estimate.cycle.walk import roll_out, simulate
from cyclekit.estimate.operator.tracks import OperatorTracks, operator_tracks
from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit.estimate.robot.program import draw_standstills, lay_out
from cyclekit.estimate.robot.safety import Dynamics, scaling_of
from cyclekit.estimate.robot.support import HUMAN_M, ROBOT_M

if TYPE_CHECKING:
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.robot.program import Program

TRACKS = 5


class Smooth:
    """A scaling that differs at every pair of positions, so that no mistaken row or instant goes unseen."""

    problem, card = "now", TrainingCard(scaling_without_operator=0.9)

    def predict(self, X: np.ndarray) -> np.ndarray:
        apart = np.linalg.norm(X[:, :3].astype(float) - X[:, 3:], axis=1)
        return np.clip(0.45 * apart - 0.35 + 0.05 * np.sin(9 * X[:, 0]), 0.0, 1.0)


def by_hand(
    model: Any, program: Program, tracks: OperatorTracks, k: int, standstill_s: np.ndarray, step_s: float
) -> dict[str, Any]:
    """Walk one program beside one track, a step at a time; the step is shared out where a motion or a stand ends."""
    part, at, last, clock, steps = 0, 0.0, 1.0, 0.0, 0
    lost, activity_s = np.zeros(len(program.tasks)), np.zeros(len(tracks.activities) + 1)
    looks: list[tuple[np.ndarray, np.ndarray]] = []
    ends = [
        end_s for task, stand_s in zip(program.tasks, standstill_s, strict=True) for end_s in (task.nominal_s, stand_s)
    ]
    while part < len(ends):
        between, sample = np.modf(round((steps + 0.5) * step_s / tracks.step_s, 6))
        sample = int(sample)
        here, after = tracks.xyz_m[k, sample], tracks.xyz_m[k, sample + 1]
        human = here if np.isnan(here + after).any() else here + (after - here) * between
        way_m, moves = program.tasks[part // 2].xyz_m, part % 2 == 0
        gone = min(at + last * step_s / 2, ends[part]) / ends[part] if moves else 1.0
        robot = way_m[int(gone * (len(way_m) - 1) + 0.5)]
        stands_on = not moves and ends[part] - at >= step_s
        last = 1.0 if stands_on else float(scaling_of(model, robot[None], human[None])[0])
        if steps % round(SUPPORT_EVERY_S / step_s) == 0:
            looks.append((robot, human))
        left = step_s
        while left > 0 and part < len(ends):
            rate = last if part % 2 == 0 else 1.0
            needs = (ends[part] - at) / rate if rate > 0 else np.inf
            spent = min(needs, left)
            if part % 2 == 0:
                lost[part // 2] += (1 - rate) * spent
                activity_s[tracks.activity[k, sample]] += (1 - rate) * spent
            at, left = (0.0, left - spent) if needs <= left else (at + rate * spent, 0.0)
            part += needs <= spent
        steps, clock = steps + 1, (steps + 1) * step_s - left
    return {"duration": clock, "lost": lost, "activity": activity_s, "looks": looks}


@pytest.fixture(scope="module")
def asked(logged: Dataset) -> tuple[list[Program], OperatorTracks]:
    """Two programs of different length and five tracks, one of whose operators is away for a while."""
    places = logged.card.executions[0].places
    nominal = nominal_tasks(logged)
    programs = [lay_out(TaskSequence("some", places[:count]), nominal, logged) for count in (7, 4)]
    tracks = operator_tracks(logged, horizon_s=90.0)
    tracks.xyz_m[1, 40:90] = np.nan
    short = {name: getattr(tracks, name)[:TRACKS] for name in ("xyz_m", "activity", "executions")}
    return programs, OperatorTracks(
        **short, activities=tracks.activities, logged=np.minimum(tracks.logged[:TRACKS], 60), step_s=tracks.step_s
    )


@pytest.mark.parametrize("step_s", [TIME_STEP_S, FINE_STEP_S])  # the middle of a step: a sample, between two
def test_many_rows_at_once_are_each_walked_as_one_would_by_hand(
    logged: Dataset, asked: tuple[list[Program], OperatorTracks], step_s: float
):
    programs, tracks = asked
    support = logged_support(logged)
    stands = [draw_standstills(program, TRACKS, 3) for program in programs]
    which, track = np.repeat([0, 1], TRACKS), np.tile(np.arange(TRACKS), 2)
    found = simulate(Smooth(), programs, which, track, stands, tracks, support, fine=step_s == FINE_STEP_S)
    samples = logged.samples()
    robot, human = (samples.select(f"{who}_{a}_m" for a in "xyz").drop_nulls().to_numpy() for who in ("robot", "human"))
    logged_cells = {(*r, *h) for r, h in zip(np.floor(robot / ROBOT_M), np.floor(human / HUMAN_M), strict=True)}

    def near(r: np.ndarray, h: np.ndarray) -> bool:
        return bool(np.isnan(h).any()) or (*np.floor(r / ROBOT_M), *np.floor(h / HUMAN_M)) in logged_cells

    for row in range(2 * TRACKS):
        program, k = programs[which[row]], track[row]
        wanted = by_hand(Smooth(), program, tracks, k, stands[which[row]][k], step_s)
        assert found.duration_s[row] == pytest.approx(wanted["duration"], abs=1e-9)
        np.testing.assert_allclose(found.robot.lost_s[row, : len(program.tasks)], wanted["lost"], atol=1e-9)
        np.testing.assert_allclose(found.activity_s[row], wanted["activity"], atol=1e-9)
        assert found.looked[row] == len(wanted["looks"])
        assert found.known[row] == sum(near(r, h) for r, h in wanted["looks"])
    assert 0 < found.known.sum() < found.looked.sum()


class Free(Smooth):
    """Full speed everywhere."""

    card = TrainingCard()

    def predict(self, X: np.ndarray) -> np.ndarray:
        return np.ones(len(X))


def test_a_cycle_that_starts_slow_takes_longer_where_recovery_is_slow(asked: tuple[list[Program], OperatorTracks]):
    programs, tracks = asked
    stands, track, slow = [draw_standstills(programs[1], TRACKS, 3)], np.arange(TRACKS), Dynamics(ramp_up_per_s=0.5)
    tracks = replace(tracks, scaling=np.array([np.nan, 1.0, 0.5, 0.5, 0.1]))
    found = simulate(Free(), programs[1:], np.zeros(TRACKS, np.int64), track, stands, tracks, dynamics=slow)
    lost_s = found.robot.lost_s.sum(axis=1)
    assert lost_s == pytest.approx([0.0, 0.0, 0.25, 0.25, 0.81], abs=1e-6)  # half of the square over the recovery


def test_rows_with_dynamics_do_not_mind_who_else_is_walked(asked: tuple[list[Program], OperatorTracks]):
    """Rows that are at their end are left out, of what the dynamics remember as well."""
    programs, tracks = asked
    slow = Dynamics(latency_s=0.3, ramp_down_per_s=2.0, ramp_up_per_s=0.5, hysteresis_m=0.15)
    stands = [draw_standstills(program, TRACKS, 3) for program in programs]
    which, track = np.repeat([0, 1], TRACKS), np.tile(np.arange(TRACKS), 2)
    found = simulate(Smooth(), programs, which, track, stands, tracks, dynamics=slow)
    for row in range(2 * TRACKS):
        program, some = programs[which[row]], stands[which[row]][track[row]][None]
        alone = simulate(Smooth(), [program], np.array([0]), track[row : row + 1], [some], tracks, dynamics=slow)
        assert found.duration_s[row] == alone.duration_s[0]
        legs = len(program.tasks)
        np.testing.assert_array_equal(found.robot.lost_s[row, :legs], alone.robot.lost_s[0])


def test_a_cycle_that_does_not_end_has_lost_what_it_lost_so_far(
    constant: Any, asked: tuple[list[Program], OperatorTracks]
):
    programs, tracks = asked
    stands = draw_standstills(programs[0], TRACKS, 0)
    both = np.array([0, 2])
    found: SimulatedCycles = simulate(constant(0.0), programs[:1], 0 * both, both, [stands[both]], tracks)
    assert np.isinf(found.duration_s).all()
    steps = int((tracks.activity.shape[1] - 2) * tracks.step_s / TIME_STEP_S)
    np.testing.assert_allclose(found.robot.lost_s[:, 0], steps * TIME_STEP_S)
    assert np.isinf(roll_out(constant(0.0), programs[0], tracks, None).duration_s).all()
