"""The result of an estimate: cycle time per sequence with its distribution and its split.

Only data and its JSON form; `rollout` computes the numbers.
"""

from __future__ import annotations

import statistics
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from cyclekit.estimate.finding import doubts_of, worst
from cyclekit.text.numbers import decimals_of, fixed, with_interval
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from collections.abc import Mapping

    import polars as pl

    from cyclekit.config.sequences import PlannedTask
    from cyclekit.dataset.cards import OperatorPaceCard
    from cyclekit.dataset.cards.task_model import PaceCard
    from cyclekit.estimate.finding import Finding, Level
    from cyclekit.estimate.statistics.distribution import CycleDistribution
    from cyclekit.estimate.validation.check import Check
    from cyclekit.estimate.validation.history import Combined
    from cyclekit.plots.drawing import Drawing

SPLIT = ("nominal_s", "safety_loss_s", "dwell_s", "wait_s")
"""Attributes that add up to the cycle time of a robot, or to the time of a task."""
PARTS = 50
"""Number of equal parts of the cycle in which the operator's activity is reported."""
AWAY, ELSEWHERE = "away", "elsewhere"
"""Names of two activities: the operator is absent; he is present, but his task is unknown."""
HIDDEN = "hidden state "
"""Prefix of activities that the robot's speed alone shows."""
OF_STATES = ("signals ", "no signal of people", HIDDEN)
"""Prefixes of activities if the operator is known by states: such an activity is no place."""
MAJORITY = 0.5
"""Minimum share that is called most of something; the largest of several shares may be far less."""


@dataclass(frozen=True)
class TaskShare:
    """Mean time of one task of the sequence, split; seconds.

    `nominal_s + safety_loss_s + dwell_s + wait_s = expected_s`. `end_low_s` and `end_high_s` bound the end of the task
    in single cycles, in seconds from the start of the cycle: the lowest and the highest requested quantile. They are
    None if single cycles are unknown, and for plans of both agents, where `plan` has them.
    """

    task: str
    expected_s: float
    nominal_s: float
    safety_loss_s: float
    dwell_s: float
    wait_s: float
    end_low_s: float | None = None
    end_high_s: float | None = None


OWN_TASK = "own task before"
"""Cause of a start that the end of the agent's previous task decided."""


@dataclass(frozen=True)
class PlannedShare:
    """One task of a plan for robot and operator: means over the cycles, seconds from the first start.

    Attributes:
        agent: Name of the agent in the plan.
        kind: `robot` or `operator`.
        task: Name of the task.
        start_s, end_s: Its start and end.
        wait_s: Time from the end of the agent's previous task to the start.
        decided: Share of the cycles in which each cause decided the start: another task, the planned start, or the
            agent's previous task.
        end_low_s, end_high_s: Lowest and highest requested quantile of the end in single cycles; None if unknown.
        rest: Whether it is the rest of the agent's task before it: the robot waited on its way to the place.
    """

    agent: str
    kind: str
    task: str
    start_s: float
    end_s: float
    wait_s: float
    decided: Mapping[str, float]
    end_low_s: float | None = None
    end_high_s: float | None = None
    rest: bool = False

    @property
    def shown(self) -> str:
        """The task in a table: the rest of one is marked."""
        return f"{self.task}, continued" if self.rest else self.task

    @property
    def ended_by(self) -> tuple[str, float] | None:
        """What most often ended the wait before the task, and in which share of the cycles; None = nothing did."""
        causes = [(cause, share) for cause, share in self.decided.items() if cause != OWN_TASK]
        return max(causes, key=lambda each: each[1], default=None)


