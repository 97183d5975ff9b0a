"""`cyclekit replay`: one execution as a Rerun recording, in 3-D and over time."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cyclekit.cli.options import Json, Quiet
from cyclekit.cli.terminal import Terminal, by_stage, duration

EXAMPLE = "cyclekit replay dataset --execution 1 --out replay.rrd"


def replay(
    dataset: Annotated[Path, typer.Argument(help="Folder of the dataset.", metavar="DATASET")],
    execution: Annotated[str, typer.Option(help="Name of the execution, or its number from 1.", metavar="ID")],
    out: Annotated[Path, typer.Option(help="Recording to write (.rrd).")],
    model: Annotated[Path | None, typer.Option(help="Model whose prediction is shown beside the log.")] = None,
    open_after: Annotated[bool, typer.Option("--open", help="Open the recording in the Rerun viewer.")] = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write a Rerun recording of one execution.

    Robot, operator, places and speed scaling, in 3-D and over time; with the prediction of a model if one is given.
    """
    from cyclekit.dataset import Dataset
    from cyclekit.models.saved import load_model
    from cyclekit.replay import open_viewer, write_replay

    terminal = Terminal(json=json, quiet=quiet)
    opened = Dataset.open(dataset)
    name = opened.find_execution(execution)
    trained = load_model(model) if model else None
    with terminal.progress("replaying") as progress:
        facts = write_replay(opened, name, out, model=trained, progress=by_stage(progress))
    terminal.warnings(facts.notes)
    document = {"replay": str(out), "execution": name, "duration_s": facts.duration_s, "notes": list(facts.notes)}
    terminal.done(document, f"{out}: execution {name}, {duration(facts.duration_s)}\nnext: rerun {out}")
    if open_after:
        open_viewer(out)
