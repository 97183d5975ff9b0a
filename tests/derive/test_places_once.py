"""Standstills midway that the logged scaling does not show: they look like places, and the user is told."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from cyclekit.dataset.dataset import Place
from cyclekit.derive.robot import visited_once
from cyclekit.segmentation.executions import Execution, Visit

if TYPE_CHECKING:
    from collections.abc import Sequence


def executions(midway: Sequence[str], count: int = 12) -> list[Execution]:
    """Return executions through the same three places; the first ones stop once midway as well."""
    orders = [["a", "b", *midway[number : number + 1], "c"] for number in range(count)]
    return [
        Execution(number, tuple(Visit(name, 10 * n, 10 * n + 5) for n, name in enumerate(order)), True)
        for number, order in enumerate(orders)
    ]


def places(names: Sequence[str], *, found: bool = True) -> dict[str, Place]:
    return {name: Place(name, (0.0, 0.0, 0.0), 0.05, inferred=found) for name in names}


def test_places_of_one_execution_each_are_said_with_the_cure() -> None:
    (said,) = visited_once(places("abcxyz"), executions("xyz"))
    assert said.text.startswith("3 of 6 places were visited in one execution only")
    assert "all_places_named = true" in said.text


@pytest.mark.parametrize(
    ("found", "midway", "count"),
    [(True, "xy", 12), (True, "xyz", 9), (False, "xyz", 12), (True, "xxyyzz", 12)],
)
def test_few_places_or_executions_named_places_and_places_of_two_executions_are_not(
    found: bool, midway: str, count: int
) -> None:
    assert visited_once(places("abcxyz", found=found), executions(midway, count)) == []
