"""How engine `ray` hands work out and takes it back, with a stand-in for Ray; the slow tests use Ray itself."""

from __future__ import annotations

import os
import sys
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from engine_tasks import square

from cyclekit.errors import EngineError
from cyclekit.parallel.engine import Engine
from cyclekit.parallel.ray_tasks import RETRIES

if TYPE_CHECKING:
    from collections.abc import Callable


class StandIn:
    """As much of Ray as the engine uses: a task is done in this process when its result is asked for."""

    class Lost(Exception):
        """What Ray says of a worker that was lost time and again."""

    def __init__(self, deadly: object = None) -> None:
        self.exceptions = SimpleNamespace(RayError=self.Lost)
        self.deadly, self.asked, self.most, self.cancelled = deadly, dict[str, Any](), 0, list[Any]()
        self.tasks: dict[int, tuple[Any, ...]] = {}

    def is_initialized(self) -> bool:
        return True

    def cluster_resources(self) -> dict[str, float]:
        return {"CPU": 2.0}

    def remote(self, **asked: Any) -> Callable[[Callable[..., Any]], Any]:
        self.asked = asked
        return lambda function: SimpleNamespace(remote=lambda *words: self._begin(function, words))

    def _begin(self, function: Callable[..., Any], words: tuple[Any, ...]) -> int:
        reference = len(self.tasks)
        self.tasks[reference] = (function, words)
        return reference

    def wait(self, references: list[int], num_returns: int) -> tuple[list[int], list[int]]:
        self.most = max(self.most, len(references))
        return references[-num_returns:], references[:-num_returns]  # the last is done first

    def get(self, reference: int) -> Any:
        function, words = self.tasks[reference]
        if self.deadly in words[0]:
            raise self.Lost
        return function(*words)

    def cancel(self, reference: int, *, force: bool) -> None:
        self.cancelled.append(reference)
        assert force


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch) -> StandIn:
    for name in ("POLARS_MAX_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.setenv(name, "2")  # a worker changes them; afterwards they are what they were
    monkeypatch.setitem(sys.modules, "ray", StandIn())
    return sys.modules["ray"]  # type: ignore[return-value]


def test_every_item_comes_back_once_with_its_result(stand_in: StandIn) -> None:
    done = sorted(Engine("ray").map(square, range(100)), key=lambda each: each.number)
    assert [each.item for each in done] == list(range(100))
    assert [each.get() for each in done] == [number**2 for number in range(100)]
    assert stand_in.asked == {"num_cpus": 1, "max_retries": RETRIES}
    assert len(stand_in.tasks) < 100  # in parts
    assert os.environ["POLARS_MAX_THREADS"] == "1"


def test_an_item_that_fails_is_told_and_the_others_go_on(stand_in: StandIn) -> None:
    done = {each.item: each for each in Engine("ray").map(square, [1, -2, 3])}
    assert (done[1].get(), done[3].get()) == (1, 9)
    with pytest.raises(ValueError, match="-2 is negative"):
        done[-2].get()


def test_an_item_that_costs_its_worker_each_time_is_given_up_and_the_others_are_done(stand_in: StandIn) -> None:
    stand_in.deadly = 33
    done = {each.item: each for each in Engine("ray").map(square, range(40))}
    assert [number for number, each in done.items() if each.error] == [33]
    assert isinstance(done[33].error, EngineError)
    assert sorted(done) == list(range(40))


def test_no_more_is_handed_out_at_once_than_the_jobs_that_were_allowed(stand_in: StandIn) -> None:
    list(Engine("ray", jobs=2).map(square, range(40)))
    assert stand_in.most == 2


def test_what_is_no_longer_wanted_is_taken_back(stand_in: StandIn) -> None:
    results = Engine("ray", jobs=2).map(square, range(40))
    next(results)
    results.close()  # type: ignore[attr-defined]
    assert len(stand_in.cancelled) == 1


def test_a_worker_with_another_version_says_so(stand_in: StandIn, monkeypatch: pytest.MonkeyPatch) -> None:
    versions = iter(["1.0", "2.0"])
    monkeypatch.setattr("cyclekit.parallel.ray_tasks.version", lambda _: next(versions))
    (done,) = Engine("ray").map(square, [1])
    assert "the work was sent by cyclekit 1.0" in str(done.error)


def test_a_cluster_that_nobody_runs_is_said_to_be_out_of_reach(
    stand_in: StandIn, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stand_in, "is_initialized", lambda: False)
    with pytest.raises(EngineError, match=r"can be reached at '127\.0\.0\.1:9'") as told:
        list(Engine("ray", address="127.0.0.1:9").map(square, [1]))
    assert "ray start --head" in str(told.value.cure)
