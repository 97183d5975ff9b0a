"""Safety functions that restart the robot late: each field has its own delay after it is free again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cyclekit.config.cells import OperatorSignal
from cyclekit.dataset.signals import SignalChanges
from cyclekit.derive.causes.cause_samples import TwoStateSignal
from cyclekit.derive.signals.operator_signals import find_signals
from cyclekit.derive.signals.signal_evidence import SignalEvidence

DELAY_S, WARNING_S, PROTECTIVE_S = 0.1, 0.5, 2.0
END_S, STEP_S = 1200.0, 0.1


def bit(spans_s: np.ndarray, at_s: np.ndarray, hold_s: float = 0.0) -> np.ndarray:
    """Return whether any span covers a time; each is `hold_s` longer."""
    begun = np.searchsorted(spans_s[:, 0], at_s, side="right") - 1
    return (begun >= 0) & (at_s < spans_s[np.maximum(begun, 0), 1] + hold_s)


def signal(spans_s: np.ndarray, on: str) -> SignalChanges:
    """Return a signal that is `on` in the spans."""
    values = np.tile([on, "0" if on == "1" else "1"], len(spans_s))
    return SignalChanges(np.append(-1.0, spans_s.ravel()), np.append(values[1], values))


def field_in_a_field(seed: int) -> SignalEvidence:
    """Return a cell: a warning field slows the robot, a protective one within it stops it where y < 0.2.

    A person crosses the warning field for a second before and after the protective one.
    """
    rng = np.random.default_rng(seed)
    begins = np.cumsum(rng.uniform(12.0, 20.0, 70))
    warning = np.column_stack([begins, begins + rng.uniform(4.0, 7.0, 70)])
    deep = warning[rng.random(70) < 0.5]
    protective = np.column_stack([deep[:, 0] + 1.2, deep[:, 1] - 1.0])
    t_s, fine_s = np.arange(0.0, END_S, STEP_S), np.arange(0.0, END_S, 0.004)
    y_m = 0.6 * np.sin(2 * np.pi * t_s / 8.0)

    def level(at_s: np.ndarray) -> np.ndarray:
        stop = bit(protective, at_s - DELAY_S, PROTECTIVE_S - DELAY_S) & (np.interp(at_s, t_s, y_m) < 0.2)
        return np.where(stop, 0, np.where(bit(warning, at_s - DELAY_S, WARNING_S - DELAY_S), 1, 2))

    change = np.diff(level(fine_s))
    signals = {"warning": signal(warning, "1"), "protective": signal(protective, "0")}
    return SignalEvidence(
        t_s,
        level(t_s),
        np.column_stack([np.full(len(t_s), 0.4), y_m]),
        (t_s // 4.0 % 2).astype(np.int64),
        (t_s // 60.0).astype(np.int64),
        fine_s[1:][change < 0],
        fine_s[1:][change > 0],
        signals,
        (0.0, 0.5, 1.0),
    )


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_each_field_has_its_own_restart_delay(seed: int) -> None:
    found = find_signals(field_in_a_field(seed))
    warning, protective = found.cards
    assert (warning.signal, protective.signal, protective.occupied) == ("warning", "protective", "0")
    assert [warning.delay_s, protective.delay_s] == pytest.approx([DELAY_S, DELAY_S], abs=0.01)
    assert warning.hold_s == pytest.approx(WARNING_S - DELAY_S, abs=0.02)
    assert protective.hold_s == pytest.approx(PROTECTIVE_S - DELAY_S, abs=0.02)
    assert found.hold_s == warning.hold_s
    assert protective.explained > 0.97


@pytest.mark.parametrize("told", [(), (OperatorSignal("w", "warning", "1"), OperatorSignal("p", "protective", "0"))])
def test_a_field_whose_falls_are_not_seen_answers_as_soon_as_the_first_one(told: tuple[OperatorSignal, ...]) -> None:
    evidence = field_in_a_field(4)
    answers_s = evidence.signals["protective"].to("0") + DELAY_S
    seen = np.abs(evidence.falls_s[:, None] - answers_s).min(axis=1) > 0.1
    found = find_signals(replace(evidence, falls_s=evidence.falls_s[seen]), told)
    protective = found.cards[1]
    assert (protective.signal, protective.occupied) == ("protective", "0")
    assert protective.delay_s == pytest.approx(DELAY_S, abs=0.01)
    assert protective.hold_s == pytest.approx(PROTECTIVE_S - DELAY_S, abs=0.02)


def test_a_signal_that_lasts_longer_ends_later_and_bridges_short_gaps() -> None:
    times_s = np.array([0.0, 5.0, 6.0, 6.5, 8.0, 9.0])
    longer = TwoStateSignal(times_s, np.array([False, True, False, True, False, False])).held(1.0)
    assert longer.t_s.tolist() == [0.0, 5.0, 9.0]
    assert longer.on.tolist() == [False, True, False]
    assert TwoStateSignal(times_s[:2], np.array([True, False])).held(1.0).t_s.tolist() == [0.0, 6.0]
