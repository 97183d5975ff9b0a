"""The commanded level: the level set by the safety function, with the response (latency, ramps) removed.

The logged scaling follows the command late (latency) and slowly (ramps). The command is known where a level is held
and in the last part of a transition to it. Before that, the ramp hides it: while the scaling rises past other levels,
the command is only known to be higher. The time of a command is the start of the change minus the reaction time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from cyclekit.scaling.transitions import (
    HELD_S,
    HeldLevel,
    RampRates,
    Transition,
    begin_of,
    fresh,
    held_levels,
    repeats,
    tolerance_of,
    transitions_of,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from cyclekit.schema import Bools, Ints, Vector

    Levels = NDArray[np.int32]

UNKNOWN = -1
_SLOWER = 1.5
"""A transition longer than this many times its ramp plus _STALLS_S has an unknown command."""
_STALLS_S = 0.3
SHORT_S = 0.6
"""Maximum time, s, of the last part of a transition for its final level to be the command; in a longer one, the command
may first have been a level farther on."""


class Response(Protocol):
    """Response of the safety function: `SafetyResponse`, or a dataset's card."""

    @property
    def latency_s(self) -> float | None:
        """Time from the command to the start of the change, s."""

    @property
    def ramp_down_per_s(self) -> float | None:
        """Fastest fall of the scaling."""

    @property
    def ramp_up_per_s(self) -> float | None:
        """Fastest rise of the scaling."""

    @property
    def hold_s(self) -> float | None:
        """Additional delay of rises, s."""


@dataclass(frozen=True)
class CommandedLevels:
    """The commanded level at N times.

    Attributes:
        level: Index of the level, shape (N,), int32; -1 = unknown.
        at_least, at_most: Bounds of the level, known in any case, shape (N,), int32.
    """

    level: Levels
    at_least: Levels
    at_most: Levels


class _Command(NamedTuple):
    """Commanded level and its bounds from `since_s` on."""

    since_s: float
    level: int
    at_least: int
    at_most: int


def commanded_levels(
    t_s: ArrayLike, scaling: ArrayLike, levels: Sequence[float], response: Response, at_s: ArrayLike | None = None
) -> CommandedLevels:
    """Return the commanded level of one stretch of a log without gaps.

    Args:
        t_s: Time, shape (T,), native rate, s, ascending.
        scaling: Speed scaling, shape (T,), fractions; NaN = unknown.
        levels: Level values, shape (P,), ascending.
        response: The response to remove; None in it means no delay.
        at_s: Times to evaluate, shape (N,); None: those of the rows.

    Returns:
        The levels at N times; -1 within the reaction time of the end of the log, where the reaction was not logged.
    """
    time, values = np.asarray(t_s, np.float64), np.asarray(scaling, np.float64)
    steps, at = np.asarray(levels, np.float64), time if at_s is None else np.asarray(at_s, np.float64)
    if len(steps) == 0 or len(time) < 3:
        none = np.full(at.shape, UNKNOWN, np.int32)
        return CommandedLevels(none, np.zeros_like(none), np.full_like(none, len(steps) - 1))
    commands = _commands(time, values, steps, RampRates(response.ramp_down_per_s, response.ramp_up_per_s))
    since, level, lowest, highest = (np.array(part) for part in zip(*commands, strict=True))
    answered = at + (response.latency_s or 0.0)
    row = np.searchsorted(since, answered, side="right") - 1
    found = [part[row].astype(np.int32) for part in (level, lowest, highest)]
    if response.hold_s:
        held = _held(since, lowest, highest, answered, response.hold_s)
        found[0][held], found[2][held] = UNKNOWN, len(steps) - 1
    return CommandedLevels(*found)


def _held(since: Vector, lowest: Ints, highest: Ints, at: Vector, hold_s: float) -> Bools:
    """Return the times at which the level may be held back by the hold time: it rises within `hold_s`."""
    rises = since[1:][lowest[1:] > highest[:-1]]
    after = np.searchsorted(rises, at, side="right")
    known = after < len(rises)
    left = np.full(at.shape, np.inf)
    left[known] = rises[after[known]] - at[known]
    return np.asarray(left <= hold_s)


def _commands(t_s: Vector, scaling: Vector, levels: Vector, rates: RampRates) -> list[_Command]:
    """Return the commands in order of time, the first one from minus infinity."""
    rows = fresh(scaling, repeats(t_s, scaling) if any(rates) else 1)  # a staircase that jumps repeats its levels
    t_s, scaling, end_s = t_s[rows], scaling[rows], float(t_s[-1])
    near, anything = tolerance_of(scaling, levels), (UNKNOWN, 0, len(levels) - 1)
    held_s = HELD_S if any(rates) else 0.0  # where the scaling jumps, one row on a level shows the command
    holds = held_levels(t_s, scaling, levels, near, rates, held_s)
    found = [_Command(-np.inf, *anything)]
    ramps = transitions_of(scaling, holds, near)
    leads_on = {ramp.first for ramp in ramps}
    both: list[HeldLevel | Transition] = [*holds, *ramps]
    for what in sorted(both, key=lambda one: (one.first, isinstance(one, HeldLevel))):
        if isinstance(what, HeldLevel):
            if found[-1].level != what.level:
                found.append(_Command(_reached(what, t_s, scaling, near, rates), *(what.level,) * 3))
            after = what.last + 1
            if after < len(t_s) and after not in leads_on:
                found.append(_Command(float(t_s[what.last]) + 1e-9, *anything))
        else:
            found += _commands_within(what, t_s, scaling, levels, near, rates)
            if what.after is None:
                found.append(_Command(float(t_s[min(what.last + 1, len(t_s) - 1)]), *anything))
    found.append(_Command(end_s + 1e-9, *anything))
    return _in_time(found)


