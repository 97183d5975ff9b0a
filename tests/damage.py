"""Harm done to a whole log, as copies and power cuts do it: cut, single bits, a block of NUL bytes."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

from cyclekit.adapter import ReadOptions, Recording
from cyclekit.errors import LogError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from cyclekit.adapter import Adapter


def damaged(whole: bytes, seed: int, cuts: int = 30, flips: int = 40) -> Iterator[bytes]:
    chance = random.Random(seed)
    for _ in range(cuts):
        yield whole[: chance.randrange(len(whole))]
    for _ in range(flips):
        broken = bytearray(whole)
        for _ in range(chance.choice([1, 1, 8])):
            broken[chance.randrange(len(broken))] ^= 1 << chance.randrange(8)
        yield bytes(broken)
    for _ in range(15):
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
