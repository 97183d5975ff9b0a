"""Formats the facts of a log, a dataset or a model as text of at most 80 columns."""

from __future__ import annotations

import os
import re
from collections import Counter
from typing import TYPE_CHECKING, Any

from cyclekit.cli.groups import grouped, regrouped
from cyclekit.cli.lists import coupling_table, lost_table, response_lines, safety_lines, task_list_tables
from cyclekit.cli.terminal import bullet, table
from cyclekit.dataset.cards import plain, texts
from cyclekit.text.numbers import compact, duration, fixed, percent, scientific, signed
from cyclekit.text.plain_text import one_line

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from cyclekit.estimate.what_to_log import RecordingPlan
    from cyclekit.inspect.facts import (
        DatasetDescription,
        Description,
        Gap,
        LogFacts,
        LogsDescription,
        ModelDescription,
        TableFacts,
    )

GAP_REASONS = {
    "seen": "operator seen",
    "occluded": "lost, and seen again within 5 s",
    "absent": "no operator, or not seen for longer",
    "outside": "before the start or after the end of the log",
}
UNEVEN = 0.02
"""Maximum relative difference between the rate and that of the median step at which steps count as even."""
SHOWN_GAPS, SHOWN_TASKS, SHOWN_FILES = 3, 12, 20


def page(found: Description) -> str:
    """Return the text of a log, several logs, a dataset or a model."""
    if found.kind == "dataset":
        return _dataset(found)  # type: ignore[arg-type]
    if found.kind == "model":
        return _model(found)  # type: ignore[arg-type]
    if found.kind == "task times":
        from cyclekit.cli.train import task_times_summary

        return f"{found.path}: model, {task_times_summary(found.model)}"  # type: ignore[union-attr]
    return _logs(found)  # type: ignore[arg-type]


def _logs(found: LogsDescription) -> str:
    parts = [_log(log) for log in found.logs] if len(found.logs) <= 3 else [_log_rows(found.logs)]
    if len(found.logs) > 3:
        named = _names([log.path for log in found.logs])
        warned = grouped((named[log.path], text) for log in found.logs for text in log.warnings)
        parts.append(bullet(warned, mark="! "))
    if found.not_read:
        parts.append("not read:\n" + bullet(grouped((str(path), reason) for path, reason in found.not_read)))
    return "\n\n".join(part for part in parts if part)


def _names(paths: Sequence[Path]) -> dict[Path, str]:
    """Return the names of files, with their folders if two files have the same name."""
    if len({path.name for path in paths}) == len(paths):
        return {path: path.name for path in paths}
    above = os.path.commonpath([path.parent for path in paths])
    return {path: path.relative_to(above).as_posix() for path in paths}


def _log_rows(logs: Sequence[LogFacts]) -> str:
    rows, named = [], _names([log.path for log in logs])
    for log in logs[:SHOWN_FILES]:
        longest = max(log.tables.values(), key=lambda facts: facts.rows, default=None)
        rows.append(
            [
                named[log.path],
                log.adapter,
                ", ".join(log.tables),
                f"{longest.rows}" if longest else "0",
                _rate(longest),
                duration(longest.duration_s) if longest else "",
                f"{sum(len(facts.gaps) for facts in log.tables.values())}",
            ]
        )
    shown = table(["log ", "adapter ", "holds ", "rows", "rate", "duration", "gaps"], rows)
    if not (more := Counter(log.adapter for log in logs[SHOWN_FILES:])):
        return shown
    kinds = ", ".join(f"{count} by {adapter}" for adapter, count in more.most_common())
    return f"{shown}\nand {more.total()} more logs ({kinds}); --json has all"


def _rate(facts: TableFacts | None) -> str:
    return f"{compact(facts.rate_hz, 4)} Hz" if facts and facts.rate_hz else "unknown"


