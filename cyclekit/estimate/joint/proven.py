"""Whether the waits that were learned roll logged executions out better than none: else a model does not use them.

Single waits may obey a condition of a kind that the learner knows, and whole executions still go otherwise: where a
zone is for one at a time, the k-th visit of one agent follows now and then the k-th of the other. So what counts is how
far the durations of whole executions, each with its own order, are from their rollouts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs

from cyclekit.dataset.cards.notes import UNPROVEN, note
from cyclekit.errors import CyclekitError
from cyclekit.estimate.joint.check import roll_logged, student
from cyclekit.estimate.joint.plans import Planner
from cyclekit.estimate.joint.roll import JointCell
from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit.estimate.validation.check import MIN_EXECUTIONS
from cyclekit.estimate.validation.logged import logged_durations
from cyclekit.learning.coupling.learn import told_coupling
from cyclekit.learning.out_of_core import in_memory

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
    names = sorted(with_waits.keys() & without.keys())
    if len(names) < MIN_EXECUTIONS:
        return card
    off = np.array([[each[name] for name in names] for each in (with_waits, without)])
    squares = (off - off.mean(axis=1, keepdims=True)) ** 2  # an estimate is corrected by the mean
    worse = squares[0] - squares[1]
    if worse.mean() <= student(len(names)) * worse.std(ddof=1) / len(names) ** 0.5:
        return card
    scatter, other = np.sqrt(squares.mean(axis=1)).tolist()
    text = (
        f"what was learned on who waits for whom is not used: the {len(names)} logged executions are off by "
        f"{scatter:.1%} from their rollouts with these waits, and by {other:.1%} with waits as a part of the work"
    )
    return structs.replace(card, coupling=told, warnings=(*card.warnings, note(UNPROVEN, text=text)))


def _errors(model: SafetyModel, dataset: Dataset, coupling: CouplingCard) -> dict[str, float]:
    """Return the logarithm of logged over mean rolled-out duration of executions, by name."""
    cell = JointCell(model, dataset, coupling)
    rolled = roll_logged(cell, Planner(cell, nominal_tasks(dataset)), seed=0)
    logged_s = logged_durations(dataset, rolled.sequences)
    off = np.log(logged_s / rolled.cycles_s.mean(axis=1))
    return dict(zip((each.name for each in rolled.sequences), off.tolist(), strict=True))
