"""Self-labelling of a dataset: its speed scaling in unbroken stretches of time, and the staircase of levels.

`scaling.levels` finds levels in a series of values; this module decides which values belong together in time (one
execution, no gap) and whether the cell file fixes the levels.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.dataset.time_grid import stretches
from cyclekit.errors import DatasetError, command_line
from cyclekit.scaling.commanded import SHORT_S, UNKNOWN, Response, commanded_levels
from cyclekit.scaling.levels import Staircase, find_staircase

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.cards import DynamicsCard, Note, TrainingCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Floats, Ints

MIN_LATENCY_S = 0.03
"""Minimum reaction time, s, that exceeds its own error."""
OF_LOGS = {"frame-assumed", "frame-doubtful", "override-moved", "override-of-program", "override-unknown"}
"""Codes of notes of the dataset on what a model learns from: distances, and a set override."""


def notes_of_logs(dataset: Dataset) -> list[Note]:
    """Return the notes of a dataset that hold for each model trained on it."""
    return [one for one in dataset.card.warnings if one.code in OF_LOGS]


def scaling_in_time(frame: pl.DataFrame, rate_hz: float) -> tuple[Floats, Ints]:
    """Return the scaling of every row of SAMPLES (NaN = unknown) and the number of its stretch, shape (N,) each."""
    return frame["scaling"].fill_null(np.nan).to_numpy(), stretches(frame, rate_hz)


def need_scaling(dataset: Dataset, frame: pl.DataFrame) -> None:
    """Refuse rows without any scaling.

    Raises:
        DatasetError: All are unknown; the message says whether a robot log is missing.
    """
    if not frame["scaling"].is_null().all():
        return
    if "robot" in dataset.positions:
        msg = f"{dataset.path}: the speed scaling is unknown in all {frame.height} samples, so nothing can be learned"
        cure = "Log the scaling (the speed override that is in force), or give a reference run without the operator in "
        raise DatasetError(msg, cure=f"{cure}cell.toml so that it can be inferred.")
    msg = f"{dataset.path}: no log of the robot was ingested, and its speed scaling is what is to be learned"
    cure = "Put the log of the robot's controller beside the tracker's, in the folder of its session, and ingest both:"
    raise DatasetError(msg, cure=f"{cure} {command_line('ingest', 'LOGS', '--out', 'DATASET')}")


def fixed_levels(dataset: Dataset) -> tuple[float, ...] | None:
    """Return the levels fixed by the dataset's cell file; None if they are to be found."""
    return dataset.card.settings.levels or None


def without_slider(dataset: Dataset, frame: pl.DataFrame) -> tuple[pl.DataFrame, Note | None]:
    """Return the rows with the scaling divided by the operator's speed slider, if it differs between executions.

    Args:
        dataset: Dataset of the rows.
        frame: All rows of some executions; the slider of an execution is read from its own rows.

    Returns:
        The rows and a note; the same rows and None without a slider.
    """
    found = staircase_of(dataset, frame)
    if found.slider is None:
        return frame, None
    said = next(one for one in found.warnings if one.code == "levels-with-slider")
    return frame.with_columns(scaling=pl.col("scaling") / pl.Series(found.slider).fill_nan(None)), said


def with_commands(dataset: Dataset, frame: pl.DataFrame, levels: Sequence[float]) -> pl.DataFrame:
    """Return the rows with the commanded scaling instead of the delayed one.

    Args:
        dataset: Dataset of the rows, whose response is removed.
        frame: Rows of SAMPLES, grouped by execution and ordered by time.
        levels: Levels of the scaling, ascending.

    Returns:
        The rows; null where a ramp hides the command, or the log ends before the response. `frame` itself if the
        dataset has no response.
    """
    response = dataset.card.dynamics
    if not follows_late(response) or len(levels) < 2:
        return frame
    commanded = commanded_in_time(dataset, frame, levels, response)
    return frame.with_columns(scaling=pl.Series(np.append(levels, np.nan)[commanded]).fill_nan(None))


