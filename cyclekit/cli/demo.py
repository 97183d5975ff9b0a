"""`cyclekit demo`: the whole way on a simulated cell, from logs to the cycle time of three sequences.

Each step is the library call that the command of the same name makes; the demo only strings them together, on its
own folder, which the same demo overwrites with the same numbers.
"""

from __future__ import annotations

import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cyclekit.cli.estimate import CAPTION, doubted, estimates_table, judged, loses_most, rests_on
from cyclekit.cli.options import Json, Quiet, vector
from cyclekit.cli.simulate import simulated
from cyclekit.cli.terminal import Terminal, duration, write_out
from cyclekit.cli.train import summary
from cyclekit.errors import command_line

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cyclekit.cli.terminal import Progress
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.learning.networks.saved import TrainedModel

EXAMPLE = "cyclekit demo --out out/"
SCENE = "box-picking"
STEPS = 6
_LEFT, _RIGHT = ([f"{side}_{number}" for number in range(1, 6)] for side in ("left", "right"))
SEQUENCES = {
    "left table first": [*_LEFT, *_RIGHT],
    "right table first": [*_RIGHT, *_LEFT],
    "tables in turn": [slot for pair in zip(_LEFT, _RIGHT, strict=True) for slot in pair],
}
"""Ten boxes each, from the conveyor to the slots in this order; none of these orders occurs in the logs."""


