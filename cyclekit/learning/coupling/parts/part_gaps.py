"""The gaps between parts that no signal reports, by EM over all visits of the robot, also those without a wait.

A part that the robot waited for came at a known time; any other came before the robot. A *chain* begins at a known time
(the start of an execution, or such a part) and goes on until the next one. Times are bins of a grid; the distribution
of gaps is the one under which the chains are most probable.
"""

from __future__ import annotations

from itertools import count
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.learning.coupling.subset import evenly

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.learning.coupling.events.part_visits import PartVisits, Times
    from cyclekit.schema import Bools, Floats, Ints, Vector

BIN_S, MAX_BINS = 0.25, 1024
"""Minimum width of a bin, s, and maximum number of bins: the longest chain is within them."""
MAX_CHAINS = 1000
"""Maximum number of chains to learn from."""
MAX_PARTS = 40
"""Maximum number of parts of a chain: the time of later ones is hardly known."""
ROUNDS = 30
"""Number of EM iterations."""
ANY = 1e-6
"""Initial mass of each bin, besides that of the observed times."""
_TINY = 1e-300


class _Chains(NamedTuple):
    """Chains of parts; bins since the begin of each, shape (C, J), by chain and part.

    Attributes:
        of_start: Whether a chain begins with its execution, shape (C,).
        low, high: First and last bin in which the part may have come; the same where the robot waited for it.
        room: Bin from which there is room for the part.
        there: Whether the chain has so many parts.
    """

    of_start: Bools
    low: Ints
    high: Ints
    room: Ints
    there: Bools


class _Part(NamedTuple):
    """A part of a chain, s since its begin: earliest and latest arrival, and when there was room for it."""

    of_start: bool
    earliest_s: float
    latest_s: float
    room_s: float


def part_gaps(visits: PartVisits, first: Times | None, gaps: Times, buffer: int) -> tuple[Vector, Vector, Vector]:
    """Return times, s, and the probability that the first part of an execution comes then, and the next one, (N,) each.

    Args:
        visits: Visits of the robot to the place of the parts.
        first: What the first parts of executions tell alone; the estimate starts from it. None: these visits follow a
            part themselves (`part_chains`), so the first gap is like the others.
        gaps: The same of parts after those that the robot waited for.
        buffer: Maximum number of waiting parts.
    """
    rows = [chain[:MAX_PARTS] for chain in _rows(visits, buffer)]
    rows = [rows[number] for number in evenly(len(rows), MAX_CHAINS)]
    longest_s = max(part.latest_s for chain in rows for part in chain)
    bin_s = max(BIN_S, longest_s / (MAX_BINS - 2))
    chains, bins = _chains(rows, bin_s), int(longest_s / bin_s) + 2
    if first is None:
        chains = chains._replace(of_start=np.zeros_like(chains.of_start))
    laws: Floats = np.array([_on_grid(each, bin_s, bins) for each in (first or gaps, gaps)])
    for _ in range(ROUNDS):
        expected = _expected(chains, laws)
        laws = np.asarray(expected / np.maximum(expected.sum(axis=1, keepdims=True), _TINY))
    return np.asarray(np.arange(bins) * bin_s), np.asarray(laws[0]), np.asarray(laws[1])


def _rows(visits: PartVisits, buffer: int) -> list[list[_Part]]:
    """Return the chains of all executions."""
    latest_s, found = np.fmax(visits.came, visits.left - visits.own_s), list[list[_Part]]()
    for left_s, latest, waited in zip(visits.left, latest_s, visits.waited, strict=True):
        begin_s, chain = 0.0, list[_Part]()
        for number in np.flatnonzero(np.isfinite(left_s)):
            room_s = left_s[number - buffer] if number >= buffer else begin_s
            earliest_s = latest[number] if waited[number] else begin_s
            chain.append(_Part(begin_s == 0.0, *(at - begin_s for at in (earliest_s, latest[number], room_s))))
            if waited[number]:
                found.append(chain)
                begin_s, chain = latest[number], []
        found += [chain] if chain else []
    return found


