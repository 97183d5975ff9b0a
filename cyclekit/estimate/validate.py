"""The validation on logged executions behind every estimate, and the models that it refuses.

A model with a large bias on the logs themselves predicts no other sequence: usually it is of another cell.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.errors import EstimateError, ModelError
from cyclekit.estimate.check import Check, check_rollout

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.safety import SafetyModel

REFUSED_BIAS = 0.1
"""A model with a larger bias on the logged executions is refused."""


def validated(
    model: SafetyModel, dataset: Dataset, *, levels: Sequence[float] = (0.05, 0.5, 0.95), seed: int
) -> tuple[Check | None, tuple[str, ...]]:
    """Return how the rollout does on logged executions; None and why in a sentence where they are too few for that."""
    try:
        return check_rollout(model, dataset, levels=levels, seed=seed), ()
    except EstimateError as error:
        return None, (f"not validated on logged executions, so no bias is known or corrected: {error.seen}",)


def refuse_biased(check: Check | None) -> None:
    """Refuse a model with a large bias on the logged executions.

    Raises:
        ModelError: Its bias is beyond REFUSED_BIAS, and no chance.
    """
    if check is not None and check.biased(REFUSED_BIAS):
        seen = f"{check.own_bias:+.1%} (+-{check.own_within:.1%}) on {check.executions} logged executions"
        raise ModelError(
            f"the model does not fit these logs: backtested with their own operator tracks, its bias is {seen}",
            cure="Train it on them: cyclekit train DATASET --out MODEL; or add --other-cell to estimate anyway "
            "(from Python other_cell=True).",
        )
