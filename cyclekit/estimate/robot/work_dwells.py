"""Standstills that depend on the work of the execution: products with different process times at the same place.

A cell may run several programs over the same places, each with its own process times. The standstills of all executions
together then fit none of them. So each place is tested: do they differ between executions of different work by more
than chance (`rank_test`), and by enough to matter? Where they do, an order takes the standstills of executions of its
own work; elsewhere nothing changes.

Where so few executions of each work were logged that no difference of theirs could be shown, the place is left open: an
order takes the standstills of all, and its intervals cover those of each work.

Products may also share all their places and visits. Then the standstills themselves show them: they fall into a few
clear kinds, each executions of one product. An order of which enough executions were logged, all of one kind, takes
that kind. For others nothing tells which kind it is.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import polars as pl

from cyclekit.estimate.statistics.same_work import Work, work_of
from cyclekit.learning.censored import whole_rows
from cyclekit.segmentation.rank_test import by_chance
from cyclekit.text.numbers import fixed

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Ints, Vector


class StandstillKind(NamedTuple):
    """Executions with standstills of one length at a place, which neither work nor way there explains.

    `few`: they are of one work, and too few to show whether it explains them.
    """

    executions: int
    number: int
    few: bool = False


Group = Work | frozenset[str] | tuple[str, ...] | StandstillKind
"""What executions are grouped by: their work; their different places, if more have these in common; or their order of
places, if all have the same work. If none of these tells the standstills apart: these themselves."""

MIN_EXECUTIONS = 5
"""Minimum number of executions of a group, and of repetitions of a task in it."""
CHANCE = 0.01
"""Maximum probability that chance makes any place differ."""
APART_S, APART = 0.2, 0.1
"""Minimum difference between medians of groups, s and as a share of the standstill."""
FEW, LEFT, TIGHT = 0.1, 0.05, 0.25
"""Kinds of standstills: minimum share of the executions in each; maximum share in none; and maximum spread (10 to 90 %)
of each, as a share of the distance to the next. Waits scatter more."""
SURE, BATCHES = 3, 2.6
"""Minimum number of executions of an order, all of one kind, for this kind to be the order's, and of a work whose
standstills the intervals of others cover; and standard deviations
by which kinds change less often than by chance if they come in batches."""


NOTHING_TELLS = "and no logged place or visit tells which"


@dataclass(frozen=True)
class Standstills:
    """Standstills at a goal in one group: mean process time and wait, s; dwell + wait, ascending, shape (N,), s."""

    dwell_s: float
    wait_s: float
    standstill_s: Vector

    @property
    def mean_s(self) -> float:
        """Mean standstill, s."""
        return self.dwell_s + self.wait_s


def groups_of(places: Sequence[str]) -> tuple[Group, ...]:
    """Return the groups to which a cycle through these places may belong: its work, its places, and its order."""
    return work_of(places), frozenset(places), tuple(places)


def key_of(group: Group) -> str:
    """Return a text that differs between groups and does not depend on the hash of a name."""
    return repr(sorted(group)) if isinstance(group, frozenset) else repr(group)


def standstills_by_work(dataset: Dataset) -> dict[str, dict[Group, Standstills]]:
    """Return the standstills per group of each task whose goal has other ones in other groups, by task name.

    A task with fewer than MIN_EXECUTIONS repetitions in a group has the group's standstills at its goal.
    """
    rows, groups = _grouped(dataset)
    shown = _differing(rows)
    found = _by_group(rows, dict.fromkeys(shown, MIN_EXECUTIONS), lambda number, _: groups[number])
    found = found or _by_kind(dataset, rows)
    unknown = [place for place in _differing(rows, least=SURE, shown=False) if place not in shown]
    few = _by_group(rows, dict.fromkeys(unknown, SURE), lambda number, count: StandstillKind(count, number, few=True))
    return few | found


def _by_group(
    rows: pl.DataFrame, least: Mapping[str, int], group_of: Callable[[int, int], Group]
) -> dict[str, dict[Group, Standstills]]:
    """Return the standstills per group of each task to places, by its name.

    Args:
        rows: Tasks with the number of their group.
        least: Minimum number of executions of a group, by place.
        group_of: The group of a number and its number of executions.
    """
    found: dict[str, dict[Group, Standstills]] = {}
    for place, count in least.items():
        there = rows.filter(pl.col("goal_place") == place)
        for (number,), mine in there.group_by(["group"], maintain_order=True):
            if (executions := mine["execution"].n_unique()) < count:
                continue
            group = group_of(int(str(number)), executions)
            for task in there["task"].unique(maintain_order=True):
                own = mine.filter(pl.col("task") == task)
                found.setdefault(task, {})[group] = standstills_in(own if own.height >= MIN_EXECUTIONS else mine)
    return found


def either_kind(by_work: Mapping[Group, Standstills]) -> Standstills | None:
    """Return the standstills of all kinds together, whatever the way there; None if kinds are not what differs."""
    kinds = [(group.executions, stands) for group, stands in by_work.items() if isinstance(group, StandstillKind)]
    if not kinds or any(isinstance(group, StandstillKind) and group.few for group in by_work):
        return None
    every = sum(count for count, _ in kinds)
    dwell_s = sum(count * stands.dwell_s for count, stands in kinds) / every
    wait_s = sum(count * stands.wait_s for count, stands in kinds) / every
    return Standstills(dwell_s, wait_s, np.sort(np.concatenate([stands.standstill_s for _, stands in kinds])))


def of_kinds(by_work: Mapping[Group, Standstills]) -> bool:
    """Return whether no order is known to be of one of the groups."""
    return any(isinstance(group, StandstillKind) for group in by_work)


def said_of_places(by_work: Mapping[str, Mapping[Group, Standstills]]) -> list[str]:
    """Return one sentence per place whose standstills differ: shortest and longest mean, and the work of these."""
    found: dict[str, str] = {}
    for task, stands in by_work.items():
        place = task.rpartition("->")[2]
        kinds = {kind: one for kind, one in stands.items() if isinstance(kind, StandstillKind)}
        if kinds:
            lasts = " or ".join(
                f"{fixed(one.mean_s, 1)} s (in {group.executions} executions)" for group, one in kinds.items()
            )
            tells = "too few of each work to show a difference" if any(kind.few for kind in kinds) else NOTHING_TELLS
            found.setdefault(place, f"standstill at {place} is {lasts}, {tells}")
            continue
        ends = (choose(stands, key=lambda group: stands[group].mean_s) for choose in (min, max))
        said = (f"{fixed(stands[group].mean_s, 1)} s in {_shown(group)}" for group in ends)
        found.setdefault(place, f"standstill at {place} depends on the work: {', '.join(said)}")
    return list(found.values())


def _shown(group: Group) -> str:
    if isinstance(group, Work):
        return str(group)
    if isinstance(group, StandstillKind):
        return f"{group.executions} executions"
    if isinstance(group, frozenset):
        return f"cycles through {', '.join(sorted(group))}"
    return f"cycles in the order {', '.join(group)}"


def _grouped(dataset: Dataset) -> tuple[pl.DataFrame, list[Group]]:
    """Return the tasks of complete executions with the number of their group, and the groups."""
    rows = dataset.tasks().filter(pl.col("nominal_s").is_not_null() & pl.col("dwell_s").is_not_null())
    logged = set(rows["execution"])
    went = [one for one in dataset.card.executions if one.whole and len(one.places) > 1 and one.execution in logged]
    levels = list(zip(*(groups_of(one.places) for one in went), strict=True)) or [()]
    mine = max(levels, key=_repeated)
    groups = list(dict.fromkeys(mine))
    numbers = {group: number for number, group in enumerate(groups)}
    number = {one.execution: numbers[group] for one, group in zip(went, mine, strict=True)}
    rows = rows.with_columns(group=pl.col("execution").replace_strict(number, default=None, return_dtype=pl.Int64))
    return rows.drop_nulls("group"), groups


def _repeated(groups: Sequence[Group]) -> int:
    """Return the number of executions in groups of at least MIN_EXECUTIONS; 0 if there is only one such group."""
    counts = [count for count in Counter(groups).values() if count >= MIN_EXECUTIONS]
    return sum(counts) if len(counts) > 1 else 0


def _differing(rows: pl.DataFrame, by: str = "off", *, least: int = MIN_EXECUTIONS, shown: bool = True) -> list[str]:
    """Return the places whose standstills differ between groups, one value per execution, beyond chance.

    Args:
        rows: Tasks with the number of their group.
        by: `off` subtracts the median of the task, as a place that is only reached from elsewhere has no other process;
            `stand` does not, for groups that differ in their process elsewhere.
        least: Minimum number of executions of a group.
        shown: False: instead, those that differ, where so few executions could show no difference, and most are of
            such groups: a cell of a few products.
    """
    stand = pl.col("dwell_s") + pl.col("wait_s").fill_null(0.0)
    each = rows.with_columns(stand=stand).with_columns(off=pl.col("stand") - pl.col("stand").median().over("task"))
    per = each.group_by("goal_place", "group", "execution", maintain_order=True).agg(pl.col("stand", "off").median())
    often = pl.len().over("goal_place", "group") >= least
    per = per.filter(often & (pl.lit(shown) | (2 * often.sum().over("goal_place") > pl.len().over("goal_place"))))
    per = per.filter(pl.col("group").n_unique().over("goal_place") > 1)
    places = per.partition_by("goal_place", maintain_order=True)
    found = []
    for mine in places:
        medians = mine.group_by("group").agg(pl.col(by).median())[by].to_numpy()
        apart = max(APART_S, APART * float(np.median(mine["stand"].to_numpy())))
        if np.ptp(medians) <= apart:
            continue
        mine = mine.sort("group")
        values = (
            mine[by].to_numpy() if shown else np.arange(mine.height, dtype=np.float64)
        )  # as different as so many can be
        chance = by_chance(values, mine["group"].to_numpy())
        if (chance * len(places) < CHANCE) == shown:
            found.append(str(mine["goal_place"][0]))
    return found


def _by_kind(dataset: Dataset, rows: pl.DataFrame) -> dict[str, dict[Group, Standstills]]:
    """Return the standstills per kind, and per order that is of one kind, of each task to a place with kinds.

    The kinds of one place are also those of all other places whose standstills differ between them.
    """
    orders = {one.execution: tuple(one.places) for one in dataset.card.executions}
    rows = rows.with_columns(stand=pl.col("dwell_s") + pl.col("wait_s").fill_null(0.0))
    found: dict[str, dict[Group, Standstills]] = {}
    for place in rows["goal_place"].unique(maintain_order=True):
        there = rows.filter(pl.col("goal_place") == place)
        if there["task"].is_in(list(found)).any() or not (of := _kind_of_executions(there, orders)):
            continue
        number = pl.col("execution").replace_strict(of, default=None, return_dtype=pl.Int64)
        grouped = rows.with_columns(group=number).drop_nulls("group")
        pure = _of_one_kind(of, orders)
        for mine in {place, *_differing(grouped, by="stand")}:
            of_kind = grouped.filter(pl.col("goal_place") == mine).partition_by("group", as_dict=True)
            stands = {kind: standstills_in(some) for (kind,), some in sorted(of_kind.items())}
            groups: dict[Group, Standstills] = {
                StandstillKind(sum(1 for one in of.values() if one == kind), kind): one for kind, one in stands.items()
            }
            groups |= {order: stands[kind] for order, kind in pure.items() if kind in stands}
            tasks = rows.filter(pl.col("goal_place") == mine)["task"].unique(maintain_order=True)
            found |= dict.fromkeys(tasks, groups)
    return found


def _kind_of_executions(there: pl.DataFrame, orders: Mapping[str, tuple[str, ...]]) -> dict[str, int]:
    """Return the kind of each execution by its standstills at one place; empty if there are none, or they tell nothing.

    They tell nothing if a signal ended them, if the way there explains them, or if they occur by chance: in any order,
    and not in batches.
    """
    if "waited_for" in there.columns and there["waited_for"].is_not_null().any():
        return {}
    each = there.group_by("execution", maintain_order=True).agg(pl.col("stand").median())
    kind = _kinds(each["stand"].to_numpy())
    if kind is None:
        return {}
    of = {name: int(number) for name, number in zip(each["execution"], kind, strict=True) if number >= 0}
    number = pl.col("execution").replace_strict(of, default=None, return_dtype=pl.Int64)
    ways = there.with_columns(kind=number).drop_nulls("kind").group_by("task").agg(pl.col("kind").n_unique())
    if (ways["kind"] == 1).all():
        return {}
    in_time = np.array([of[name] for name in orders if name in of])
    return of if _of_one_kind(of, orders) or _in_batches(in_time) else {}


def _of_one_kind(of: Mapping[str, int], orders: Mapping[str, tuple[str, ...]]) -> dict[tuple[str, ...], int]:
    """Return the kind of each order logged SURE times; empty if such orders have several kinds, or all the same.

    Where one order has several kinds by chance (a part that is scanned twice), its mean holds for other orders too.
    """
    by_order: dict[tuple[str, ...], list[int]] = {}
    for execution, number in of.items():
        by_order.setdefault(orders[execution], []).append(number)
    often = {order: mine for order, mine in by_order.items() if len(mine) >= SURE}
    pure = {order: mine[0] for order, mine in often.items() if len(set(mine)) == 1}
    share = sum(len(often[order]) for order in pure) / max(sum(map(len, often.values())), 1)
    return pure if share >= 1.0 - FEW and len(set(pure.values())) > 1 else {}


def _in_batches(kind: Ints) -> bool:
    """Return whether kinds, shape (N,), in order of time, follow themselves more often than by chance, as products do.

    Wald and Wolfowitz, Annals of Mathematical Statistics 11, 1940: the number of runs.
    """
    share = np.bincount(kind) / len(kind)
    other = float(1.0 - (share**2).sum())
    changes, steps = int((np.diff(kind) != 0).sum()), len(kind) - 1
    return changes < steps * other - BATCHES * float(np.sqrt(steps * other * (1.0 - other)))


def _kinds(stand_s: Vector) -> Ints | None:
    """Return the number of the kind of each standstill, shape (N,), from the shortest; -1 = none; None: no kinds."""
    rank = np.argsort(stand_s)
    ordered = stand_s[rank]
    cuts = np.flatnonzero(np.diff(ordered) > APART_S + APART * ordered[:-1]) + 1
    least = max(MIN_EXECUTIONS, FEW * len(ordered))
    parts = [part for part in np.split(rank, cuts) if len(part) >= least]
    if len(parts) < 2 or sum(map(len, parts)) < (1.0 - LEFT) * len(ordered):
        return None
    apart = np.diff([float(np.median(stand_s[part])) for part in parts])
    spread = [float(np.subtract(*np.quantile(stand_s[part], (0.9, 0.1)))) for part in parts]
    if any(max(near) > TIGHT * off for near, off in zip(pairwise(spread), apart.tolist(), strict=True)):
        return None
    kind = np.full(len(ordered), -1, np.int64)
    for number, part in enumerate(parts):
        kind[part] = number
    return kind


def standstills_in(rows: pl.DataFrame) -> Standstills:
    """Return the standstills of some tasks.

    What is `cut` lasted at least so long; what is then longer than all others may be the end of work, and counts as the
    longest of them.
    """
    dwell_s, wait_s = rows["dwell_s"].to_numpy(), rows["wait_s"].fill_null(0.0).to_numpy()
    stands_s, cut = dwell_s + wait_s, rows["cut"].fill_null(value=False).to_numpy()
    if not cut.all():
        longest_s = float(stands_s[~cut].max())
        row = whole_rows(np.where(cut, np.minimum(stands_s, longest_s), stands_s), cut)
        dwell_s, stands_s = np.minimum(dwell_s[row], longest_s), np.minimum(stands_s[row], longest_s)
        wait_s = stands_s - dwell_s
    return Standstills(float(dwell_s.mean()), float(wait_s.mean()), np.sort(stands_s))
