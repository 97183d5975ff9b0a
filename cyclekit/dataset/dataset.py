"""The dataset: a folder of Parquet files with its provenance, opened for reading.

    DATASET/dataset.json                                  schema version, provenance, executions, places, levels
    DATASET/recordings/<id>/{robot,people,events}.parquet native rate, SI, each log's own clock
    DATASET/shared/<table>-<number>.parquet               the same of many short recordings; `index.json` locates each
    DATASET/samples/<part>.parquet                        `rate_hz`, one clock, one base frame; of one or more sessions
    DATASET/tasks.parquet                                 one row per executed task
    DATASET/quarantine.parquet                            every row set aside, with file, row and reason

A dataset is put in place as a whole (`atomic`). `ingest` decides the content of the tables.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import msgspec
import polars as pl

from cyclekit import schema
from cyclekit.dataset.files import DatasetFiles
from cyclekit.dataset.opening import opened_card
from cyclekit.dataset.recorded_tables import RecordedTables
from cyclekit.dataset.signals import logged_bits
from cyclekit.errors import DatasetError, UnknownName, command_line
from cyclekit.storage.identify import DATASET_CARD
from cyclekit.storage.remote.folders import local
from cyclekit.text.results import html_table

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from cyclekit.config import Furniture
    from cyclekit.dataset.cards import DatasetCard, ExecutionCard, PlaceCard, RecordingCard
    from cyclekit.dataset.checksums import Stamp
    from cyclekit.dataset.signals import SignalChanges
    from cyclekit.plots.drawing import Drawing

People = Literal["auto", "positions", "signals"]
"""Source of information on people."""
CARD, TASKS, QUARANTINE = DATASET_CARD, "tasks.parquet", "quarantine.parquet"


@dataclass(frozen=True)
class Place:
    """A named place of the cell, where the robot (or the operator) stops.

    Attributes:
        xyz_m: Centre in the base frame, metres.
        radius_m: Radius within which a position counts as at the place.
        inferred: Whether it was found in the logs; False if the cell file names it.
        label: Display name from the cell file; None without one.
    """

    name: str
    xyz_m: tuple[float, float, float]
    radius_m: float
    inferred: bool
    label: str | None = None

    @property
    def shown(self) -> str:
        """Display name: the label, else the name."""
        return self.label or self.name


class Dataset:
    """A dataset opened for reading; tables are read on demand."""

    def __init__(self, path: Path, card: DatasetCard, place: str | None = None, stamp: Stamp | None = None) -> None:
        """Store the arguments; use `Dataset.open` instead.

        Args:
            path: Its folder on this machine.
            card: Content of its `dataset.json`.
            place: Path or URL by which any machine can open it; default: the folder.
            stamp: Stamp of the file of the card, which shows later whether another ingest replaced the dataset.

        `is_part` is True for the result of `only`; `people` is the argument of `by_people`.
        """
        self.path = path
        self.card = card
        self.place = place or str(path)
        self.is_part = False
        self.people: People = "auto"
        self._stamp = stamp
        self._files = DatasetFiles(path, card.files, stamp)
        self._recorded = RecordedTables(path, self._files, card.recordings)

    def __repr__(self) -> str:
        """Return its place and the number of executions."""
        return f"Dataset: {self.place}, {len(self.card.executions)} executions"

    def plot(self) -> Drawing:
        """Return a figure of the duration of each execution, split by its robot tasks (matplotlib)."""
        from cyclekit.plots.results import PARTS, executions_figure

        seconds = [pl.col(name).sum() for name, _, _ in PARTS]
        spent = self.executions.join(self.tasks().group_by("execution").agg(seconds), on="execution", how="left")
        spent = spent.sort("session", "start_s")
        parts = {name: spent[name].fill_null(0.0).to_list() for name, _, _ in PARTS}
        return executions_figure(spent["duration_s"].to_list(), parts)

    def _repr_html_(self) -> str:
        """Return the executions as a small table for a notebook."""
        return html_table(repr(self), self.executions)

    @classmethod
    def open(cls, path: Path | str) -> Dataset:
        """Open the dataset at `path`, a folder or a URL (`storage`).

        Raises:
            DatasetError: There is no dataset, or it is of another schema version.
            StorageError: The URL cannot be read.
        """
        place, path = str(path), local(path)
        card, stamp = opened_card(path)
        return cls(path, card, place, stamp)

    @classmethod
    def of(cls, given: Dataset | Path | str) -> Dataset:
        """Return an open dataset unchanged, and open one given by its folder or URL."""
        return given if isinstance(given, Dataset) else cls.open(given)

    def only(self, executions: Sequence[str]) -> Dataset:
        """Return a view of the dataset with these executions only: their samples, tasks and entries.

        Raises:
            UnknownName: An execution is not in the dataset.
        """
        card = msgspec.structs.replace(self.card, executions=tuple(self._execution(name) for name in executions))
        part = Dataset(self.path, card, self.place, self._stamp)
        part.is_part, part.people = True, self.people
        return part

    def by_people(self, people: People) -> Dataset:
        """Return a view of the dataset with people known only by positions or by signals; auto: the more frequent one.

        Raises:
            DatasetError: No execution has that kind of information.
        """
        missing = {"positions": "people" not in self.positions, "signals": not self.card.operator_signals}
        if missing.get(people, False):
            msg = f"{self.place}: no log holds {people} of people"
            raise DatasetError(msg, cure="Leave --people out (from Python people), or ingest logs that hold them.")
        if people == self.people:
            return self
        alike = Dataset(self.path, self.card, self.place, self._stamp)
        alike.is_part, alike.people = self.is_part, people
        return alike

    @cached_property
    def executions(self) -> pl.DataFrame:
        """One row per execution: execution, session, start_s, end_s, duration_s, complete (Bool).

        `complete`: the log shows all of it, and it was not interrupted.
        """
        rows = [[one.execution, one.session, one.start_s, one.end_s, one.whole] for one in self.card.executions]
        types = {"execution": schema.TEXT, "session": schema.TEXT, "start_s": schema.F64, "end_s": schema.F64}
        frame = pl.DataFrame(rows, schema={**types, "complete": schema.FLAG}, orient="row")
        return frame.with_columns(duration_s=pl.col("end_s") - pl.col("start_s"))

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return self.card.rate_hz

    @property
    def places(self) -> dict[str, Place]:
        """Robot places by name."""
        return {name: self._place(name, one) for name, one in self.card.places.items()}

    @property
    def human_places(self) -> dict[str, Place]:
        """Operator places by name (empty if neither the cell file nor events name any)."""
        return {name: self._place(name, one) for name, one in self.card.human_places.items()}

    def _place(self, name: str, card: PlaceCard) -> Place:
        label = self.label(name)
        return Place(name, card.xyz_m, card.radius_m, card.inferred, None if label == name else label)

    def label(self, place: str) -> str:
        """Return the display name of a place of robot or operator: its label in the cell file, else its name."""
        settings = self.card.settings
        named = settings.places.get(place) or settings.human_places.get(place)
        return named.label if named is not None and named.label else place

    def task_label(self, task: str) -> str:
        """Return the display name of a task `start->goal`, made of the labels of its places."""
        return "->".join(self.label(place) for place in task.split("->"))

    @property
    def furniture(self) -> dict[str, Furniture]:
        """Objects in the cell, by name, from the cell file."""
        return dict(self.card.settings.furniture)

    @property
    def levels(self) -> tuple[float, ...]:
        """Staircase levels found in the logged scaling, ascending; empty if none were found."""
        return self.card.levels

    @property
    def recordings(self) -> tuple[RecordingCard, ...]:
        """Provenance of each recording, as in the card: id, session, sources, adapter, clock, frame, rows, warnings."""
        return self.card.recordings

    def samples(self, executions: Sequence[str] | None = None, columns: Sequence[str] | None = None) -> pl.DataFrame:
        """Return the samples at `rate_hz`, all or of some executions, ordered by execution and time.

        Args:
            executions: Names of executions; None = all.
            columns: Columns of table SAMPLES; None = all. With few columns, months of logs fit into memory.
        """
        wanted = list(schema.SAMPLES if columns is None else columns)
        if executions is None and self.is_part:
            executions = self.executions["execution"].to_list()
        entries = None if executions is None else [self._execution(name) for name in executions]
        files = self._files.of_samples(None if entries is None else {one.part or one.session for one in entries})
        if not files:
            return schema.empty(schema.SAMPLES).select(wanted)
        self._files.check_memory(files, wanted, None if executions is None else self._rows_of(executions))
        if executions is None:
            return self._files.collected(self._scan(files, wanted), "samples")  # reads many files at once
        mine = pl.col("execution").is_in(list(executions))  # filtered per file, to save memory
        needed = list(dict.fromkeys(["execution", *wanted]))
        scans = [self._scan([file], needed).filter(mine).select(wanted) for file in files]
        return pl.concat([self._files.collected(scan, "samples") for scan in scans])

    def summed_up(self, summary: Callable[[pl.LazyFrame], pl.LazyFrame]) -> pl.DataFrame:
        """Return the summary of all samples, which may be more than fit into memory.

        Args:
            summary: Makes it of the samples, both as lazy frames.
        """
        files = self._files.of_samples(None)
        samples = self._scan(files, list(schema.SAMPLES)) if files else schema.empty(schema.SAMPLES).lazy()
        return self._files.collected(summary(self._mine(samples)), "samples")

    @property
    def positions(self) -> tuple[str, ...]:
        """Agents with known positions: `robot`, `people`."""
        tables = {table for record in self.recordings for table in record.tables}
        told = self.card.positions
        return tuple(told if told is not None else (whose for whose in ("robot", "people") if whose in tables))

    @property
    def holds_task_lists_alone(self) -> bool:
        """Whether it was made of task lists without the robot's log."""
        return "task lists" in self._held_alone()

    def _held_alone(self) -> list[str]:
        """Return the kinds of logs it was made of if none has positions; else nothing."""
        names = {"task_list": "task lists", "safety": "overrides or distances"}
        held = [text for table, text in names.items() if any(table in record.tables for record in self.recordings)]
        return [] if self.positions or self.card.rows.samples else held

    def require_positions(self) -> None:
        """Raise an error if the dataset has no positions, for questions about motion or places.

        Raises:
            DatasetError: It was made only of task lists, overrides or distances.
        """
        if held := self._held_alone():
            look = command_line("inspect", self.place)
            raise DatasetError(
                f"{self.place}: made of {' and '.join(held)} alone: the positions of robot and people, which this "
                "needs, were not logged",
                cure=f"Ingest the robot's log with them. What is known: {look}",
            )

    def tasks(self) -> pl.DataFrame:
        """Return one row per task found in the robot's motion (table TASKS)."""
        return self.every_task().filter(pl.col("start_place").is_not_null())

    def uninterrupted_tasks(self) -> pl.DataFrame:
        """Return `tasks` without those of interrupted executions; tasks that no other execution has stay."""
        stopped = [one.execution for one in self.card.executions if one.interrupted_s]
        return _unless(pl.col("execution").is_in(stopped), self.tasks())

    def whole_tasks(self) -> pl.DataFrame:
        """Return `uninterrupted_tasks` without those that the end of a log cuts; tasks that no other log has stay."""
        partly = pl.col("execution").is_in([one.execution for one in self.card.executions if not one.complete])
        return _unless(partly & pl.col("cut").fill_null(value=False), self.uninterrupted_tasks())

    def every_task(self) -> pl.DataFrame:
        """Return one row per task of either agent, found in motion or from a task list (table TASKS)."""
        self._files.check_memory([self._files.verified_file(TASKS)], list(schema.TASKS))
        return self._files.collected(self._tasks(list(schema.TASKS)), TASKS)

    def done_tasks(self) -> pl.DataFrame:
        """Return the pairs of execution and robot task that occurred, without repetition."""
        rows = self._tasks(["execution", "task", "start_place"]).filter(pl.col("start_place").is_not_null())
        return self._files.collected(rows.select("execution", "task").unique(maintain_order=True), TASKS)

    def quarantine(self) -> pl.DataFrame:
        """Return every row that was set aside (table QUARANTINE), ordered by recording."""
        file = self._files.verified_file(QUARANTINE)
        self._files.check_memory([file], list(schema.QUARANTINE))
        rows = self._files.scan([file], schema.QUARANTINE, list(schema.QUARANTINE))
        return self._files.collected(rows, QUARANTINE)

    def recorded(self, recording: str, table: str) -> pl.DataFrame | None:
        """Return one native-rate table (`robot`, `people` or `events`) of a recording; None if there is none."""
        return self._recorded.table(recording, table)

    def recorded_between(self, recording: str, table: str, first_s: float, last_s: float) -> pl.DataFrame | None:
        """Return rows of one native-rate table from `first_s` to `last_s`, clock of the log; None if there is none."""
        return self._recorded.between(recording, table, first_s, last_s)

    def bits(self, recording: RecordingCard) -> dict[str, SignalChanges]:
        """Return the values over time of a recording's digital inputs and outputs, by name, clock of the log."""
        return logged_bits(recording, self._recorded.stored)

    def times(self, recording: str, table: str) -> Iterator[pl.DataFrame]:
        """Yield the times (`t_s`) of one native-rate table in parts, as it may be larger than memory."""
        return self._recorded.times(recording, table)

    def native_robot(
        self, execution: str, columns: Sequence[str] | None = None, *, if_there: Sequence[str] = ()
    ) -> pl.DataFrame | None:
        """Return the native-rate robot rows of one execution, `t_s` in session time; None without a robot log.

        `columns`: columns to read; None = all. `if_there`: further columns, where the log has them.
        """
        return self._recorded.robot_of(self._execution(execution), columns, if_there)

    def find_execution(self, name: str) -> str:
        """Return the name of the execution `name`; a plain number counts executions from 1.

        Raises:
            UnknownName: There is none.
        """
        names = self.executions["execution"].to_list()
        if name.isdigit() and name not in names and 1 <= int(name) <= len(names):
            return str(names[int(name) - 1])
        return self._execution(name).execution

    def verify(self) -> int:
        """Verify every file of the dataset, and return the number of files.

        Raises:
            DatasetError: A file is missing or damaged, or the dataset holds no checksums.
        """
        cure = f"Ingest the logs again: cyclekit ingest LOGS --out {self.path}"
        if self._files.listed is None:
            raise DatasetError(f"{self.path}: has no checksums of its files, so they cannot be verified", cure=cure)
        if damaged := self.damaged():
            some = "; ".join(f"{name} is {what}" for name, what in list(damaged.items())[:3])
            more = f"; and {len(damaged) - 3} more" if len(damaged) > 3 else ""
            raise DatasetError(f"{self.path}: {some}{more}", cure=cure)
        return len(self._files.listed) + 1

    def damaged(self) -> dict[str, str]:
        """Return the files that changed since they were written, with the problem of each.

        Empty if the dataset holds no checksums.
        """
        return self._files.damaged()

    def _rows_of(self, executions: Sequence[str]) -> int:
        """Return the maximum number of samples of executions."""
        entries = [self._execution(name) for name in executions]
        return int(sum(one.end_s - one.start_s for one in entries) * self.rate_hz) + 2 * len(entries)

    def _tasks(self, columns: Sequence[str]) -> pl.LazyFrame:
        file = self._files.verified_file(TASKS)
        return self._mine(self._files.scan([file], schema.TASKS, columns, added=schema.ADDED_TO_TASKS))

    def _scan(self, files: Sequence[Path], columns: Sequence[str]) -> pl.LazyFrame:
        return self._files.scan(files, schema.SAMPLES, columns, added=schema.ADDED_TO_SAMPLES)

    def _mine(self, rows: pl.LazyFrame) -> pl.LazyFrame:
        """Return the rows of the dataset's executions, if it is only a part of the stored ones."""
        return rows.filter(pl.col("execution").is_in(self.executions["execution"].to_list())) if self.is_part else rows

    @cached_property
    def _by_name(self) -> dict[str, ExecutionCard]:
        return {one.execution: one for one in self.card.executions}

    def _execution(self, name: str) -> ExecutionCard:
        by_name = self._by_name
        if name not in by_name:
            names = list(by_name)
            shown = ", ".join(names[:3]) + (f" … {names[-1]} ({len(names)} in all)" if len(names) > 3 else "")
            cure = f"Give one of {shown}, or a number from 1 to {len(names)}." if names else "It has no execution."
            raise UnknownName(str(self.path), "execution", name, names, cure=cure)
        return by_name[name]


def _unless(left_out: pl.Expr, tasks: pl.DataFrame) -> pl.DataFrame:
    """Return tasks without some; where these are all of a kind, they stay."""
    return tasks.filter(~left_out | left_out.all().over("task"))
