"""Signals of long logs are read once for all executions, not once for each: four times as many cost four times more."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import polars as pl
import pytest

from cyclekit import schema
from cyclekit.dataset.cards.dataset import ExecutionCard
from cyclekit.dataset.signals import SignalChanges
from cyclekit.learning.coupling.events.logged_visits import courses_of

LONG_S = 10.0


class Counted(np.ndarray):
    """Times that count how many of them were compared."""

    compared = 0

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        plain = [value.view(np.ndarray) if isinstance(value, Counted) else value for value in inputs]
        if ufunc not in (np.less, np.less_equal, np.greater, np.greater_equal):
            return np.asarray(getattr(ufunc, method)(*plain, **options)).view(Counted)
        Counted.compared += self.size
        return getattr(ufunc, method)(*plain, **options)


class Cards(list[ExecutionCard]):
    """Cards that count how often one is looked at."""

    looked = 0

    def __iter__(self) -> Any:
        for card in super().__iter__():
            Cards.looked += 1
            yield card


def _operations(executions: int, *, people: bool) -> tuple[int, int]:
    """Return how many times were compared, and how many cards looked at, for a session of one bit and one operator."""
    begins = np.arange(executions) * LONG_S
    rows: list[dict[str, Any]] = []
    for name, begin_s in enumerate(begins.tolist()):
        for index, (start, goal, at_s) in enumerate((("bin", "desk", 2.0), ("desk", "bin", 6.0))):
            times = {"start_s": begin_s + at_s - 1.0, "arrival_s": begin_s + at_s, "end_s": begin_s + at_s + 2.0}
            rows.append({"agent": "robot", "start_place": start, "goal_place": goal, "index": index, **times})
            rows[-1]["execution"] = str(name)
        if people:
            times = {"start_s": begin_s, "arrival_s": begin_s + 1.0, "end_s": begin_s + 5.0}
            rows.append({"agent": "operator", "goal_place": "desk", "index": 0, "execution": str(name), **times})
    tasks = schema.conform(pl.DataFrame(rows, infer_schema_length=None), schema.TASKS)
    t_s = np.concatenate([[-1.0], np.sort(np.concatenate([begins + 3.0, begins + 5.5]))])
    bits = {"digital-input 2": SignalChanges(t_s.view(Counted), (np.arange(len(t_s)) % 2).astype(str))}
    clock = SimpleNamespace(rate=1.0, offset_s=0)
    records: Any = [SimpleNamespace(id="r", session="s", rows={"robot": 9}, clock=clock)]
    cards = Cards(
        ExecutionCard(execution=str(n), session="s", start_s=at, end_s=at + LONG_S - 1.0, complete=True)
        for n, at in enumerate(begins.tolist())
    )
    Counted.compared = Cards.looked = 0
    assert len(courses_of(cards, tasks, records, lambda *_: None, lambda _: bits)) == executions
    return Counted.compared, Cards.looked


@pytest.mark.parametrize("people", [True, False])
def test_four_times_as_many_executions_cost_at_most_five_times_more(people: bool) -> None:
    (few, few_cards), (many, many_cards) = (_operations(n, people=people) for n in (25, 100))
    assert few_cards > 0
    assert many_cards <= 5 * few_cards
    assert many <= 5 * max(few, 50)
