from __future__ import annotations

import pytest

from cyclekit.text.numbers import exact_percent, whole_percent


@pytest.mark.parametrize(
    ("part", "whole", "exact"),
    [(0.0, "0 %", "0 %"), (0.125, "12 %", "12.5 %"), (1 / 3, "33 %", "33.33 %"), (1, "100 %", "100 %")],
)
def test_parts_are_whole_or_with_the_digits_they_have(part: float, whole: str, exact: str) -> None:
    assert (whole_percent(part), exact_percent(part)) == (whole, exact)
