"""How a model does on logged executions: asked by most estimates, and what takes most of their time.

Of one model and one dataset it is computed once in a process; another model, dataset or level is another question.
"""

from __future__ import annotations

import pickle
from typing import TYPE_CHECKING, Any

import pytest

from cyclekit.estimate.validation.check import Check, check_rollout

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.robot.safety import SafetyModel

_KNOWN: dict[bytes, Check] = {}


@pytest.fixture(scope="module", autouse=True)
def judged_once() -> Iterator[None]:
    """Let estimates of a module, and of other modules that ask for it, remember what they found."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cyclekit.estimate.limits.check_rollout", _remembered)
        yield


def _remembered(model: SafetyModel, dataset: Dataset, **options: Any) -> Check:
    try:
        question = pickle.dumps((model, dataset.path, dataset.card, options))
    except (AttributeError, TypeError, pickle.PicklingError):  # a model that a test made up
        return check_rollout(model, dataset, **options)
    if question not in _KNOWN:
        _KNOWN[question] = check_rollout(model, dataset, **options)
    return _KNOWN[question]
