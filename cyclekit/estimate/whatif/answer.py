"""Cycle times before and after a change, with the same operators."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit.errors import EstimateError
from cyclekit.estimate.robot.safety import Dynamics
from cyclekit.estimate.robot.signal_states import on_states_of
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.statistics.bias import half_width_95
from cyclekit.estimate.statistics.resample import resampled
from cyclekit.estimate.validation.question import Altered
from cyclekit.estimate.whatif.alter import altered_safety, altered_tasks, altered_tracks
from cyclekit.estimate.whatif.coupled import altered_coupling
from cyclekit.parallel.one_thread import one_thread
from cyclekit.text.numbers import compact, decimals_of, difference, seconds, with_interval
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    import polars as pl

    from cyclekit.config.sequences import TaskSequence
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.operator.tracks import OperatorTracks
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.estimate.robot.nominal import NominalTask
    from cyclekit.estimate.robot.safety import SafetyModel
    from cyclekit.estimate.validation.check import Check
    from cyclekit.estimate.whatif.change import Change
    from cyclekit.schema import Vector

NO_PROOF = "This is a forecast of cycle times from logs. It is no safety proof."


@dataclass(frozen=True, repr=False)
class WhatIf(Result):
    """One sequence under one change.

    Attributes:
        change: Name of the change.
        before, after: The estimates, with the name of the sequence.
        saves_s: before - after, mean, and its 95 % interval from resampled executions (common operators); if the
            changed safety function is defined in a file, including the error of the learned one.
        safety: NO_PROOF.
    """

    change: str
    before: CycleEstimate
    after: CycleEstimate
    saves_s: tuple[float, float, float]
    safety: str = NO_PROOF

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {
            "change": self.change,
            "before": self.before.to_dict(),
            "after": self.after.to_dict(),
            "saves_s": list(self.saves_s),
            "safety": self.safety,
        }

    def to_frame(self) -> pl.DataFrame:
        """Return one row for the changed sequence, seconds."""
        import polars as pl

        saved, low, high = self.saves_s
        row = {"change": self.change, "sequence": self.after.name}
        times = {"before_s": self.before.expected_s, "after_s": self.after.expected_s}
        return pl.DataFrame([row | times | {"saves_s": saved, "saves_low_s": low, "saves_high_s": high}])

    def _lines(self) -> list[str]:
        before_s, after_s = self.before.expected_s, self.after.expected_s
        times = f"{seconds(before_s, after_s)} -> {seconds(after_s, before_s)}"
        return [f"{self.change!r}, {self.after.name!r}: {times}, saves {self.saving_in_words}"]

    @property
    def saving_in_words(self) -> str:
        """The saving as the two means differ in the text, with its interval."""
        before_s, after_s, places = self.before.expected_s, self.after.expected_s, self.decimals
        return with_interval(difference(before_s, after_s, places), *self.saves_s[1:], places)

    @property
    def decimals(self) -> int:
        """Number of decimals that all times of this result show."""
        return decimals_of(self.before.expected_s, self.after.expected_s)


@one_thread()
def what_if(
    model: SafetyModel,
    dataset: Dataset,
    sequences: Sequence[TaskSequence],
    changes: Sequence[Change],
    *,
    seed: int = 0,
    extrapolate: bool = False,
    validate: bool = True,
    check: Check | None = None,
    refused: Callable[[TaskSequence | Change, EstimateError], None] | None = None,
    other_cell: bool = False,
    progress: Callable[[float, str], None] | None = None,
) -> list[WhatIf]:
    """Estimate every sequence in the unchanged cell and under every change.

    The arguments are described at `cyclekit.what_if`. `refused` is called with each sequence that these logs cannot
    answer in the unchanged cell, and each change that they cannot answer, and the reason; the others are answered.
    Without it the first such error is raised.

    Raises:
        UnknownName: A place does not exist; the message names the change.
        ModelError: As in `estimate`.
        EstimateError: As in `estimate`; or a change cannot be answered, such as an operator who cannot come as often
            as requested.
    """
    tell = progress or (lambda fraction, text: None)

    def estimates(
        safety: SafetyModel,
        wanted: Sequence[TaskSequence],
        altered: Altered | None,
        **given: Any,  # noqa: ANN401
    ) -> dict[str, CycleEstimate]:
        asked = {"seed": seed, "extrapolate": extrapolate, "other_cell": other_cell, **given}
        return {entry.name: entry for entry in estimate(safety, dataset, wanted, altered=altered, **asked)}

    before = estimates(model, sequences, None, validate=validate, check=check, refused=refused)
    answered = [sequence for sequence in sequences if sequence.name in before]
    check = next((entry.check for entry in before.values()), None)
    moved = {
        name: entry.combined.expected_s / entry.combined.rollout_s for name, entry in before.items() if entry.combined
    }
    logged, answers = Dynamics.of(dataset.card.dynamics, model), []
    for number, change in enumerate(changes if answered else ()):
        tell(number / len(changes), change.name)
        refuse = None if refused is None else partial(_refuse_change, change, refused)
        try:
            safety = on_states_of(altered_safety(change, model, logged), dataset)
            altered = replace(_altered(change, safety, dataset, logged), moved=moved, pace=change.operator_pace)
            altered = replace(altered, coupling=altered_coupling(change, model.card.coupling))
            after = estimates(safety, answered, altered, check=_check_of(change, check), refused=refuse)
        except EstimateError as error:
            if refused is None:
                raise _named(change, error) from error
            refused(change, _named(change, error))
            continue
        names = [sequence.name for sequence in answered if sequence.name in after]
        answers += [_compared(change, before[name], _marked(change, after[name], logged), seed) for name in names]
    return answers


def _refuse_change(
    change: Change,
    refused: Callable[[TaskSequence | Change, EstimateError], None],
    _: TaskSequence,
    error: EstimateError,
) -> None:
    refused(change, _named(change, error))


def _named(change: Change, error: EstimateError) -> EstimateError:
    if change.name in error.seen:
        return error
    return EstimateError(f"change {change.name!r}: {error.seen}", nearest=error.nearest, cure=error.cure)


def _check_of(change: Change, check: Check | None) -> Check | None:
    """Return the validation for the changed cell: a function defined in a file has no network bias."""
    return check if check is None or not change.levels else replace(check, own_bias=0.0)


def _altered(change: Change, safety: SafetyModel, dataset: Dataset, logged: Dynamics) -> Altered:
    def tasks_of(tasks: Mapping[str, NominalTask]) -> dict[str, NominalTask]:
        return altered_tasks(change, tasks, dataset)

    def tracks_of(tracks: OperatorTracks, tasks: Mapping[str, NominalTask]) -> OperatorTracks:
        return altered_tracks(change, tracks, tasks, safety)

    return Altered(tasks_of, tracks_of, replace(logged, **change.dynamics))


def _marked(change: Change, after: CycleEstimate, logged: Dynamics) -> CycleEstimate:
    found = [NO_PROOF]
    if change.levels:
        found.append(_in_time(change, logged))
    if change.base_m is not None and not change.levels:
        found.append("the learned safety function is assumed to move with the robot's base")
    if change.places:
        found.append("motions to moved places are bent and stretched logged motions, not planned again")
    return replace(after, limits=(*after.limits, *found))


def _in_time(change: Change, logged: Dynamics) -> str:
    """Return a sentence on the response of s that is kept from the logs."""
    kept = {name: value for name, value in vars(logged).items() if value and name not in change.dynamics}
    if kept:
        told = ", ".join(f"{name} {compact(value, 3)}" for name, value in kept.items())
        return f"the changed safety function keeps the logged {told}"
    return "no logged latency, ramp or hysteresis is kept: none is known, or the change sets them"


def _compared(change: Change, before: CycleEstimate, after: CycleEstimate, seed: int) -> WhatIf:
    saved, means = paired_savings(before, after, seed)
    low, high = np.quantile(means, (0.025, 0.975)).tolist()
    mean, off_s = float(saved.mean()), _network_error_s(change, before)
    return WhatIf(
        change.name,
        before,
        after,
        (mean, mean - float(np.hypot(mean - low, off_s)), mean + float(np.hypot(high - mean, off_s))),
    )


def paired_savings(before: CycleEstimate, after: CycleEstimate, seed: int) -> tuple[Vector, Vector]:
    """Return the saving of each cycle with the same operator (K,), and its mean in resamples of the logs, s."""
    saved = np.array(before.durations_s) - np.array(after.durations_s)
    entries = len(saved) // max(before.executions, 1)
    names = [str(k % max(before.executions, 1)) for k in range(len(saved))]
    return saved, np.asarray(resampled(names, seed, together=min(entries, 3)) @ saved)


def _network_error_s(change: Change, before: CycleEstimate) -> float:
    """Return half the 95 % interval, s, of the error of a saving due to the network.

    Only if the changed function is defined in a file: it has no such error, but the unchanged cell has.
    """
    if not change.levels or before.check is None:
        return 0.0
    return half_width_95(before.check.model_error, len(before.check.residuals)) * before.expected_s
