"""Blocks are parsed several at a time and handed on in order; an error comes at its block, and no thread is left."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING

import pytest

from cyclekit_adapters.text.delimited import TextLayout, joined, row_blocks
from cyclekit_adapters.text.parallel_map import MAX_PENDING, THREADS, parallel_map

if TYPE_CHECKING:
    from collections.abc import Iterator


def test_results_come_with_their_items_and_in_their_order():
    def later_for_even(item: int) -> int:
        time.sleep(0.0 if item % 2 else 0.002)
        return -item

    assert list(parallel_map(range(30), later_for_even)) == [(item, -item) for item in range(30)]
    assert list(parallel_map([], later_for_even)) == []


def test_one_item_alone_is_made_by_the_caller():
    assert list(parallel_map([1], lambda _: threading.get_ident())) == [(1, threading.get_ident())]
    assert dict(parallel_map([1, 2], lambda _: threading.get_ident()))[1] != threading.get_ident()


def test_two_are_in_the_making_at_the_same_time():
    together = threading.Barrier(2, timeout=60.0)
    assert len(list(parallel_map(range(2 * THREADS), lambda _: together.wait()))) == 2 * THREADS  # else it would break


def test_two_are_in_the_making_while_the_caller_has_a_third():
    together = threading.Barrier(THREADS + 1, timeout=60.0)

    def make(item: int) -> None:
        if item in (1, 2):
            together.wait()

    for item, _ in parallel_map(range(5), make):
        if item == 0:
            together.wait()  # else it would break


def test_no_more_items_are_taken_than_are_worked_on():
    taken: list[int] = []

    def items() -> Iterator[int]:
        for item in range(100):
            taken.append(item)
            yield item

    for item, _ in parallel_map(items(), str):
        assert len(taken) - item <= MAX_PENDING  # the rest of a log larger than memory is not in memory


def test_an_error_comes_at_its_item_and_one_who_stops_leaves_no_thread():
    before = threading.active_count()

    def make(item: int) -> int:
        return 1 // (item - 3)

    made = parallel_map(range(100), make)
    assert [item for item, _ in (next(made), next(made), next(made))] == [0, 1, 2]
    with pytest.raises(ZeroDivisionError):
        next(made)
    assert threading.active_count() == before
    stopped = parallel_map(range(100), str)
    assert next(stopped) == (0, "0")
    stopped.close()  # type: ignore[attr-defined]
    assert threading.active_count() == before


@pytest.mark.parametrize("size", [7, 60, 61, 500])
def test_the_line_and_row_of_each_row_do_not_depend_on_how_a_log_is_cut_into_blocks(size: int):
    lines = [f"{row},{row}.5" for row in range(90)]
    lines[20], lines[41] = "", "20,x"  # a blank line, a garbled number
    lines[60:60] = ["t,x"]  # the names once more
    lines[85:85] = ["time,x"]  # another table
    text = "\n".join(["t,x", *lines, "89,0.2"]).encode()  # the last one was cut
    blocks, rest = [], text
    while rest:
        end = rest.find(b"\n", min(size, len(rest) - 1)) + 1 or len(rest)
        blocks.append(rest[:end])
        rest = rest[end:]
    whole = joined(row_blocks([text], layout := TextLayout(("t", "x"), ",", 1), numbers=["t", "x"]))
    found = joined(row_blocks(blocks, layout, numbers=["t", "x"]))
    assert found.frame.equals(whole.frame)
    assert found.set_aside.equals(whole.set_aside)
    assert found.rows_read == whole.rows_read == 92
    assert whole.set_aside["source_row"].to_list() == [43, 62, *range(87, 95)]
