"""Which kind of rule explains the commanded level: the simplest that does, judged on held-out executions."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards.rule import RuleCard
from cyclekit.learning.rules.crossing_fit import by_crossings
from cyclekit.learning.rules.crossings import LAG_M, lags
from cyclekit.learning.rules.families import FAMILIES
from cyclekit.learning.rules.families.signal import SIGNALS
from cyclekit.learning.rules.fitting import few_of, fit_limits, refined
from cyclekit.learning.rules.hysteresis import with_edges_to_leave, with_even_margins, with_one_hysteresis
from cyclekit.learning.rules.intervals import with_intervals
from cyclekit.learning.rules.quantities import quantities, with_bounds, without_doubtful
from cyclekit.learning.rules.regions import followed

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.learning.rules.fitting import Limits
    from cyclekit.learning.rules.quantities import RulePlace
    from cyclekit.learning.rules.rows import RuleRows

EXPLAINS = 0.999
"""Without noise, a rule that names the level of this part of the held-out samples explains them."""
NOISY_EXPLAINS = 0.9
"""With noise, a rule that names fewer explains nothing."""
SAME, NOISE_M = 0.001, 0.003
"""With noise larger than this, rules and networks whose parts differ by less are taken as equal: the simpler is chosen;
without, by less than what a rule may leave unexplained."""
CHANCE = 2.0
"""Nor can they where the difference is less than so many standard errors over executions."""
LIKELY = 0.02
"""A distance that explains this much less than the best one by itself is not tried together with a rectangle."""
GAINS = 0.005
"""Two conditions at once must explain so much more than one."""
FAR_M, FAR_NOISE, FAR_PART = 0.05, 4.0, 0.005
"""Noise makes a rule wrong near its edges alone: within FAR_M, and so many times the noise. One that is wrong farther
off for more than this part of the held-out samples is not the rule, however many of the others it explains. Where no
rule is left, those within a standard error over executions are: labels of an inferred scaling are wrong together."""
TEST_PART = 0.2
LAGS = ", with hysteresis"


@dataclass(frozen=True)
class RuleSearch:
    """What the ladder found.

    Attributes:
        rule: The simplest rule that explains the commanded level; None where none does.
        explained: Part of the held-out samples that each kind that was fitted explains, in that order.
        network: The same of the network; None where there is none.
        rows, executions: What was looked at.
    """

    rule: RuleCard | None
    explained: Mapping[str, float] = field(default_factory=dict)
    network: float | None = None
    rows: int = 0
    executions: int = 0

    @property
    def likely(self) -> frozenset[str]:
        """The kinds that explain nearly as much as the best one, and the single conditions that these join."""
        least = max(self.explained.values(), default=1.0) - LIKELY
        best = {said.removesuffix(LAGS) for said, part in self.explained.items() if part >= least}
        joined = {FAMILIES[name].uses for name in best if FAMILIES[name].mixed}
        return frozenset(
            best | {name for name, family in FAMILIES.items() if not family.mixed and family.uses in joined}
        )

    @property
    def lags(self) -> bool:
        """Whether the kind that explains most has hysteresis."""
        return bool(self.explained) and max(self.explained, key=lambda said: self.explained[said]).endswith(LAGS)

    @property
    def clean(self) -> bool:
        """Whether the rule explains the logs as one does whose positions have no noise."""
        return self.rule is not None and self.rule.explained >= EXPLAINS


@dataclass(frozen=True)
class _Fit:
    name: str
    lag: bool
    limits: Limits
    right: NDArray[np.float64]
    far: float
    far_error: float

    @property
    def said(self) -> str:
        return f"{self.name}{LAGS}" if self.lag else self.name


def find_rule(
    rows: RuleRows,
    levels: Sequence[float],
    *,
    held_out: NDArray[np.int64] | None = None,
    network: NDArray[np.int64] | None = None,
    latency_s: float = 0.0,
    judged_apart: bool = False,
    kinds: Collection[str] = FAMILIES,
    seed: int = 0,
) -> RuleSearch:
    """Find the simplest rule that explains the commanded level.

    Args:
        rows: Of at least two executions.
        levels: Of the speed scaling, ascending.
        held_out: Numbers of the executions to judge by; None: a fifth of them, drawn by `seed`.
        network: Level that a network names in each row, shape (N,), which has not seen `held_out`; None = no network.
        latency_s: By which positions were shifted, kept in the rule.
        judged_apart: The chosen rule is not fitted again to the executions by which it was judged.
        kinds: Of rules that are looked at, by name.
        seed: Of what is drawn.
    """
    levels = tuple(levels)
    judged = drawn(rows.execution, seed) if held_out is None else held_out
    learn, judge = rows.of(np.setdiff1d(rows.execution, judged)), rows.of(judged, known=True)
    if not len(learn) or not len(judge) or len(levels) < 2:
        return RuleSearch(None, rows=len(rows))
    named = None if network is None else network[np.isin(rows.execution, judged) & rows.known]
    rival = None if named is None else _by_execution(named == judge.level, judge)
    fits: list[_Fit] = []
    tried = _tried(_Search(learn, judge, levels, few_of(learn, seed), kinds), fits)
    clean = (fit for fit in tried if judge.noise_m <= NOISE_M and _part(fit.right, judge) >= EXPLAINS and _is_wide(fit))
    best = next(clean, None)
    if best is None:
        best = _simplest(fits, judge, learn, levels, rival)
    noisy = judge.noise_m > NOISE_M or best is None or _part(best.right, judge) < EXPLAINS
    explained = {fit.said: _part(fit.right, judge) for fit in fits}
    seen = (len(rows), len(np.unique(rows.execution)))
    part = None if rival is None else _part(rival, judge)
    rule = None if best is None else _whole(best, learn if judged_apart else rows, levels, noisy=noisy, seed=seed)
    if rule is None or best is None:
        return RuleSearch(None, explained, part, *seen)
    card = RuleCard(
        family=best.name,
        hysteresis=best.lag,
        levels=levels,
        limits=rule,
        latency_s=latency_s,
        explained=explained[best.said],
        network=part,
        others={name: each for name, each in explained.items() if name != best.said},
        rows=seen[0],
        executions=seen[1],
    )
    return RuleSearch(card, explained, part, *seen)


def _is_wide(fit: _Fit) -> bool:
    """Return whether a rule with hysteresis has any to speak of: a latency that is off looks like a little."""
    values = quantities(fit.limits)
    apart = [
        abs(values[outer].value - at.value)
        for place, at in values.items()
        if (outer := place._replace(until=True)) in values and not place.until
    ]
    return not fit.lag or (bool(apart) and float(np.median(apart)) >= LAG_M)


def drawn(executions: NDArray[np.int64], seed: int) -> NDArray[np.int64]:
    """Return the numbers of the executions to judge by, of the number of the execution of each row, shape (N,)."""
    every = np.unique(executions)
    return np.random.default_rng(seed).permutation(every)[: max(1, round(TEST_PART * len(every)))]


@dataclass(frozen=True)
class _Search:
    """Rows to learn from and to judge by, how often each to learn from counts where a rule is looked for, and kinds."""

    learn: RuleRows
    judge: RuleRows
    levels: Sequence[float]
    few: NDArray[np.float64]
    kinds: Collection[str]

    def fitted(self, name: str, fits: Sequence[_Fit], *, lag: bool) -> _Fit:
        """Return a kind fitted: with hysteresis from what it is without; to all rows if it may explain the level."""
        family, asked = FAMILIES[name], (self.learn, self.levels)
        start = next((fit.limits for fit in fits if fit.name == name), None)
        limits = _evened(fit_limits(*asked, family, lag=lag, weight=self.few, start=start), *asked)
        found = self._judged(name, limits, lag=lag)
        if _part(found.right, self.judge) < NOISY_EXPLAINS or self.few.all():
            return found
        return self._judged(name, _evened(refined(limits, *asked, family, lag=lag), *asked), lag=lag)

    def _judged(self, name: str, limits: Limits, *, lag: bool) -> _Fit:
        agrees = _agrees(limits, self.levels, self.judge)
        near = _agrees(limits, self.levels, self.judge, max(FAR_M, FAR_NOISE * self.judge.noise_m))
        far = _by_execution(~near, self.judge)
        error = float(np.sqrt(len(far)) * far.std(ddof=1)) if len(far) > 1 else 0.0
        parts = (float(far.sum()) / len(self.judge), error / len(self.judge))
        return _Fit(name, lag, limits, _by_execution(agrees, self.judge), *parts)


def _tried(search: _Search, fits: list[_Fit]) -> Iterator[_Fit]:
    """Yield one kind of rule after the other, fitted; `fits` keeps them.

    Single conditions come before two of them, and without hysteresis before with it. Of two conditions at once only
    those are fitted whose distance explains much by itself, and no more of them where two explain no more than one.
    """
    judge = search.judge
    known = {*judge.apart_m, *([SIGNALS] if judge.positions.signals else [])}
    able = [name for name, family in FAMILIES.items() if set(family.uses) <= known and name in search.kinds]
    single = [name for name in able if not FAMILIES[name].mixed]
    for lag in (False, True):
        yield from _fitted(single, search, fits, lag=lag)
    likely = _likely_distances(fits, judge)
    mixed = [name for name in able if FAMILIES[name].mixed and FAMILIES[name].uses in likely]
    enough = max((_part(fit.right, judge) for fit in fits if not fit.lag), default=0.0) + GAINS
    for names in (mixed[: len(likely)], mixed[len(likely) :]):
        before = len(fits)
        yield from _fitted(names, search, fits, lag=False)
        if max((_part(fit.right, judge) for fit in fits[before:]), default=0.0) < enough:
            return
        yield from _fitted(names, search, fits, lag=True)


def _fitted(names: Sequence[str], search: _Search, fits: list[_Fit], *, lag: bool) -> Iterator[_Fit]:
    for name in names:
        if FAMILIES[name].may_lag or not lag:
            fits.append(search.fitted(name, fits, lag=lag))
            yield fits[-1]


def _evened(limits: Limits, rows: RuleRows, levels: Sequence[float]) -> Limits:
    """Return limits with every edge to leave and with even margins, where these explain no less.

    A missing edge is few samples that nobody left across: their few contradictions do not make it one that is not.
    """
    for change, less in ((with_edges_to_leave, 1.0 - EXPLAINS), (with_even_margins, 0.0)):
        other = change(limits)
        if other != limits:
            right, right_then = (float(_agrees(each, levels, rows).mean()) for each in (limits, other))
            limits = other if right_then >= right - less else limits
    return limits


def _agrees(limits: Limits, levels: Sequence[float], rows: RuleRows, least_m: float = 0.0) -> NDArray[np.bool_]:
    """Return which rows a rule explains, shape (N,), with each edge uncertain by `least_m` at least.

    Of a threshold no more is known than that it lies between the last slow and the first fast sample: a row in that gap
    speaks neither for nor against the rule.
    """
    smaller, larger = (with_bounds(limits, larger=each, least_m=least_m) for each in (False, True))
    fastest, slowest = (followed(bound, levels, rows) for bound in (smaller, larger))
    return np.asarray((slowest <= rows.level) & (rows.level <= fastest))


def _likely_distances(fits: Sequence[_Fit], judge: RuleRows) -> set[tuple[str, ...]]:
    """Return the distances that explain nearly as much as the best one does."""
    plain = [fit for fit in fits if not fit.lag and set(FAMILIES[fit.name].uses) & set(judge.apart_m)]
    parts = {fit.name: _part(fit.right, judge) for fit in plain}
    return {FAMILIES[name].uses for name, part in parts.items() if part >= max(parts.values()) - LIKELY}


def _simplest(
    fits: Sequence[_Fit], judge: RuleRows, learn: RuleRows, levels: Sequence[float], rival: NDArray[np.float64] | None
) -> _Fit | None:
    """Return the simplest rule that no other rule, nor the network, is better than beyond chance.

    Noise makes any hysteresis look useful, as it holds a level that flickers: it is believed only where the level is
    seen to rise farther out than it falls.
    """
    steps = {level: step for step, level in enumerate(levels)}
    found = [fit for fit in fits if fit.limits and fit.lag == lags(fit.limits, learn, steps)]
    sure = [fit for fit in found if fit.far <= FAR_PART]
    likely = [fit for fit in found if fit.far - fit.far_error <= FAR_PART]
    for able in (sure, likely):
        rivals = [fit.right for fit in able] + ([] if rival is None else [rival])
        for fit in able:
            explains = _part(fit.right, judge) >= NOISY_EXPLAINS
            if explains and not any(_better(other, fit.right, judge) for other in rivals):
                return fit
    return None


def _better(one: NDArray[np.float64], other: NDArray[np.float64], judge: RuleRows) -> bool:
    """Tell whether one names more levels than the other, beyond chance and by more than what is taken as equal."""
    lead = one - other
    same = SAME if judge.noise_m > NOISE_M else 1.0 - EXPLAINS
    chance = CHANCE * float(np.sqrt(len(lead)) * lead.std(ddof=1)) if len(lead) > 1 else 0.0
    return float(lead.sum()) > max(same * len(judge), chance)


def _whole(fit: _Fit, rows: RuleRows, levels: Sequence[float], *, noisy: bool, seed: int) -> Limits | None:
    """Return the chosen kind of rule fitted to all rows, with intervals, and without what these make doubtful."""
    family = FAMILIES[fit.name]
    limits = _evened(refined(fit.limits, rows, levels, family, lag=fit.lag), rows, levels)
    if not limits:
        return None
    known: Collection[RulePlace] = ()
    noise_m = rows.noise_m if noisy else 0.0
    if noisy:
        limits, known = by_crossings(limits, rows, {level: step for step, level in enumerate(levels)})
    limits = with_intervals(limits, rows, levels, family, known=known, noise_m=noise_m, seed=seed)
    return without_doubtful(with_one_hysteresis(limits, known))


def _by_execution(right: NDArray[np.bool_], rows: RuleRows) -> NDArray[np.float64]:
    """Return the number of rows that are named rightly in each execution, shape (E,)."""
    _, number = np.unique(rows.execution, return_inverse=True)
    return np.bincount(number.ravel(), right).astype(np.float64)


def _part(right: NDArray[np.float64], rows: RuleRows) -> float:
    return float(right.sum() / len(rows))
