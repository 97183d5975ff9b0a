"""Finds the rule behind a dataset: reads the samples, compares kinds of rules, and compares with the network."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Protocol

import numpy as np
from msgspec import structs

from cyclekit.learning.out_of_core import rows_of as count_rows
from cyclekit.learning.out_of_core import some_executions
from cyclekit.learning.rules.families import FAMILIES
from cyclekit.learning.rules.fields import find_fields, rows_by_signals
from cyclekit.learning.rules.ladder import RuleSearch, find_rule, held_out_sample
from cyclekit.learning.rules.law.law_evidence import find_law
from cyclekit.learning.rules.law.law_rows import law_rows
from cyclekit.learning.rules.safety import distances_of
from cyclekit.learning.rules.samples.distances import TO_LINK
from cyclekit.learning.rules.samples.links import poses_of
from cyclekit.learning.rules.samples.rows import rows_of
from cyclekit.learning.signal_inputs import by_signals

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from numpy.typing import NDArray

    from cyclekit.dataset.cards import TrainingCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.learning.rules.samples.rows import RuleRows
    from cyclekit.schema import Vector

MAX_ROWS = 60_000
"""Maximum number of samples; above it, executions are drawn at random (thresholds are then known to millimetres)."""
MIN_ROWS, MIN_EXECUTIONS = 500, 3
PARTS, EQUAL = 5, 0.002
"""Number of partial latencies tried with hysteresis, and the tolerance in explained share within which the middle one
of the best is chosen."""
_BLOCK = 2048


class LevelNamer(Protocol):
    """Interface of a network to compare with: it predicts a level for each pair of positions."""

    @property
    def card(self) -> TrainingCard:
        """Training card of the network."""

    def predict(self, X: NDArray[np.float32], /) -> Vector:
        """Return the scaling, shape (N,), for rows x_r, x_h, shape (N, 6), m."""

    def steps(self, X: NDArray[np.float32], /) -> NDArray[np.int64]:
        """Return the index of the most likely level, shape (N,), for rows x_r, x_h, shape (N, 6), m."""


def rule_of(
    dataset: Dataset,
    levels: Sequence[float],
    *,
    model: LevelNamer | None = None,
    keep_held_out: bool = False,
    signals: bool = True,
    seed: int = 0,
) -> RuleSearch:
    """Find the simplest rule that explains the commanded level in a dataset.

    Args:
        dataset: Dataset with positions and a scaling.
        levels: Levels of the speed scaling, ascending.
        model: Network with the same levels, to compare with on its held-out executions.
        keep_held_out: Do not fit the rule again with the held-out executions.
        signals: Allow rules on signals; an estimate cannot evaluate these.
        seed: Seed of random draws.
    """
    names = _looked_at(dataset, seed)
    if by_signals(dataset):
        return _fields(dataset, names, levels, model, keep_held_out=keep_held_out, seed=seed)
    unseen = set(() if model is None else model.card.held_out) & set(names)
    law = law_of(dataset, model=model, keep_held_out=keep_held_out, seed=seed)
    if law is not None:
        return _with_poses(law, dataset, names)
    latency_s = float(dataset.card.dynamics.latency_s or 0.0)
    search = partial(_searched, dataset, names, unseen, levels, model)
    search = partial(search, keep_held_out=keep_held_out, seed=seed, signals=signals)
    found = search(latency_s)
    if latency_s and not found.clean:  # a latency read from the wrong distance hides the rule
        other = search(0.0)
        found = other if other.clean else found if found.rule else with_partial_latency(search, latency_s, found, other)
    return _with_poses(found, dataset, names)


def with_partial_latency(
    search: Callable[..., RuleSearch], latency_s: float, late: RuleSearch, at_once: RuleSearch
) -> RuleSearch:
    """Return the rule found with part of the latency, or with all of it if no part gives a rule with hysteresis.

    The latency is estimated without hysteresis and so absorbs some of it: a hysteresis of 0.2 m looks like 0.1 to 0.2 s
    of latency of a walking person. The part is chosen that makes a rule with hysteresis explain most.
    """
    if not late.lags and not at_once.lags:
        return late
    kinds = late.likely | at_once.likely
    parts_s = np.linspace(0.0, latency_s, PARTS + 2)[1:-1].tolist()
    tried = [(one, one.rule.explained) for part_s in parts_s if (one := search(part_s, kinds=kinds)).rule is not None]
    most = max((explained for _, explained in tried), default=0.0)
    best = [one for one, explained in tried if one.lags and explained >= most - EQUAL]
    return best[len(best) // 2] if best else late


def _fields(
    dataset: Dataset,
    names: Sequence[str],
    levels: Sequence[float],
    model: LevelNamer | None,
    *,
    keep_held_out: bool,
    seed: int,
) -> RuleSearch:
    """Return the rule on signals for a dataset whose signals detect people."""
    rows = rows_by_signals(dataset, names, levels)
    if _too_few(rows):
        return RuleSearch(None, rows=len(rows))
    judged = None if model is None else _numbers(names, model.card.held_out, rows.execution)
    return find_fields(
        rows,
        levels,
        held_out=judged,
        network=None if model is None or judged is None else _named(model, rows, levels),
        latency_s=float(dataset.card.dynamics.latency_s or 0.0),
        keep_held_out=keep_held_out,
        seed=seed,
    )


def _too_few(rows: RuleRows) -> bool:
    """Return whether there are too few rows, executions or levels to find a rule."""
    return len(rows) < MIN_ROWS or len(np.unique(rows.execution)) < MIN_EXECUTIONS or len(np.unique(rows.level)) < 2


def _with_poses(found: RuleSearch, dataset: Dataset, names: Sequence[str]) -> RuleSearch:
    """Return a rule on the nearest link with the arm's poses, so that it works without joint angles."""
    if found.rule is None or TO_LINK not in distances_of(found.rule):
        return found
    return replace(found, rule=structs.replace(found.rule, poses=poses_of(dataset, names)))


