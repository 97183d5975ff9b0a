"""Any delimited table with columns mapped in the cell file: logs without a public format.

Used for exports of FANUC, ABB, Yaskawa, Doosan, Techman and xArm, PLC logs and laser scanner tracks. The cell file
gives the meaning and unit of each column. Nothing is guessed: no column is found by its name, no unit by the size of
its values. Such a table looks like any other, so this adapter recognises nothing by itself and has to be named. The
user has to check what `draft` proposes for the cell file.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, cast

import polars as pl

from cyclekit.adapter import Draft, ReadOptions, Recording, Role, StreamingAdapter, concat_parts
from cyclekit.errors import ConfigError, DamagedLog, EmptyLog, MissingColumns
from cyclekit.schema import EVENTS, PEOPLE, ROBOT, conform
from cyclekit.text.numbers import given
from cyclekit_adapters.mapped.chosen_rows import ChosenRows
from cyclekit_adapters.mapped.csv_map import METRES, RADIANS, SIGNAL_JOIN, STATES, WHERE, CsvMap, csv_map
from cyclekit_adapters.mapped.draft import QUANTITIES, draft_of
from cyclekit_adapters.mapped.draft_events import event_draft
from cyclekit_adapters.mapped.draft_states import is_trace
from cyclekit_adapters.mapped.draft_table import sheet_draft_table, text_draft_table
from cyclekit_adapters.mapped.map_columns import Columns, columns_of, unresolved
from cyclekit_adapters.mapped.map_table import MapTable, text_table
from cyclekit_adapters.mapped.mapped_time import mapped_times, require_epoch
from cyclekit_adapters.mapped.sheets import sheet_table
from cyclekit_adapters.robots.controller_time import BackwardSteps, ClockRestarts, Range
from cyclekit_adapters.tasks.draft_tasks import task_draft
from cyclekit_adapters.tasks.state_changes import StateChanges
from cyclekit_adapters.text.in_parts import in_parts
from cyclekit_adapters.text.list_cells import ListCells, first_width
from cyclekit_adapters.text.text_rows import TextRows, Wanted
from cyclekit_adapters.text.workbook import is_workbook
from cyclekit_adapters.times.coarse_stamps import Spread, share_stamps, spread_of
from cyclekit_adapters.times.local_clock import LocalClock
from cyclekit_adapters.times.row_times import T_S, TimeColumn, timed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

    from cyclekit.adapter import ClockKind

_SLACK = 1e-3
_BOTH = 'Name the columns of both; in a drafted map choose among the lines that begin with "# ?".'


class _MappedCsv:
    def recognises(self, path: Path) -> bool:
        return False

    def draft(self, path: Path) -> Draft | None:
        table = sheet_draft_table(path) if is_workbook(path) else text_draft_table(path)
        if table is None:
            return None
        draft = draft_of(table, f"{path.parent.name} {path.stem}")
        if is_trace(table) or any(line.key in QUANTITIES and line.value for line in draft.map):
            return draft
        if not is_workbook(path) and task_draft(table):
            return None  # the adapter of task lists drafts it
        return event_draft(table) or draft

    def _may_be(self, path: Path) -> str:
        """Return what a draft says of the time of a table whose map names none."""
        draft = self.draft(path)
        lines = [one for one in draft.map if one.key in ("time", "time_unit", "time_format")] if draft else []
        said = [f"{one.key} = {one.value!r}{f' ({one.why})' if one.why else ''}" for one in lines]
        return f"It may be {', '.join(said)}. " if said else ""

    def read(self, path: Path, options: ReadOptions) -> Recording:
        return concat_parts(self.stream(path, options))

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        mapping = csv_map(options)
        role = options.role or mapping.role()
        if role == "tasks":
            cure = 'Give adapter = "task-list" instead, with the columns in [sources.map].'
            raise ConfigError(f"{path}: a mapped table cannot be read as tasks", cure=cure)
        table, columns = _found(path, mapping, role)
        mapping, names = columns.mapping, columns.names
        if not mapping.time and not options.rate_hz:
            cure = 'Map it in cell.toml (time = "..."), or give rate_hz = ... if the rows have a fixed rate.'
            raise MissingColumns(path, ["time"], names, f"{self._may_be(path)}{cure}")
        cells = {name: [row[at] for row in table.first_rows if at < len(row)] for at, name in enumerate(names)}
        times = mapped_times(path, mapping, cells, options.rate_hz)
        columns = replace(columns, mapping=replace(mapping, time_format=times.pattern or None))
        clock = cast("ClockKind", mapping.clock or times.clock(mapping.time_zone))
        restarts, seen, back = ClockRestarts(T_S), _Seen(mapping, role), BackwardSteps(T_S, mapping.person)
        chosen = ChosenRows(mapping.only)
        events, hour = StateChanges(mapping.names), LocalClock(mapping.time_zone, times.pattern)
        canonicals: dict[str, Callable[[pl.DataFrame, CsvMap], pl.DataFrame]]
        canonicals = {"robot": _robot, "people": _people, "events": partial(_events, events)}
        canonical = canonicals[role]
        wanted, lists = _wanted(columns, role)
        stamps = [" ".join(row) for row in zip(*(cells.get(name, []) for name in times.columns), strict=False)]
        spread = None
        of = mapping.person if role == "people" else "".join(mapping.signal[:1])
        if share_stamps(stamps, cells.get(str(of), ())):
            again = map(lists.rows, map(chosen.rows, table.blocks(names, wanted)))
            spread = _spread(path, columns, times, options, role, again)

        def make(rows: TextRows) -> Recording:
            rows = timed(lists.rows(rows), times, hour, options.rate_hz)
            rows = spread.rows(rows) if spread else rows
            rows = _of_good_quality(rows, mapping)
            if clock == "epoch":
                require_epoch(path, rows.frame, times)
            if role == "robot":
                restarts.add(rows.frame)
            else:
                back.add(rows.frame)
            rows = replace(rows, frame=seen.without_missing(rows.frame))
            seen.add(rows.frame)
            tables = {role: canonical(rows.frame, mapping)}
            if role == "robot" and mapping.tags:
                tables["events"] = events.changes(rows.frame, T_S, mapping.tags)
            return Recording(
                **tables,  # type: ignore[arg-type]  # roles are fields
                clock=clock,
                time_units=times.time_units,
                joint_names=mapping.joints if role == "robot" else (),
                rows_are="row" if "sheet" in table.facts else "line",
                rows_read=rows.rows_read,
                set_aside=rows.set_aside,
            )

        def finish(last: Recording) -> Recording:
            facts = {"time": f"{' and '.join(times.columns)}: {times.why}" if times.columns else times.why}
            facts |= {"columns": ", ".join(name[:80] for name in names[:60]), **table.facts}
            unplaced = times.warnings(mapping.time_zone) if clock != "epoch" else []
            coarse = [spread.said] if spread else []
            warnings = (*seen.warnings(restarts.back), *unplaced, *coarse, *back.warnings(), *hour.warnings())
            return replace(last, warnings=warnings, facts=facts)

        try:
            yield from in_parts(path, map(chosen.rows, table.blocks(names, wanted)), make, finish)
        except EmptyLog:
            if (nothing := chosen.nothing()) is None:
                raise
            raise nothing from None


def _spread(
    path: Path, columns: Columns, times: TimeColumn, options: ReadOptions, role: Role, rows: Iterable[TextRows]
) -> Spread | None:
    """Return where rows lie within the stamps that they share; None if they share none."""
    mapping = columns.mapping
    values = [*mapping.places().values(), *mapping.joints, *([mapping.speed] if mapping.speed else [])]
    clock = LocalClock(mapping.time_zone, times.pattern)
    stamped = (timed(block, times, clock, options.rate_hz) for block in rows)
    if role == "events":
        signal = mapping.signal[0] if len(mapping.signal) == 1 else None
        return spread_of(path, stamped, (), track=signal, rate_hz=options.rate_hz, ask=False)
    person = mapping.person if role == "people" else None
    return spread_of(path, stamped, values, track=person, rate_hz=options.rate_hz)


def _found(path: Path, mapping: CsvMap, role: Role) -> tuple[MapTable, Columns]:
    """Return the table and the columns that the map refers to.

    Raises:
        ConfigError: The map is invalid for this table.
        LogError: The table cannot be read, or lacks these columns.
    """
    entries = {entry for kind in _columns(mapping, role) for entry in kind} | set(mapping.only)
    table: MapTable = sheet_table(path, mapping) if is_workbook(path) else text_table(path, mapping, entries)
    if missing := unresolved(entries, table.names):
        if any("\ufffd" in name for name in table.names):
            encoding = table.facts.get("encoding", "utf-8")
            cause = f'its header is not written in {encoding}: give encoding in [sources.map], for example "latin-1"'
            raise DamagedLog(path, cause)
        raise MissingColumns(path, missing, table.names, table.cure(entries, mapping))
    cells = {name: [row[at] for row in table.first_rows if at < len(row)] for at, name in enumerate(table.names)}
    widths = {name: width for name, columns in cells.items() if (width := first_width(columns)) is not None}
    return table, columns_of(path, mapping, table.names, widths)


def _wanted(columns: Columns, role: Role) -> tuple[Wanted, ListCells]:
    """Return the columns to read from the table, and the splitter of its list cells."""
    mapping, made = columns.mapping, {name for lists in columns.lists.values() for name in lists.values()}
    numbers, texts, required = _columns(mapping, role)
    if missing := {name for name in {*numbers, *texts} - made if name not in columns.names}:
        seen = f"{WHERE}: column {min(missing)!r} holds no list in the first rows"
        raise ConfigError(seen, cure="Name its numbers one by one: [0], [1], ...")
    if wrong := made.intersection(texts):
        raise ConfigError(f"{WHERE}: {min(wrong)!r} is an element of a list of numbers, but is mapped to a text")
    texts = list(dict.fromkeys([*texts, *(column for column, lists in columns.lists.items() if made & set(numbers))]))
    all_but_time = [name for name in (*numbers, *texts) if name not in mapping.time]
    some = all_but_time if role != "people" else []  # a row of a tracker without a position tells that nobody was seen
    texts += [name for name in mapping.only if name not in texts]
    if both := set(numbers).intersection(texts):
        raise ConfigError(f"{WHERE}: column {min(both)!r} is mapped to a number and to a text")
    wanted = Wanted(
        numbers=[name for name in numbers if name not in made],
        texts=texts,
        required=[name for name in required if name not in made],
        any_of=[name for name in some if name not in made],
    )
    return wanted, ListCells(columns.lists, tuple(name for name in required if name in made))


def _columns(mapping: CsvMap, role: Role) -> tuple[list[str], list[str], list[str]]:
    """Return number columns, text columns and required columns for a role."""
    time = list(mapping.time)
    number_time, text_time = ([], time) if mapping.time_format else (time, [])
    places = mapping.places()
    if role == "events":
        columns, bits = [*mapping.signal, *([mapping.value] if mapping.value else [])], _bit_fields(mapping)
        if not (mapping.signal and mapping.value) and not mapping.tags and not bits:
            cure = "Name both columns, or in tags the columns that are a signal each, or in digital_in their bit field."
            raise ConfigError(f"{WHERE}: events need the keys signal and value", cure=cure)
        texts = [*text_time, *columns, *mapping.tags, *([mapping.quality] if mapping.quality else [])]
        return [*number_time, *bits], list(dict.fromkeys(texts)), [*time, *mapping.signal]
    if places and not {"x", "y"}.issubset(places):
        raise ConfigError(f"{WHERE}: a position needs at least x and y", cure=_BOTH)
    if role == "people":
        if not places:
            raise ConfigError(f"{WHERE}: people need the keys x and y", cure=_BOTH)
        person = [mapping.person] if mapping.person else []
        numbers = [*number_time, *places.values(), *([mapping.confidence] if mapping.confidence else [])]
        return list(dict.fromkeys(numbers)), [*text_time, *person], [*time, *person]
    whole_numbers = (mapping.digital_in, mapping.digital_out, mapping.register)
    others = [column for column in (*mapping.scaling, mapping.slider, mapping.speed, *whole_numbers) if column]
    numbers = [*places.values(), *others, *mapping.joints]
    if not numbers:
        cure = 'Map x, y, z or joints, scaling or speed; a draft asks for them in lines that begin with "# ?".'
        raise ConfigError(f"{WHERE}: no quantity of the robot is mapped", cure=cure)
    state = [mapping.state] if mapping.state else []
    return list(dict.fromkeys([*number_time, *numbers])), list(dict.fromkeys([*text_time, *state, *mapping.tags])), time


def _robot(frame: pl.DataFrame, mapping: CsvMap) -> pl.DataFrame:
    metres, radians = METRES[mapping.length_unit], RADIANS[mapping.joint_unit]
    columns = [pl.col(T_S).alias("t_s"), pl.col("source_row")]
    columns += [(pl.col(column) * metres).alias(f"tcp_{axis}_m") for axis, column in mapping.places().items()]
    columns += [(pl.col(column) * radians).alias(f"q{i}_rad") for i, column in enumerate(mapping.joints)]
    if mapping.speed:
        columns.append((pl.col(mapping.speed).abs() * metres).alias("tcp_speed_m_s"))
    if mapping.scaling:
        product = _fraction(mapping.scaling[0], mapping)
        for column in mapping.scaling[1:]:
            product = product * _fraction(column, mapping)
        columns.append(product.alias("scaling"))
    if mapping.slider:
        columns.append(_fraction(mapping.slider, mapping).alias("slider"))
    if mapping.state:
        words = dict(zip(STATES, STATES, strict=True)) | dict(mapping.states)
        state = pl.col(mapping.state).replace_strict(words, default=None, return_dtype=pl.String)
        columns.append(state.alias("state"))
    whole = (
        ("digital_in_bits", mapping.digital_in),
        ("digital_out_bits", mapping.digital_out),
        ("register", mapping.register),
    )
    columns += [pl.col(n).cast(pl.Int64, strict=False).alias(name) for name, n in whole if n]
    return conform(frame.select(columns), ROBOT)


def _fraction(column: str, mapping: CsvMap) -> pl.Expr:
    value = pl.col(column) / mapping.scaling_max
    return pl.when(value.is_between(0.0, 1.0 + _SLACK)).then(value.clip(0.0, 1.0))


def _people(frame: pl.DataFrame, mapping: CsvMap) -> pl.DataFrame:
    metres = METRES[mapping.length_unit]
    places = [(pl.col(column) * metres).alias(f"{axis}_m") for axis, column in mapping.places().items()]
    person = pl.col(mapping.person) if mapping.person else pl.lit("0")
    return conform(frame.select(pl.col(T_S).alias("t_s"), person.alias("person"), "source_row", *places), PEOPLE)


def _events(states: StateChanges, frame: pl.DataFrame, mapping: CsvMap) -> pl.DataFrame:
    if mapping.tags or _bit_fields(mapping):
        frame, bits = _with_bits(frame, _bit_fields(mapping))
        return states.changes(frame, T_S, [*mapping.tags, *bits])
    parts = [pl.col(column).str.strip_chars() for column in mapping.signal]
    name = parts[0] if len(parts) == 1 else pl.concat_str(parts, separator=SIGNAL_JOIN)
    signal, value = name.alias("signal"), pl.col(str(mapping.value)).alias("value")
    named = signal.replace(dict(mapping.names)) if mapping.names else signal
    return conform(frame.select(pl.col(T_S).alias("t_s"), named, value, "source_row"), EVENTS)


def _bit_fields(mapping: CsvMap) -> list[str]:
    return [column for column in (mapping.digital_in, mapping.digital_out) if column]


def _with_bits(frame: pl.DataFrame, columns: list[str]) -> tuple[pl.DataFrame, list[str]]:
    """Return the rows with a text column for each bit of these columns, named `DI 3`, and the names of these."""
    names = []
    for column in columns:
        field = frame[column].cast(pl.Int64, strict=False)
        for bit in range(int(field.max() or 0).bit_length()):  # type: ignore[arg-type]  # of an integer column
            names.append(f"{column} {bit}")
            frame = frame.with_columns((field // (1 << bit) % 2).cast(pl.String).alias(names[-1]))
    return frame, names


def _of_good_quality(rows: TextRows, mapping: CsvMap) -> TextRows:
    """Return the rows with those of insufficient quality set aside."""
    if mapping.quality is None or mapping.quality not in rows.frame.columns:
        return rows
    good = {word.strip().lower() for word in mapping.good}
    bad = ~rows.frame[mapping.quality].str.to_lowercase().is_in(list(good)).fill_null(value=False)
    return rows.without(bad, f"its quality ({mapping.quality}) is none of {', '.join(mapping.good)}")


@dataclass
class _Seen:
    """Counts over the rows so far, for warnings."""

    mapping: CsvMap
    role: Role
    states: set[str] = field(default_factory=set)
    beyond: int = 0
    rows: int = 0
    missing: int = 0
    unsure: int = 0

    def __post_init__(self) -> None:
        self.spread = Range((*self.mapping.scaling, *([self.mapping.slider] if self.mapping.slider else [])))

    def without_missing(self, frame: pl.DataFrame) -> pl.DataFrame:
        """Return rows with null for missing values: a position with all numbers missing, or any other missing number.

        With confidence 0, a position is left over from an earlier row and also becomes null.
        """
        mapping, places = self.mapping, list(self.mapping.places().values())
        self.rows += frame.height
        nowhere = pl.lit(value=False)
        if mapping.missing and places:
            nowhere = pl.all_horizontal(pl.col(name).is_in(mapping.missing) for name in places).fill_null(value=False)
            self.missing += int(frame.select(nowhere.sum()).item())
        if mapping.confidence and self.role == "people":
            unsure = (pl.col(mapping.confidence) <= 0.0).fill_null(value=False)
            self.unsure += int(frame.select(unsure.sum()).item())
            nowhere = nowhere | unsure
        known = [pl.when(~nowhere).then(pl.col(name)).alias(name) for name in places]
        others = [*mapping.scaling, *mapping.joints, *filter(None, (mapping.slider, mapping.speed))]
        known += [pl.when(~pl.col(name).is_in(mapping.missing)).then(pl.col(name)).alias(name) for name in others]
        return frame.with_columns(known) if mapping.missing or mapping.confidence else frame

    def add(self, frame: pl.DataFrame) -> None:
        if self.role != "robot":
            return
        self.spread.add(frame)
        top = self.mapping.scaling_max * (1.0 + _SLACK)
        wrong = [(frame[column] < 0.0) | (frame[column] > top) for column in self.mapping.scaling]
        self.beyond += sum(int(mask.sum()) for mask in wrong)
        if self.mapping.state:
            self.states |= set(frame[self.mapping.state].drop_nulls().unique().to_list())

    def warnings(self, back: int) -> list[str]:
        mapping, said = self.mapping, []
        if back:
            said.append(f"time steps back {back} time(s): each part is a separate run")
        if self.missing:
            numbers = ", ".join(given(number) for number in mapping.missing)
            said.append(f"the position is missing ({numbers}) in {self.missing} of {self.rows} rows: unknown there")
        if self.unsure:
            said.append(f"{mapping.confidence} is 0 in {self.unsure} of {self.rows} rows: no person is detected there")
        if self.beyond:
            top = f"0..{given(mapping.scaling_max)}"
            said.append(f"scaling is outside {top} in {self.beyond} rows: unknown there; check scaling_max")
        said += [
            f"{column} never exceeds 1 %: if it is a fraction, set scaling_max = 1"
            for column in mapping.scaling
            if mapping.scaling_max == 100 and 0 < self.spread.most.get(column, 0) <= 1.0
        ]
        if other := sorted(self.states - set(STATES) - set(mapping.states)):
            said.append(f"states {', '.join(map(repr, other[:5]))} are unknown; map them in `states`")
        return said


ADAPTER: StreamingAdapter = _MappedCsv()
