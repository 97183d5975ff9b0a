"""`cyclekit plan`: searches the fastest order of the same tasks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cyclekit.cli.light import light, light_of_findings
from cyclekit.cli.options import Checked, Json, LoggedPlace, ModelPlace, OtherCell, Quiet
from cyclekit.cli.terminal import Terminal
from cyclekit.text.numbers import counted, percent, seconds

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.estimate.plan import OrderPlan
    from cyclekit.estimate.plan.task_orders import TaskOrderPlan

EXAMPLE = """cyclekit plan model jobs.toml --dataset dataset

\b
jobs.toml, more in docs/commands.md:
  start = "home"
  end = "home"
  via = "conveyor"                   # visited before each place; or leave it out
  visit = ["left_1", "left_2", "right_1", "right_2"]
  before = [["left_1", "left_2"]]    # the first before the second"""


def plan(
    model: ModelPlace,
    jobs: Annotated[
        Path,
        typer.Argument(help="Jobs file: what is to be done, and what must precede what.", metavar="JOBS.toml"),
    ],
    dataset: LoggedPlace,
    out: Annotated[Path | None, typer.Option(help="Also write it: a sequence file (.toml) or Excel (.xlsx).")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the search and the resampling.")] = 0,
    check: Checked = True,
    other_cell: OtherCell = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Search the order of tasks with the least cycle time.

    Tries all orders if they are few; else improves good and random ones in small steps.
    Prints what the order saves compared with the logged ones.
    """
    from cyclekit.api.plan import plan_order
    from cyclekit.estimate.plan.task_orders import TaskOrderPlan

    terminal = Terminal(json=json, quiet=quiet)
    with terminal.progress("planning") as progress:
        found = plan_order(
            model, dataset, jobs, out=out, seed=seed, validate=check, other_cell=other_cell, progress=progress
        )
    if out is not None:
        terminal.remark(f"written: {out}")
    if isinstance(found, TaskOrderPlan):
        terminal.answer(found.to_dict(), light([found.estimate]), _both(found))
        return
    terminal.warnings(found.notes)
    terminal.answer(found.to_dict(), light_of_findings(found.findings), _text(found))


def _both(found: TaskOrderPlan) -> str:
    """Return the order of both agents' tasks, and the time saved."""
    agents = dict.fromkeys(task.agent for task in found.tasks)
    lines = [f"{agent}: {', '.join(one.name for one in found.tasks if one.agent == agent)}" for agent in agents]
    return "\n".join(
        [
            *lines,
            *_saved(found, found.estimate.expected_s),
            f"search: {counted(found.tried, 'order')} scored; {counted(found.estimate.executions, 'logged execution')}",
            *found.estimate.limits,
        ]
    )


def _saved(found: OrderPlan | TaskOrderPlan, expected_s: float, star: str = "") -> list[str]:
    """Return the cycle time, that of the logged executions or of random orders, and what the order saves."""
    return [
        f"expected {seconds(expected_s, found.against_s)}{star}; "
        f"{found.against} {seconds(found.against_s, expected_s)} on average",
        f"saves {found.saving_in_words}" + (" a cycle" if any(found.saves_s) else ""),
    ]


def _orders(robot: str, operator: Sequence[str]) -> list[str]:
    return [f"robot: {robot}", f"operator: {', '.join(operator)}"]


def _text(found: OrderPlan) -> str:
    from cyclekit.estimate.finding import MARKS, worst
    from cyclekit.estimate.plan import some

    order = ", ".join(found.order)
    lines = [
        *([f"order: {order}"] if found.operator is None else _orders(order, found.operator)),
        *_saved(found, found.expected_s, MARKS[worst(found.findings)]),
        f"{found.searched}: {counted(found.tried, 'order')} scored; {counted(found.executions, 'logged execution')}",
    ]
    if found.allowance > 1.0:
        lines.append(f"expected: with {percent(found.allowance - 1.0, 1)} more, because the same logs chose the order")
    if found.unlogged:
        lines.append(
            f"left out: orders that need a task that was never logged; log these tasks to include the orders: "
            f"{some(found.unlogged)}"
        )
    return "\n".join(lines)
