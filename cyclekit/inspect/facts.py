"""Facts about a log, a dataset or a model, as data and as JSON values."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from cyclekit.text.numbers import fixed, given
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import polars as pl

    from cyclekit.dataset.cards import CouplingCard, TrainingCard
    from cyclekit.dataset.lost_time import LostTime
    from cyclekit.estimate.what_to_log import RecordingPlan
    from cyclekit.inspect.response import ResponseFacts
    from cyclekit.learning.task_times.saved import TaskTimesModel
    from cyclekit.scaling.override_log import OverrideResponse


@dataclass(frozen=True)
class Gap:
    """A gap in a log: start `at_s` and length `length_s`, seconds of the log's clock."""

    at_s: float
    length_s: float


@dataclass(frozen=True)
class TableFacts:
    """One table of a log.

    Attributes:
        rows: Number of rows.
        rate_hz: Mean rate of samples of one person or the robot, without gaps; None for events, and with fewer than
            two times.
        step_s: Median step between samples, s; None likewise.
        lost: Number of samples missing between rows, without gaps; None if steps are irregular.
        duration_s: Time from the first to the last row, s.
        known: Fraction of rows with a value, for each column that has any.
        gaps: Gaps, in order of time.
    """

    rows: int
    rate_hz: float | None
    duration_s: float
    known: Mapping[str, float]
    gaps: tuple[Gap, ...]
    step_s: float | None = None
    lost: int | None = None


@dataclass(frozen=True)
class Span:
    """Minimum, median and maximum of a quantity."""

    least: float
    median: float
    most: float


@dataclass(frozen=True)
class AgentFacts:
    """An agent of a task list.

    Attributes:
        kind: robot or operator.
        overlaps: Number of tasks that start before the end of an earlier one of the agent.
        overlap_s: Maximum overlap, s.
    """

    name: str
    kind: str
    tasks: int
    overlaps: int
    overlap_s: float


@dataclass(frozen=True)
class ListedTask:
    """Durations of one agent's executions of a task, s; None if no end is known.

    Attributes:
        failed: Number that failed.
        no_end: Number without an end.
    """

    agent: str
    task: str
    count: int
    mean_s: float | None
    sd_s: float | None
    least_s: float | None
    most_s: float | None
    failed: int
    no_end: int


@dataclass(frozen=True)
class TaskListFacts:
    """A task list.

    Attributes:
        executions: Number of named executions; `execution_s`: their durations.
        failed: Number of failed tasks.
        no_end: Number of tasks without an end.
        planned: Number of tasks with a planned start.
    """

    agents: tuple[AgentFacts, ...]
    tasks: tuple[ListedTask, ...]
    executions: int
    execution_s: Span | None
    failed: int
    no_end: int
    planned: int


@dataclass(frozen=True)
class SafetyFacts:
    """A safety system's log.

    Attributes:
        override: Override, weighted by time, 0 to 1; None = not logged.
        override_values: Each value of the override with its duration, s, longest first.
        override_s: Time with known override, s.
        response: Levels and ramp rates of the override; None if it has no levels.
        distance_m: Distance of the rows; None = not logged.
        distance_repeats: Share of the rows with the same distance as the row before.
    """

    override: Span | None
    override_values: tuple[tuple[float, float], ...]
    override_s: float
    distance_m: Span | None
    distance_repeats: float
    response: OverrideResponse | None = None


@dataclass(frozen=True)
class LogFacts:
    """One log file (or one folder that is a log).

    Attributes:
        rows_read: Number of data rows or messages read.
        set_aside: Number of rows not used, by reason.
        tables: Facts of `robot`, `people`, `events`, `task_list`, `safety`, if the log has them.
        levels: Levels of the logged speed scaling, ascending; `level_share`: fraction of its known rows on each.
        facts: Statements of the log about itself.
        task_list: Facts of its task list; `safety`: facts of the safety system's rows. None without any.
    """

    path: Path
    adapter: str
    package: str
    clock: str
    rows_read: int
    tables: Mapping[str, TableFacts]
    set_aside: Mapping[str, int]
    levels: tuple[float, ...]
    level_share: tuple[float, ...]
    warnings: tuple[str, ...]
    facts: Mapping[str, str]
    task_list: TaskListFacts | None = None
    safety: SafetyFacts | None = None


@dataclass(frozen=True, repr=False)
class LogsDescription(Result):
    """One log or a folder of logs; as a frame, one row per log and table.

    Attributes:
        not_read: Path and reason of each file that is not a usable log.
    """

    path: Path
    logs: tuple[LogFacts, ...]
    not_read: tuple[tuple[Path, str], ...] = ()
    kind: str = "logs"

    def _frame_rows(self) -> list[dict[str, object]]:
        names = ("rows", "rate_hz", "duration_s")
        return [
            {"log": str(log.path), "adapter": log.adapter, "table": table}
            | {name: getattr(facts, name) for name in names}
            | {"gaps": len(facts.gaps)}
            for log in self.logs
            for table, facts in log.tables.items()
        ]

    def _lines(self) -> list[str]:
        names = [f"{log.path.name}: {log.adapter}, {', '.join(log.tables)}" for log in self.logs]
        return [f"{self.path}: {len(self.logs)} logs, {len(self.not_read)} files not read", *names]


