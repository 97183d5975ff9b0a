"""The facts themselves: what is known of a log, of a dataset, of a model, as data and as JSON values."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


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
class LogFacts:
    """One log file (or one folder that is a log).

    Attributes:
        rows_read: Data rows or messages looked at.
        set_aside: Rows not used, by reason.
        tables: Facts of `robot`, `people`, `events`, where the log has them.
        levels: Levels of the logged speed scaling, ascending; `level_share`: fraction of its known rows on each.
        facts: What the log states about itself.
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


@dataclass(frozen=True)
class LogsDescription:
    """Logs, one or a folder of them.

    Attributes:
        not_read: Path and reason of each file that is no usable log.
    """

    path: Path
    logs: tuple[LogFacts, ...]
    not_read: tuple[tuple[Path, str], ...] = ()
    kind: str = "logs"

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return _plain(asdict(self))


@dataclass(frozen=True)
class DatasetDescription:
    """A dataset.

    Attributes:
        sources: Source files that went in; rows set aside from them, by reason.
        robot_place: Centre and radius per robot place, metres; `human_place` likewise.
        tasks: Per task: how often, mean seconds of motion at full speed, of safety loss, of dwell and wait.
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
    kind: str = "dataset"

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return _plain(asdict(self))


@dataclass(frozen=True)
class ModelDescription:
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
    card: Mapping[str, Any]
    kind: str = "model"

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return _plain(asdict(self))


Description = LogsDescription | DatasetDescription | ModelDescription


def _plain(value: dict[str, Any]) -> dict[str, Any]:
    """Return the value with paths as text, ready for JSON."""
    plain: dict[str, Any] = json.loads(json.dumps(value, default=str))
    return plain
