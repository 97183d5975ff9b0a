"""The next item is made while the present one is worked on, in one thread, and errors come where they belong."""

from __future__ import annotations

import sqlite3
import threading
from typing import TYPE_CHECKING

import pytest

from cyclekit.storage.prefetch import prefetch

if TYPE_CHECKING:
    from collections.abc import Iterator


def test_all_items_come_in_order():
    assert list(prefetch(iter(range(100)))) == list(range(100))
    assert list(prefetch(iter([]))) == []
    assert list(prefetch(iter([None, None]))) == [None, None]


def test_the_next_item_is_begun_before_the_present_one_is_done_with():
    begun = threading.Event()

    def items() -> Iterator[int]:
        yield 1
        begun.set()
        yield 2

    taken = prefetch(items())
    assert next(taken) == 1
    assert begun.wait(10.0)  # without asking for it
    assert list(taken) == [2]


def test_an_error_comes_in_place_of_its_item():
    def items() -> Iterator[int]:
        yield 1
        msg = "damaged"
        raise ValueError(msg)

    taken = prefetch(items())
    assert next(taken) == 1
    with pytest.raises(ValueError, match="damaged"):
        next(taken)


def test_one_who_stops_early_leaves_no_thread_and_nothing_open():
    ended: list[int] = []

    def items() -> Iterator[int]:
        database = sqlite3.connect(":memory:")  # may be used in the thread that opened it only
        try:
            yield from range(1000)
        finally:
            database.close()
            ended.append(threading.get_ident())

    before = threading.active_count()
    taken = prefetch(items())
    assert next(taken) == 0
    taken.close()  # type: ignore[attr-defined]
    assert len(ended) == 1
    assert ended[0] != threading.get_ident()
    assert threading.active_count() == before
