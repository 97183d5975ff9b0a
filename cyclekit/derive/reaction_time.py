"""Estimate the reaction time that explains the commanded level best, if the places of its changes do not give it.

At the right reaction time, the positions of that time ago determine the level, whatever the rule; at any other, the
same positions have different levels when people approach and when they leave. So a small decision tree
(`usual_levels`) is fitted to the delayed positions for each candidate, and the candidate with fewest errors is chosen.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.derive.causes.usual_levels import usual_levels
from cyclekit.derive.concatenated import APART_S, commanded_samples, shifts_apart
from cyclekit.derive.signals.session_signals import some_executions

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from cyclekit.derive.second_pass import SecondPassResult
    from cyclekit.scaling.response import SafetyResponse
    from cyclekit.schema import Floats, Ints, Vector

LATEST_S, STEP_S = 0.8, 0.05
"""Maximum candidate for the reaction time and step between candidates, s."""
MAX_ROWS, MIN_ROWS = 20_000, 500
"""Maximum and minimum number of samples near changes of the level."""
NEAR_S = 1.5
"""Maximum time from a change of level, s: farther away, any reaction time explains the level."""
BETTER, SIGMAS = 0.8, 4.0
"""Maximum ratio of errors to those at reaction time 0; minimum reduction in standard errors of a count."""
AWAY_M = 99.0
_AXES = [f"{who}_{axis}_m" for who in ("robot", "human") for axis in "xyz"]


def reaction_time(
    sessions: Sequence[SecondPassResult], levels: Sequence[float], response: SafetyResponse, folder: Path
) -> float | None:
    """Return the reaction time that explains the commanded level best, s; None if none is clearly better than 0.

    Args:
        sessions: The sessions, with their samples in files.
        levels: Levels of the scaling, ascending.
        response: Response with the ramps to remove.
        folder: Folder of the files.
    """
    chosen = some_executions(sessions)
    found = [_of_file(folder / f"{part}.parquet", chosen, levels, response) for part in _parts(sessions)]
    found = [one for one in found if len(one[0])]
    if len(levels) < 2 or not found:
        return None
    t_s, level, places, execution = _joined(found)
    rows = _near_changes(t_s, level)
    if len(rows) < MIN_ROWS or len(np.unique(execution[rows])) < 4:
        return None
    rows = rows[:: -(-len(rows) // MAX_ROWS)]
    late_s = np.arange(0.0, LATEST_S + STEP_S / 2, STEP_S)
    unpredicted = np.array([_unpredicted(t_s, level, places, execution, rows, late) for late in late_s.tolist()])
    best = int(unpredicted.argmin())
    if best in {0, len(unpredicted) - 1} or unpredicted[best] > BETTER * unpredicted[0]:
        return None
    if unpredicted[0] - unpredicted[best] < SIGMAS * np.sqrt(unpredicted[0] + unpredicted[best]):
        return None
    before, here, after = unpredicted[best - 1 : best + 2]
    bend = before - 2.0 * here + after
    return round(float(late_s[best] + (0.5 * STEP_S * (before - after) / bend if bend > 0.0 else 0.0)), 2)


def _parts(sessions: Sequence[SecondPassResult]) -> list[str]:
    return list(dict.fromkeys(one.part for one in sessions if one.samples))


def _of_file(
    file: Path, chosen: Sequence[str], levels: Sequence[float], response: SafetyResponse
) -> tuple[Vector, Ints, Floats, Ints]:
    """Return time, commanded level, places (N, 6) and execution of the samples of one file whose places are known."""
    found = commanded_samples(file, chosen, ["human_gap", *_AXES], _AXES, levels, response)
    if found is None:
        return np.empty(0), np.empty(0, np.int64), np.empty((0, 6)), np.empty(0, np.int64)
    frame, t_s, stretch, level = found
    places = frame.select(_AXES).to_numpy()
    away = (frame["human_gap"] == "absent").fill_null(value=False).to_numpy()
    places[away, 3:] = AWAY_M
    places[:, 5] = np.nan_to_num(places[:, 5])  # a height may be unknown
    number = frame["execution"].rank("dense").to_numpy().astype(np.int64)
    return t_s + stretch * APART_S, level, places, number


def _joined(found: Sequence[tuple[Vector, Ints, Floats, Ints]]) -> tuple[Vector, Ints, Floats, Ints]:
    """Return the files concatenated, far apart in time."""
    shifts = shifts_apart((float(one[0][0]), float(one[0][-1])) for one in found)
    t_s = [one[0] + shift for one, shift in zip(found, shifts, strict=True)]
    execution: list[Ints] = []
    for one in found:
        execution.append(one[3] + (int(execution[-1].max()) if execution else 0))
    level, places = (np.concatenate([one[k] for one in found]) for k in (1, 2))
    return np.concatenate(t_s), level, places, np.concatenate(execution)


def _near_changes(t_s: Vector, level: Ints) -> Ints:
    """Return the samples of known level within NEAR_S of a change of it."""
    known = np.flatnonzero(level >= 0)
    changed = known[1:][np.diff(level[known]) != 0]
    at = np.searchsorted(t_s[changed], t_s[known])
    last = np.clip(np.stack([at - 1, at]), 0, max(len(changed) - 1, 0))
    if not len(changed):
        return np.empty(0, np.int64)
    return np.asarray(known[np.abs(t_s[changed][last] - t_s[known]).min(axis=0) <= NEAR_S])


def _unpredicted(t_s: Vector, level: Ints, places: Floats, execution: Ints, rows: Ints, late_s: float) -> float:
    """Return the number of levels that the positions `late_s` earlier do not predict."""
    seen_s = t_s[rows] - late_s
    after = np.clip(np.searchsorted(t_s, seen_s), 1, len(t_s) - 1)
    share = np.clip((seen_s - t_s[after - 1]) / (t_s[after] - t_s[after - 1]), 0.0, 1.0)[:, None]
    there = places[after - 1] * (1.0 - share) + places[after] * share
    jumps = np.abs(places[after] - places[after - 1]).max(axis=1) > AWAY_M / 2  # the operator appears or leaves
    told = np.isfinite(there).all(axis=1) & ~jumps & (t_s[after] - t_s[after - 1] < 1.0)
    apart = there[:, 3:5] - there[:, :2]
    features = np.column_stack([there, np.hypot(*apart.T)])
    if not told.any():
        return float(len(rows))
    classes, kind = np.unique(level[rows][told], return_inverse=True)
    tree = usual_levels(features[told], kind, len(classes), execution[rows][told])
    off = tree.shares[tree.leaf(features[told])].argmax(axis=1) != kind
    return float(off.mean()) * len(rows)
