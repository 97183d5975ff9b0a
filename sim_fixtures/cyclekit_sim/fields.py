"""Cells without a tracker: fields that watch the floor, as bits in the logs, and bits unrelated to people.

A field is on while the person is in its rectangle; it may count only while the TCP is in a given region. The other bits
that a controller or PLC logs change as in real cells: with the gripper, the conveyor, the program, or the speed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cyclekit_sim.arm import Array
from cyclekit_sim.engine import Trace
from cyclekit_sim.program import Ints
from cyclekit_sim.rules import Limit, Points, Rectangle, Rule
from cyclekit_sim.session import Session

GRIPPER_BIT, CONVEYOR_BIT, LAMP_BIT, SIDE_BIT = 0, 1, 6, 7
"""Bits unrelated to people: gripper feedback, passing parts, a lamp for slow speed, a bit of the program."""
NAMES = {GRIPPER_BIT: "gripper_closed", CONVEYOR_BIT: "part_passes", LAMP_BIT: "slow_lamp", SIDE_BIT: "left_side"}
_FEEDBACK_S, _LAMP_S, _PART_S = 0.04, 0.1, (1.5, 6.0)
_OPEN, _PRESSED_S, _LATER_S = (0.3, 0.8), 0.3, 60.0
"""Share of a person's time inside for which the door is open; how long its reset button is pressed; the maximum time
for which a door stays open after the end of a log."""


@dataclass(frozen=True)
class Field:
    """A field of a scanner, a light curtain, or a mat.

    Attributes:
        name: Name of its signal in an event log.
        bit: Its digital input.
        x_m, y_m: Ranges of the watched rectangle, base frame.
        scaling: Maximum scaling while a person is there.
        robot_polygon_m: It counts only while the TCP is above this polygon; empty: always.
        occupied: Value of its bit while a person is there; 0 for safety outputs.
        reset_bit: Digital input of the reset button of a door; None: no door. Its bit then shows that it is open: from
            when the person goes in until he has closed it. He presses the button as he leaves, and until then the
            robot is stopped.
    """

    name: str
    bit: int
    x_m: tuple[float, float]
    y_m: tuple[float, float]
    scaling: float
    robot_polygon_m: Points = ()
    occupied: int = 1
    reset_bit: int | None = None


def rule_of(fields: Sequence[Field]) -> Rule:
    """Return the safety function of some fields: the lowest scaling of those that count."""
    return Rule(
        tuple(
            Limit(one.scaling, rectangle=Rectangle(one.x_m, one.y_m), robot_polygon_m=one.robot_polygon_m)
            for one in fields
        )
    )


def on_of(fields: Sequence[Field], person_m: Array) -> Ints:
    """Return which fields are on (K,), bit k = field k, for person positions (K, 3); NaN: no person."""
    found = np.zeros(len(person_m), np.int64)
    for k, one in enumerate(fields):
        found |= Rectangle(one.x_m, one.y_m).holds(np.nan_to_num(person_m, nan=1e6), 0.0).astype(np.int64) << k
    return found


def with_inputs(trace: Trace, fields: Sequence[Field], rng: np.random.Generator) -> Trace:
    """Return a run with its digital inputs: those of the fields, and those unrelated to people."""
    times = np.asarray(np.arange(len(trace.scaling)) * trace.cycle_s, dtype=np.float64)
    on, inputs = on_of(fields, trace.track.at(times)), np.zeros(len(times), np.int64)
    for k, one in enumerate(fields):
        if one.reset_bit is None:
            inputs |= ((((on >> k) & 1) == one.occupied).astype(np.int64)) << one.bit
    program, of = trace.program, trace.segment
    late = trace.nominal_s >= 0.5 * program.length_s[of]
    closed = np.where(late, program.closed_after[of], program.closed_before[of])
    left = np.array([name.startswith("left") for name in program.goals])[of]
    edges = np.cumsum(rng.uniform(*_PART_S, int(times[-1] / _PART_S[0]) + 2))
    parts = np.searchsorted(edges, times) % 2
    slow = _later((trace.scaling < 1.0).astype(np.int64), _LAMP_S, trace.cycle_s)
    shown = {GRIPPER_BIT: _later(closed, _FEEDBACK_S, trace.cycle_s), CONVEYOR_BIT: parts, LAMP_BIT: slow}
    for bit, value in (shown | {SIDE_BIT: left}).items():
        inputs |= value.astype(np.int64) << bit
    for k, one in enumerate(fields):
        if one.reset_bit is not None:
            after = times[-1] + np.arange(1, int(_LATER_S / trace.cycle_s)) * trace.cycle_s
            inside = (on_of(fields, trace.track.at(np.concatenate([times, after]))) >> k) & 1
            is_open, pressed = _door(inside, trace.cycle_s, rng)
            inputs |= (is_open[: len(times)] == one.occupied).astype(np.int64) << one.bit
            inputs |= pressed[: len(times)] << one.reset_bit
    return replace(trace, inputs=inputs if trace.inputs is None else inputs | trace.inputs)


def events_of(session: Session, fields: Sequence[Field]) -> tuple[list[float], list[str], list[str]]:
    """Return the signal changes as logged by a PLC: session times, names, values; the initial values come first."""
    robot = session.robot
    names: dict[int, str] = {**NAMES, **{one.bit: one.name for one in fields}}
    names |= {one.reset_bit: f"{one.name}_reset" for one in fields if one.reset_bit is not None}
    rows = []
    for bit, name in names.items():
        values = (robot.inputs >> bit) & 1
        at = np.flatnonzero(np.diff(values, prepend=-1))
        rows += [(float(robot.t_s[i]), name, str(int(values[i]))) for i in at]
    times, signals, told = zip(*sorted(rows), strict=True)
    return list(times), list(signals), list(told)


def _door(inside: Ints, cycle_s: float, rng: np.random.Generator) -> tuple[Ints, Ints]:
    """Return whether a door is open and its button pressed, for whether a person is inside; shape (N,) each."""
    change = np.diff(inside, prepend=0, append=0)
    is_open, pressed = np.zeros(len(inside), np.int64), np.zeros(len(inside), np.int64)
    for begin, end in zip(np.flatnonzero(change == 1), np.flatnonzero(change == -1), strict=True):
        is_open[begin : begin + int(rng.uniform(*_OPEN) * (end - begin)) + 1] = 1
        pressed[end : end + round(_PRESSED_S / cycle_s)] = 1
    return is_open, pressed


def _later(values: Ints, by_s: float, cycle_s: float) -> Ints:
    by = round(by_s / cycle_s)
    return np.concatenate([np.full(by, values[0]), values])[: len(values)]
