"""What an estimate says: cycle time per sequence with its distribution and its split.

Only data and its JSON form; `rollout` computes the numbers.
"""

from __future__ import annotations

import statistics
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from cyclekit.text.results import Result

if TYPE_CHECKING:
    from collections.abc import Mapping

    import polars as pl

    from cyclekit.config.sequences import PlannedTask
    from cyclekit.estimate.check import Check
    from cyclekit.estimate.history import Combined
    from cyclekit.plots.drawing import Drawing

PARTS = 50
"""In so many parts of the cycle it is told what the operator does."""
AWAY, ELSEWHERE = "away", "elsewhere"
"""What he does where he is not there, and where it is not known at which of his tasks he is."""
OF_STATES = ("signals ", "no signal of people", "hidden state ")
"""What he does begins with one of these where he is known by states: then it is no place."""
MOST = 0.5
"""A share is called most of something only above this part of it; the largest of several may be far less."""


@dataclass(frozen=True)
class TaskShare:
    """Mean time of one task of the sequence, split; seconds.

    `nominal_s + safety_loss_s + dwell_s + wait_s = expected_s`. Between `end_low_s` and `end_high_s` (seconds from the
    start of the cycle) it ends in single cycles: the lowest and the highest quantile that was asked for; None where
    single cycles are not known, and of plans for both agents, whose tasks have them in `plan`.
    """

    task: str
    expected_s: float
    nominal_s: float
    safety_loss_s: float
    dwell_s: float
    wait_s: float
    end_low_s: float | None = None
    end_high_s: float | None = None


