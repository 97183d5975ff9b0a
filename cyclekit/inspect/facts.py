"""The facts themselves: what is known of a log, of a dataset, of a model, as data and as JSON values."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

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
    """A silence in a log: from `at_s` on, `length_s` long, seconds of the log's own clock."""

    at_s: float
    length_s: float


@dataclass(frozen=True)
class TableFacts:
    """One table of a log.

    Attributes:
        rows: Number of rows.
        rate_hz: Samples of a person or of the robot a second on average, gaps left out; None below two instants, and
            of events.
        step_s: Median step between them; None likewise.
        lost: Samples missing between rows, gaps left out; None where steps are of any length.
        duration_s: From the first instant to the last.
        known: Fraction of rows that hold a value, per column that holds any.
        gaps: Silences, in order of time.
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
    """Least, median and most of a quantity."""

    least: float
    median: float
    most: float


@dataclass(frozen=True)
class AgentFacts:
    """An agent of a task list.

    Attributes:
        kind: robot or operator.
        overlaps: Tasks that start before an earlier one of the agent has ended; `overlap_s`: by how much at most.
    """

    name: str
    kind: str
    tasks: int
    overlaps: int
    overlap_s: float


@dataclass(frozen=True)
class ListedTask:
    """What one agent's executions of a task took, seconds; None where no end is known.

    Attributes:
        failed: How many failed.
        no_end: How many have no end.
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
        executions: How many are named; `execution_s`: how long they lasted.
        failed: Tasks that failed.
        no_end: Tasks without an end.
        planned: Tasks with a planned start.
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
    """A safety system's log of itself.

    Attributes:
        override: Over time, 0 to 1; None = not logged.
        override_values: Each value with the seconds it held, the longest first.
        override_s: Seconds in which it is known.
        response: Its levels and how fast it falls and rises; None where it is no staircase.
        distance_m: Of the rows; None = not logged.
        distance_repeats: Part of the rows whose distance is that of the row before.
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
        rows_read: Data rows or messages looked at.
        set_aside: Rows not used, by reason.
        tables: Facts of `robot`, `people`, `events`, `task_list`, `safety`, where the log has them.
        levels: Levels of the logged speed scaling, ascending; `level_share`: fraction of its known rows on each.
        facts: What the log states about itself.
        task_list: What its task list says; `safety`: what a safety system logged of itself. None where it has none.
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
    """Logs, one or a folder of them; as a frame one row per log and table.

    Attributes:
        not_read: Path and reason of each file that is no usable log.
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

    def _said(self) -> list[str]:
        names = [f"{log.path.name}: {log.adapter}, {', '.join(log.tables)}" for log in self.logs]
        return [f"{self.path}: {len(self.logs)} logs, {len(self.not_read)} files not read", *names]


@dataclass(frozen=True, repr=False)
class DatasetDescription(Result):
    """A dataset; as a frame one row per task found, mean seconds.

    Attributes:
        sources: Source files that went in; rows set aside from them, by reason.
        robot_place: Centre and radius per robot place, metres; `human_place` likewise.
        task_list: What the task lists in it say; None without any.
        safety: What each recording of a safety system's log says, by recording.
        lost: Lost time by cause; None where nothing of it is known.
        positions: Of whom places are known.
        coupling: Who waits for whom; None where too few executions show both agents.
        response: Reaction time, ramps and hysteresis of the safety system; None where no change of level was seen.
        tasks: Per task found in the robot's motion: how often, mean seconds of motion at full speed, of safety loss, of
            dwell and wait.
        level_share: Per staircase level, fraction of those samples that are on a level; `on_level`: of all samples, the
            fraction that is.
        scaling_known: Fraction of the samples whose scaling is known; `scaling_inferred`: of those, not logged.
        scaling_gaps: Why it is unknown in the others: samples by reason; `motion_covered`: fraction of the samples of
            moving robots in which it is known; `scaling_sd`: median standard deviation of an inferred one.
        operator_seen: Fraction of the samples in which the operator's position is known.
        gaps: Silences per recording and table (`id/robot`), where there are any.
        clocks: How each recording's clock was related to its session's, by recording: method, offset_s, rate, and
            what is known of how good that is (docs/clocks.md).
        operator: Samples in which each recording of people saw somebody, and why nobody in the others.
        to_log: What to log next; None where the robot's tasks are not known.
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

    def _said(self) -> list[str]:
        counts = f"{self.executions} executions, {self.samples} samples at {self.rate_hz:g} Hz"
        return [f"{self.path}: dataset, {counts}", *(f"! {text}" for text in self.warnings)]


@dataclass(frozen=True, repr=False)
class ModelDescription(Result):
    """A model.

    Attributes:
        horizon_s: How far ahead the target lies or reaches.
        levels: Staircase levels that it knows.
        parameters: How many numbers the network has.
        card: How it came about, as written when it was trained.
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

    def _said(self) -> list[str]:
        levels = ", ".join(f"{level:.2f}" for level in self.levels) or "none"
        return [f"{self.path}: {self.network} for problem {self.problem}, levels {levels}"]


@dataclass(frozen=True, repr=False)
class TaskTimesDescription(Result):
    """A model that was learned from task lists.

    Attributes:
        model: What it knows.
    """

    path: Path
    model: TaskTimesModel
    kind: str = "task times"

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {"path": str(self.path), "kind": self.kind, "card": self.model.to_dict()}

    def to_frame(self) -> pl.DataFrame:
        """One row per task."""
        return self.model.to_frame()

    def _said(self) -> list[str]:
        return [f"{self.path}: model of task times, {len(self.model.card.tasks)} tasks"]


Description = LogsDescription | DatasetDescription | ModelDescription | TaskTimesDescription