@dataclass(frozen=True, repr=False)
class CycleEstimate(Result):
    """Expected cycle time of one sequence.

    Attributes:
        name: The sequence's name in the user's file.
        places: Ordered places, the start first.
        expected_s: Mean cycle time over the operator tracks.
        expected_low_s, expected_high_s: 95 % interval of that mean. It covers finite logs (resampled tracks) and, if
            validated, the network's error and an uncorrected bias that a doubt names. It does not cover the error in
            positions that were never logged, which is unknown.
        distribution: The predictive distribution of single cycles; None if they are unknown.
        nominal_s, safety_loss_s, dwell_s, wait_s: Split of `expected_s`, with `idle_s` for a plan of both agents.
        support: Share of the rolled-out time with robot and operator positions near logged samples.
        tracks: Number of operator tracks behind the estimate.
        limits: Limits of the number that need no attention, one sentence each.
        tasks: The split per task, in order.
        safety_by_activity_s: Mean safety loss per operator activity (human task), seconds, where known.
        durations_s: Cycle time on each track, seconds, as simulated, in the order of the logged executions: to compare
            cycles with the same operator. `distribution` predicts single cycles.
        estimator: Estimator of the number: `rollout`, `average`, `history` or `nominal`.
        why: Why this estimator was used, one sentence.
        executions: Number of logged executions behind the estimate; `tracks` is larger if several start in each.
        levels: Levels of `quantiles_s`.
        calibrated: Whether `distribution` and the interval of the mean were corrected by logged executions.
        takt_s: Requested takt time, seconds.
        beats: Probability that its mean is below that of another sequence of the same work
            (`cyclekit.estimate.statistics.same_work`), by name, over common resampled executions.
        extrapolated: Whether most of the cycle runs through positions that were never logged.
        operator: Requested order of the operator's tasks; None if left open.
        findings: What is known about the basis of the number, each with a level: the traffic light above it.
        check: The validation on logged executions that corrected the estimate; None without one.
        combined: The rollout and the sum of logged task durations, whose weighted mean the estimate is; None if it is
            one of them.
        plan: Start, end and wait of each task of both agents, if both are rolled out. For task lists, `nominal_s` is
            the usual time of the robot's tasks, `safety_loss_s` the change due to concurrent tasks.
        idle_s: Mean time from the end of the robot's last task to that of the operator's; 0 if the robot ends the
            cycle.
        operator_at: Share of cycles in which the operator is at, or on the way to, each task, in PARTS equal parts of
            `expected_s`; empty if he is unknown, or if `plan` has his tasks.
        asked: The requested tasks of both agents of a plan.
        pace: Accepted changes of the operator's pace; the estimate is for the pace at their end.
        mean_pace_s: Mean cycle time at the operator's mean pace over the logged executions of task lists, to compare
            it with past cycles; None if the pace does not change.
        allowance: Factor on every cycle because the order was chosen among many by the same logs (`TaskSequence`).
    """

    name: str
    places: tuple[str, ...]
    expected_s: float
    expected_low_s: float
    expected_high_s: float
    distribution: CycleDistribution | None
    nominal_s: float
    safety_loss_s: float
    dwell_s: float
    wait_s: float
    support: float
    tracks: int
    limits: tuple[str, ...]
    tasks: tuple[TaskShare, ...]
    safety_by_activity_s: Mapping[str, float]
    durations_s: tuple[float, ...]
    estimator: str = "rollout"
    why: str = ""
    executions: int = 0
    levels: tuple[float, ...] = (0.05, 0.5, 0.95)
    calibrated: bool = False
    takt_s: float | None = None
    beats: Mapping[str, float] = field(default_factory=dict)
    extrapolated: bool = False
    operator: tuple[str, ...] | None = None
    findings: tuple[Finding, ...] = ()
    check: Check | None = field(default=None, repr=False)
    combined: Combined | None = None
    plan: tuple[PlannedShare, ...] = ()
    idle_s: float = 0.0
    operator_at: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    asked: tuple[PlannedTask, ...] = field(default=(), repr=False)
    pace: tuple[OperatorPaceCard | PaceCard, ...] = field(default=(), repr=False)
    mean_pace_s: float | None = None
    allowance: float = 1.0

    @property
    def level(self) -> Level:
        """Level of the worst finding: red, and the number cannot be trusted."""
        return worst(self.findings)

    @property
    def doubts(self) -> tuple[str, ...]:
        """The amber and red findings with their cures, one sentence each."""
        return doubts_of(self.findings)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The doubts, and the other limits of the number."""
        return (*self.doubts, *self.limits)

    @property
    def per_visit_s(self) -> float:
        """Mean time per visit, to compare cycles of different work."""
        return self.expected_s / max(len(self.places) - 1, 1)

    @property
    def quantiles_s(self) -> dict[float, float]:
        """Quantiles of single cycles, by level; empty if these are unknown."""
        if self.distribution is None:
            return {}
        return {level: self.distribution.quantile(level) for level in self.levels}

    @property
    def takt_probability(self) -> tuple[float, float, float] | None:
        """Share of the cycles within the takt time, and its 95 % interval; None without a takt, or unknown cycles."""
        return None if self.takt_s is None else self.within(self.takt_s)

    def within(self, takt_s: float) -> tuple[float, float, float] | None:
        """Return the share of the cycles within a takt time, s, and its 95 % interval; None if cycles are unknown."""
        return None if self.distribution is None else self.distribution.within(takt_s)

    @property
    def median_s(self) -> float:
        """Median of single cycles."""
        return statistics.median(self.durations_s) if self.distribution is None else self.distribution.quantile(0.5)

    @property
    def costliest_task(self) -> tuple[TaskShare, float] | None:
        """The task with the largest safety loss, and its share of the whole safety loss; None without any loss."""
        task = max(self.tasks, key=lambda share: share.safety_loss_s, default=None)
        if task is None or task.safety_loss_s <= 0 or self.safety_loss_s <= 0:
            return None
        return task, task.safety_loss_s / self.safety_loss_s

    @property
    def costliest_activity(self) -> tuple[str, float] | None:
        """The operator's activity with the largest mean safety loss, and that loss, s; None if unknown."""
        known = {name: lost for name, lost in self.safety_by_activity_s.items() if name != "unknown"}
        return max(known.items(), key=lambda entry: entry[1]) if known else None

    def plot(self) -> Drawing:
        """Return a time chart of the sequence (mean times) as a matplotlib figure."""
        from cyclekit.estimate.gantt import gantt_figure

        return gantt_figure([self])

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values, without `check`, `asked` and `pace`; quantile levels become keys such as "0.05"."""
        out = {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in vars(self).items()
            if name not in ("check", "asked", "pace", "limits", "distribution", "levels")
        }
        out["takt_probability"] = None if self.takt_probability is None else list(self.takt_probability)
        out |= {"doubts": list(self.doubts), "warnings": list(self.warnings), "level": self.level}
        out["findings"] = [one.to_dict() for one in self.findings]
        out["tasks"] = [dict(vars(task)) for task in self.tasks]
        out["plan"] = [dict(vars(task)) for task in self.plan]
        out["quantiles_s"] = {f"{level:g}": value for level, value in self.quantiles_s.items()}
        out["combined"] = None if self.combined is None else dict(vars(self.combined))
        return out | {"median_s": self.median_s, "per_visit_s": self.per_visit_s}

    def to_frame(self) -> pl.DataFrame:
        """Return one row per task, mean seconds."""
        import polars as pl

        return pl.DataFrame([dict(vars(task)) for task in self.tasks])

    @property
    def mean_in_words(self) -> str:
        """The mean with its interval: 94.4 s (95 % CI 92.9 to 95.8 s)."""
        mean_s = self.expected_s, self.expected_low_s, self.expected_high_s
        return with_interval(*mean_s, decimals_of(self.expected_s))

    def _lines(self) -> list[str]:
        names = ("motion", "safety", "dwell", "wait", *(("idle",) if self.idle_s else ()))
        times_s = zip(names, (*(getattr(self, part) for part in SPLIT), self.idle_s), strict=False)
        parts = ", ".join(f"{name} {fixed(value_s, decimals_of(self.expected_s))}" for name, value_s in times_s)
        return [f"{self.name!r} {self.mean_in_words}; {parts} s", *(f"* {text}" for text in self.doubts)]
