"""What the tests of estimates share: the ways that the robot of the logged cell went."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from judged_once import judged_once  # noqa: F401 - for every test of this folder

if TYPE_CHECKING:
    from cyclekit.dataset.dataset import Dataset


@pytest.fixture(scope="session")
def routes(logged: Dataset) -> list[tuple[str, ...]]:
    """The places of every logged execution."""
    return [entry.places for entry in logged.card.executions]