def _steps(facts: TableFacts) -> list[str]:
    """Return a line on the time steps if rows were lost or the steps are uneven."""
    if not facts.rate_hz or not facts.step_s:
        return []
    if facts.lost:
        part = percent(facts.lost / (facts.lost + facts.rows))
        return [f"            steps: {compact(1000 * facts.step_s, 4)} ms (median), {facts.lost} samples lost ({part})"]
    if abs(facts.step_s * facts.rate_hz - 1.0) < UNEVEN:
        return []
    return [f"            steps: {compact(1000 * facts.step_s, 4)} ms (median), uneven"]


def _log(log: LogFacts) -> str:
    lines = [
        one_line(f"{log.path}"),
        f"  adapter   {log.adapter} ({log.package})",
        f"  clock     {log.clock}",
        f"  rows      {log.rows_read} read, {sum(log.set_aside.values())} set aside",
    ]
    lines += [bullet([reason], mark=f"            {count} x ") for reason, count in log.set_aside.items()]
    for name, facts in log.tables.items():
        lines += _table(name, facts)
    if log.levels:
        shown = ", ".join(f"{fixed(v, 2)} ({percent(s)})" for v, s in zip(log.levels, log.level_share, strict=True))
        lines.append(bullet([f"{shown} of the rows with a known scaling"], mark="  scaling   "))
    if log.safety:
        lines += safety_lines(log.safety)
    lines += [bullet([shorten(value)], mark=f"  {key}: ") for key, value in log.facts.items() if value]
    if log.task_list:
        lines.append("\n" + task_list_tables(log.task_list) + "\n")
    notes = bullet(log.warnings, mark="  ! ")
    return "\n".join(lines) + (f"\n{notes}" if notes else "")


def _table(name: str, facts: TableFacts) -> list[str]:
    rate = "" if name in ("events", "task_list") else f"{_rate(facts)}, "
    lines = [f"  {name:<9} {facts.rows} rows, {rate}{duration(facts.duration_s)}", *_steps(facts)]
    always = _columns([column for column, share in facts.known.items() if share == 1])
    partly = [f"{column} {percent(share)}" for column, share in facts.known.items() if share < 1]
    for title, columns in (("columns", always), ("partly known", partly)):
        if columns:
            lines.append(bullet([", ".join(columns)], mark=f"            {title}: "))
    return lines if name == "task_list" else [*lines, f"            gaps: {_gaps(facts.gaps)}"]


