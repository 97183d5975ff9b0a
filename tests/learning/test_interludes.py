"""What agents do now and then beside their work: tasks done again, tool changes."""

from __future__ import annotations

import pytest

from cyclekit.learning.interludes import find_interludes, find_rework


def done(order: str, took_s: float = 2.0) -> list[tuple[str, float, float]]:
    """Return tasks named by letters; the second of two alike in a row takes twice as long, and `t` waits for 1 s."""
    return [
        (name, took_s * (1 + (number > 0 and order[number - 1] == name)), 1.0 * (name == "t"))
        for number, name in enumerate(order)
    ]


def test_picks_that_are_done_again_are_counted_with_their_duration() -> None:
    (found,) = find_interludes("robot", [done("pfpf"), done("ppfpf"), done("pfpf"), done("pfpppf")])
    assert (found.agent, found.task, found.before, found.visits, found.times) == ("robot", "p", ("p",), 8, 3)
    assert found.took_s == pytest.approx(4.0)


@pytest.mark.parametrize("orders", [("ppff", "pfpf", "ffpp"), ("ppf", "ppf"), ("pf", "fp")])
def test_two_parts_in_a_row_are_no_repetition(orders: tuple[str, ...]) -> None:
    """Each execution has as many of them, in whatever order; or all have them in a row."""
    assert find_interludes("robot", [done(order) for order in orders]) == []


def test_tool_changes_between_tasks_of_several_products_are_found() -> None:
    """Steps that a product always has are work, however rare the product is."""
    orders = ["afbsf", "tafaf", "bsftbsf", "afaf", "taftbsf", "bsfaf", "afbsf", "aftaf"]
    (found,) = find_interludes("robot", [done(order) for order in orders])
    assert (found.task, sorted(found.before), found.visits, found.times) == ("t", ["a", "b"], 16, 5)
    assert found.took_s == pytest.approx(3.0)  # with its wait


def test_what_an_interlude_saves_on_the_next_way_is_subtracted() -> None:
    plain, change = [("a", 2.0, 0.0), ("f", 2.0, 0.0)], [("t", 3.0, 0.0), ("a", 1.5, 0.0), ("f", 2.0, 0.0)]
    (found,) = find_interludes("robot", [plain, change, plain, plain])
    assert found.took_s == pytest.approx(2.5)


@pytest.mark.parametrize(
    "orders",
    [
        ("afbf", "afaf", "bf", "af", "bfbfaf", "bfaf"),  # parts in any number: as many picked as placed
        ("ab", "c", "bcd", "ad", "d", "abcd", "bd", "ac"),  # any places: they are the work
        ("cacbc", "accbc", "cccab", "baccc", "cbacc", "cabcc"),  # three of a task, some in a row
    ],
)
def test_work_of_any_length_has_no_interludes(orders: tuple[str, ...]) -> None:
    assert find_interludes("robot", [done(order) for order in orders]) == []


def test_what_goes_back_after_its_test_is_rework_where_most_do_not() -> None:
    def ends(order: str) -> list[tuple[str, float]]:
        return [(name, 10.0 * number) for number, name in enumerate(order, 1)]

    (found,) = find_rework("part", [ends(order) for order in ("cwpt", "cwptwpt", "cwpt", "cwpt", "cwptpt")])[:1]
    assert (found.task, found.before, found.visits, found.times) == ("w, p, t again", ("w",), 5, 1)
    assert found.took_s == pytest.approx(30.0)
    assert find_rework("robot", [ends(order) for order in ("papb", "papb", "pbpa", "pa")]) == []
