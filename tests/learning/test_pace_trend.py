"""A steady change of the pace is found beside people and days that differ; another person is no change."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from cyclekit.learning.pace_trend import ChangeShape, PaceTrend, find_trend

if TYPE_CHECKING:
    from cyclekit.schema import Vector


def _found(off: Vector, sessions: int) -> PaceTrend | None:
    passed = np.linspace(0.0, 1.0, len(off))
    early = -np.expm1(-4.0 * passed) / -np.expm1(-4.0)
    shapes = [ChangeShape(one, float(one.mean())) for one in (passed, early)]
    return find_trend(off, np.arange(len(off)) * sessions // len(off), shapes)


def _paces(change: float, seed: int, levels: tuple[float, ...] = (0.0,), count: int = 60) -> Vector:
    rng = np.random.default_rng(seed)
    level = np.repeat(levels, -(-count // len(levels)))[:count]
    return np.asarray(level + change * np.linspace(0.0, 1.0, count) + rng.normal(0.0, 0.05, count))


def _probabilities(change: float, sessions: int, levels: tuple[float, ...] = (0.0,), count: int = 60) -> list[float]:
    found = [_found(_paces(change, seed, levels, count), sessions) for seed in range(6)]
    return [one.probability for one in found if one is not None]


@pytest.mark.parametrize("sessions", [1, 2, 3, 6, pytest.param(12, marks=pytest.mark.slow)])
def test_few_sessions_suffice_where_the_change_within_them_and_between_them_agrees(sessions: int) -> None:
    assert float(np.median(_probabilities(-0.25, sessions))) > 0.9
    assert max(_probabilities(0.0, sessions)) < 0.5


@pytest.mark.parametrize(
    ("levels", "sessions"), [((0.1, -0.1), 2), ((0.1, -0.1) * 3, 6), ((0.1,) * 3 + (-0.1,) * 3, 6), ((0.1, -0.1), 1)]
)
def test_other_people_are_no_steady_change(levels: tuple[float, ...], sessions: int) -> None:
    assert max(_probabilities(0.0, sessions, levels, 120)) < 0.9


@pytest.mark.parametrize("turns", [1, 3, 6])
def test_a_change_is_found_beside_people_in_turn(turns: int) -> None:
    found = _found(_paces(-0.3, 1, (0.14, -0.14) * turns, 120), 2 * turns)
    assert found is not None
    assert found.probability > 0.9
    assert found.change == pytest.approx(-0.3, abs=0.1)


@pytest.mark.parametrize("sessions", [2, 3, 6])
def test_the_error_of_the_latest_pace_is_known(sessions: int) -> None:
    off = []
    for seed in range(12):
        paces = _paces(-0.25, seed)
        found = _found(paces, sessions)
        assert found is not None
        level = float(paces.mean()) + 0.5 * found.change
        off.append((level + 0.25) / found.error)
    assert float(np.mean(np.abs(off) < 1.96)) >= 0.8


@pytest.mark.parametrize(
    ("levels", "sessions", "least", "most"),
    [
        ((0.14, -0.14) * 3, 6, 0.02, 0.05),  # two people who return
        ((0.14, -0.14) * 3 + (0.14,), 7, 0.02, 0.06),  # one of them came more often
        ((0.15, -0.12, 0.02, 0.09, -0.2, 0.06), 6, 0.05, 0.2),  # others each day
    ],
)
def test_only_people_who_return_are_known(levels: tuple[float, ...], sessions: int, least: float, most: float) -> None:
    off = []
    for seed in range(4):
        paces = _paces(-0.3, seed, levels, 12 * sessions)
        found = _found(paces, sessions)
        assert found is not None
        assert least < found.error < most
        off.append(abs(float(paces.mean()) + 0.5 * found.change + 0.3) / found.error)
    assert max(off) < 2.5


def test_few_executions_tell_of_no_change() -> None:
    assert _found(_paces(-0.3, 0, count=20), 2) is None
