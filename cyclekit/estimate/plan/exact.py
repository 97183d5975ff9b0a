"""Orders as `estimate` gives them: the search looks them up in a table, what is printed of them was walked."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.config.sequences import TaskSequence
from cyclekit.estimate.rollout import estimate

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.check import Check
    from cyclekit.estimate.plan.jobs import Jobs
    from cyclekit.estimate.plan.search import Scorer
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.estimate.safety import SafetyModel
    from cyclekit.schema import Floats

    Order = tuple[str, ...]

WALKED = 10
"""Of more different orders to compare with, so many are walked, and all are looked up in the table of arrivals."""


@dataclass(frozen=True)
class Walker:
    """Estimates orders of the jobs; a number is given where little was logged too, and marked."""

    model: SafetyModel
    dataset: Dataset
    jobs: Jobs
    seed: int
    other_cell: bool

    def estimates(self, orders: Sequence[Order], *, validate: bool, check: Check | None) -> list[CycleEstimate]:
        """Return the estimate of each order; `validate` and `check` as of `estimate`."""
        wanted = [TaskSequence(f"order {n}", self.jobs.places(order)) for n, order in enumerate(orders)]
        found = estimate(
            self.model,
            self.dataset,
            wanted,
            seed=self.seed,
            extrapolate=True,
            validate=validate,
            check=check,
            other_cell=self.other_cell,
        )
        by_name = {each.name: each for each in found}
        return [by_name[each.name] for each in wanted]

    def mean_of(self, orders: Sequence[Order], table: Scorer, check: Check | None) -> Floats:
        """Return the mean duration of orders, each as often as it occurs, on each track, shape (K,), s."""
        times = Counter(orders)
        some = [list(times)[i] for i in np.linspace(0, len(times) - 1, min(len(times), WALKED)).astype(int)]
        walked = np.array([each.durations_s for each in self.estimates(some, validate=False, check=check)])
        if len(some) == len(times):
            return np.asarray(np.average(walked, axis=0, weights=[times[order] for order in some]))
        return np.asarray(table.durations(orders).mean(axis=0) * (walked.mean() / table.means(some).mean()))
