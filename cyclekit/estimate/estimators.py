"""The estimators by name: a line here makes one known to `estimate` and to what it says of its numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cyclekit.estimate.rivals import by_average, by_history, by_nominal

if TYPE_CHECKING:
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.program import Program
    from cyclekit.estimate.tracks import OperatorTracks
    from cyclekit.estimate.walk import Rolled

    Alone = Callable[[Dataset, Program, int], Rolled]
    Beside = Callable[[Any, Program, OperatorTracks, int], Rolled]


@dataclass(frozen=True)
class Estimator:
    """One way from a laid-out sequence to its cycles.

    Attributes:
        why: Why it is used, as the estimate says it.
        needs: Problem that the model must predict; None = any.
        alone: Gives cycles from the dataset, the program and a seed, without operator tracks.
        beside: Gives a program's cycles beside tracks, from the model, the program, the tracks and a seed. With
            neither, all programs are walked together in time steps.
        goals: The tracks must say where the operator is bound for.
    """

    why: str
    needs: str | None = None
    alone: Alone | None = None
    beside: Beside | None = None
    goals: bool = False


ESTIMATORS: dict[str, Estimator] = {
    "rollout": Estimator("simulation of the learned safety function with every logged operator track", "now"),
    "average": Estimator("task durations from predicted mean scalings", "average", beside=by_average, goals=True),
    "history": Estimator("logged durations of the same tasks", alone=by_history),
    "nominal": Estimator("time without an operator", alone=by_nominal),
}
"""Estimators by name."""
