"""Find the levels of a speed scaling, and the level of every sample.

Many safety systems switch between a few speeds that were chosen in a risk assessment. In the log, these are values
that are held. So plateaus are found in time first (`plateaus`), and their values are clustered by density, weighted by
duration; each cluster is a level, with its mean as value. The literature clusters single values instead; those methods
are available by name (`FINDERS`). The networks learn what causes a level.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards import Note, note
from cyclekit.dataset.time_grid import USUAL_HZ, samples_in
from cyclekit.errors import ShapeError, UnknownName
from cyclekit.parallel.one_thread import one_thread
from cyclekit.scaling.levels.clusters import (
    FINDERS,
    Cluster,
    cluster_values,
    of_plateaus,
    operator_sliders,
    rounded,
    usual_eps,
)
from cyclekit.scaling.levels.kmeans import by_silhouette, condense
from cyclekit.scaling.levels.labels import label_in_time, unbroken
from cyclekit.scaling.levels.plateaus import Plateaus, find_plateaus
from cyclekit.text.numbers import fixed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from cyclekit.schema import Floats, Ints, Vector

MIN_HELD_S = 1.0
"""Minimum time, s, for which a level is held, over all plateaus; short, so that rare levels are found."""
PLATEAU = "plateau"
"""Default method to find levels; those of `FINDERS` ignore the order in time."""


@dataclass(frozen=True)
class Staircase:
    """The levels of a speed scaling, and the level of every sample.

    Attributes:
        levels: Level values, shape (P,), ascending, fractions of full speed.
        label: Index into `levels` of every sample, shape (T,), int32; -1 = unknown or in transition between levels.
        share: Share of the known samples on each level, shape (P,).
        warnings: Doubts about the levels; empty if there are none.
        means: Mean of the samples of each level, shape (P,): `levels` before rounding.
        slider: The operator's slider at every sample, shape (T,), if the values are levels times a slider that differs
            between runs; else None.
        noise: Standard deviation of the noise of one sample.
        is_staircase: False if the values are not held on a few levels; then learn them by regression.
    """

    levels: Floats
    label: NDArray[np.int32]
    share: Floats
    warnings: tuple[Note, ...] = ()
    means: Floats | None = None
    slider: Floats | None = None
    noise: float = 0.0
    is_staircase: bool = True


@one_thread()
def find_staircase(
    scaling: ArrayLike,
    *,
    run: ArrayLike | None = None,
    method: str = PLATEAU,
    levels: Sequence[float] | None = None,
    eps: float | None = None,
    min_samples: int | None = None,
    rate_hz: float = USUAL_HZ,
) -> Staircase:
    """Find the levels of a speed scaling and label every sample.

    Args:
        scaling: Speed scaling, shape (T,), fractions, in order of time; NaN = unknown.
        run: Stretch (execution, without gaps) of every sample, shape (T,); None: one stretch, split where the scaling
            is unknown.
        method: `plateau` or one of `FINDERS`.
        levels: Known levels of the safety configuration; if given, samples are only labelled.
        eps: Neighbourhood radius of the clustering; None: 3.5 standard deviations of the mean of a plateau of 1.5 s
            (`plateau`) or of one sample (`dbscan`), at least 0.01.
        min_samples: Minimum number of held samples of a level; None: those of one second, at least three.
        rate_hz: Rate of the samples; minimum durations of plateaus and levels are in seconds.

    Returns:
        The staircase. P = 0, with a warning, if no value is held long enough.

    Raises:
        ShapeError: `scaling` or `run` is not one-dimensional, or their lengths differ.
        UnknownName: The method does not exist.
    """
    values = np.asarray(scaling, dtype=np.float64)
    runs = np.zeros(values.shape, np.int64) if run is None else np.asarray(run)
    if values.ndim != 1 or runs.shape != values.shape:
        msg = f"scaling and run must be (T,), not {values.shape} and {runs.shape}"
        raise ShapeError(msg)
    if method not in (PLATEAU, *FINDERS):
        raise UnknownName("levels", "method", method, (PLATEAU, *FINDERS))
    known = np.isfinite(values)
    stretch = unbroken(runs, known)
    most_noise = np.inf if levels is None else float(np.diff(np.unique(levels)).min(initial=1.0)) / 8
    plateaus = find_plateaus(values[known], stretch[known], rate_hz=rate_hz, most_noise=most_noise)
    least = samples_in(MIN_HELD_S, rate_hz, least=3) if min_samples is None else min_samples
    if levels is not None:
        return _finish(values, stretch, plateaus, Cluster.fixed(levels), None)
    if method != PLATEAU:
        found = cluster_values(values[known], method, eps, least, plateaus.noise)
        return _finish(values, stretch, plateaus, found, None)
    near = usual_eps(plateaus.noise, rate_hz) if eps is None else eps
    slider, found = None, of_plateaus(plateaus, plateaus.value, near, least)
    if run is not None:
        slider, found = operator_sliders(plateaus, runs[known], found, near, least)
    whole = None
    if slider is not None:
        whole = np.full(values.shape, np.nan)
        whole[known] = slider
    return _finish(values, stretch, plateaus, found, whole)


@one_thread()
def second_opinion(scaling: ArrayLike, staircase: Staircase) -> Note | None:
    """Return a warning if K-means with silhouette finds another number of levels in the labelled samples.

    Args:
        scaling: Speed scaling of the staircase, shape (T,).
        staircase: Found by `plateau`; its labels exclude ramps, which mislead K-means.
    """
    values = np.asarray(scaling, dtype=np.float64)
    if staircase.slider is not None:
        values = values / staircase.slider
    held = values[staircase.label >= 0]
    if held.size < 2 or staircase.levels.size < 2:
        return None
    other = int(by_silhouette(condense(held)).max()) + 1
    if other == staircase.levels.size:
        return None
    return note("levels-disputed", levels=int(staircase.levels.size), other=other)


def _finish(values: Floats, stretch: Ints, plateaus: Plateaus, found: Cluster, slider: Floats | None) -> Staircase:
    """Round the levels if the data support it, label every sample, and add warnings."""
    levels = found.value if found.deviation is None else rounded(found.value, found.deviation)
    seen = values if slider is None else values / slider
    labels = label_in_time(seen, levels, stretch, plateaus=plateaus)
    known = int(np.isfinite(values).sum())
    share = np.bincount(labels[labels >= 0], minlength=levels.size) / max(known, 1)
    held = float(plateaus.samples.sum()) / max(known - plateaus.on_ramp, 1)
    parts = plateaus.on_ramp / max(known, 1), plateaus.varied / max(known, 1)
    said, stairs = doubts(levels, share, found.spread, known=known, held=held, noise=plateaus.noise, slopes=parts)
    if slider is not None:
        each = ", ".join(fixed(value, 2) for value in np.unique(np.round(slider[np.isfinite(slider)], 2))[:8])
        said.append(note("levels-with-slider", sliders=each))
    return Staircase(levels, labels, share, tuple(said), found.value, slider, plateaus.noise, stairs)


_MANY_LEVELS = 12
"""Maximum number of levels of a staircase; no safety configuration offers more."""
_WIDE = 6.0
"""Maximum width of the middle 90 % of a level's cluster, in eps."""
_MUCH_UNKNOWN = 0.2
_LITTLE_HELD = 0.5
_CONTINUOUS = 0.35
"""Maximum share of the time on slopes of various rates; above, the scaling is continuous."""
_MUCH_NOISE = 0.15


