"""`cyclekit demo`: runs all steps on a simulated cell, from logs to a report of sequences, an order and changes.

Each step calls the library function of the command of the same name. Repeated runs overwrite the folder with the same
numbers.
"""

from __future__ import annotations

import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cyclekit.cli.light import light, marked
from cyclekit.cli.options import Json, OperatorLog, OperatorXyz, OperatorYaw, Quiet, vector
from cyclekit.cli.terminal import Terminal, bullet, table, write_out
from cyclekit.cli.train import summary
from cyclekit.errors import command_line
from cyclekit.text.numbers import duration, fixed, given, interval

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.answers import CycleEstimates
    from cyclekit.learning.networks.saved import TrainedModel
    from cyclekit.report import ReportFacts
    from cyclekit.schema import Progress

EXAMPLE = "cyclekit demo --out out/"
SCENE = "box-picking"
STEPS = 6
WIDTH = 60
"""Maximum width of the final table, characters."""
_LEFT, _RIGHT = ([f"{side}_{number}" for number in range(1, 6)] for side in ("left", "right"))
SEQUENCES = {
    "left table first": [*_LEFT, *_RIGHT],
    "right table first": [*_RIGHT, *_LEFT],
    "tables in turn": [slot for pair in zip(_LEFT, _RIGHT, strict=True) for slot in pair],
}
"""Ten boxes each, from the conveyor to the slots in this order; none of these orders occurs in the logs."""

TAKT_S = 100.0
"""Takt time of the demo, s: most logged cycles are within it."""
JOBS = f"""# Written by cyclekit demo
# The same ten boxes, in the order that takes the least time.
start = "home"
end = "home"
via = "conveyor"
visit = [{", ".join(f'"{slot}"' for slot in (*_LEFT, *_RIGHT))}]
"""
CHANGES = """# Written by cyclekit demo
# What would help?
[[change]]
name = "zones 0.2 m tighter"
levels = [0.0, 0.25, 0.5, 0.75, 1.0]
thresholds_m = [1.0, 1.3, 1.7, 2.2]

[[change]]
name = "half as many visits"
frequency = 0.5
"""