def _columns(names: Sequence[str]) -> list[str]:
    """Return the names of columns, those of joints as a range: `q0_rad ... q5_rad`."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(re.sub(r"^(qd?)\d+", r"\1#", name), []).append(name)
    return [f"{group[0]} ... {group[-1]}" if len(group) > 2 else ", ".join(group) for group in groups.values()]


def _gaps(gaps: Sequence[Gap]) -> str:
    if not gaps:
        return "none"
    shown = [f"{duration(gap.length_s)} at {fixed(gap.at_s, 1)} s" for gap in sorted(gaps, key=lambda g: -g.length_s)]
    more = f" and {len(gaps) - SHOWN_GAPS} shorter" if len(gaps) > SHOWN_GAPS else ""
    return ", ".join(shown[:SHOWN_GAPS]) + more


def _dataset(found: DatasetDescription) -> str:
    complete = found.executions - found.executions_complete
    why = "with a task without an end" if found.task_list else "cut by the start or the end of a log"
    cut = f" ({complete} {why})" if complete else ""
    head = [
        f"{found.path}: dataset, schema version {found.schema_version}",
        f"  executions  {found.executions}{cut}, {duration(found.duration_s)} in all",
        *(_of_samples(found) if found.samples else ["  positions   none: neither of the robot nor of people"]),
        f"  recordings  {found.recordings}, from {found.sources} source files",
    ]
    head += [bullet([reason], mark=f"  set aside   {count} rows: ") for reason, count in found.set_aside.items()]
    levels = [
        [fixed(level, 2), percent(share), percent(share * found.on_level)]
        for level, share in zip(found.levels, found.level_share, strict=True)
    ]
    parts = ["\n".join(head)]
    parts += ["\n".join([f"safety system, {name}", *safety_lines(facts)]) for name, facts in found.safety.items()]
    if levels:
        parts.append(table(["scaling level ", "of those on a level", "of all samples"], levels))
    elif found.samples:
        parts.append("no staircase levels found")
    parts.append(response_lines(found.response))
    parts += [_places("robot place ", found.places), _places("operator place ", found.human_places)]
    if found.samples:
        parts.append(_tasks(found.tasks))
        parts.append(lost_table(found.lost))
    parts.append(to_log(found.to_log))
    parts.append(task_list_tables(found.task_list) if found.task_list else "")
    parts.append(coupling_table(found.coupling, of_logs=True))
    parts += [_clocks(found.clocks), _operator(found.operator)]
    silences = [f"gaps in {name}: {_gaps(gaps)}" for name, gaps in found.gaps.items()]
    parts.append(bullet(_some(silences, SHOWN_FILES)))
    parts.append(bullet(regrouped(found.warnings), mark="! "))
    return "\n\n".join(part for part in parts if part)


def to_log(plan: RecordingPlan | None) -> str:
    """Return what to log next; empty if nothing is missing."""
    return "What to log next\n" + bullet(plan.lines) if plan is not None and plan.lines else ""


def _of_samples(found: DatasetDescription) -> list[str]:
    inferred = f", {percent(found.scaling_inferred)} of that inferred" if found.scaling_inferred else ""
    return [
        f"  samples     {found.samples} at {compact(found.rate_hz)} Hz; "
        f"operator seen in {percent(found.operator_seen)}",
        f"  scaling     known in {percent(found.scaling_known)} of them{inferred}",
        f"  in motion   known in {percent(found.motion_covered)} of the samples{_deviation(found)}",
        *([bullet([_reasons(found.scaling_gaps)], mark="  unknown     ")] if found.scaling_gaps else []),
    ]


def _deviation(found: DatasetDescription) -> str:
    return "" if found.scaling_sd is None else f", to {fixed(found.scaling_sd, 4)} (median standard deviation)"


def _reasons(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{reason} {count}" for reason, count in counts.items())


def _clocks(clocks: Mapping[str, Mapping[str, Any]]) -> str:
    """Return how clocks were aligned: one entry per recording whose clock is not that of its session."""
    lines = [
        f"clock of {name}: {_clock(clock)}"
        for name, clock in clocks.items()
        if clock.get("method") not in (None, "own", "same-log")
    ]
    return bullet(_some(lines, SHOWN_FILES))


def _clock(clock: Mapping[str, Any]) -> str:
    parts = [str(clock["method"]), f"offset {fixed(clock.get('offset_s', 0.0), 3)} s"]
    if abs(clock.get("rate", 1.0) - 1.0) > 1e-9:
        parts.append(f"rate {signed(1e6 * (clock['rate'] - 1.0), 1)} ppm")
    if "residual_s" in clock:
        parts.append(f"residual {fixed(1000 * clock['residual_s'], 1)} ms")
    if "events" in clock:
        rejected = f" ({clock['events_rejected']} rejected)" if clock.get("events_rejected") else ""
        parts.append(f"{clock['events']} {_counted(clock)}{rejected}")
    if "correlation" in clock:
        parts.append(f"correlation {fixed(clock['correlation'], 2)}")
    if "second_best" in clock:
        parts.append(f"second-best fit {percent(clock['second_best'])} at {signed(clock['second_best_s'], 2)} s")
    if "same_as" in clock:
        parts.append(f"that of {clock['same_as']}")
    return ", ".join(parts)


def _counted(clock: Mapping[str, Any]) -> str:
    return "stamps" if clock["method"] == "lower-envelope" else "events"


def _operator(seen: Mapping[str, Mapping[str, int]]) -> str:
    """Return the number of samples with an operator, and of those without one by reason, over all recordings."""
    total = {name: sum(counts.get(name, 0) for counts in seen.values()) for name in GAP_REASONS}
    if not any(total.values()):
        return ""
    lines = [f"  {name:<11} {count} samples: {GAP_REASONS[name]}" for name, count in total.items() if count]
    disbelieved = sum(counts.get("not_believed", 0) for counts in seen.values())
    lines += [f"  implausible {disbelieved} positions: faster than a person moves"] if disbelieved else []
    return "\n".join(["operator, by the logs of people", *lines])


def _places(title: str, places: Mapping[str, Mapping[str, Any]]) -> str:
    rows = [
        [
            _labelled(name, place),
            *(fixed(round(value, 2) + 0.0, 2) for value in place["xyz_m"]),
            "found" if place["inferred"] else "named",
        ]
        for name, place in places.items()
    ]
    return table([title, "x, m", "y, m", "z, m", "origin "], rows) if rows else ""


def _labelled(name: str, place: Mapping[str, Any]) -> str:
    label = place["label"]
    return name if label == name else f"{name} ({label})"


def _tasks(tasks: Sequence[Mapping[str, Any]]) -> str:
    def mean(value: float | None) -> str:
        return "unknown" if value is None else fixed(value, 1)

    columns = ("nominal_s", "safety_loss_s", "dwell_s", "wait_s")
    rows = [[str(row["task"]), str(row["count"]), *(mean(row[name]) for name in columns)] for row in tasks]
    if not rows:
        return "no robot tasks found"
    more = (
        f"\n... and {len(rows) - SHOWN_TASKS} tasks more (all of them with --json)" if len(rows) > SHOWN_TASKS else ""
    )
    return table(["task ", "times", "motion, s", "safety", "dwell", "wait"], rows[:SHOWN_TASKS]) + more


def _model(found: ModelDescription) -> str:
    card, metrics = found.card, found.card.metrics
    split = {} if card.split is None else {name: len(names) for name, names in plain(card.split).items() if names}
    lines = [
        f"{found.path}: model",
        f"  problem    {found.problem}" + (f", horizon {duration(found.horizon_s)}" if found.horizon_s else ""),
        f"  network    {found.network}, {found.parameters} parameters",
        f"  levels     {', '.join(f'{fixed(level, 2)}' for level in found.levels) or 'none'}",
        f"  trained    on dataset {card.dataset or 'unknown'}, seed {'unknown' if card.seed is None else card.seed}, "
        f"by cyclekit {card.cyclekit or 'unknown'}",
        f"  executions {', '.join(f'{count} {part}' for part, count in split.items()) or 'unknown'}",
    ]
    lines += [f"  dropped    {count} samples: {reason}" for reason, count in card.dropped.items()]
    if metrics is not None:
        named = "" if metrics.accuracy is None else f", {percent(metrics.accuracy)} of levels predicted correctly"
        errors = f"MSE {scientific(metrics.mse_mean)}, mean absolute error {fixed(metrics.mae, 4)}"
        lines.append(bullet([f"{errors}{named} ({metrics.rows} samples)"], mark="  held out   "))
    if card.rule is not None:
        from cyclekit.cli.train import rule_lines

        lines += [bullet([text], mark="  ") for text in rule_lines(card.rule)]
    page = "\n".join([*lines, bullet(texts(card.warnings), mark="  ! ")]).rstrip()
    return "\n\n".join(part for part in (page, coupling_table(card.coupling)) if part)


def shorten(text: str) -> str:
    """Return a text shortened to at most three lines; the JSON document holds all of it."""
    return text if len(text) <= 220 else f"{text[:200].rstrip()} ... (all of it with --json)"


def _some(texts: Sequence[str], count: int) -> list[str]:
    kept = list(texts[:count])
    return [*kept, f"... and {len(texts) - count} more"] if len(texts) > count else kept
