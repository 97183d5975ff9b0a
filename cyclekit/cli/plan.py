"""`cyclekit plan`: the order of the same work that takes least time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cyclekit.cli.estimate import DOUBTED, alarmed
from cyclekit.cli.options import Checked, Json, LoggedPlace, ModelPlace, OtherCell, Quiet
from cyclekit.cli.terminal import Terminal, bullet, write_out

if TYPE_CHECKING:
    from cyclekit.estimate.plan import Plan

EXAMPLE = "cyclekit plan model jobs.toml --dataset dataset"


def plan(
    model: ModelPlace,
    jobs: Annotated[Path, typer.Argument(help="What is to be visited, and what comes first.", metavar="JOBS.toml")],
    dataset: LoggedPlace,
    out: Annotated[Path | None, typer.Option(help="Also write the order here, as a sequence file.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the search and the resampling.")] = 0,
    check: Checked = True,
    other_cell: OtherCell = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Search the order of tasks with the least cycle time.

    All orders where they are few; else greedy, Monte Carlo and a local search.
    Says what the order saves against the logged ones.
    """
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.dataset.guard import check_output
    from cyclekit.estimate.plan import load_jobs
    from cyclekit.estimate.plan import plan as search
    from cyclekit.learning.networks.saved import load_model

    terminal = Terminal(json=json, quiet=quiet)
    check_output(out, "sequences", [model, jobs, dataset], endings=(".toml",))
    wanted = load_jobs(jobs)
    with terminal.progress("planning") as progress:
        found = search(
            load_model(model),
            Dataset.open(dataset),
            wanted,
            seed=seed,
            validate=check,
            other_cell=other_cell,
            progress=progress,
        )
    if out is not None:
        names = ", ".join(f'"{place}"' for place in found.places)
        write_out(out, f'# Written by cyclekit plan\n[[sequence]]\nname = "planned"\nplaces = [{names}]\n')
        terminal.remark(f"written: {out}")
    alarms = [found.alarm] if found.alarm else []
    doubts = bullet(found.doubts, mark=DOUBTED)
    terminal.warnings(found.notes)
    terminal.answer({**found.to_json(), "warnings": alarms}, alarmed(alarms), f"{_text(found)}\n{doubts}".rstrip())


def _text(found: Plan) -> str:
    from cyclekit.estimate.plan import some

    saved, low, high = found.saves_s
    star = "*" if found.doubts else ""
    lines = [
        f"order: {', '.join(found.order)}",
        f"expected {found.expected_s:.1f} s{star}; {found.against} {found.against_s:.1f} s on average",
        f"saves {saved:.1f} s a cycle ({low:.1f} to {high:.1f} s, 95%) beside the logged operators",
        f"of that {found.saves_unseen_s:.1f} s with operators the order was not chosen by",
        f"{found.searched}: {found.tried} orders scored; {found.executions} logged executions",
    ]
    if found.unlogged:
        lines.append(
            f"left out: orders that need a task that was never logged; log these to have them searched: "
            f"{some(found.unlogged)}"
        )
    return "\n".join(lines)
