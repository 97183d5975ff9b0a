"""Whether the waits that were learned roll logged executions out worse than none: then a model does not use them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs

from cyclekit.errors import CyclekitError
from cyclekit.estimate.joint.check import roll_logged
from cyclekit.estimate.joint.plans import Planner
from cyclekit.estimate.joint.roll import JointCell
from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit.estimate.validation.logged import logged_durations
from cyclekit.learning.coupling.learn import told_coupling
from cyclekit.learning.out_of_core import in_memory
from cyclekit.learning.unproven import unproven

if TYPE_CHECKING:
    from cyclekit.dataset.cards import CouplingCard, TrainingCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.robot.safety import SafetyModel


def with_proven_waits(model: SafetyModel, dataset: Dataset) -> TrainingCard:
    """Return the card of a model with the learned waits, or with those of the cell file alone if these do better.

    They do if squared errors of logged executions are smaller without the learned waits by more than chance. The waits
    were learned from the same executions, which is in their favour.

    Args:
        model: The safety function that was learned; its card holds the learned waits.
        dataset: The logs that they were learned from.
    """
    card, learned = model.card, model.card.coupling
    if learned is None or not any(gate.conditions and not gate.told for gate in learned.gates):
        return card
    try:
        cell = JointCell(model, dataset, learned)
        if cell.unseen or (told := told_coupling(dataset)) is None:
            return card
        dataset, _ = in_memory(dataset)
        with_waits, without = (_errors(model, dataset, coupling) for coupling in (learned, told))
    except CyclekitError:  # an estimate will report it
        return card
    if (said := unproven(with_waits, without)) is None:
        return card
    return structs.replace(card, coupling=told, warnings=(*card.warnings, said))


def _errors(model: SafetyModel, dataset: Dataset, coupling: CouplingCard) -> dict[str, float]:
    """Return the logarithm of logged over mean rolled-out duration of executions, by name."""
    cell = JointCell(model, dataset, coupling)
    rolled = roll_logged(cell, Planner(cell, nominal_tasks(dataset)), seed=0)
    logged_s = logged_durations(dataset, rolled.sequences)
    off = np.log(logged_s / rolled.cycles_s.mean(axis=1))
    return dict(zip((each.name for each in rolled.sequences), off.tolist(), strict=True))
