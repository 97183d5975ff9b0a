"""No test fails because the machine was busy, and none changes what others read."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from hypothesis import settings
from made_once import changed, shared_folder

if TYPE_CHECKING:
    from collections.abc import Iterator

settings.register_profile("cyclekit", deadline=None, print_blob=True)
settings.register_profile("everyday", settings.get_profile("cyclekit"), max_examples=25)  # of `make test`
settings.load_profile("cyclekit")


@pytest.fixture(scope="session", autouse=True)
def _what_is_shared_stays_as_it_was(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Whoever changed a cell that other tests read is found out at the end of the run."""
    yield
    assert changed(shared_folder(tmp_path_factory)) == []


@pytest.fixture
def words_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages of the test have empty pictures: drawing them takes most of the time, and other files look at them."""
    monkeypatch.setattr("cyclekit.report.pictures.Picture._drawn", lambda *_: "<svg></svg>")
