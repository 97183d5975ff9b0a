"""Orders of both agents' tasks: what always followed each other in the logs stays together."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from cyclekit.dataset.cards.task_model import NeedCard, TaskModelCard, TaskTimesCard
from cyclekit.estimate.plan.task_orders import JobTask, TaskJobs, plan_tasks
from cyclekit.learning.task_times.runs import DoneTask, Run, always_in_a_row

JOBS = [["pick", "place"], ["pick", "place"], ["drill"], ["drill"]]


def runs(count: int, *, split: bool = False, ends: bool = False) -> list[Run]:
    """Return executions of a robot whose jobs come in any order.

    `split`: once a drill comes between pick and place; `ends`: it always begins with a scan and goes home at the end.
    """
    rng = np.random.default_rng(1)
    found = []
    for number in range(count):
        names = [task for job in rng.permutation(len(JOBS)) for task in JOBS[job]]
        names = ["pick", "drill", "place"] if split and not number else names
        names = ["scan", *names, "home"] if ends else names
        done = tuple(DoneTask(task, 2.0 * at, 2.0 * at + 1.0) for at, task in enumerate(names))
        found.append(Run(str(number), {"arm": done}, number))
    return found


def model() -> TaskModelCard:
    """Return a robot that may only place when the operator has opened, which takes him long after each pick."""
    usual: dict[str, Any] = {"rates": {}, "after": {}, "lags_s": (0.0,)}
    times_s = {("arm", "pick"): 2.0, ("arm", "place"): 2.0, ("arm", "drill"): 8.0, ("worker", "open"): 9.0}
    times_s |= {("arm", "scan"): 1.0, ("arm", "home"): 1.0}
    needs = {"place": (NeedCard(agent="worker", task="open"),), "open": (NeedCard(agent="arm", task="pick"),)}
    cards = tuple(
        TaskTimesCard(agent=agent, task=task, usual_s=s, work_s=(s, 1.01 * s), needs=needs.get(task, ()), **usual)
        for (agent, task), s in times_s.items()
    )
    return TaskModelCard(agents={"arm": "robot", "worker": "operator"}, tasks=cards, executions=20)


def planned(logged: list[Run], places: int = 2, **more: int) -> tuple[list[str], float]:
    times = {"pick": 2, "place": places, "drill": 2, **more}
    tasks = [JobTask("arm", name, many) for name, many in times.items()]
    found = plan_tasks(model(), TaskJobs((*tasks, JobTask("worker", "open", 2))), logged)
    return [task.name for task in found.tasks if task.agent == "arm"], found.estimate.expected_s


def test_tasks_that_always_followed_each_other_stay_together() -> None:
    assert always_in_a_row(runs(20)) == {("arm", "place"): "pick"}
    together, s = planned(runs(20))
    assert [b for a, b in pairwise(together) if a == "pick"] == ["place", "place"]
    free, free_s = planned([])
    assert "drill" in [b for a, b in pairwise(free) if a == "pick"]
    assert free_s < s - 5.0


@pytest.mark.parametrize("logged", [runs(20, split=True), runs(2)])
def test_tasks_are_free_that_once_were_apart_or_of_which_few_orders_are_known(logged: list[Run]) -> None:
    assert not always_in_a_row(logged)


def test_tasks_are_free_that_the_work_has_not_equally_often() -> None:
    order, _ = planned(runs(20), places=1)
    assert sorted(order) == ["drill", "drill", "pick", "pick", "place"]


def test_what_an_agent_always_did_first_or_last_stays_there() -> None:
    logged = runs(20, ends=True)
    assert always_in_a_row(logged) == {("arm", "place"): "pick", ("arm", "scan"): "", ("arm", ""): "home"}
    order, _ = planned(logged, home=1, scan=1)
    assert (order[0], order[-1]) == ("scan", "home")
    assert [b for a, b in pairwise(order) if a == "pick"] == ["place", "place"]
