"""Clocks of simulated logs are what is stated or assumed: half of an ingest would test them, the same in every file.

A module about clocks says `pytestmark = pytest.mark.tests_clocks`: there they are tested. Everywhere they are where
alignment by the logs is asked for, and in every other process: commands that a test starts.
"""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import pytest

from cyclekit.derive import log_clocks, robot_clocks

if TYPE_CHECKING:
    from collections.abc import Iterator

CALLERS = ("cyclekit.derive.robot_clocks", "cyclekit.derive.set_override.moved")
TESTED = log_clocks.with_tested_clocks


def _as_they_are(*args: Any, asked: bool) -> Any:
    return TESTED(*args, asked=True) if asked else list(args[1])


def are_tested() -> bool:
    """Return whether an ingest of this process tests clocks at present."""
    return robot_clocks.with_tested_clocks is TESTED


@contextmanager
def clocks(instead: Any = TESTED) -> Iterator[None]:
    """Have ingests test clocks, whatever the module is about; or do something else with them."""
    with pytest.MonkeyPatch.context() as patch:
        for module in CALLERS:
            patch.setattr(f"{module}.with_tested_clocks", instead)
        yield


@pytest.fixture(scope="session", autouse=True)
def _clocks_as_they_are() -> Iterator[None]:
    with clocks(_as_they_are):
        yield


@pytest.fixture(scope="module", autouse=True)
def _clocks_tested(request: pytest.FixtureRequest) -> Iterator[None]:
    if request.node.get_closest_marker("tests_clocks") is None:
        yield
    else:
        with clocks():
            yield