def _chains(rows: Sequence[Sequence[_Part]], bin_s: float) -> _Chains:
    shape = len(rows), max(map(len, rows))
    low, high, room = np.zeros((3, *shape), np.int64)
    there = np.zeros(shape, np.bool_)
    for n, chain in enumerate(rows):
        _, earliest, latest, free = np.array(chain).T / bin_s
        known, some = earliest == latest, slice(len(chain))
        high[n, some] = np.where(known, np.round(latest), np.floor(latest))
        low[n, some] = np.where(known, high[n, some], 0)
        room[n, some] = np.clip(np.ceil(free), 0, high[n, some])
        there[n, some] = True
    return _Chains(np.array([chain[0].of_start for chain in rows]), low, high, room, there)


def _on_grid(times: Times, bin_s: float, bins: int) -> Vector:
    """Return the mass of each bin, shape (bins,); what is shorter than all observed times is spread over these."""
    found, at = np.full(bins, ANY), np.minimum(np.round(times.at / bin_s).astype(np.int64), bins - 1)
    np.add.at(found, at, times.mass)
    shortest = int(at[times.mass > 0.0].min())
    found[: shortest + 1] += max(0.0, 1.0 - float(times.mass.sum())) / (shortest + 1)
    return np.asarray(found / found.sum())


def _expected(chains: _Chains, laws: Floats) -> Floats:
    """Return the expected number of gaps in each bin, shape (2, bins): to first parts, and between parts."""
    bins, law = np.arange(laws.shape[1]), laws[np.where(chains.of_start, 0, 1)]
    size = _fast(2 * len(bins))  # no wrap-around
    of_gaps = np.fft.rfft(laws[1], size)
    before: list[Floats] = []
    scale: list[Floats] = []
    for part in range(chains.there.shape[1]):
        some = chains.there[:, part]
        mass = (
            law
            if not part
            else np.fft.irfft(np.fft.rfft(before[-1][some[chains.there[:, part - 1]]], size) * of_gaps, size)
        )
        mass = np.maximum(mass[:, : len(bins)], 0.0)
        mass = _not_before(mass, chains.room[some, part]) * _seen(chains, part, bins)
        scale.append(np.maximum(mass.sum(axis=1, keepdims=True), _TINY))
        before.append(mass / scale[-1])
    found, after = np.zeros_like(laws), np.ones((0, len(bins)))
    for part in reversed(range(chains.there.shape[1])):
        some = chains.there[:, part]
        ahead = np.ones((np.count_nonzero(some), len(bins)))
        if part + 1 < chains.there.shape[1]:
            ahead[chains.there[some, part + 1]] = after
        ahead *= _seen(chains, part, bins) / scale[part]
        room = chains.room[some, part][:, None]
        ahead = np.where(bins < room, np.take_along_axis(ahead, room, 1), ahead)
        if not part:
            for n, mine in enumerate((chains.of_start, ~chains.of_start)):
                found[n] += (laws[n] * ahead[mine]).sum(axis=0)
            break
        later = np.fft.rfft(ahead, size)
        start = np.fft.rfft(before[part - 1][some[chains.there[:, part - 1]]], size)
        found[1] += laws[1] * np.maximum(np.fft.irfft(np.conj(start) * later, size)[:, : len(bins)], 0.0).sum(axis=0)
        after = np.maximum(np.fft.irfft(np.conj(of_gaps) * later, size)[:, : len(bins)], 0.0)
    return found


def _fast(least: int) -> int:
    """Return the next size with factors 2, 3 and 5 alone, up to 4096: an FFT of another one is several times slower."""
    return next(size for size in count(least) if 30**12 % size == 0)


def _not_before(mass: Floats, room: Ints) -> Floats:
    """Return mass with that of earlier bins moved to the bin from which there is room, shape (C, bins)."""
    bins, at = np.arange(mass.shape[1]), room[:, None]
    found = np.where(bins < at, 0.0, mass)
    np.put_along_axis(found, at, np.take_along_axis(np.cumsum(mass, axis=1), at, 1), 1)
    return found


def _seen(chains: _Chains, part: int, bins: Ints) -> Bools:
    """Return the bins in which a part may have come, shape (C, bins), of the chains that have so many."""
    some = chains.there[:, part]
    return np.asarray((bins >= chains.low[some, part, None]) & (bins <= chains.high[some, part, None]))