def commanded_in_time(
    dataset: Dataset,
    frame: pl.DataFrame,
    levels: Sequence[float],
    response: Response,
    *,
    sure_s: float = 0.0,
    or_faster: bool = False,
    people: Ints | None = None,
) -> Ints:
    """Return the index of the commanded level at every row, shape (N,); -1 = unknown.

    Args:
        dataset: Dataset of the rows.
        frame: Rows of SAMPLES, grouped by execution and ordered by time.
        levels: Levels of the scaling, ascending.
        response: The response to remove.
        sure_s: The level is also unknown this close to a change, s.
        or_faster: Return -1 - k if a rising ramp hides the level and it is at least k.
        people: State of the people in every row, shape (N,): while it stays the same, a ramp hides no level, see
            `_led_to`.
    """
    scaling, run = scaling_in_time(frame, dataset.rate_hz)
    ends = np.flatnonzero(np.diff(run)) + 1
    stretches_of = zip(np.split(frame["t_s"].to_numpy(), ends), np.split(scaling, ends), strict=True)
    states = np.split(np.zeros(frame.height, np.int64) if people is None else people, ends)
    found = []
    for (t_s, s), state in zip(stretches_of, states, strict=True):
        at_s = np.concatenate([t_s - sure_s, t_s + sure_s])
        commanded = commanded_levels(t_s, s, levels, response, at_s)
        hidden = or_faster & (commanded.level < 0) & (commanded.at_least > 0)
        early, late = np.split(np.where(hidden, -1 - commanded.at_least, commanded.level), 2)
        level = np.where(early == late, early, UNKNOWN)
        if people is not None:
            lowest = commanded.at_least.reshape(2, -1).min(axis=0)
            level = _led_to(level, lowest, commanded.at_most.reshape(2, -1).max(axis=0), state, t_s)
        found.append(level)
    return np.concatenate(found).astype(np.int64)


def _led_to(level: Ints, lowest: Ints, highest: Ints, people: Ints, t_s: Floats) -> Ints:
    """Return levels with those that a ramp hides, where people stay in one state: the level to which the ramp leads.

    Then only the robot changed the level, by its way into or out of a region. Without these rows, the edge of a region
    would be found too far in: a robot that stops in it is seen there only after its ramp has passed the other levels.

    Args:
        level: Level of each row of one stretch, shape (N,); negative = hidden.
        lowest: Its lower bound, shape (N,).
        highest: Its upper bound, shape (N,).
        people: State of the people, shape (N,).
        t_s: Time, shape (N,), s.
    """
    known, hidden = np.flatnonzero(level >= 0), np.flatnonzero(level < 0)
    after = np.searchsorted(known, hidden)
    between = (after > 0) & (after < len(known))
    hidden, before, after = hidden[between], known[after[between] - 1], known[after[between]]
    changes = np.cumsum(np.diff(people, prepend=people[:1]) != 0)
    alone = (changes[before] == changes[after]) & (t_s[after] - t_s[before] <= SHORT_S)
    left = (level[before] < lowest[hidden]) | (level[before] > highest[hidden])
    there = (lowest[hidden] <= level[after]) & (level[after] <= highest[hidden])
    sure = alone & left & there
    found = level.copy()
    found[hidden[sure]] = level[after[sure]]
    return found


def as_learned(card: TrainingCard, dataset: Dataset, frame: pl.DataFrame, levels: Sequence[float]) -> pl.DataFrame:
    """Return the rows with the scaling that a model was trained on: commanded, or as logged."""
    commanded = card.spec is not None and card.spec.target == "commanded"
    return with_commands(dataset, frame, levels) if commanded else frame


def follows_late(response: DynamicsCard) -> bool:
    """Return whether the scaling follows the command with a delay, with ramps, or after a hold time."""
    seen = (response.ramp_down_per_s, response.ramp_up_per_s, response.hold_s)
    return (response.latency_s or 0.0) >= MIN_LATENCY_S or any(seen)


def staircase_of(dataset: Dataset, frame: pl.DataFrame) -> Staircase:
    """Return the staircase of levels in rows of a dataset, found or fixed by its cell file.

    Args:
        dataset: Dataset of the rows.
        frame: Table SAMPLES or a part of it, grouped by execution and ordered by time.
    """
    scaling, run = scaling_in_time(frame, dataset.rate_hz)
    return find_staircase(scaling, run=run, levels=fixed_levels(dataset), rate_hz=dataset.rate_hz)
