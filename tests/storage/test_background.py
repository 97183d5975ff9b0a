"""Calls behind: in order, one waiting at most, errors raised where somebody hears them, no thread left."""

from __future__ import annotations

import threading

import pytest

from cyclekit.storage.background import BackgroundWriter


def test_calls_are_made_in_order_in_another_thread_and_none_is_left():
    before, made = threading.active_count(), list[tuple[int, int]]()
    writer = BackgroundWriter()
    for number in range(20):
        writer.begin(lambda number=number: made.append((number, threading.get_ident())))
    writer.end()
    assert [number for number, _ in made] == list(range(20))
    assert threading.get_ident() not in {thread for _, thread in made}
    assert threading.active_count() == before


def test_the_caller_goes_on_meanwhile():
    go, waited = threading.Event(), list[bool]()
    writer = BackgroundWriter()
    writer.begin(lambda: waited.append(go.wait(10.0)))
    go.set()  # if `begin` waited for its call, nobody would set it in time
    writer.end()
    assert waited == [True]


@pytest.mark.parametrize("at_once", [True, False])
def test_an_error_is_raised_at_the_next_call_or_at_the_end(at_once: bool):
    def fails() -> None:
        raise OSError(28, "No space left on device", "robot.parquet")

    before = threading.active_count()
    writer = BackgroundWriter()
    writer.begin(fails)
    with pytest.raises(OSError, match="No space left"):
        writer.end() if at_once else writer.begin(list.clear)
    writer.end()
    assert threading.active_count() == before
