"""Task times that are learned in less time, for tests that look at neither held-out orders nor single rates."""

from __future__ import annotations

import pytest

_LESS = {"learn.FOLDS": 2, "rates.ROUNDS": 3, "rates.MORE_ROUNDS": 2}


def learn_quickly(patch: pytest.MonkeyPatch) -> None:
    """Learn in three times instead of six, each with few rounds of rates and spreads."""
    for name, value in _LESS.items():
        patch.setattr(f"cyclekit.learning.task_times.{name}", value)


@pytest.fixture
def quick_task_times(monkeypatch: pytest.MonkeyPatch) -> None:
    """Task times of the test are learned quickly: other files look at rates and held-out orders."""
    learn_quickly(monkeypatch)
