"""Results as text: the first lines, and how many are left out."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from cyclekit.text import results
from cyclekit.text.results import Result


@dataclass(frozen=True, repr=False)
class Numbers(Result):
    count: int

    def _lines(self) -> list[str]:
        return [str(number) for number in range(self.count)]


@pytest.mark.parametrize("shown", [3, 8])
def test_the_last_line_says_how_many_are_left_out(shown: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "SHOWN_LINES", shown)
    assert repr(Numbers(shown)).splitlines()[-1].strip() == str(shown - 1)
    lines = repr(Numbers(20)).splitlines()
    assert len(lines) == shown
    assert lines[-1].strip() == f"... and {20 - shown + 1} more"
