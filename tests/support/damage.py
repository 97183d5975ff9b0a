"""Harm done to a whole log, as copies and power cuts do it: cut, single bits, a block of NUL bytes."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

from examples import drawn

from cyclekit.adapter import ReadOptions, Recording
from cyclekit.errors import LogError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from cyclekit.adapter import Adapter

CUTS, FLIPS, HOLES = drawn(30), drawn(40), drawn(15)


def damaged(whole: bytes, seed: int, cuts: int = CUTS, flips: int = FLIPS) -> Iterator[bytes]:
    chance = random.Random(seed)
    for _ in range(cuts):
        yield whole[: chance.randrange(len(whole))]
    for _ in range(flips):
        broken = bytearray(whole)
        for _ in range(chance.choice([1, 1, 8])):
            broken[chance.randrange(len(broken))] ^= 1 << chance.randrange(8)
        yield bytes(broken)
    for _ in range(HOLES):
        start = chance.randrange(len(whole))
        yield whole[:start] + bytes(min(64, len(whole) - start)) + whole[start + 64 :]


def read_or_refuse(adapter: Adapter, path: Path, options: ReadOptions | None = None) -> Recording | None:
    """Return the recording, or None for one of our refusals; anything else is a failure of the test."""
    adapter.recognises(path)  # must not raise, whatever is there
    try:
        log = adapter.read(path, options or ReadOptions())
    except LogError:
        return None
    assert isinstance(log, Recording)
    return log


def read_damaged(
    adapter: Adapter,
    file: Path,
    whole: bytes,
    seed: int,
    options: ReadOptions | None = None,
    *,
    place: Path | None = None,
    partly: bool = False,
    **harm: int,
) -> None:
    """Read damaged copies of a log: each is read or refused by us, and what only lost a little is not refused.

    Args:
        adapter: Who reads.
        file: What is damaged, with its bytes in `whole`; `place` is what is read where that is another.
        whole: The log as it was.
        seed: Of the damage.
        options: What it is read with.
        place: The folder that `file` lies in, where that is the log.
        partly: The log is one of rows, so that one that was cut gives the rows before the cut.
        harm: How many `cuts` and `flips`.
    """
    file.write_bytes(whole)
    clean = read_or_refuse(adapter, place or file, options)
    assert clean is not None
    rows = []
    for broken in damaged(whole, seed, **harm):
        file.write_bytes(broken)
        log = read_or_refuse(adapter, place or file, options)
        rows.append(0 if log is None else log.rows_read)
    assert sum(count > 0 for count in rows) >= len(rows) / 10, "nearly every damaged copy is refused"
    if partly:
        cut = rows[: harm.get("cuts", CUTS)]
        assert any(0 < count < clean.rows_read for count in cut), "a log that was cut is refused as a whole"
