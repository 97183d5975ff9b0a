"""Coarse alignment of clocks, on request only: operator near against robot slow.

It finds the lag at which the robot is slow while the operator is near. The reaction time thus becomes part of the clock
offset and cannot be measured afterwards. The method finds a lost offset of seconds, never delays, so the result is
rounded to whole samples.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.alignment.clocks.fit import ClockFit
from cyclekit.dataset.cards import note
from cyclekit.dataset.unknown_height import in_plane

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.schema import Points, Vector


FAR_M = 4.0
"""Maximum distance of a person, m; larger ones count as this."""
REACH_S = 120.0
"""Maximum offset, s."""
MIN_SHARE = 0.6
TOO_WEAK = 0.2
AMBIGUOUS = 0.9


def coarse_fit(people: Sequence[Points], tcp_m: Points, scaling: Vector, *, step_s: float) -> ClockFit | None:
    """Return the shift in whole samples at which the robot is slow while a person is near.

    Args:
        people: Position per sample since the start of the log, one array (N, 3) per person, base frame, m; NaN = not
            seen.
        tcp_m: TCP per sample since the start of the robot log, shape (M, 3), m.
        scaling: Speed scaling per sample, shape (M,); NaN = unknown.
        step_s: Sampling period, s.

    Returns:
        The fit, from time since the first row of the log to time since the first row of the robot log; None if there
        is no correlation.
    """
    slow = 1.0 - scaling
    reach = round(REACH_S / step_s)
    count = max((len(track) for track in people), default=0)
    least = MIN_SHARE * min(count, len(tcp_m))
    lags = np.arange(-min(reach, count), min(reach, len(tcp_m)) + 1)
    score = np.array([_agreement(people, tcp_m, slow, int(lag), least) for lag in lags])
    if not np.isfinite(score).any():
        return None
    best = int(np.nanargmax(score))
    peak = float(score[best])
    if peak < TOO_WEAK:
        return None
    elsewhere = np.where(np.abs(lags - lags[best]) * step_s > 5.0, score, np.nan)
    second = int(np.nanargmax(elsewhere)) if np.isfinite(elsewhere).any() else best
    doubt = float(score[second]) / peak if second != best else None
    warnings = [note("clock-coarse")]
    if doubt is not None and doubt >= AMBIGUOUS:
        warnings.append(note("clock-coarse-ambiguous", away_s=float(lags[second] - lags[best]) * step_s))
    return ClockFit(
        "coarse",
        float(lags[best]) * step_s,
        warnings=tuple(warnings),
        residual_s=step_s,
        correlation=round(peak, 4),
        second_best=round(doubt, 4) if doubt is not None else None,
        second_best_s=float(lags[second] - lags[best]) * step_s if doubt is not None else None,
    )


def _agreement(people: Sequence[Points], tcp_m: Points, slow: Vector, lag: int, least: float) -> float:
    """Return Pearson's correlation of "near" with "slow" if sample i of the people is sample i + lag of the robot."""
    near = np.full(len(tcp_m), np.inf)
    for track in people:
        begin, end = max(0, lag), min(len(tcp_m), len(track) + lag)
        if end > begin:
            where = in_plane(tcp_m[begin:end], track[begin - lag : end - lag])
            far = np.linalg.norm(where - tcp_m[begin:end], axis=1)
            near[begin:end] = np.fmin(near[begin:end], far)
    known = np.isfinite(near) & np.isfinite(slow)
    if known.sum() < max(least, 20):
        return float("nan")
    a, b = -np.minimum(near[known], FAR_M), slow[known]
    a, b = a - a.mean(), b - b.mean()
    scale = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / scale if scale > 1e-9 else float("nan")
