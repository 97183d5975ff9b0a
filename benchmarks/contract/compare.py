"""Hold two results of the contract against each other, and against the truth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

WORSE = 0.3
"""Growth of a row's mean error that is reported, points of per cent: about the chance of a row."""
WORSE_ON_AVERAGE = 0.05
"""Growth of the mean over all common rows that is reported, points of per cent."""
COVERED = (0.86, 0.94)
"""Least and largest share of fresh executions in the 90 % ranges, on average over all rows."""
Row = dict[str, Any]
Key = tuple[str, str, int, int]


def key_of(row: Row) -> Key:
    """Return what names a row."""
    return row["cell"], row["kind"], row["executions"], row["seed"]


def error_of(row: Row, names: Iterable[str] | None = None) -> float:
    """Return the mean absolute error of a row's answered orders, %; NaN without any."""
    wanted = None if names is None else set(names)
    errors = [abs(each["error"]) for each in row["orders"] if wanted is None or each["name"] in wanted]
    return 100.0 * float(np.mean(errors)) if errors else float("nan")


def chance_of(row: Row) -> float:
    """Return the mean absolute error of a perfect method beside the same logs, %; NaN without orders."""
    errors = [abs(each["chance"]) for each in row["orders"]]
    return 100.0 * float(np.mean(errors)) if errors else float("nan")


def summary(rows: list[Row]) -> str:
    """Return one line on all rows: errors, chance, coverage."""
    orders = [order for row in rows for order in row["orders"]]
    refused = sum(len(row["refused"]) for row in rows)
    if not orders:
        return f"{len(rows)} rows, no order answered, {refused} refused"
    return (
        f"{len(rows)} rows, {len(orders)} orders answered, {refused} refused: mean |error| "
        f"{100 * np.mean([abs(each['error']) for each in orders]):.2f} %, chance "
        f"{100 * np.mean([abs(each['chance']) for each in orders]):.2f} %, intervals of the mean hold in "
        f"{np.mean([each['held'] for each in orders]):.1%}, 90 % ranges hold "
        f"{np.mean([each['inside'] for each in orders]):.1%}"
    )


def faults(old: list[Row], new: list[Row]) -> list[str]:
    """Return what is worse in the new result than in the old one, one sentence each.

    Rows are compared on the orders that both answered. An order that only the old one
    answered is a fault; one that the new one did not ask is none.
    """
    before = {key_of(row): row for row in old}
    found, growth = [], []
    for row in new:
        if (other := before.get(key_of(row))) is None:
            continue
        common = {each["name"] for each in row["orders"]} & {each["name"] for each in other["orders"]}
        told = f"{row['cell']}, {row['kind']}, {row['executions']} executions, seed {row['seed']}"
        if lost := sorted({each["name"] for each in other["orders"]} & set(row["refused"])):
            reasons = "; ".join(sorted({row["refused"][name] for name in lost}))
            found.append(f"{told}: {len(lost)} orders no longer answered: {reasons}")
        if not common:
            continue
        now, then = error_of(row, common), error_of(other, common)
        growth.append(now - then)
        if now - then > WORSE:
            found.append(f"{told}: mean |error| {then:.2f} -> {now:.2f} % (chance {chance_of(row):.2f} %)")
    if growth and np.mean(growth) > WORSE_ON_AVERAGE:
        found.append(f"mean over {len(growth)} common rows: {np.mean(growth):+.3f} points")
    inside = [each["inside"] for row in new for each in row["orders"]]
    if inside and not COVERED[0] <= np.mean(inside) <= COVERED[1]:
        found.append(f"90 % ranges hold {np.mean(inside):.1%} of fresh executions")
    return found
