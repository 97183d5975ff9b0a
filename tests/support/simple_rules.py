"""Trainings whose search for a rule leaves out polygons: these take most of its time, and other files look at them."""

from __future__ import annotations

import pytest

from cyclekit.learning.rules.families import FAMILIES
from cyclekit.learning.rules.families.polygon import POLYGON


def search_simply(patch: pytest.MonkeyPatch) -> None:
    """Leave polygons out of the kinds of rules."""
    patch.setattr(
        "cyclekit.learning.rules.ladder.FAMILIES",
        {name: family for name, family in FAMILIES.items() if name not in POLYGON and "polygon" not in name},
    )


@pytest.fixture
def simple_rules(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trainings of the test look for simple rules."""
    search_simply(monkeypatch)