def demo(
    out: Annotated[Path, typer.Option(help="Folder for everything that the demo makes.")] = Path("out"),
    executions: Annotated[int, typer.Option(min=5, help="How many executions are simulated.")] = 40,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same logs.")] = 1,
    operator_log: Annotated[
        Path | None, typer.Option(help="A real tracker recording that walks instead of the simulated operator.")
    ] = None,
    operator_xyz: Annotated[
        str | None, typer.Option(help="Where the recording's origin stands, base frame: x,y,z in m.")
    ] = None,
    operator_yaw: Annotated[float, typer.Option(help="How the recording is turned about the vertical, degrees.")] = 0.0,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Go the whole way once, on a simulated cell.

    Plant logs are simulated and ingested, a model is trained, three sequences are estimated; a replay and a report
    are written. The same demo again gives the same numbers.
    """
    settings: dict[str, Any] = {"operator_log": operator_log, "operator_yaw_deg": operator_yaw}
    if operator_xyz is not None:
        settings["operator_xyz_m"] = vector(operator_xyz)
    run = _Run(Terminal(json=json, quiet=quiet), out)
    _check(out, operator_log)
    dataset = _dataset(run, executions, seed, settings)
    model = _model(run, dataset, seed)
    estimates = _estimates(run, dataset, model, seed)
    replay, report = _replay(run, dataset, model), _report(run, dataset, model, estimates)
    document = {
        "sequences": [entry.to_json() for entry in estimates],
        "files": {"dataset": dataset.path, "model": out / "model", "replay": replay, "report": report},
        "seconds": run.spent_s,
    }
    run.terminal.answer(document, _closing(estimates, run))


@dataclass
class _Run:
    """Where the demo works, and how long each step took."""

    terminal: Terminal
    out: Path
    spent_s: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def step(self, title: str) -> Iterator[Progress]:
        began_s = time.monotonic()
        with self.terminal.progress(title) as progress:
            yield progress
        self.spent_s[title] = time.monotonic() - began_s
        self.terminal.remark(f"[{len(self.spent_s)}/{STEPS}] {title}: {duration(self.spent_s[title])}")


def _check(out: Path, operator_log: Path | None) -> None:
    """Refuse before any work what would be refused after half of it."""
    from cyclekit.dataset.guard import Kind, check_output
    from cyclekit.learning.training import need_torch

    need_torch()
    check_output(out, "folder", [operator_log])
    parts: dict[str, Kind] = {
        "logs": "logs",
        "dataset": "dataset",
        "model": "model",
        "sequences.toml": "sequences",
        "estimates.json": "estimates-json",
        "replay.rrd": "replay",
        "report.html": "page",
    }
    for name, kind in parts.items():
        check_output(out / name, kind, [operator_log])


def _dataset(run: _Run, executions: int, seed: int, settings: dict[str, Any]) -> Dataset:
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.ingest.ingest import ingest
    from cyclekit.parallel.engine import Engine

    with run.step(f"simulate {executions} executions of {SCENE}") as progress:
        logs = simulated(SCENE, run.out / "logs", executions, seed, settings, progress)
    with run.step("ingest the logs") as progress:
        ingest([logs], run.out / "dataset", engine=Engine(jobs=2), progress=progress)
    return Dataset.open(run.out / "dataset")


def _model(run: _Run, dataset: Dataset, seed: int) -> TrainedModel:
    from cyclekit.learning.networks.saved import load_model, save_model
    from cyclekit.learning.networks.spec import ModelSpec
    from cyclekit.learning.training import train

    with run.step("train the safety function") as progress:
        save_model(run.out / "model", train(dataset, ModelSpec.of(seed=seed), progress=progress))
    model = load_model(run.out / "model")  # as the other commands will find it
    run.terminal.remark(f"  {summary(model.card)}")
    return model


def _estimates(run: _Run, dataset: Dataset, model: TrainedModel, seed: int) -> list[CycleEstimate]:
    from cyclekit.config.sequences import load_sequences
    from cyclekit.estimate.rollout import estimate

    file = run.out / "sequences.toml"
    write_out(file, sequences_toml(set(dataset.tasks()["task"])))
    with run.step(f"estimate {len(SEQUENCES)} sequences") as progress:
        found = estimate(model, dataset, load_sequences(file), seed=seed, progress=progress)
    write_out(run.out / "estimates.json", {"sequences": [entry.to_json() for entry in found]})
    return found


def sequences_toml(logged: set[str]) -> str:
    """Return the sequence file of the demo: every box from the conveyor to its slot, then home.

    Args:
        logged: Tasks that occur in the logs. Which slot was the last one of an execution is chance, so each order
            ends with a slot from which the robot was seen to go home, or at its last slot where there is none.
    """
    blocks = []
    for name, slots in SEQUENCES.items():
        last = next((slot for slot in reversed(slots) if f"{slot}->home" in logged), None)
        order = [slot for slot in slots if slot != last] + ([last] if last else [])
        places = ["home", *(place for slot in order for place in ("conveyor", slot)), *(["home"] if last else [])]
        quoted = ", ".join(f'"{place}"' for place in places)
        blocks.append(f'[[sequence]]\nname = "{name}"\nplaces = [{quoted}]\n')
    return "\n".join(["# Written by cyclekit demo", *blocks])


def _replay(run: _Run, dataset: Dataset, model: TrainedModel) -> Path:
    from cyclekit.replay import write_replay

    file = run.out / "replay.rrd"
    with run.step("write the replay") as progress:
        write_replay(dataset, dataset.find_execution("1"), file, model=model, progress=progress)
    return file


def _report(run: _Run, dataset: Dataset, model: TrainedModel, estimates: list[CycleEstimate]) -> Path:
    from cyclekit.learning.evaluation.evaluate import evaluate
    from cyclekit.report import write_report

    file = run.out / "report.html"
    with run.step("evaluate, and write the report") as progress:
        evaluation = evaluate(model, dataset)
        check = estimates[0].check
        write_report(dataset, model, file, estimates=estimates, evaluation=evaluation, check=check, progress=progress)
    return file


def _closing(estimates: list[CycleEstimate], run: _Run) -> str:
    model, dataset = run.out / "model", run.out / "dataset"
    lines = ["How long does a cycle take? Three orders of the same ten boxes, quickest first:", ""]
    lines += [f"{estimates_table(estimates)}\n{CAPTION}\n{doubted(estimates)}".rstrip(), "", loses_most(estimates)]
    check = estimates[0].check
    lines += ["", rests_on(estimates), *(["", judged(check)] if check else []), "", "Next"]
    lines += [
        "- the page for the customer, in any browser:",
        f"    {run.out / 'report.html'}",
        "- the first execution in 3-D, with the model's prediction:",
        f"    {command_line(run.out / 'replay.rrd', program='rerun')}",
        f"- your own sequences: change {run.out / 'sequences.toml'}, then",
        f"    {command_line('estimate', model, run.out / 'sequences.toml', '--dataset', dataset)}",
        "",
        f"Done in {duration(sum(run.spent_s.values()))}.",
    ]
    return "\n".join(lines)
