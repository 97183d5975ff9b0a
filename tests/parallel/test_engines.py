"""One map, whichever engine does it: same results, failures told, and a worker that is killed costs a retry."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from typing import TYPE_CHECKING

import pytest
from engine_tasks import dies_always, dies_once, environment, square

from cyclekit.errors import ConfigError, EngineError, MissingExtra
from cyclekit.ingest.read.read_logs import check_shared
from cyclekit.parallel.engine import LOCAL, Engine, in_chunks

if TYPE_CHECKING:
    from pathlib import Path


RAY = pytest.param("ray", marks=pytest.mark.slow)  # quick: test_ray_tasks


@pytest.fixture(scope="module", params=["here", "processes", RAY])
def engine(request: pytest.FixtureRequest) -> Engine:
    """Each of the ways in which work is done."""
    if request.param == "ray":
        return request.getfixturevalue("cluster")
    return LOCAL if request.param == "here" else Engine(jobs=2)


def test_every_item_comes_back_once_with_its_result(engine: Engine) -> None:
    done = sorted(engine.map(square, range(100)), key=lambda each: each.number)
    assert [each.item for each in done] == list(range(100))
    assert [each.get() for each in done] == [number**2 for number in range(100)]


def test_no_items_are_no_work(engine: Engine) -> None:
    assert list(engine.map(square, [])) == []


def test_an_item_that_fails_is_told_and_the_others_go_on(engine: Engine) -> None:
    done = {each.item: each for each in engine.map(square, [1, -2, 3])}
    assert (done[1].get(), done[3].get()) == (1, 9)
    with pytest.raises(ValueError, match="-2 is negative"):
        done[-2].get()


@pytest.mark.parametrize("engine", ["processes", RAY], indirect=True)
def test_a_worker_that_is_killed_in_mid_work_costs_a_retry_and_nothing_else(engine: Engine, tmp_path: Path) -> None:
    markers = [str(tmp_path / f"{number}") for number in range(6)]
    (tmp_path / "4").touch()
    assert sorted(each.get() for each in engine.map(dies_once, markers)) == markers


@pytest.mark.parametrize("engine", ["processes", RAY], indirect=True)
def test_an_item_that_kills_its_worker_each_time_is_given_up_and_the_others_are_done(engine: Engine) -> None:
    done = {each.item: each for each in engine.map(dies_always, range(40))}
    assert [number for number, each in done.items() if each.error] == [3]
    assert isinstance(done[3].error, EngineError)
    assert sorted(each.get() for number, each in done.items() if number != 3) == [n for n in range(40) if n != 3]


@pytest.mark.parametrize("engine", ["processes", RAY], indirect=True)
def test_a_worker_has_one_thread(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("POLARS_MAX_THREADS", "OMP_NUM_THREADS"):
        monkeypatch.setenv(name, "2")
    workers = {each.get() for each in engine.map(environment, range(4))}
    assert {(tables, products) for _, tables, products in workers} == {("1", "1")}


@pytest.mark.parametrize(("count", "workers", "size"), [(1, 2, 1), (40, 2, 2), (10_000, 2, 32), (7, 1, 1)])
def test_thousands_of_items_are_handed_out_in_parts_that_still_share_evenly(count: int, workers: int, size: int):
    parts = in_chunks(count, workers)
    assert [number for part in parts for number in part] == list(range(count))
    assert max(map(len, parts)) <= size


@pytest.mark.slow  # imports Ray
@pytest.mark.skipif(find_spec("ray") is None, reason="needs Ray")
def test_a_cluster_that_nobody_runs_is_said_to_be_out_of_reach() -> None:
    code = "from cyclekit.parallel.engine import Engine; list(Engine('ray', address='127.0.0.1:9').map(abs, [1]))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    assert "EngineError: no Ray cluster can be reached at '127.0.0.1:9'" in done.stderr
    assert "ray start --head" in done.stderr


def test_without_ray_the_message_names_the_command_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtra, match=r'pip install "cyclekit\[ray\]"'):
        list(Engine("ray").map(square, [1]))


@pytest.mark.parametrize("wrong", [{"name": "spark"}, {"jobs": 0}, {"address": "auto"}])
def test_an_engine_that_contradicts_itself_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ConfigError):
        Engine(**wrong)


def test_a_worker_that_does_not_see_the_dataset_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(EngineError, match="not there on the machine of the worker") as told:
        check_shared(tmp_path / "elsewhere")
    assert "where all machines see it" in str(told.value.cure)
    check_shared(tmp_path)