def doubts(
    levels: Vector,
    share: Vector,
    spread: Vector,
    *,
    known: int,
    held: float,
    noise: float,
    slopes: tuple[float, float] = (0.0, 0.0),
) -> tuple[list[Note], bool]:
    """Return the evidence against a staircase.

    Args:
        levels: Shape (P,), ascending.
        share: Share of the known samples on each level, shape (P,).
        spread: Width of each cluster in eps, shape (P,).
        known: Number of samples with known scaling.
        held: Share of these on plateaus, without those on ramps between levels.
        noise: Standard deviation of one sample.
        slopes: Share of the known samples on ramps of one rate (transitions between levels), and on slopes of
            various rates.

    Returns:
        Notes with the evidence, and whether it is a staircase nevertheless.
    """
    if known == 0:
        return [note("scaling-nowhere")], False
    if levels.size == 0 or noise > _MUCH_NOISE:
        return [note("levels-none")], False
    said, stairs = [], True
    if levels.size == 1:
        said.append(note("levels-one", level=float(levels[0])))
    if levels.size > _MANY_LEVELS:
        said.append(note("levels-many", levels=int(levels.size)))
        stairs = False
    wide = [fixed(value, 2) for value, width in zip(levels, spread, strict=True) if width > _WIDE]
    if wide:
        said.append(note("levels-wide", values=", ".join(wide)))
        stairs = False
    on_ramp, varied = slopes
    if varied > _CONTINUOUS:
        said.append(note("scaling-continuous", varied=varied))
        stairs = False
    if (unknown := 1 - float(share.sum()) - on_ramp) > _MUCH_UNKNOWN:
        said.append(note("levels-left", unknown=unknown))
    if held < _LITTLE_HELD and stairs:
        said.append(note("levels-not-held", held=held))
        stairs = False
    return said, stairs