def demo(
    out: Annotated[Path, typer.Option(help="Folder for everything that the demo makes.")] = Path("out"),
    executions: Annotated[int, typer.Option(min=5, help="How many executions are simulated.")] = 40,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same logs.")] = 1,
    operator_log: OperatorLog = None,
    operator_xyz: OperatorXyz = None,
    operator_yaw: OperatorYaw = 0.0,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run every step once, on a simulated cell.

    Simulates and ingests plant logs, trains a model, estimates three sequences for a takt of 100 s, and writes a replay
    and a report with the order that takes the least time and two changes of the cell. Repeated, it gives the same
    numbers.
    """
    settings: dict[str, object] = {"operator_log": operator_log, "operator_yaw_deg": operator_yaw}
    if operator_xyz is not None:
        settings["operator_xyz_m"] = vector(operator_xyz)
    run = _Run(Terminal(json=json, quiet=quiet), out)
    _check(out, operator_log)
    dataset = _dataset(run, executions, seed, settings)
    model = _model(run, dataset, seed)
    estimates = _estimates(run, dataset, model)
    replay, report = _replay(run, dataset, model), _report(run, dataset, model, estimates)
    document = {
        "sequences": [entry.to_dict() for entry in estimates],
        "files": {"dataset": dataset.path, "model": out / "model", "replay": replay, "report": report.path},
        "seconds": run.spent_s,
    }
    run.terminal.answer(document, _closing(estimates, report.headline, run))


@dataclass
class _Run:
    """The folder of the demo, and the duration of each step."""

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
    """Raise errors of the arguments before the first step."""
    from cyclekit.dataset.guard import Kind, check_output
    from cyclekit.extras import need

    need("demo", "simulate", "train", "replay")
    check_output(out, "folder", [operator_log])
    parts: dict[str, Kind] = {
        "logs": "logs",
        "dataset": "dataset",
        "model": "model",
        "sequences.toml": "sequences",
        "jobs.toml": "sequences",
        "changes.toml": "sequences",
        "estimates.json": "estimates-json",
        "replay.rrd": "replay",
        "report.html": "page",
    }
    for name, kind in parts.items():
        check_output(out / name, kind, [operator_log])


def _dataset(run: _Run, executions: int, seed: int, settings: dict[str, object]) -> Dataset:
    from cyclekit.api.ingest import ingest_logs
    from cyclekit.api.simulate import simulate_logs
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.parallel.engine import Engine

    simulated = partial(simulate_logs, SCENE, run.out / "logs", executions=executions, seed=seed)
    with run.step(f"simulate {executions} executions of {SCENE}") as progress:
        logs = simulated(settings=settings, progress=progress).logs
    with run.step("ingest the logs") as progress:
        ingest_logs(logs, run.out / "dataset", engine=Engine(jobs=2), progress=progress)
    return Dataset.open(run.out / "dataset")


def _model(run: _Run, dataset: Dataset, seed: int) -> TrainedModel:
    from cyclekit.api.train import train_model
    from cyclekit.learning.networks.saved import load_model
    from cyclekit.learning.networks.spec import ModelSpec

    with run.step("train the safety function") as progress:
        train_model(dataset, ModelSpec.of(seed=seed), out=run.out / "model", progress=progress)
    model = load_model(run.out / "model")
    run.terminal.remark(f"  {summary(model.card)}")
    return model


def _estimates(run: _Run, dataset: Dataset, model: TrainedModel) -> CycleEstimates:
    from cyclekit.api.estimate import estimate_cycles

    file = run.out / "sequences.toml"
    write_out(file, sequences_toml(set(dataset.tasks()["task"])))
    with run.step(f"estimate {len(SEQUENCES)} sequences") as progress:
        return estimate_cycles(model, dataset, file, out=run.out / "estimates.json", takt_s=TAKT_S, progress=progress)


def sequences_toml(logged: set[str]) -> str:
    """Return the sequence file of the demo: every box from the conveyor to its slot, then home.

    Args:
        logged: Tasks that occur in the logs. The last slot of a logged execution is random, so each order ends with a
            slot from which the robot went home in the logs, or at its last slot if there is none.
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
    from cyclekit.api.replay import write_replay

    with run.step("write the replay") as progress:
        return write_replay(dataset, 1, run.out / "replay.rrd", model=model, progress=progress).path


def _report(run: _Run, dataset: Dataset, model: TrainedModel, estimates: CycleEstimates) -> ReportFacts:
    from cyclekit.api.report import write_report

    jobs, changes = run.out / "jobs.toml", run.out / "changes.toml"
    write_out(jobs, JOBS)
    write_out(changes, CHANGES)
    with run.step("search the order, price two changes, and write the report") as progress:
        return write_report(
            dataset,
            run.out / "report.html",
            model=model,
            sequences=run.out / "sequences.toml",
            what_if=[changes],
            jobs=jobs,
            takt_s=TAKT_S,
            estimates=estimates,
            progress=progress,
        )


def _closing(estimates: CycleEstimates, verdict: str, run: _Run) -> str:
    model, sequences, takt = run.out / "model", run.out / "sequences.toml", f"{given(TAKT_S)}s"
    lines = [
        "Cycle time of three orders of the same ten boxes:",
        "",
        light(estimates, width=WIDTH),
        _table(estimates),
        "",
        bullet([verdict], mark="", width=WIDTH),
        "",
        "Next",
        "- the page for the customer, in any browser:",
        f"    {run.out / 'report.html'}",
        "- the first execution in 3-D, with the prediction:",
        f"    {command_line(run.out / 'replay.rrd', program='rerun')}",
        f"- sequences of your own: change {sequences}, then",
        f"    {command_line('estimate', model, sequences, '--dataset', run.out / 'dataset', '--takt', takt)}",
        "",
        f"Done in {duration(sum(run.spent_s.values()))}.",
    ]
    return "\n".join(line for line, before in zip(lines, ["x", *lines], strict=False) if line or before)


def _table(estimates: CycleEstimates) -> str:
    """Return a table with mean, 95 % interval and slow-down of each sequence, at most 60 characters wide."""
    rows = [
        [
            f"{rank}. {one.name}",
            marked(one, fixed(one.expected_s, 1)),
            interval(one.expected_low_s, one.expected_high_s, 1),
            fixed(one.safety_loss_s, 1),
        ]
        for rank, one in enumerate(estimates, start=1)
    ]
    return table(["order ", "mean, s", "95 % CI", "slow-down"], rows)
