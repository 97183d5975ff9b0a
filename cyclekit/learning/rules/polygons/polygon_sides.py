"""Which sides a polygon needs: the fewest that the samples do not contradict.

The search for polygons (`polygons`) moves one side at a time. It may describe one side by two, neither of which can be
left out while the other stays as it is; and it may miss a short side. So here the others are fitted again after a side
is left out or added.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.learning.rules.polygons.polygon_fit import MAX_SIDES, climbed, depths_of, normals, terms_of, terms_with

if TYPE_CHECKING:
    from cyclekit.learning.rules.polygons.polygon_fit import PolygonSamples, PolygonState

NEEDED = 8.0
"""Minimum log-likelihood that a side must add after the others are fitted again: about the logarithm of the number of
samples near a polygon, as by the Bayesian information criterion for two parameters."""
_BLUR_M, _SWEEPS, _FEW_SWEEPS = (0.04, 0.01, 0.0), 60, 20
_ANGLES = np.deg2rad(np.arange(0.0, 360.0, 10.0))
_TRIED, _MOST_POINTS = 3, 40
_ABOUT_M = 0.05
"""Distance, m, beyond a polygon at which samples still decide on a further side."""


def needed(state: PolygonState, samples: PolygonSamples, rng: np.random.Generator) -> PolygonState:
    """Return the polygon with the best fit, with the fewest sides that it needs.

    Args:
        state: Polygon to start from.
        samples: Samples near it.
        rng: Source of random steps.
    """
    state, fit = climbed(state, samples, rng, _SWEEPS, _BLUR_M)
    while len(state.angle_rad) < MAX_SIDES + 1:
        more, new = max(_with_one_more(state, samples, rng), key=lambda one: one[1], default=(state, fit))
        if new - fit <= NEEDED:
            break
        state, fit = climbed(more, samples, rng, _SWEEPS, _BLUR_M)
    while len(state.angle_rad) > 1:
        every = range(len(state.angle_rad))
        tried = [climbed(state.without(side), samples, rng, _FEW_SWEEPS, _BLUR_M) for side in every]
        fewer, new = max(tried, key=lambda one: one[1])
        if fit - new > NEEDED and len(state.angle_rad) <= MAX_SIDES:
            break
        state, fit = climbed(fewer, samples, rng, _SWEEPS, _BLUR_M)
    return state


def _with_one_more(
    state: PolygonState, samples: PolygonSamples, rng: np.random.Generator
) -> list[tuple[PolygonState, float]]:
    """Return the best polygons with one more side, which excludes fast samples inside, each with its fit."""
    depth = depths_of(state, samples).min(axis=0)
    wrong = np.flatnonzero((samples.side < 0) & (depth > 2.0 * samples.spread_m))
    wrong = wrong[:: 1 + len(wrong) // _MOST_POINTS]
    near = samples._replace(
        **{name: each[depth > -_ABOUT_M] for name, each in zip(samples._fields, samples, strict=True)}
    )
    depth = depth[depth > -_ABOUT_M]
    spread = near.side * near.spread_with(state.jitter)
    terms = terms_of(depth, spread)
    found = []
    for normal, angle in zip(normals(_ANGLES), _ANGLES, strict=True):
        for point in samples.floor_m[wrong]:
            beyond = np.minimum(depth, (point - near.floor_m) @ normal)
            found.append((float(terms_with(terms, depth, beyond, spread).sum()), float(angle), point))
    found.sort(key=lambda one: -one[0])
    more = [
        state._replace(angle_rad=np.append(state.angle_rad, angle), through_m=np.vstack([state.through_m, point]))
        for _, angle, point in found[:_TRIED]
    ]
    return [climbed(one, samples, rng, _FEW_SWEEPS, (0.0,)) for one in more]
