"""Tasks that some executions do again right after themselves."""

from __future__ import annotations

import pytest

from cyclekit.learning.repeats import find_repeats


def done(order: str, took_s: float = 2.0) -> list[tuple[str, float]]:
    """Return tasks named by letters; the second of two alike in a row takes twice as long."""
    return [(name, took_s * (1 + (number > 0 and order[number - 1] == name))) for number, name in enumerate(order)]


def test_picks_that_are_done_again_are_counted_with_their_duration() -> None:
    (found,) = find_repeats("robot", [done("pfpf"), done("ppfpf"), done("pfpf"), done("pfpppf")])
    assert (found.agent, found.name, found.visits, found.times) == ("robot", "p", 8, 3)
    assert found.took_s == pytest.approx(4.0)


@pytest.mark.parametrize("orders", [("ppff", "pfpf", "ffpp"), ("ppf", "ppf"), ("pf", "fp")])
def test_two_parts_in_a_row_are_no_repetition(orders: tuple[str, ...]) -> None:
    """Each execution has as many of them, in whatever order; or all have them in a row."""
    assert find_repeats("robot", [done(order) for order in orders]) == []