def _looked_at(dataset: Dataset, seed: int) -> list[str]:
    """Return the names of all executions, or of a random subset with at most MAX_ROWS samples."""
    names: list[str] = dataset.executions["execution"].to_list()
    if count_rows(dataset) <= MAX_ROWS:
        return names
    some = set(some_executions(dataset, names, MAX_ROWS, seed=seed))
    return [name for name in names if name in some]


def law_of(
    dataset: Dataset, *, model: LevelNamer | None = None, keep_held_out: bool = False, seed: int = 0
) -> RuleSearch | None:
    """Return the continuous law of the scaling; None if there is none.

    Args:
        dataset: Dataset with positions and a scaling.
        model: As in `rule_of`.
        keep_held_out: As in `rule_of`.
        seed: Seed of random draws.
    """
    if by_signals(dataset):
        return None
    names = _looked_at(dataset, seed)
    rows = law_rows(dataset, names)
    if rows is None or len(rows) < MIN_ROWS or len(np.unique(rows.execution)) < MIN_EXECUTIONS:
        return None
    unseen = () if model is None else model.card.held_out
    judged = _numbers(names, unseen, rows.execution)
    rival = None if judged is None else model
    judged = held_out_sample(rows.execution, seed) if judged is None else judged
    return find_law(rows, held_out=judged, network=rival, keep_held_out=keep_held_out, seed=seed)


def _searched(
    dataset: Dataset,
    names: Sequence[str],
    unseen: Collection[str],
    levels: Sequence[float],
    model: LevelNamer | None,
    latency_s: float,
    *,
    keep_held_out: bool,
    signals: bool,
    seed: int,
    kinds: Collection[str] = FAMILIES,
) -> RuleSearch:
    rows = rows_of(dataset, names, levels, latency_s=latency_s, signals=signals)
    if _too_few(rows):
        return RuleSearch(None, rows=len(rows))
    judged = _numbers(names, unseen, rows.execution)
    named = None if model is None or judged is None else _named(model, rows, levels)
    search = partial(find_rule, rows, levels, held_out=judged, network=named)
    return search(latency_s=latency_s, keep_held_out=keep_held_out, kinds=kinds, seed=seed)


def _numbers(names: Sequence[str], chosen: Collection[str], executions: NDArray[np.int64]) -> NDArray[np.int64] | None:
    """Return the numbers of the chosen executions that have rows; None for fewer than two, or for all of them."""
    found = np.intersect1d([number for number, name in enumerate(names) if name in chosen], executions)
    return found.astype(np.int64) if 2 <= len(found) < len(np.unique(executions)) else None


def _named(model: LevelNamer, rows: RuleRows, levels: Sequence[float]) -> NDArray[np.int64]:
    """Return the level that the network predicts for each row; without an operator, the level learned from the logs."""
    without = model.card.scaling_without_operator
    alone = len(levels) - 1 if without is None else int(np.abs(np.asarray(levels) - without).argmin())
    found = np.full(len(rows), alone)
    present = np.flatnonzero(rows.present)
    for first in range(0, len(present), _BLOCK):
        some = present[first : first + _BLOCK]
        found[some] = model.steps(rows.at_m[some])
    return found
