"""Validation of the rollout on logged executions, and prediction intervals based on it.

Each complete execution is rolled out twice: with its own operator track, which isolates the network's error; and with
the operator tracks of all other executions, as a new sequence would be. If the operator does not react to the robot,
both agree with the log on average.

If the operator of a new cycle behaves like the logged ones, the conformal quantile of their rolled-out cycles, each
perturbed by a residual of logged executions, has its nominal coverage (Vovk's argument, as in Angelopoulos and Bates,
arXiv 2107.07511). The coverage is measured: each logged duration is compared with the rolled-out cycles of all other
operators.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import bdtr, ndtr

from cyclekit.errors import EstimateError
from cyclekit.estimate.finding import Finding
from cyclekit.estimate.operator.tracks import operator_tracks
from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit.estimate.robot.safety import OnStates, SafetyModel
from cyclekit.estimate.robot.signal_states import on_states_of
from cyclekit.estimate.statistics.bias import bias_of, half_width_95
from cyclekit.estimate.statistics.conformal import holds
from cyclekit.estimate.statistics.resample import TOGETHER
from cyclekit.estimate.validation.history import TaskTimes, chance_of_logs, order_error
from cyclekit.estimate.validation.log_level import LogLevel, log_level
from cyclekit.estimate.validation.logged import (
    logged_durations,
    logged_sequences,
    only_tracks,
    with_other_tracks,
    with_own_tracks,
)
from cyclekit.estimate.validation.several import open_wait
from cyclekit.learning.out_of_core import in_memory
from cyclekit.parallel.one_thread import one_thread
from cyclekit.text.numbers import percent, signed_percent

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.config.sequences import TaskSequence
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.operator.tracks import OperatorTracks
    from cyclekit.schema import Bools, Floats, Vector


MAX_EXECUTIONS = 200
"""Maximum number of logged executions to roll out, evenly chosen; every caller gets the same ones, so the same
correction. The standard error of the coverage is then 2 percentage points."""
ENOUGH = 1.25
"""Length of the tracks, as a multiple of the longest logged execution; longer only if a cycle does not end."""
MIN_EXECUTIONS = 3
"""Minimum number of executions to estimate the bias: fewer give no standard error."""
FEW_EXECUTIONS = 10
"""Minimum number of executions to report a coverage: fewer do not determine a 5 % quantile."""
REACTS_Z = 3.0
"""Threshold, standard errors, of the difference between durations with other and own operator tracks."""
ELSEWHERE = 0.3
"""Standard deviation of a corrected bias on other orders, as a share of the bias. Measured as the learned against the
true safety function, in cells with ramps and hysteresis."""
OWN_BIAS = 0.01
"""Minimum bias with the own operator tracks that is reported as a doubt, as a share of the duration."""
ALARMING_BIAS = 0.03
"""Minimum bias at which a number cannot be trusted although it is corrected, as a share of the duration."""
SURE = 3.0
"""Threshold, standard errors: a larger bias is significant, and so is a lack of coverage. A statistical level: at half
of it two of twelve simulated cells are called red for their coverage, at twice none, as now."""
LOOK = "clocks, frames and unknown causes in cyclekit inspect DATASET"
"""Where to look for the cause of a bias."""


@dataclass(frozen=True)
class Check:
    """Comparison of rolled-out with logged durations; errors are shares of the duration.

    Attributes:
        executions: Number of logged executions that were rolled out.
        held_out: Number of them that the network was not trained on.
        own_bias: Mean of rolled / logged - 1, each execution with its own operator track; over held-out executions if
            they are significantly worse than the others (`bias`), else over all.
        own_error: Standard error of that mean; it includes the distance of the held-out executions from it.
        crossed_bias: Mean of rolled / logged - 1 with the tracks of all other operators.
        reacts_z: Difference of the two biases in standard errors: far from 0, the operator reacts to the robot.
        residuals: logged / rolled - 1 of the same executions as `own_bias`.
        coverage: Share of logged executions between the outer conformal quantiles of the cycles with all other
            operators; None with few executions.
        coverage_held_out: `coverage` of the held-out executions; None without any.
        levels: The outer quantile levels of these coverages.
        order_error: Error of sums of logged task durations due to the order of tasks, as a share of the duration of an
            order of one task (`history.order_error`); None with few executions, or with a `level`.
        unseen_error: Standard deviation of the model's error because the logs do not show people, or what the robot
            waits for.
        level: Logged and rolled-out durations of the logged orders, to correct estimates if the logs do not show
            people; None if they do.
        rolled: Mean of the rollouts with all other operators, as a share of the mean logged duration.
        spread: Factor on the deviations of cycles from their mean, so that they scatter as logged executions of other
            orders do about their expected durations; 1 if the logs show people.
        open_wait: How far the robot's waits in another order may be off to either side, as a share of the duration,
            because several people are taken for one (`open_wait`).
    """

    executions: int
    held_out: int
    own_bias: float
    own_error: float
    crossed_bias: float
    reacts_z: float
    residuals: tuple[float, ...]
    coverage: float | None
    coverage_held_out: float | None
    levels: tuple[float, float]
    order_error: float | None = None
    unseen_error: float = 0.0
    spread: float = 1.0
    level: LogLevel | None = None
    rolled: float = 1.0
    open_wait: float = 0.0

    @property
    def look_at(self) -> str:
        """Where to look for the cause of a bias first: the first words of a sentence on it."""
        return "look at"

    @property
    def factor(self) -> float:
        """Factor on a rolled-out duration that corrects the bias with the own operator tracks, or that of `level`.

        The bias is shrunk towards 0 by its uncertainty (a positive-part James-Stein weight): a bias far above its
        standard error is corrected, one below it is not.
        """
        if self.level is not None:
            return self.level.factor
        return 1.0 / (1.0 + self.own_bias * self._sure)

    @property
    def like_for_like(self) -> float:
        """Factor on a logged mean that rolls it out as estimates are: with other operators, and corrected.

        What is left of it is the model's error and chance, which is in an estimate too, and in no saving.
        """
        return self.rolled * self.factor

    @property
    def model_error(self) -> float:
        """Standard deviation of the mean due to the network and to people not logged, as a share of the mean."""
        return float(np.hypot(self.network_error, self.unseen_error))

    @property
    def network_error(self) -> float:
        """Standard deviation of the mean due to the network's error, as a share of the mean."""
        left = 1 - self._sure, ELSEWHERE * self._sure
        return float(np.hypot(self.own_bias * np.hypot(*left), self.own_error))

    @property
    def own_within(self) -> float:
        """Half-width of the 95 % interval of the bias (Student's t, with one residual per execution)."""
        return half_width_95(self.own_error, len(self.residuals))

    @property
    def _sure(self) -> float:
        return max(0.0, 1.0 - self.own_error**2 / max(self.own_bias**2, 1e-12))

    @property
    def _reacts(self) -> bool:
        return abs(self.reacts_z) > REACTS_Z

    @property
    def with_own(self) -> str:
        """What the executions were rolled out with to find the bias."""
        return "their own operators"

    @property
    def with_others(self) -> str:
        """What they were rolled out with to find the coverage."""
        return "the operators of all others"

    def biased(self, beyond: float) -> bool:
        """Return whether the bias with the own operator tracks exceeds a share of the duration and is significant."""
        return abs(self.own_bias) > max(beyond, SURE * self.own_error)

    @property
    def doubted_bias(self) -> float:
        """Bias that nothing corrects, as a share of the duration; it widens the interval."""
        return (abs(self.crossed_bias) if self._reacts else 0.0) + self.open_wait

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What the comparison says of the rollout: its bias, its coverage, and whether the operator reacts."""
        found = [self._bias_found, self._coverage_found]
        if self._reacts:
            text = (
                f"backtest with the operators of all others: bias {signed_percent(self.crossed_bias, 1)}; the operator "
                "seems to react to the robot, which no rollout reproduces"
            )
            found.append(Finding("reacts", "amber", text))
        return tuple(found)

    @property
    def _bias_found(self) -> Finding:
        text = f"backtest with {self.with_own}: bias {signed_percent(self.own_bias, 1)}"
        if not self.biased(OWN_BIAS):
            return Finding("bias", "green", text)
        text += f" (± {percent(self.own_within, 1)}) on {self.executions} logged executions"
        text += f"; every duration is corrected by {signed_percent(self.factor - 1, 1)}"
        return Finding("bias", "red" if self.biased(ALARMING_BIAS) else "amber", text, f"{self.look_at} {LOOK}")

    @property
    def _coverage_found(self) -> Finding:
        """The coverage is red if so few executions inside their intervals are no chance (SURE)."""
        if self.coverage is None:
            text = f"{self.executions} logged executions are too few for reliable quantiles"
            return Finding("backtest", "amber", text, covered=False)
        wanted = self.levels[1] - self.levels[0]
        low = bdtr(round(self.coverage * self.executions), self.executions, wanted) < ndtr(-SURE)
        text = f"{percent(self.coverage)} of the logged executions lie in their {percent(wanted)} prediction intervals"
        if not low:
            return Finding("backtest", "green", text)
        return Finding("backtest", "red", f"only {text}", f"{self.look_at} {LOOK}")

    def residuals_of(self, count: int) -> Vector:
        """Return an error for each of `count` cycles, as a share: residuals minus their mean, repeated and shuffled."""
        off = np.resize(np.array(self.residuals) - np.mean(self.residuals), count)
        return np.asarray(np.random.default_rng(0).permutation(off))

    def single(self, cycles_s: Vector) -> Vector:
        """Return corrected cycles (K,), s, as equally probable single ones: each perturbed by a residual."""
        if self.spread != 1.0:
            mean_s = cycles_s.mean()
            cycles_s = mean_s + self.spread * (cycles_s - mean_s)
        return np.asarray(cycles_s * (1.0 + self.residuals_of(len(cycles_s))))

    def to_dict(self) -> dict[str, object]:
        """Return the validation as plain JSON values."""
        out = {name: list(value) if isinstance(value, tuple) else value for name, value in vars(self).items()}
        level = self.level.factor if self.level else None
        return out | {"findings": [one.to_dict() for one in self.findings], "level": level}


@one_thread()
def check_rollout(
    model: SafetyModel,
    dataset: Dataset,
    *,
    levels: Sequence[float] = (0.05, 0.5, 0.95),
    most: int | None = MAX_EXECUTIONS,
    seed: int = 0,
) -> Check:
    """Roll out the logged executions and compare their durations with the logs.

    Args:
        model: A model of problem `now`.
        dataset: The logs.
        levels: Quantile levels that the estimate will report.
        most: Maximum number of executions to roll out, evenly chosen, with each other's operator tracks; None: all.
        seed: Seed of the order in which logged standstills are used.

    Raises:
        EstimateError: Fewer than MIN_EXECUTIONS complete executions have an operator track and tasks of known scaling.
    """
    model = on_states_of(model, dataset)
    dataset, _ = in_memory(dataset)
    nominal = nominal_tasks(dataset)
    sequences = logged_sequences(dataset, nominal)
    _enough(dataset, len(sequences))
    longest_s = 3.0 * max(sum(nominal[task].nominal_s + nominal[task].dwell_s for task in s.tasks) for s in sequences)
    usual_s = min(ENOUGH * float(logged_durations(dataset, sequences).max()), longest_s)
    for until_s in (usual_s, longest_s):
        tracks = operator_tracks(dataset, horizon_s=until_s, model=model)
        sequences = _some([sequence for sequence in sequences if sequence.name in tracks.executions], most)
        _enough(dataset, len(sequences))
        tracks = only_tracks(tracks, {sequence.name for sequence in sequences})
        own = with_own_tracks(model, dataset, sequences, nominal, tracks)
        others = with_other_tracks(model, dataset, sequences, nominal, tracks, seed=seed)
        if np.isfinite(own).all() and not np.isinf(others).any():
            break
    logged = logged_durations(dataset, sequences)
    _enough(dataset, int((np.isfinite(own) & np.isfinite(others).any(axis=1)).sum()))
    unseen = set(model.card.held_out)
    held_out = np.array([sequence.name in unseen for sequence in sequences])
    others[np.isinf(others)] = np.nan
    part = model.unseen_error if isinstance(model, OnStates) else 0.0
    names = [sequence.name for sequence in sequences]
    level = log_level(names, logged, others, tracks.executions) if part else None
    found = replace(compare(logged, own, others, held_out, levels), level=level)
    some = np.isfinite(others).any(axis=1)
    means = np.full(len(sequences), np.nan)
    means[some] = np.nanmean(others[some], axis=1) * found.factor
    unseen_error, spread = unseen_people(part, logged / means, others[some])
    return replace(
        found,
        order_error=_order_error(model, dataset, sequences, others, means, tracks) if level is None else None,
        unseen_error=unseen_error,
        spread=spread,
        open_wait=open_wait(dataset, names, float(logged.mean())),
    )


def _order_error(
    model: SafetyModel,
    dataset: Dataset,
    sequences: Sequence[TaskSequence],
    others_s: Floats,
    means_s: Vector,
    tracks: OperatorTracks,
) -> float | None:
    """Return the error of history due to the order: see `order_error`."""
    times, chance = TaskTimes(dataset), np.zeros(len(sequences))
    if isinstance(model, OnStates):  # few operator tracks are simulated, so chance causes most of the difference
        together = TOGETHER if tracks.runs_on else 1
        chance = chance_of_logs(times, sequences, others_s, tracks.executions, together)
    return order_error(times, sequences, means_s, chance)


def unseen_people(part: float, off: Vector, others_s: Floats) -> tuple[float, float]:
    """Return `unseen_error` and `spread` of a `Check`.

    Args:
        part: Error of expected durations, as a share of the spread of logged durations.
        off: Logged over expected durations, shape (E,); NaN if the latter is unknown.
        others_s: Durations with each of K operator tracks, for the executions with known ones, shape (N, K), s.
    """
    if not part:
        return 0.0, 1.0
    logged = float(np.nanstd(off))
    rolled = float(np.nanmean((np.nanstd(others_s, axis=1) / np.nanmean(others_s, axis=1)) ** 2)) ** 0.5
    return part * logged, logged / rolled if rolled else 1.0


def _some(sequences: list[TaskSequence], most: int | None) -> list[TaskSequence]:
    """Return at most `most` sequences, evenly chosen."""
    if most is None or len(sequences) <= most:
        return sequences
    return [sequences[i] for i in np.linspace(0, len(sequences) - 1, most).astype(int)]


def _enough(dataset: Dataset, count: int) -> None:
    if count < MIN_EXECUTIONS:
        msg = f"{dataset.path}: {count} complete executions can be rolled out again; {MIN_EXECUTIONS} are needed"
        raise EstimateError(msg, cure="See what the logs lack: cyclekit inspect DATASET")


def compare(logged_s: Vector, own_s: Vector, others_s: Floats, held_out: Bools, levels: Sequence[float]) -> Check:
    """Compare rolled-out with logged durations.

    Args:
        logged_s: Logged durations, shape (E,).
        own_s: Durations rolled out with the own operator track, shape (E,).
        others_s: Durations rolled out with each of K operator tracks, shape (E, K); NaN values are ignored.
        held_out: Which executions the network was not trained on, shape (E,).
        levels: Quantile levels in (0, 1).
    """
    good = np.isfinite(own_s) & np.isfinite(others_s).any(axis=1)
    logged_s, own_s, others_s, held_out = logged_s[good], own_s[good], others_s[good], held_out[good]
    count = len(logged_s)
    mean = np.nanmean(others_s, axis=1)
    own, cross = own_s / logged_s - 1, mean / logged_s - 1
    bias = bias_of(own, held_out)
    reacts = (mean - own_s) / logged_s
    z = float(reacts.mean() / max(reacts.std(ddof=1) / np.sqrt(count), 1e-9)) if count > 2 else 0.0
    outer = min(min(levels), 1 - max(levels))
    enough = count >= FEW_EXECUTIONS
    inside = np.array([holds(y, row[np.isfinite(row)], outer) for y, row in zip(logged_s, others_s, strict=True)])
    return Check(
        executions=count,
        held_out=int(held_out.sum()),
        own_bias=bias.bias,
        own_error=bias.error,
        crossed_bias=float(cross.mean()),
        reacts_z=z,
        residuals=tuple((1 / (1 + bias.off) - 1).tolist()),
        coverage=float(inside.mean()) if enough else None,
        coverage_held_out=float(inside[held_out].mean()) if enough and held_out.any() else None,
        levels=(outer, 1 - outer),
        rolled=float(mean.mean() / logged_s.mean()),
    )
