"""Assign each lost second to a cause: input, limit of the path, person, protective stop; else unknown.

Causes that the log states come first (slider, program state: `segmentation.time_account`). The rest is assigned by
evidence. Slow motion while an input is on belongs to the input. Slow motion at the same place of a path in every pass,
also while nobody is near, belongs to a limit. Slow motion where people usually cause it belongs to the person. A
standstill midway where they usually do not is a protective stop. A cause gets only what it adds to the causes before
it in this order: the person's share is what would be saved without them, and no second counts twice.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.derive.causes.cause_samples import (
    DISTANCES,
    HALTED,
    HELD,
    SAME,
    STEP_M,
    Rows,
    TwoStateSignal,
    features_of,
)
from cyclekit.derive.causes.path_limits import ALWAYS_SHARE, Limit, always_slow, find_limits, limit_at
from cyclekit.derive.causes.recoveries import begun_by, recovering
from cyclekit.derive.causes.usual_levels import UsualLevels, usual_levels
from cyclekit.scaling.commanded import commanded_levels
from cyclekit.scaling.response import SafetyResponse, changes_of, rate_of
from cyclekit.schema import SCALING_CAUSES

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.schema import Bools, Floats, Ints, Vector

REACTION_S = 0.5
"""Maximum time, s, for a controller to apply or release an input (UR reduced mode: up to 500 ms)."""
SAMPLES_BEFORE, SAMPLES_AFTER = 5, 2
"""Number of samples before and after a slow one in which the operator must have been where people slow the robot."""
MAX_PERSISTING_SAMPLES = 10
"""Maximum number of samples for which a level persists after its cause has gone."""
MAX_DIP_SAMPLES = 20
"""Maximum number of samples of a dip, between two parts caused by a person, that is assigned to the person as well."""
EDGE_M = 0.02
"""Uncertainty, m, of a distance threshold: a robot that stops at a threshold is just inside it."""
MIN_LEVEL_SHARE = 0.35
"""Minimum share of samples at a level for operator positions to explain it; below, it usually has another cause."""
MIN_SAMPLES_OF_STATE = 50
"""Minimum number of samples in motion in each state of a signal to judge it."""
MIN_FOLLOWED_SHARE, MAX_RESPONSE_S = 0.5, 1.0
"""Minimum share of an input's changes that the scaling follows, and the maximum time, s, in which it begins to."""
MIN_CHANGES = 5
"""Minimum number of changes to a state that judge whether the robot was slow already."""
MIN_ACCURACY = 0.9
"""Minimum balanced accuracy with which the operator's position predicts a signal that watches the operator."""
MAX_ROWS = 60_000


class Input(NamedTuple):
    """Maximum scaling `cap` while a signal is in state `on`."""

    on: bool
    cap: float


@dataclass(frozen=True)
class Evidence:
    """Evidence on the causes of lost time, from all sessions.

    Attributes:
        top: Highest scaling.
        levels: Scaling of each class of `usual`.
        usual: Usual scalings by operator position; None without data.
        inputs: Signals that slow the robot and do not watch the operator.
        watching: Signals that watch the operator.
        limits: Limits of the path, by task.
        up_per_s: Rate at which the scaling recovers, 1/s; None = at once or unknown.
    """

    top: float
    levels: Vector
    usual: UsualLevels | None
    inputs: Mapping[str, Input]
    watching: tuple[str, ...]
    limits: Mapping[str, Limit]
    up_per_s: float | None = None


NOTHING = Evidence(1.0, np.ones(1), None, {}, (), {})


