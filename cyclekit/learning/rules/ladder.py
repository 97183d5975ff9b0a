"""Selects the simplest kind of rule that explains the commanded level on held-out executions."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards.rule import RuleCard
from cyclekit.learning.rules.edges.brackets import CLEAR_M, bracketed
from cyclekit.learning.rules.edges.crossing_fit import by_crossings, enough_changes
from cyclekit.learning.rules.edges.crossings import LAG_M, lags
from cyclekit.learning.rules.edges.hysteresis import with_edges_to_leave, with_even_margins, with_one_hysteresis
from cyclekit.learning.rules.families import FAMILIES
from cyclekit.learning.rules.families.signal import SIGNALS
from cyclekit.learning.rules.fitting import few_of, fit_limits, refined
from cyclekit.learning.rules.intervals import with_intervals
from cyclekit.learning.rules.polygons.polygon_mean import mean_polygons
from cyclekit.learning.rules.samples.quantities import quantities, with_bounds, without_doubtful
from cyclekit.learning.rules.samples.regions import followed

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.learning.rules.fitting import Limits
    from cyclekit.learning.rules.samples.quantities import RulePlace
    from cyclekit.learning.rules.samples.rows import RuleRows

EXPLAINS = 0.999
"""Without noise: minimum share of held-out samples whose level a rule must predict."""
NOISY_EXPLAINS = 0.9
"""With noise: minimum share of held-out samples whose level a rule must predict."""
SAME, NOISE_M = 0.001, 0.003
"""Tolerance in explained share within which rules and networks count as equal, and the noise, m, above which it
applies; below, the tolerance is what a rule may leave unexplained."""
CHANCE = 2.0
"""Standard errors over executions that a difference in explained share must exceed."""
LIKELY = 0.02
"""Maximum deficit in explained share, against the best distance, at which a distance is combined with a rectangle."""
GAINS = 0.005
"""Minimum gain in explained share of two conditions over one."""
FAR_M, FAR_NOISE, FAR_PART = 0.05, 4.0, 0.005
"""Noise causes errors only near edges: within FAR_M, or FAR_NOISE times the noise if larger. A rule is rejected if its
errors farther away exceed the share FAR_PART of the held-out samples. If no rule remains, those within one standard
error over executions are accepted, because label errors of an inferred scaling are correlated."""
FEWER = 0.5
"""Maximum ratio of a rule's errors to the network's at which the rule answers although it was rejected: it does not
explain everything, for example where people are hidden, but the network explains even less."""
TEST_PART = 0.2
"""Share of executions held out for the comparison."""
LAGS = ", with hysteresis"


@dataclass(frozen=True)
class RuleSearch:
    """Result of the search for a rule.

    Attributes:
        rule: The simplest rule that explains the commanded level; None if there is none.
        explained: Share of held-out samples that each fitted kind explains, in order of fitting.
        network: The same share for the network; None without a network.
        rows, executions: Number of samples and executions used.
    """

    rule: RuleCard | None
    explained: Mapping[str, float] = field(default_factory=dict)
    network: float | None = None
    rows: int = 0
    executions: int = 0

    @property
    def likely(self) -> frozenset[str]:
        """Kinds that explain nearly as much as the best one, and the single conditions that they combine."""
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
        """Whether the rule explains at least the share EXPLAINS, as expected without position noise."""
        return self.rule is not None and self.rule.explained >= EXPLAINS


@dataclass(frozen=True)
class _Fit:
    name: str
    lag: bool
    limits: Limits
    correct: NDArray[np.float64]
    far_share: float
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
    keep_held_out: bool = False,
    kinds: Collection[str] = FAMILIES,
    seed: int = 0,
) -> RuleSearch:
    """Find the simplest rule that explains the commanded level.

    Args:
        rows: Samples of at least two executions.
        levels: Levels of the speed scaling, ascending.
        held_out: Numbers of the executions for the comparison; None: a fifth of them, drawn with `seed`.
        network: Level predicted by a network that has not seen `held_out`, shape (N,); None = no network.
        latency_s: Time by which positions were shifted, s; stored in the rule.
        keep_held_out: Do not fit the chosen rule again with the held-out executions.
        kinds: Names of the kinds of rules to try.
        seed: Seed of random draws.
    """
    levels = tuple(levels)
    judged = held_out_sample(rows.execution, seed) if held_out is None else held_out
    learn, judge = rows.of(np.setdiff1d(rows.execution, judged)), rows.of(judged, known=True)
    if not len(learn) or not len(judge) or len(levels) < 2:
        return RuleSearch(None, rows=len(rows))
    named = None if network is None else network[np.isin(rows.execution, judged) & rows.known]
    rival = None if named is None else _by_execution(named == judge.level, judge)
    fits: list[_Fit] = []
    tried = _tried(_Search(learn, judge, levels, few_of(learn, seed), kinds), fits)
    clean = (
        fit for fit in tried if judge.noise_m <= NOISE_M and _part(fit.correct, judge) >= EXPLAINS and _is_wide(fit)
    )
    best = next(clean, None)
    if best is None:
        best = _simplest(fits, judge, learn, levels, rival)
    noisy = judge.noise_m > NOISE_M or best is None or _part(best.correct, judge) < EXPLAINS
    explained = {fit.said: _part(fit.correct, judge) for fit in fits}
    seen = (len(rows), len(np.unique(rows.execution)))
    part = None if rival is None else _part(rival, judge)
    rule = None if best is None else _whole(best, learn if keep_held_out else rows, levels, noisy=noisy, seed=seed)
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
    """Return whether the hysteresis of a rule, if any, is large enough: a wrong latency looks like a small one."""
    values = quantities(fit.limits)
    apart = [
        abs(values[outer].value - at.value)
        for place, at in values.items()
        if (outer := place._replace(until=True)) in values and not place.until
    ]
    return not fit.lag or (bool(apart) and float(np.median(apart)) >= LAG_M)


def held_out_sample(executions: NDArray[np.int64], seed: int) -> NDArray[np.int64]:
    """Return the numbers of randomly held-out executions, given the execution of each row, shape (N,)."""
    every = np.unique(executions)
    return np.random.default_rng(seed).permutation(every)[: max(1, round(TEST_PART * len(every)))]


@dataclass(frozen=True)
class _Search:
    """Rows to fit to and to compare on, weight of each row in the coarse search, and kinds to try."""

    learn: RuleRows
    judge: RuleRows
    levels: Sequence[float]
    few: NDArray[np.float64]
    kinds: Collection[str]

    def fitted(self, name: str, fits: Sequence[_Fit], *, lag: bool) -> _Fit:
        """Return one kind fitted: with hysteresis starting from the fit without; to all rows if it is promising."""
        family, asked = FAMILIES[name], (self.learn, self.levels)
        start = next((fit.limits for fit in fits if fit.name == name), None)
        limits = _evened(fit_limits(*asked, family, lag=lag, weight=self.few, start=start), *asked)
        found = self._judged(name, limits, lag=lag)
        if _part(found.correct, self.judge) < NOISY_EXPLAINS or self.few.all():
            return found
        return self._judged(name, _evened(refined(limits, *asked, family, lag=lag), *asked), lag=lag)

    def _judged(self, name: str, limits: Limits, *, lag: bool) -> _Fit:
        agrees = _agrees(limits, self.levels, self.judge)
        near = _agrees(limits, self.levels, self.judge, max(FAR_M, FAR_NOISE * self.judge.noise_m))
        far_errors = _by_execution(~near, self.judge)
        error = float(np.sqrt(len(far_errors)) * far_errors.std(ddof=1)) if len(far_errors) > 1 else 0.0
        parts = (float(far_errors.sum()) / len(self.judge), error / len(self.judge))
        return _Fit(name, lag, limits, _by_execution(agrees, self.judge), *parts)


def _tried(search: _Search, fits: list[_Fit]) -> Iterator[_Fit]:
    """Yield the fits of one kind of rule after the other; `fits` collects them.

    Single conditions come before combinations, and fits without hysteresis before those with. A combination is fitted
    only if its distance alone explains much, and the rest only if combinations so far explain more than single
    conditions.
    """
    judge = search.judge
    known = {*judge.apart_m, *([SIGNALS] if judge.positions.signals else [])}
    able = [name for name, family in FAMILIES.items() if set(family.uses) <= known and name in search.kinds]
    single = [name for name in able if not FAMILIES[name].mixed]
    for lag in (False, True):
        yield from _fitted(single, search, fits, lag=lag)
    likely = _likely_distances(fits, judge)
    mixed = [name for name in able if FAMILIES[name].mixed and FAMILIES[name].uses in likely]
    enough = max((_part(fit.correct, judge) for fit in fits if not fit.lag), default=0.0) + GAINS
    for names in (mixed[: len(likely)], mixed[len(likely) :]):
        before = len(fits)
        yield from _fitted(names, search, fits, lag=False)
        if max((_part(fit.correct, judge) for fit in fits[before:]), default=0.0) < enough:
            return
        yield from _fitted(names, search, fits, lag=True)


def _fitted(names: Sequence[str], search: _Search, fits: list[_Fit], *, lag: bool) -> Iterator[_Fit]:
    for name in names:
        if FAMILIES[name].may_lag or not lag:
            fits.append(search.fitted(name, fits, lag=lag))
            yield fits[-1]


def _evened(limits: Limits, rows: RuleRows, levels: Sequence[float]) -> Limits:
    """Return limits with all edges to leave and with even margins, if these explain as much.

    An edge to leave is missing if hardly any samples cross it; a few contradicting samples do not prove that there is
    none.
    """
    for change, less in ((with_edges_to_leave, 1.0 - EXPLAINS), (with_even_margins, 0.0)):
        other = change(limits)
        if other != limits:
            correct, correct_then = (float(_agrees(each, levels, rows).mean()) for each in (limits, other))
            limits = other if correct_then >= correct - less else limits
    return limits


def _agrees(limits: Limits, levels: Sequence[float], rows: RuleRows, least_m: float = 0.0) -> NDArray[np.bool_]:
    """Return which rows a rule explains, shape (N,), with each edge uncertain by at least `least_m`.

    A threshold is only known to lie between the last slow and the first fast sample: a row in this gap counts as
    explained.
    """
    smaller, larger = (with_bounds(limits, larger=each, least_m=least_m) for each in (False, True))
    fastest, slowest = (followed(bound, levels, rows) for bound in (smaller, larger))
    return np.asarray((slowest <= rows.level) & (rows.level <= fastest))


def _likely_distances(fits: Sequence[_Fit], judge: RuleRows) -> set[tuple[str, ...]]:
    """Return the distances that explain nearly as much as the best one."""
    plain = [fit for fit in fits if not fit.lag and set(FAMILIES[fit.name].uses) & set(judge.apart_m)]
    parts = {fit.name: _part(fit.correct, judge) for fit in plain}
    return {FAMILIES[name].uses for name, part in parts.items() if part >= max(parts.values()) - LIKELY}


def _simplest(
    fits: Sequence[_Fit], judge: RuleRows, learn: RuleRows, levels: Sequence[float], rival: NDArray[np.float64] | None
) -> _Fit | None:
    """Return the simplest rule that no other rule, and not the network, beats by more than chance.

    If all are rejected, but the network is wrong far more often than one of them, that one answers. With noise, any
    hysteresis seems useful because it stabilises a flickering level. It is accepted only if the level measurably rises
    farther out than it falls.
    """
    steps = {level: step for step, level in enumerate(levels)}
    found = [fit for fit in fits if fit.limits and fit.lag == lags(fit.limits, learn, steps)]
    sure = [fit for fit in found if fit.far_share <= FAR_PART]
    likely = [fit for fit in found if fit.far_share - fit.far_error <= FAR_PART]
    for able in (sure, likely):
        rivals = [fit.correct for fit in able] + ([] if rival is None else [rival])
        for fit in able:
            explains = _part(fit.correct, judge) >= NOISY_EXPLAINS
            if explains and not any(_better(other, fit.correct, judge) for other in rivals):
                return fit
    return None if rival is None else _least_wrong(found, judge, rival)


def _least_wrong(fits: Sequence[_Fit], judge: RuleRows, rival: NDArray[np.float64]) -> _Fit | None:
    """Return the simplest rule that no other one beats by more than chance, if the network is wrong far more often."""
    wrong = FEWER * (1.0 - _part(rival, judge))
    able = [fit for fit in fits if 1.0 - _part(fit.correct, judge) <= min(wrong, 1.0 - NOISY_EXPLAINS)]
    able = [fit for fit in able if _better(fit.correct, rival, judge)]
    return next((fit for fit in able if not any(_better(one.correct, fit.correct, judge) for one in able)), None)


def _better(one: NDArray[np.float64], other: NDArray[np.float64], judge: RuleRows) -> bool:
    """Return whether `one` predicts more levels than `other`, by more than chance and tolerance."""
    lead = one - other
    same = SAME if judge.noise_m > NOISE_M else 1.0 - EXPLAINS
    chance = CHANCE * float(np.sqrt(len(lead)) * lead.std(ddof=1)) if len(lead) > 1 else 0.0
    return float(lead.sum()) > max(same * len(judge), chance)


def _whole(fit: _Fit, rows: RuleRows, levels: Sequence[float], *, noisy: bool, seed: int) -> Limits | None:
    """Return the chosen kind fitted to all rows, with intervals, without the parts that these make doubtful."""
    family = FAMILIES[fit.name]
    limits = _evened(refined(fit.limits, rows, levels, family, lag=fit.lag), rows, levels)
    if not limits:
        return None
    steps = {level: step for step, level in enumerate(levels)}
    known: frozenset[RulePlace] = frozenset()
    noise_m = rows.noise_m if noisy else 0.0
    if noisy:
        limits, known = by_crossings(limits, rows, steps)
    limits, sides = mean_polygons(limits, rows, steps, seed=seed)
    often = known if noisy else enough_changes(limits, rows, steps, CLEAR_M).keys()
    seldom = quantities(limits).keys() - often - sides
    limits, placed = bracketed(limits, rows, steps, seldom)
    known |= sides
    limits = with_intervals(limits, rows, levels, family, known=known | placed, noise_m=noise_m, seed=seed)
    return without_doubtful(with_one_hysteresis(limits, known))


def _by_execution(correct: NDArray[np.bool_], rows: RuleRows) -> NDArray[np.float64]:
    """Return the number of correct rows in each execution, shape (E,)."""
    _, number = np.unique(rows.execution, return_inverse=True)
    return np.bincount(number.ravel(), correct).astype(np.float64)


def _part(correct: NDArray[np.float64], rows: RuleRows) -> float:
    return float(correct.sum() / len(rows))