def _in_time(commands: Sequence[_Command]) -> list[_Command]:
    """Return the commands with times that never decrease."""
    since = np.maximum.accumulate([command.since_s for command in commands])
    return [command._replace(since_s=float(begin)) for command, begin in zip(commands, since, strict=True)]


def _commands_within(
    ramp: Transition, t_s: Vector, scaling: Vector, levels: Vector, near: float, rates: RampRates
) -> list[_Command]:
    """Return the commands of a transition: at each level that it passes, the command is beyond."""
    rate, top = rates.of(rises=ramp.rises), len(levels) - 1
    begins_s = (
        begin_of(ramp, t_s, scaling, levels, rate) if ramp.before is not None else _turn_time(ramp, t_s, scaling, rates)
    )
    if rate is None and ramp.after is not None and ramp.before is not None:
        return [_Command(begins_s, *(ramp.after,) * 3)]
    rows = slice(ramp.first, ramp.last + 1)
    values, times = scaling[rows], t_s[rows]
    change = abs(float(values[-1] - values[0])) if len(values) else 0.0
    if len(values) and times[-1] - times[0] > _SLOWER * (change / rate if rate else 0.0) + _STALLS_S:
        return [_Command(begins_s, UNKNOWN, 0, top)]
    if ramp.rises:
        next_one = np.searchsorted(levels, np.maximum.accumulate(values) - near)
    else:
        next_one = np.searchsorted(levels, np.minimum.accumulate(values) + near, side="right") - 1
    next_one = next_one.clip(0, top)
    if ramp.before is not None:  # the scaling may still be near the level that it left
        first = min(ramp.before + 1, top) if ramp.rises else max(ramp.before - 1, 0)
        next_one = np.maximum(next_one, first) if ramp.rises else np.minimum(next_one, first)
    if ramp.after is not None:
        next_one = np.minimum(next_one, ramp.after) if ramp.rises else np.maximum(next_one, ramp.after)
    if not len(next_one):
        next_one, times = np.array([ramp.after if ramp.after is not None else UNKNOWN]), np.array([begins_s])
    new = np.flatnonzero(np.diff(next_one, prepend=-2))
    begin = times[new].tolist()
    begin[0] = begins_s
    edge = top if ramp.rises else 0
    found = [
        _Command(
            since, level if level in {edge, ramp.after} else UNKNOWN,
            level if ramp.rises else (level if level == ramp.after else 0),
            (level if level == ramp.after else top) if ramp.rises else level,
        )
        for since, level in zip(begin, next_one[new].tolist(), strict=True)
    ]  # fmt: skip
    if ramp.after is None or ramp.after == edge or found[-1].level != ramp.after:
        return found
    return [*found[:-1], _last_part(found[-1], top, rises=ramp.rises, reached_s=float(times[-1]))]


def _reached(hold: HeldLevel, t_s: Vector, scaling: Vector, near: float, rates: RampRates) -> float:
    """Return the time at which a level is certainly reached, s: a slow ramp is near a level before it reaches it."""
    rate = rates.of(rises=bool(scaling[hold.first] > scaling[hold.first - 1])) if hold.first else None
    return min(float(t_s[hold.first]) + (near / rate if rate else 0.0), float(t_s[hold.last]))


def _turn_time(ramp: Transition, t_s: Vector, scaling: Vector, rates: RampRates) -> float:
    """Return the start of a transition that left no level, s: where its ramp meets the one before it."""
    before, first, after = max(ramp.first - 1, 0), ramp.first, min(ramp.first + 1, len(t_s) - 1)
    sign = 1.0 if ramp.rises else -1.0
    came, goes = rates.of(rises=not ramp.rises), rates.of(rises=ramp.rises)
    if not sign * scaling[before] > sign * scaling[first] or came is None or goes is None:  # no turning point seen
        return float(t_s[before])
    gone = sign * (scaling[after] - scaling[before]) - goes * (t_s[after] - t_s[before])
    return float(np.clip(t_s[before] - gone / (came + goes), t_s[before], t_s[after]))


def _last_part(last: _Command, top: int, *, rises: bool, reached_s: float) -> _Command:
    """Return the command of the last part of a transition; if it takes long, the command may have been farther on."""
    if reached_s - last.since_s <= SHORT_S:
        return last
    return last._replace(level=UNKNOWN, at_least=last.level if rises else 0, at_most=top if rises else last.level)