def find_evidence(rows: Rows, levels: Sequence[float], people: Sequence[str] = ()) -> Evidence:
    """Return the evidence on causes of lost time from some executions.

    Args:
        rows: Samples of the executions.
        levels: Levels of the scaling, ascending; with fewer than two, classes are tenths.
        people: Signals that show people; if empty, signals that the operator's position predicts.
    """
    moving = rows.moving & np.isfinite(rows.scaling)
    if not moving.any():
        return NOTHING
    top = float(np.quantile(rows.scaling[moving], 0.99))
    by_level = len(levels) >= 2
    values = np.array(levels) if by_level else np.linspace(0.0, 1.0, 11)
    label, up_per_s = _commanded(rows, levels) if by_level else (_tenths(rows), None)
    told = moving & (label >= 0)
    features, seen = features_of(rows, ())
    capping = _capping(rows, moving, top)
    watching = tuple(people) or tuple(
        name for name in capping if _follows(rows.switches[name].at(rows.t_s), features, seen, rows)
    )
    inputs = {name: how for name, how in capping.items() if name not in watching}
    free = moving & ~_active(rows, inputs)
    fast = moving & (rows.scaling >= top - SAME)
    slow = always_slow(rows, free & (rows.scaling > HALTED), fast)
    features, seen = features_of(rows, watching)
    usual = None
    if (usable := told & free & seen & ~slow).any():
        chosen = np.flatnonzero(usable) if people else _apart(rows, np.flatnonzero(usable), label)
        chosen = chosen[:: 1 + len(chosen) // MAX_ROWS]
        group = np.zeros_like(chosen) if people else rows.execution[chosen]  # a field may be on in few executions
        usual = usual_levels(features[chosen], label[chosen], len(values), group)
    evidence = Evidence(top, values, usual, inputs, watching, {})
    usually = usual_scaling(rows, evidence)
    alone = free if usual is None and not seen.any() else free & seen & (usually >= top - SAME)
    rises = recovering(rows.t_s, rows.scaling, rows.breaks, up_per_s)
    if usual is not None and usual.cuts and rises.any():
        person = _minimum_around(usually)
        recovers = begun_by(rises, rows.breaks, (person < top - SAME) & (person <= rows.scaling + SAME))
        slow, alone = always_slow(rows, free & (rows.scaling > HALTED) & ~recovers, fast), alone & ~recovers
    return Evidence(top, values, usual, inputs, watching, find_limits(rows, slow, alone, fast, top), up_per_s)


def _commanded(rows: Rows, levels: Sequence[float]) -> tuple[Ints, float | None]:
    """Return the commanded level at each sample, shape (N,), -1 = unknown, and the rate of recovery, 1/s."""
    parts = [part for part in np.split(np.arange(len(rows.t_s)), np.flatnonzero(rows.breaks)) if len(part)]
    changes = [change for part in parts for change in changes_of(rows.t_s[part], rows.scaling[part], levels)]
    down, up = (rate_of([change for change in changes if change.rises is rises]) for rises in (False, True))
    response = SafetyResponse(None, down, up, None, len(changes), None)
    found = [commanded_levels(rows.t_s[part], rows.scaling[part], levels, response).level for part in parts]
    return np.concatenate(found).astype(np.int64), up


def _tenths(rows: Rows) -> Ints:
    """Return the scaling in tenths where it is held, shape (N,), else -1."""
    return np.where(rows.held, np.rint(np.nan_to_num(rows.scaling) * 10).astype(np.int64), -1)


def lost_shares(rows: Rows, evidence: Evidence) -> Floats:
    """Return the share of each sample's time lost to each cause, shape (N, 5), in the order of SCALING_CAUSES.

    For a sample in motion with known scaling s, the shares add up to 1 - s; for any other sample to 0.
    """
    known = np.isfinite(rows.scaling)  # also at a standstill: a ramp that began there continues in the next motion
    s = np.where(known, rows.scaling, 1.0)
    same = np.maximum(SAME, np.minimum(3.0 * np.nan_to_num(rows.deviation), 0.1))
    top, limit = np.maximum(evidence.top, s), limit_at(rows, evidence.limits)
    top = np.where(top >= 1.0 - same, 1.0, top)
    limit = np.minimum(np.where(known & (s <= limit + same), limit, 1.0), top)
    cap = np.minimum(_input_cap(rows, evidence), limit)
    told = (s >= cap - same) & (cap < top - same)
    limit = np.maximum(np.where(told & (limit <= cap), s, limit), s)
    cap = np.maximum(np.where(told, s, cap), s)
    shares = np.zeros((len(s), len(SCALING_CAUSES)))
    with np.errstate(invalid="ignore", divide="ignore"):
        at = [np.where(c > HALTED, s / c, np.where(c >= s, told, 1.0)) for c in (top, limit, cap)]
    shares[:, UNKNOWN], shares[:, LIMITS], shares[:, INPUT] = at[0] - s, at[1] - at[0], at[2] - at[1]
    rest = 1.0 - at[2]
    which = _remaining_cause(rows, s, known & (rest > 0) & (s < cap - same), same, evidence)
    shares[np.arange(len(s)), which] += rest
    shares[~(known & rows.moving)] = 0.0
    return shares


PERSON, INPUT, LIMITS, STOP, UNKNOWN = range(len(SCALING_CAUSES))


def _remaining_cause(rows: Rows, s: Vector, slow: Bools, same: Vector, evidence: Evidence) -> Ints:
    """Return the cause of the loss that neither inputs nor limits explain, shape (N,)."""
    lowest = _minimum_around(usual_scaling(rows, evidence))
    told = np.isfinite(lowest)
    person = slow & told & (lowest <= s + same) & (lowest < evidence.top - same)
    stopped = slow & told & ~person & (s <= HALTED)
    which = np.full(len(s), UNKNOWN)
    which[person], which[stopped] = PERSON, STOP
    open_ = slow & ~person & ~stopped
    capped = _active(rows, evidence.inputs)
    after = np.where(capped, INPUT, np.where(limit_at(rows, evidence.limits) < 1.0, LIMITS, UNKNOWN))
    held, base = 0, 0.0
    known = np.isfinite(rows.scaling)
    last = np.maximum.accumulate(np.where(known | rows.breaks, np.arange(len(s)), 0))  # a pause has no scaling
    people = evidence.usual is not None and evidence.usual.cuts
    begun = recovering(rows.t_s, rows.scaling, rows.breaks, evidence.up_per_s if people else None) & rows.breaks
    which[open_ & begun & ~capped] = PERSON  # the cause was before the log, or between executions
    for i in np.flatnonzero(open_).tolist():  # the scaling recovers late and slowly
        j = int(last[i - 1])
        if i == 0 or rows.breaks[i] or s[i] < s[j] - same[i]:
            held, base = 0, s[i]
            continue
        before = which[j] if slow[j] else after[j]
        held = held + 1 if open_[j] and s[i] <= base + HELD else 0
        base = base if held else s[i]  # a slow ramp rises by less than HELD per sample
        if before != UNKNOWN and held < MAX_PERSISTING_SAMPLES:
            which[i] = before
    for i in np.flatnonzero(open_)[::-1].tolist():  # a ramp down belongs to the level that it ends at
        if which[i] == UNKNOWN and i + 1 < len(s) and not rows.breaks[i + 1] and slow[i + 1] and s[i] >= s[i + 1]:
            which[i] = which[i + 1]
    _bridge_person(which, slow, s <= HALTED, rows.breaks)
    return which


def _bridge_person(which: Ints, slow: Bools, halted: Bools, breaks: Bools) -> None:
    """Assign to the person the samples between two parts of one slow-down that the person caused.

    Applies to the rest of a standstill, and to a brief dip of unknown cause.
    """
    mine = np.flatnonzero(slow & (which == PERSON))
    for before, after in zip(mine[:-1].tolist(), mine[1:].tolist(), strict=True):
        part = slice(before + 1, after)
        if after == before + 1 or breaks[before + 1 : after + 1].any() or not slow[part].all():
            continue
        brief = after - before <= MAX_DIP_SAMPLES and (which[part] == UNKNOWN).all()
        if brief or halted[before : after + 1].all():
            which[part] = PERSON


def usual_scaling(rows: Rows, evidence: Evidence) -> Vector:
    """Return the lowest usual scaling for the operator's position, shape (N,); NaN = position unknown."""
    features, seen = features_of(rows, evidence.watching)
    if evidence.usual is None:
        return np.full(len(features), np.nan)
    nearer = features.copy()
    nearer[:, :DISTANCES] -= EDGE_M
    lowest = [evidence.levels[evidence.usual.lowest(some, MIN_LEVEL_SHARE)] for some in (features, nearer)]
    return np.where(seen, np.minimum(*lowest), np.nan)


def _minimum_around(values: Vector) -> Vector:
    """Return the minimum from SAMPLES_BEFORE samples before to SAMPLES_AFTER after each; NaN only where all are NaN."""
    padded = np.concatenate([np.full(SAMPLES_BEFORE, np.nan), values, np.full(SAMPLES_AFTER, np.nan)])
    known = np.where(np.isnan(padded), np.inf, padded)
    windows = np.lib.stride_tricks.sliding_window_view(known, SAMPLES_BEFORE + SAMPLES_AFTER + 1)
    lowest = windows.min(axis=1)
    return np.where(np.isinf(lowest), np.nan, lowest)


def _capping(rows: Rows, moving: Bools, top: float) -> dict[str, Input]:
    """Return the signals with one state in which the robot rarely reaches full speed, while it does in the other."""
    found = {}
    for name, switch in rows.switches.items():
        on = switch.at(rows.t_s)
        for state in (True, False):
            here, other = rows.scaling[moving & (on == state)], rows.scaling[moving & (on != state)]
            if min(len(here), len(other)) < MIN_SAMPLES_OF_STATE or not (here > HALTED).any():
                continue
            slower = float(np.quantile(here, ALWAYS_SHARE)) < top - SAME <= float(np.quantile(other, ALWAYS_SHARE))
            if slower:
                percent = np.bincount(np.rint(here[here > HALTED] * 100).astype(np.int64))
                how = Input(state, float(percent.argmax()) / 100)
                if _scaling_follows(rows, switch, top, how):
                    found[name] = how
    return found


def _scaling_follows(rows: Rows, switch: TwoStateSignal, top: float, how: Input) -> bool:
    """Return whether the scaling falls when a signal turns to its state, and rises when it turns back.

    An operator who presses a button is near the robot: it is slow while the button is on, and before and after. So the
    scaling has to fall wherever it was above the cap. If it was never above it, nothing shows that the signal slows the
    robot.
    """
    falls, rises, slow_already = list[bool](), list[bool](), 0
    for at_s, on in zip(switch.t_s.tolist(), switch.on.tolist(), strict=True):
        low, middle, high = np.searchsorted(rows.t_s, (at_s - MAX_RESPONSE_S, at_s, at_s + MAX_RESPONSE_S)).tolist()
        before, after = (some[np.isfinite(some)] for some in (rows.scaling[low:middle], rows.scaling[middle:high]))
        if not len(before) or not len(after) or rows.execution[low] != rows.execution[high - 1]:
            continue
        if on == how.on and before[-1] > how.cap + SAME:
            falls.append(bool(after.min() < before[-1] - SAME))
        elif on == how.on:
            slow_already += 1
        elif before[-1] < top - SAME:
            rises.append(bool(after.max() > before[-1] + SAME))
    if not falls and slow_already >= MIN_CHANGES:
        return False
    return all(float(np.mean(some)) >= MIN_FOLLOWED_SHARE for some in (falls, [*falls, *rises]) if some)


def _active(rows: Rows, inputs: Mapping[str, Input]) -> Bools:
    """Return whether any of the inputs slows the robot or was released within REACTION_S, shape (N,)."""
    active = np.zeros(len(rows.t_s), np.bool_)
    for name, how in inputs.items():
        active |= rows.switches[name].within(rows.t_s, REACTION_S, on=how.on) if name in rows.switches else False
    return active


def _input_cap(rows: Rows, evidence: Evidence) -> Vector:
    cap = np.ones(len(rows.t_s))
    for name, how in evidence.inputs.items():
        on = _active(rows, {name: how})
        cap[on] = np.minimum(cap[on], how.cap)
    return cap


def _follows(on: Bools, features: Floats, seen: Bools, rows: Rows) -> bool:
    """Return whether the operator's position predicts a signal, on held-out executions."""
    even = rows.execution % 2 == 0
    learn, judge = np.flatnonzero(seen & even), np.flatnonzero(seen & ~even)
    if (
        min(len(learn), len(judge)) < MIN_SAMPLES_OF_STATE
        or len(np.unique(on[learn])) < 2
        or len(np.unique(on[judge])) < 2
    ):
        return False
    learn = learn[:: 1 + len(learn) // MAX_ROWS]
    tree = usual_levels(features[learn], on[learn].astype(np.int64), 2, rows.execution[learn] // 2)
    right = tree.lowest(features[judge], 0.5) == on[judge]
    return float(np.mean([right[on[judge] == state].mean() for state in (True, False)])) >= MIN_ACCURACY


def _apart(rows: Rows, chosen: Ints, label: Ints) -> Ints:
    """Return one sample per execution, level and pair of places, so that a standstill counts once."""
    places = np.nan_to_num(np.column_stack([rows.robot_m, rows.human_m])[chosen], nan=1e4) / STEP_M
    key = np.column_stack(
        [rows.execution[chosen], label[chosen], np.floor(places / [1, 1, 1, 2, 2, 4]).astype(np.int64)]
    )
    return np.asarray(chosen[np.sort(np.unique(key, axis=0, return_index=True)[1])])


__all__ = ["NOTHING", "Evidence", "Rows", "TwoStateSignal", "find_evidence", "lost_shares", "usual_scaling"]
