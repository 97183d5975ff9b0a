"""Formats task lists, logs of safety systems and lost time as lines and tables."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.cli.terminal import bullet, table
from cyclekit.dataset.lost_time import CAUSE_NAMES
from cyclekit.learning.coupling.words import habit_lines, wait_rows
from cyclekit.scaling.response import MIN_RAMPS
from cyclekit.text.numbers import compact, counted, duration, exact_percent, fixed, percent, span

if TYPE_CHECKING:
    from cyclekit.dataset.cards import CouplingCard
    from cyclekit.dataset.lost_time import LostTime, PersonLoss
    from cyclekit.inspect.facts import SafetyFacts, TaskListFacts
    from cyclekit.inspect.response import ResponseFacts
    from cyclekit.scaling.override_log import OverrideResponse

_FEW_ROWS = (
    "the log has fewer than 3 rows in a ramp between levels; simulated ramps of 500 % per second, logged at 10 Hz, "
    "were read 24 % too slow to 15 % too steep. Log at a higher rate."
)
Z95 = 1.96
SHOWN_AGENTS, SHOWN_TASKS, SHOWN_VALUES = 12, 24, 6


def task_list_tables(found: TaskListFacts) -> str:
    """Return the agents of a task list, the durations of its tasks, and anomalies."""
    agents = [
        [
            one.name,
            one.kind,
            f"{one.tasks}",
            f"{one.overlaps}" + (f" (to {fixed(one.overlap_s, 1)} s)" if one.overlaps else ""),
        ]
        for one in found.agents
    ]
    tasks = [
        [one.agent, one.task, f"{one.count}", *map(_seconds, (one.mean_s, one.sd_s, one.least_s, one.most_s))]
        for one in found.tasks
    ]
    others = len(agents) - SHOWN_AGENTS
    more_agents = f"\n... and {others} agents more (--json has all)" if others > 0 else ""
    more = f"\n... and {len(tasks) - SHOWN_TASKS} tasks more (--json has all)" if len(tasks) > SHOWN_TASKS else ""
    heads = ["agent ", "task ", "times", "mean, s", "sd", "min", "max"]
    parts = [
        table(["agent ", "is ", "tasks", "overlaps"], agents[:SHOWN_AGENTS]) + more_agents,
        table(heads, tasks[:SHOWN_TASKS]) + more,
        bullet(_said(found), mark=""),
    ]
    return "\n\n".join(parts)


def _said(found: TaskListFacts) -> list[str]:
    total = sum(one.tasks for one in found.agents)
    lasted = found.execution_s
    spans = f", {span(lasted.least, lasted.most, 1)} s long (median {fixed(lasted.median, 1)} s)" if lasted else ""
    return [
        f"executions: {found.executions}{spans}" if found.executions else "executions: none named",
        f"outcome: {found.failed} of {total} tasks failed; without an end: {found.no_end}",
        f"planned start: known of {percent(found.planned / max(total, 1))} of the tasks",
    ]


def response_lines(found: ResponseFacts | None) -> str:
    """Return the response of the safety system (latency, ramps, hysteresis), one line per known property."""
    if found is None:
        return ""
    read = found.read
    values = (
        ("reaction time", _value(read.latency_s, "s")),
        ("slows by", _rate(read.ramp_down_per_s, read.ramp_down_se_per_s, read.changes)),
        ("recovers by", _rate(read.ramp_up_per_s, read.ramp_up_se_per_s, read.changes)),
        ("hysteresis", _value(read.hysteresis_m, "m")),
        ("hold time", _value(read.hold_s, "s")),
    )
    lines = [f"response of the safety system, read from {read.changes} changes of level"]
    lines += [f"  {name:<13} {value}" for name, value in values]
    if found.few_rows:
        lines.append(bullet([_FEW_ROWS], mark="  ! "))
    return "\n".join(lines)


def _value(value: float | None, unit: str) -> str:
    return "not seen" if value is None else f"{compact(value, 3)} {unit}"


def _rate(per_s: float | None, error: float | None, changes: int) -> str:
    """Return a rate in percent per second, with its interval if that is wider than the rounding."""
    if per_s is None:
        return "at once" if changes >= 2 * MIN_RAMPS else "not known, too few changes"
    low, high = (f"{compact(max(0.0, 100.0 * (per_s + sign * Z95 * (error or 0.0))), 3)}" for sign in (-1, 1))
    interval = f" (95 % CI {low} to {high})" if low != high else ""
    return f"{compact(100.0 * per_s, 3)} % per second{interval}"


def _seconds(value: float | None) -> str:
    return "unknown" if value is None else fixed(value, 2)


def lost_table(found: LostTime | None) -> str:
    """Return the seconds lost per cause, the number of stops between places, and of changes of speed."""
    if found is None:
        return ""
    causes = sorted((cause for cause in found.seconds if found.seconds[cause] > 0.0), key=lambda c: -found.seconds[c])
    rows = []
    for cause in causes:
        stops = found.stops_per_hour.get(cause, 0.0)
        rows.append(
            [CAUSE_NAMES[cause], fixed(found.seconds[cause], 1), fixed(100 * found.share(cause), 1), fixed(stops, 1)]
        )
        rows += [_level(one) for one in found.person if cause == "person"]
    total = sum(found.seconds.values())
    stops = sum(found.stops_per_hour.values())
    rows.append(["all lost time", fixed(total, 1), fixed(100 * total / found.duration_s, 1), fixed(stops, 1)])
    shown = table(["time lost to ", "s", "% of time", "standstills per hour"], rows)
    changes = fixed(found.changes_per_hour, 1)
    return f"{shown}\nstandstills: between places; changes of the speed scaling per hour: {changes}"


def _level(one: PersonLoss) -> list[str]:
    where = "" if one.nearest_m is None else f", operator {span(one.nearest_m, one.farthest_m, 2)} m away"
    return [f"  at {percent(one.level)} speed{where}", fixed(one.lost_s, 1), "", ""]


def _levels(read: OverrideResponse) -> str:
    """Return the levels of an override log, and the share of its rows on each."""
    shares = zip(read.levels, read.share, strict=True)
    return bullet(
        [", ".join(f"{exact_percent(v)} ({percent(share)} of the rows)" for v, share in shares)],
        mark="  levels    ",
    )


def safety_lines(found: SafetyFacts) -> list[str]:
    """Return the ranges of override and distance, and the time spent at each value of the override."""
    lines = []
    if (seen := found.override) is not None:
        values, total = found.override_values, max(found.override_s, 1e-9)
        shown = ", ".join(f"{percent(s / total)} of the time at {exact_percent(v)}" for v, s in values[:SHOWN_VALUES])
        others = len(values) - SHOWN_VALUES
        rest = f", the rest at {others} other values" if others > 0 else ""
        known = duration(found.override_s)
        lines.append(
            f"  override  {compact(100 * seen.least)} to {exact_percent(seen.most)}, "
            f"{counted(len(values), 'value')}, known for {known}"
        )
        values_line = bullet([f"{shown}{rest}"], mark=" " * 12)
        lines.append(_levels(found.response) if others > 0 and found.response else values_line)
        if (read := found.response) is not None and read.changes:
            down, up = (_rate(rate, None, read.changes) for rate in (read.down_per_s, read.up_per_s))
            lines.append(f"  response  slows by {down}, recovers by {up}")
    if (seen := found.distance_m) is not None:
        repeats = f"{percent(found.distance_repeats)} of the rows repeat the one before"
        said = f"{span(seen.least, seen.most, 2)} m (median {fixed(seen.median, 2)} m); {repeats}"
        lines.append(bullet([said], mark="  distance  "))
    return lines


USED_IF = (
    "found in the logs; a model uses them unless logged executions roll out worse with them. Those used: "
    "cyclekit inspect MODEL"
)


def coupling_table(found: CouplingCard | None, *, of_logs: bool = False) -> str:
    """Return the learned wait conditions as a table; empty if unknown.

    Args:
        found: The conditions.
        of_logs: Whether they are those found in a dataset, of which a model may use none; else a model's.
    """
    if found is None:
        return ""
    rows = []
    for row in wait_rows(found):
        low_s, middle_s, high_s = row.lag_s
        lag = [fixed(middle_s, 1), span(low_s, high_s, 1)]
        rows.append([row.who, row.until, *lag, percent(row.condition.held), row.had_to_wait])
    if not rows:
        none = "found" if of_logs else "used"
        return f"waits of robot and operator for each other: none {none} in {found.executions} executions"
    heads = ["who waits ", "until ", "lag, s", "5 to 95 %", "obeyed", "had to wait"]
    learned = of_logs and any(gate.conditions and not gate.told for gate in found.gates)
    return "\n".join([table(heads, rows), *habit_lines(found), *([USED_IF] if learned else [])])
