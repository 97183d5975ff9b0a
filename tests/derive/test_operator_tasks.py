"""The operator's tasks of an execution, to the robot's last task and to the start of the next execution."""

from __future__ import annotations

import numpy as np

from cyclekit import schema
from cyclekit.dataset.cards import ExecutionCard
from cyclekit.dataset.dataset import Place
from cyclekit.derive.operator_tasks import operator_tasks
from cyclekit.people.activity import OperatorStandstills

COLUMNS = list(schema.TASKS)
SPOTS = {name: Place(name, (x_m, 0.0, 1.0), 0.2, inferred=True) for name, x_m in (("bench", 1.0), ("rest", 3.0))}


def _stays(*times_s: tuple[float, float]) -> OperatorStandstills:
    at_m = np.array([[1.0, 0.0, 1.0], [3.0, 0.0, 1.0]])[: len(times_s)]
    return OperatorStandstills(0, (0.0, 10.0), [(0, 0)] * len(times_s), np.array(times_s), at_m, [], told=False)


def test_where_it_is_known_until_the_next_execution_no_visit_is_cut_by_the_robots_end() -> None:
    card = ExecutionCard(execution="a.001", session="a", start_s=0.0, end_s=10.0, complete=True)
    cut = operator_tasks([card], [_stays((4.0, 10.0))], SPOTS)
    whole = operator_tasks([card], [_stays((4.0, 13.0), (14.0, 15.0))], SPOTS, [16.0])
    ends = [[(row[COLUMNS.index("task")], row[COLUMNS.index("end_s")]) for row in rows] for rows in (cut, whole)]
    assert ends == [[("bench", None)], [("bench", 13.0), ("rest", 15.0)]]
