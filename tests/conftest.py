"""No test fails because the machine was busy, and none changes what others read."""

from __future__ import annotations

import atexit
import gc
import os
import shutil
import sys
import tempfile
from itertools import zip_longest
from typing import TYPE_CHECKING

import numpy as np
import pytest
from cluster import bucket, cluster, small_cell  # noqa: F401 - fixtures for every folder
from hypothesis import settings
from known_cells import check, constant, hand_made, logged, staircase, truth  # noqa: F401
from made_once import changed, shared_folder
from quick_task_times import quick_task_times  # noqa: F401
from simple_rules import simple_rules  # noqa: F401
from simulated_cells import boxes, cells, large, logs, motive_log, reads, robot_log, three_runs  # noqa: F401
from stated_clocks import _clocks_as_they_are, _clocks_tested  # noqa: F401

if TYPE_CHECKING:
    from collections.abc import Iterator

if os.environ.pop("PYTHONDONTWRITEBYTECODE", ""):
    # Each process that a test starts would compile all sources again. What is compiled stays out of the tree.
    sys.pycache_prefix = os.environ["PYTHONPYCACHEPREFIX"] = tempfile.mkdtemp(prefix="cyclekit-compiled-")
    sys.dont_write_bytecode = False
    atexit.register(shutil.rmtree, sys.pycache_prefix, ignore_errors=True)

os.fsync = lambda _: None  # no test cuts the power, and every dataset would wait for the disk ten times

gc.disable()  # until all tests are collected: a tenth of the time of that

# Where CI is set, the examples are the same in every run: a change is judged by what it does, not by new examples.
settings.register_profile("cyclekit", deadline=None, print_blob=True, derandomize="CI" in os.environ)
settings.register_profile("everyday", settings.get_profile("cyclekit"), max_examples=12)  # of `make test`
settings.load_profile("cyclekit")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """In several processes, let files of one folder run far from each other.

    Files side by side ask for the same cells, and the one process would wait for the other to make them. The last files
    are short, and stay last, so that all processes end together.
    """
    if not hasattr(config, "workerinput"):
        return
    files = list(dict.fromkeys(item.path for item in items))
    last = next((at for at, file in enumerate(files) if file.parent.name == "storage"), len(files))
    middle = (last + 1) // 2
    mixed = [file for pair in zip_longest(files[:middle], files[middle:last]) for file in pair if file is not None]
    place = {file: at for at, file in enumerate([*mixed, *files[last:]])}
    items.sort(key=lambda item: place[item.path])


def pytest_collection_finish() -> None:
    """Leave what was imported out of every later garbage collection: 6 % of the processor time of a run."""
    gc.enable()
    gc.freeze()
    gc.set_threshold(100_000, 50, 100)
    atexit.register(gc.unfreeze)  # some packages count what is left; not earlier: pytest collects twice at the end


@pytest.fixture(scope="session", autouse=True)
def _what_is_shared_stays_as_it_was(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Whoever changed a cell that other tests read is found out at the end of the run."""
    yield
    assert changed(shared_folder(tmp_path_factory)) == []


@pytest.fixture
def no_boosting(monkeypatch: pytest.MonkeyPatch) -> None:
    """Evaluations of the test leave out the rival that takes most of their time; other files look at it."""
    monkeypatch.setattr("cyclekit.learning.evaluation.evaluate._boosted", lambda *_: [])


@pytest.fixture
def words_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages of the test have empty pictures, and a table of the scaling without an answer.

    Both take most of the time, and other files look at them.
    """
    from cyclekit.report.play import scaling_grid

    monkeypatch.setattr("cyclekit.report.pictures.Picture._drawn", lambda *_: "<svg></svg>")
    monkeypatch.setattr(
        scaling_grid, "_entries", lambda _, robot_m, __: np.full(len(robot_m), scaling_grid.ASK, np.uint8)
    )
