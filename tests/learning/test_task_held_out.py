"""Errors of task times on orders that were held out."""

from __future__ import annotations

import numpy as np

from cyclekit.learning.task_times.learn import learn_runs
from cyclekit.learning.task_times.runs import DoneTask, Run

TASKS = ["fetch", "place", "screw", "check", "pack"]


def test_orders_that_ran_once_do_not_make_a_bias_of_their_scatter() -> None:
    rng, runs = np.random.default_rng(4), []
    for number, pace in enumerate(rng.permutation(np.linspace(0.5, 1.5, 24)).tolist()):
        ends = np.cumsum(np.full(len(TASKS), 2.0 * pace)).tolist()
        done = zip(rng.permutation(TASKS).tolist(), [0.0, *ends], ends, strict=False)
        runs.append(Run(str(number), {"arm": tuple(DoneTask(*each) for each in done)}, number))
    judged = learn_runs(runs, {"arm": "robot"}).held_out
    assert judged is not None
    assert abs(judged.bias) < 0.02  # the mean of 1 / pace is 1.1
