"""Sessions one after the other, far apart in time."""

from __future__ import annotations

from itertools import pairwise

from cyclekit.derive.concatenated import APART_S, shifts_apart


def test_each_part_starts_long_after_the_end_of_the_one_before() -> None:
    spans_s = [(50.0, 80.0), (0.0, 10.0), (1e6, 1e6 + 5.0)]
    moved = [
        (first_s + shift, last_s + shift)
        for (first_s, last_s), shift in zip(spans_s, shifts_apart(spans_s), strict=True)
    ]
    assert moved[0] == (0.0, 30.0)
    assert [after[0] - before[1] for before, after in pairwise(moved)] == [APART_S, APART_S]