@dataclass(frozen=True)
class PlannedShare:
    """One task of a plan for robot and operator: means over the cycles, seconds from the first start.

    Attributes:
        agent: Its name in the plan; `kind`: robot or operator.
        task: Its name.
        start_s, end_s: When it starts and ends.
        wait_s: Time from the end of the agent's own task before it to its start.
        decided: In which part of the cycles what decided the start: another task, the planned start, or the agent's own
            task before it.
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


@dataclass(frozen=True, repr=False)
class CycleEstimate(Result):
    """Expected cycle time of one sequence.

    Attributes:
        name: The sequence's name in the user's file.
        places: Ordered places, the start first.
        expected_s: Mean cycle time over the operator tracks.
        expected_low_s, expected_high_s: 95 % interval of that mean: finite logs by resampling the tracks, and where
            it was validated the network's error, and a bias that a doubt names and nothing takes out. What is off in
            positions that were never logged is not known and not in it.
        quantiles_s: Quantiles of single cycles, by level.
        nominal_s, safety_loss_s, dwell_s, wait_s: Split of `expected_s`, with `idle_s` of a plan for both.
        support: Fraction of the rolled-out time whose robot and operator positions lie near logged samples.
        tracks: Number of logged operator tracks it rests on.
        doubts: What makes the number itself doubtful, one sentence each: shown beside it.
        warnings: These, and what else limits the number.
        tasks: The split per task, in order.
        safety_by_activity_s: Mean safety loss per operator activity (human task), seconds, where known.
        durations_s: Cycle time on each track, seconds, in the order of the executions they were logged in.
        estimator: What made the number: `rollout`, `average`, `history` or `nominal`.
        why: Why that one, one sentence.
        executions: Number of logged executions it rests on; `tracks` can be more, entered at several instants of each.
        calibrated: Whether `quantiles_s` and the interval of the mean were corrected by logged executions.
        takt_s: Takt time that was asked about, seconds.
        takt_probability: Part of the cycles that meet it, and its 95 % interval from resampling executions, no narrower
            than Wilson's of so many executions.
        beats: Probability that its mean is below that of another sequence of the same work
            (`cyclekit.estimate.same_work`), by name, over common resampled executions.
        extrapolated: Marked: most of it runs through positions that were never logged.
        operator: What the operator was asked to do meanwhile; None where that was left open.
        check: The validation on logged executions that corrected it; None where there was none.
        combined: The rollout and the sum of logged task durations that it is the weighted mean of; None where it rests
            on one of them.
        plan: Start, end and wait of each task of both agents, where both are rolled out. Of task lists `nominal_s`
            is the robot's tasks as long as usual, `safety_loss_s` what differs as other tasks go on beside them.
        idle_s: From the end of the robot's last task to that of the operator's, mean; 0 where the robot ends the cycle.
        operator_at: In which part of the cycles the operator is at each task or on the way to it, in PARTS equal parts
            of `expected_s`; empty where he is not known, and where `plan` has his tasks.
        asked: The tasks of both agents as a plan was asked for.
    """

    name: str
    places: tuple[str, ...]
    expected_s: float
    expected_low_s: float
    expected_high_s: float
    quantiles_s: Mapping[float, float]
    nominal_s: float
    safety_loss_s: float
    dwell_s: float
    wait_s: float
    support: float
    tracks: int
    warnings: tuple[str, ...]
    tasks: tuple[TaskShare, ...]
    safety_by_activity_s: Mapping[str, float]
    durations_s: tuple[float, ...]
    estimator: str = "rollout"
    why: str = ""
    executions: int = 0
    calibrated: bool = False
    takt_s: float | None = None
    takt_probability: tuple[float, float, float] | None = None
    beats: Mapping[str, float] = field(default_factory=dict)
    extrapolated: bool = False
    operator: tuple[str, ...] | None = None
    doubts: tuple[str, ...] = ()
    check: Check | None = field(default=None, repr=False)
    combined: Combined | None = None
    plan: tuple[PlannedShare, ...] = ()
    idle_s: float = 0.0
    operator_at: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    asked: tuple[PlannedTask, ...] = field(default=(), repr=False)

    @property
    def per_visit_s(self) -> float:
        """Mean time per visit: what cycles of different work can be held against each other by."""
        return self.expected_s / max(len(self.places) - 1, 1)

    @property
    def median_s(self) -> float:
        """Median of single cycles."""
        return self.quantiles_s[0.5] if 0.5 in self.quantiles_s else statistics.median(self.durations_s)

    @property
    def costliest_task(self) -> tuple[TaskShare, float] | None:
        """The task that loses most to safety, and its part of the whole safety loss; None where nothing is lost."""
        task = max(self.tasks, key=lambda share: share.safety_loss_s, default=None)
        if task is None or task.safety_loss_s <= 0 or self.safety_loss_s <= 0:
            return None
        return task, task.safety_loss_s / self.safety_loss_s

    @property
    def costliest_activity(self) -> tuple[str, float] | None:
        """The operator's activity that cost most, and its mean loss in seconds; None where none is known."""
        known = {name: lost for name, lost in self.safety_by_activity_s.items() if name != "unknown"}
        return max(known.items(), key=lambda entry: entry[1]) if known else None

    def plot(self) -> Drawing:
        """Return the sequence as a time chart, mean times, as a matplotlib figure."""
        from cyclekit.estimate.gantt import gantt_figure

        return gantt_figure([self])

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values, without `check` and `asked`; quantile levels become keys such as "0.05"."""
        out = {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in vars(self).items()
            if name not in ("check", "asked")
        }
        out["tasks"] = [dict(vars(task)) for task in self.tasks]
        out["plan"] = [dict(vars(task)) for task in self.plan]
        out["quantiles_s"] = {f"{level:g}": value for level, value in self.quantiles_s.items()}
        out["combined"] = None if self.combined is None else dict(vars(self.combined))
        return out | {"median_s": self.median_s, "per_visit_s": self.per_visit_s}

    def to_frame(self) -> pl.DataFrame:
        """One row per task, mean seconds."""
        import polars as pl

        return pl.DataFrame([dict(vars(task)) for task in self.tasks])

    def _said(self) -> list[str]:
        expected = f"{self.expected_s:.1f} s (95% CI {self.expected_low_s:.1f} to {self.expected_high_s:.1f} s)"
        parts = f"motion {self.nominal_s:.1f}, safety {self.safety_loss_s:.1f}, dwell {self.dwell_s:.1f}"
        parts += f", wait {self.wait_s:.1f}" + (f", idle {self.idle_s:.1f}" if self.idle_s else "")
        return [f"{self.name!r} {expected}; {parts} s", *(f"* {text}" for text in self.doubts)]
