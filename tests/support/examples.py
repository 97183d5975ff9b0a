"""How many inputs a test draws: no more than the profile of the run allows, which is fewer every day."""

from __future__ import annotations

from typing import Any

from hypothesis import settings


def at_most(examples: int, **options: Any) -> settings:
    """Return settings of a test that costs more than others: so many inputs, or the fewer of the profile."""
    return settings(max_examples=min(examples, settings.default.max_examples), **options)


def drawn(count: int) -> int:
    """Return how many inputs a test draws by itself: `count`, or half of them every day."""
    return count if settings.default.max_examples >= 100 else count // 2