@dataclass(frozen=True, repr=False)
class DatasetDescription(Result):
    """A dataset; as a frame, one row per task of the robot, mean seconds.

    Attributes:
        sources: Number of source files; `set_aside`: number of their rows not used, by reason.
        places: Centre and radius of each robot place, m; `human_places` likewise.
        task_list: Facts of the task lists; None without any.
        safety: Facts of the safety system's logs, by recording.
        lost: Lost time by cause; None if unknown.
        positions: Agents with known positions.
        coupling: Wait conditions of robot and operator found in the logs, of which a model uses none if logged
            executions roll out worse with them; None if too few executions show both agents.
        response: Reaction time, ramps and hysteresis of the safety system; None without changes of level.
        tasks: Count, and mean seconds of motion at full speed, safety loss, dwell and wait, for each task found in the
            robot's motion.
        level_share: Share of each level among the samples on a level; `on_level`: share of all samples on a level.
        scaling_known: Fraction of samples with known scaling; `scaling_inferred`: fraction of these not logged.
        scaling_gaps: Number of samples with unknown scaling, by reason; `motion_covered`: fraction of samples in motion
            with known scaling; `scaling_sd`: median standard deviation of an inferred scaling.
        operator_seen: Fraction of samples with known operator position.
        gaps: Gaps by recording and table (`id/robot`).
        clocks: Clock fit of each recording: method, offset_s, rate, and quality (docs/clocks.md).
        operator: Number of samples in which each recording of people shows a person, and of the others by reason.
        to_log: What to log next; None if the robot's tasks are unknown.
    """

    path: Path
    schema_version: int
    recordings: int
    sources: int
    set_aside: Mapping[str, int]
    executions: int
    executions_complete: int
    duration_s: float
    samples: int
    rate_hz: float
    places: Mapping[str, Mapping[str, Any]]
    human_places: Mapping[str, Mapping[str, Any]]
    tasks: tuple[Mapping[str, Any], ...]
    levels: tuple[float, ...]
    level_share: tuple[float, ...]
    scaling_known: float
    scaling_inferred: float
    operator_seen: float
    gaps: Mapping[str, tuple[Gap, ...]]
    warnings: tuple[str, ...]
    clocks: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    operator: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    scaling_gaps: Mapping[str, int] = field(default_factory=dict)
    motion_covered: float = 0.0
    scaling_sd: float | None = None
    on_level: float = 0.0
    task_list: TaskListFacts | None = None
    safety: Mapping[str, SafetyFacts] = field(default_factory=dict)
    lost: LostTime | None = None
    positions: tuple[str, ...] = ()
    coupling: CouplingCard | None = None
    response: ResponseFacts | None = None
    kind: str = "dataset"
    verified: int | None = None
    to_log: RecordingPlan | None = None

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        from cyclekit.dataset.cards import plain

        document = super().to_dict() | {"coupling": None if self.coupling is None else plain(self.coupling)}
        document["response"] = None if self.response is None else self.response.to_dict()
        return document if self.verified is not None else {k: v for k, v in document.items() if k != "verified"}

    def _frame_rows(self) -> tuple[Mapping[str, Any], ...]:
        return self.tasks

    def _lines(self) -> list[str]:
        counts = f"{self.executions} executions, {self.samples} samples at {given(self.rate_hz)} Hz"
        return [f"{self.path}: dataset, {counts}", *(f"! {text}" for text in self.warnings)]


@dataclass(frozen=True, repr=False)
class ModelDescription(Result):
    """A model.

    Attributes:
        horizon_s: Prediction horizon, s.
        levels: Levels of the speed scaling.
        parameters: Number of parameters of the network.
        card: Training card.
    """

    path: Path
    problem: str
    network: str
    horizon_s: float
    levels: tuple[float, ...]
    parameters: int
    card: TrainingCard
    kind: str = "model"

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        return super().to_dict() | {"card": self.card.to_dict()}

    def _frame_rows(self) -> list[dict[str, object]]:
        return [{name: getattr(self, name) for name in ("problem", "network", "horizon_s", "parameters", "levels")}]

    def _lines(self) -> list[str]:
        levels = ", ".join(fixed(level, 2) for level in self.levels) or "none"
        return [f"{self.path}: {self.network} for problem {self.problem}, levels {levels}"]


@dataclass(frozen=True, repr=False)
class TaskTimesDescription(Result):
    """A model learned from task lists.

    Attributes:
        model: The model.
    """

    path: Path
    model: TaskTimesModel
    kind: str = "task times"

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {"path": str(self.path), "kind": self.kind, "card": self.model.to_dict()}

    def to_frame(self) -> pl.DataFrame:
        """Return one row per task."""
        return self.model.to_frame()

    def _lines(self) -> list[str]:
        return [f"{self.path}: model of task times, {len(self.model.card.tasks)} tasks"]


Description = LogsDescription | DatasetDescription | ModelDescription | TaskTimesDescription
