"""Fits rules on signals that detect people, for cells without a tracker.

A level applies while any of its signals is on; each signal counts everywhere, or while the TCP is in a rectangle.
Signals are added to a level while they explain more samples; edges of rectangles that explain almost nothing are
removed, so a field that counts everywhere has no rectangle.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs

from cyclekit.dataset.cards.rule import MetresCard, RectangleCard, RegionCard, RuleCard, SignalCard
from cyclekit.dataset.time_grid import stretches
from cyclekit.learning.labelling import commanded_in_time, without_slider
from cyclekit.learning.rules.cuts import best_box, without_idle_edges
from cyclekit.learning.rules.families.family import Family
from cyclekit.learning.rules.fitting import fit_limits
from cyclekit.learning.rules.ladder import NOISY_EXPLAINS, RuleSearch, held_out_sample
from cyclekit.learning.rules.safety import values_of_bits
from cyclekit.learning.rules.samples.regions import followed, inside, turned
from cyclekit.learning.rules.samples.rows import RuleRows
from cyclekit.learning.signal_inputs import as_inputs

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.learning.rules.cuts import LimitRows
    from cyclekit.schema import Bools, Ints

KIND = "table of signals"
SURE_S = 0.03
"""Uncertainty of delays, s: this close to a change of the level the commanded level is unknown."""
FEW_ROWS, GAIN = 5.0, 1e-3
"""Minimum gain of a signal, or of an edge of its rectangle: in rows, and as a share of the rows."""
MAX_SIGNALS = 8
MARGIN = 0.005
"""Maximum deficit of the rule, in share of held-out levels, against the network."""


def rows_by_signals(dataset: Dataset, executions: Sequence[str], levels: Sequence[float]) -> RuleRows:
    """Return the rows to which a rule on signals is fitted: signals, TCP positions and commanded levels.

    Args:
        dataset: Dataset whose signals detect people.
        executions: Names of the executions to use.
        levels: Levels of the speed scaling, ascending.
    """
    frame, _ = without_slider(dataset, dataset.samples(list(executions)))
    bits = frame["human_signals"].fill_null(0).to_numpy()
    level = commanded_in_time(
        dataset, frame, levels, dataset.card.dynamics, sure_s=SURE_S, people=bits.astype(np.int64)
    )
    robot_m = frame.select("robot_x_m", "robot_y_m", "robot_z_m").fill_null(float("nan")).to_numpy()
    level[frame["human_signals"].is_null().to_numpy() | np.isnan(robot_m[:, 0])] = -1
    order = {name: number for number, name in enumerate(executions)}
    number = frame["execution"].replace_strict(order).cast(int).to_numpy()
    named = dataset.card.operator_signals
    return RuleRows.made(
        robot_m,
        as_inputs(bits, len(named)),
        level,
        number,
        stretch=stretches(frame, dataset.rate_hz),
        signals=values_of_bits(named, bits),
    )


def find_fields(
    rows: RuleRows,
    levels: Sequence[float],
    *,
    held_out: Ints | None = None,
    network: Ints | None = None,
    latency_s: float = 0.0,
    keep_held_out: bool = False,
    seed: int = 0,
) -> RuleSearch:
    """Return the rule on signals that explains the level; arguments as of `ladder.find_rule`."""
    levels = tuple(levels)
    judged = held_out_sample(rows.execution, seed) if held_out is None else held_out
    learn, judge = rows.of(np.setdiff1d(rows.execution, judged)), rows.of(judged)
    if not len(learn) or not len(judge) or len(levels) < 2:
        return RuleSearch(None, rows=len(rows))
    limits = fit_limits(learn, levels, FIELDS, lag=False)
    explained = float((followed(limits, levels, judge) == judge.level).mean())
    rival = None if network is None else float((network[np.isin(rows.execution, judged)] == judge.level).mean())
    seen = (len(rows), len(np.unique(rows.execution)))
    if not limits or explained < max(NOISY_EXPLAINS, (rival or 0.0) - MARGIN):
        return RuleSearch(None, {KIND: explained}, rival, *seen)
    limits = limits if keep_held_out else fit_limits(rows, levels, FIELDS, lag=False)
    card = RuleCard(
        family=KIND,
        levels=levels,
        limits=limits,
        latency_s=latency_s,
        explained=explained,
        network=rival,
        rows=seen[0],
        executions=seen[1],
    )
    return RuleSearch(card, {KIND: explained}, rival, *seen)


def _fit(rows: LimitRows, start: RegionCard | None) -> RegionCard:
    """Return the signals, each with its rectangle of the TCP, that explain best which rows are slow."""
    del start
    region, wrong = RegionCard(), rows.wrong(RegionCard())
    least = max(FEW_ROWS, GAIN * float(rows.weight.sum()))
    while len(region.signals) < MAX_SIGNALS:
        covered = inside(region, rows.positions)
        used = {one.signal for one in region.signals}
        tried = [
            structs.replace(region, signals=(*region.signals, one))
            for name, _ in rows.positions.signals
            if name not in used
            for one in _with_place(name, rows, ~covered)
        ]
        best = min(tried, key=rows.wrong, default=region)
        if rows.wrong(best) > wrong - least:
            return region
        region, wrong = best, rows.wrong(best)
    return region


def _with_place(name: str, rows: LimitRows, left: Bools) -> list[SignalCard]:
    """Return a signal that counts everywhere, and one with the rectangle of the TCP that fits the remaining rows best.

    Empty if the signal is never on there.
    """
    values = rows.positions.signals[name, 0.0]
    on = (values != "") & left
    if not on.any():
        return []
    everywhere = SignalCard(signal=name, value=str(values[on][0]))
    found = best_box(turned(rows.positions.tcp_m, 0.0), rows.slow, rows.weight * on)
    if found is None:
        return [everywhere]
    along, across = ((_middle(low), _middle(high)) for low, high in found)
    boxed = structs.replace(everywhere, robot=RectangleCard(along=along, across=across))
    there = rows.where(left)
    least = max(FEW_ROWS, GAIN * float(there.weight.sum()))
    return [everywhere, without_idle_edges(boxed, lambda one: there.wrong(RegionCard(signals=(one,))), least)]


def _middle(edge: MetresCard | None) -> MetresCard | None:
    """Return an edge without bounds: the gap between samples around it is no confidence interval."""
    return None if edge is None else MetresCard(value=edge.value)


FIELDS = Family(_fit, may_lag=False)
