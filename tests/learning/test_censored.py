"""What the end of a log cuts lasted at least so long: neither left out nor taken as whole."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest

from cyclekit import schema
from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.censored import as_whole
from cyclekit.learning.coupling.events.visits import ExecutionVisits, PlaceVisit, events_of
from cyclekit.learning.coupling.learn import learn_executions
from cyclekit.learning.task_times.learn import learn_task_times

if TYPE_CHECKING:
    from pathlib import Path

    from cyclekit.dataset.cards.coupling import Agent

LONG_S, PLACES = (4.0, 30.0), ("saw", "bench", "rack", "desk")


@pytest.mark.parametrize("cut_at_s", [20.0, 60.0])
def test_durations_that_some_logs_cut_have_the_mean_of_whole_ones(cut_at_s: float) -> None:
    rng = np.random.default_rng(0)
    true_s, ends_s = rng.uniform(*LONG_S, 4000), rng.uniform(0.0, cut_at_s + LONG_S[1], 4000)
    cut = ends_s < true_s
    found = as_whole(np.minimum(true_s, ends_s), cut)
    assert found.mean() == pytest.approx(np.mean(LONG_S), rel=0.02)
    assert np.quantile(found, [0.1, 0.9]) == pytest.approx(np.quantile(true_s, [0.1, 0.9]), rel=0.05)


def test_without_a_cut_one_nothing_changes_and_the_longest_counts_as_whole() -> None:
    assert as_whole(np.array([3.0, 1.0]), np.array([False, False])).tolist() == [1.0, 3.0]
    assert as_whole(np.array([3.0, 1.0]), np.array([False, True])).tolist() == [3.0, 3.0]
    assert as_whole(np.array([3.0, 1.0]), np.array([True, False])).tolist() == [1.0, 3.0]


def beside(rng: np.random.Generator, number: int, lasts_s: float) -> ExecutionVisits:
    """Return an execution of a robot that waits for nobody; the operator goes from place to place meanwhile."""
    robot = [PlaceVisit("home", 0.0, 0.0), PlaceVisit("tray", 10.0, 12.0), PlaceVisit("home", lasts_s, np.nan)]
    operator, at = list[PlaceVisit](), -rng.uniform(0.0, LONG_S[1])
    while at < lasts_s:
        left = at + rng.uniform(*LONG_S)
        if left > 0.0:
            place = str(rng.choice([one for one in PLACES if not operator or one != operator[-1].place]))
            operator.append(PlaceVisit(place, max(at, 0.0), left if left + 2.0 < lasts_s else np.nan))
        at = left + 2.0
    visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": operator}
    return ExecutionVisits(str(number), visits, events_of(visits))


def test_own_work_that_the_end_of_executions_cuts_is_as_long_as_it_is() -> None:
    rng = np.random.default_rng(1)
    card = learn_executions([beside(rng, n, 60.0) for n in range(120)], schema.conform(pl.DataFrame(), schema.TASKS))
    assert card is not None
    found = {gate.place: np.mean(gate.own_s) for gate in card.gates if (gate.agent, gate.at) == ("operator", "leave")}
    assert np.mean([found[place] for place in PLACES]) == pytest.approx(np.mean(LONG_S), rel=0.05)


def test_tasks_that_the_end_of_lists_cuts_take_as_long_as_they_do(tmp_path: Path) -> None:
    """Each execution is listed for 20 to 70 s, until the arm has done its tasks; the person is often still at hers."""
    rng, rows = np.random.default_rng(3), []
    for number in range(90):
        mount_s, lists_s = rng.uniform(5.0, 8.0), rng.uniform(20.0, 70.0)
        for agent, task, start_s, took_s in (
            ("arm", "pick", 0.0, 4.0), ("arm", "place", lists_s - 4.0, 4.0),
            ("human", "mount", 1.0, mount_s), ("human", "pack", 2.0 + mount_s, rng.uniform(20.0, 50.0)),
        ):  # fmt: skip
            times_s = [100.0 * number + s for s in (start_s, start_s + took_s)]
            rows.append((f"r{number}", agent, task, times_s[0], times_s[1] if start_s + took_s <= lists_s else None))
    columns = ["run", "agent", "task", "start_s", "end_s"]
    pl.DataFrame(rows, schema=columns, orient="row").write_csv(tmp_path / "tasks.csv")
    ingest([tmp_path / "tasks.csv"], tmp_path / "dataset")
    dataset = Dataset.open(tmp_path / "dataset")
    assert 0.2 < 1 - dataset.executions["complete"].mean() < 0.7
    model = learn_task_times(dataset)
    (pack,) = [task for task in model.tasks if task.task == "pack"]
    assert pack.usual_s == pytest.approx(35.0, rel=0.06)
    assert model.executions == dataset.executions["complete"].sum()
