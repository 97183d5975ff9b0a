"""`cyclekit benchmark`: the paper's comparison, done again on a simulated cell."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer

from cyclekit.cli.options import EngineName, Jobs, Json, Quiet, RayAddress, engine_of, whole_numbers
from cyclekit.cli.terminal import Terminal

SCENES = ("box-picking", "pick-and-package", "laser-zones")
EXAMPLE = "cyclekit benchmark paper --executions 1000 --out out/paper"


def benchmark(
    what: Annotated[Literal["paper"], typer.Argument(help="Which comparison.", metavar="WHAT")],
    out: Annotated[Path, typer.Option(help="Folder for datasets, results and the page.", metavar="DIR")] = Path(
        "out/paper"
    ),
    executions: Annotated[int, typer.Option(min=10, help="Executions per scene and seed.")] = 1000,
    seeds: Annotated[str, typer.Option(help="Seeds, with commas between.")] = "1,2,3",
    scenes: Annotated[
        str, typer.Option(help="Scenes, with commas between.")
    ] = "box-picking,pick-and-package,laser-zones",
    steps: Annotated[int | None, typer.Option(min=10, help="Steps of every training; default: what suits.")] = None,
    only: Annotated[str, typer.Option(help="Only numbers whose name contains this.")] = "",
    done: Annotated[bool, typer.Option("--done", help="Run nothing; tables and figures of what is there.")] = False,
    page: Annotated[Path | None, typer.Option(help="Also put the tables into this Markdown file.")] = None,
    engine: EngineName = "local",
    jobs: Jobs = None,
    ray_address: RayAddress = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Simulate, train every network of the paper, and write its tables and figures beside rivals and floors.

    WHAT is paper. What was done before is kept: the command goes on where it stopped.
    """
    from cyclekit.benchmark import Settings, benchmark_paper
    from cyclekit.benchmark.tables import markdown, put_into, write_figures
    from cyclekit.dataset.guard import check_output
    from cyclekit.errors import ConfigError
    from cyclekit.learning.training import need_torch
    from cyclekit.storage.atomic import write_text
    from cyclekit.storage.outputs import check_writable

    del what
    terminal, work = Terminal(json=json, quiet=quiet), engine_of(engine, jobs, ray_address)
    if not done:
        need_torch()
    check_output(out, "folder", [])
    check_output(out / "tables.md", "words", [])
    check_writable(page, (".md",))
    settings = Settings(executions, whole_numbers(seeds), _names(scenes), steps, only, done)
    with terminal.progress("benchmark") as progress:
        results, refused = benchmark_paper(settings, out, partial(_prepared, executions), progress, work)
        text = markdown(results)
        write_text(out / "tables.md", f"{text}\n<!-- written by cyclekit -->\n")
        write_figures(results, out / "figures")
        if page is not None:
            put_into(page, text)
    terminal.answer({"out": str(out), "results": results, "refused": refused}, text)
    if refused:
        some = "; ".join(refused[:3]) + (f"; and {len(refused) - 3} more" if len(refused) > 3 else "")
        raise ConfigError(f"not all could be trained: {some}", cure="Try other --seeds or --steps.")


def _prepared(executions: int, scene: str, seed: int, folder: Path) -> None:
    """Simulate and ingest one scene unless that was done; keep the truth beside the dataset, and drop the logs."""
    import shutil

    from cyclekit.cli.simulate import simulated
    from cyclekit.ingest.ingest import ingest

    dataset = folder / "dataset"
    if (dataset / "dataset.json").is_file() and (folder / "truth.json").is_file():
        return
    folder.mkdir(parents=True, exist_ok=True)
    logs = simulated(scene, folder / "logs", executions, seed, {}, lambda _share, _what: None)
    shutil.copyfile(logs / "truth" / "truth.json", folder / "truth.json")
    ingest([logs], dataset)
    shutil.rmtree(logs)


def _names(text: str) -> tuple[str, ...]:
    from cyclekit.errors import UnknownName

    names = tuple(dict.fromkeys(word.strip() for word in text.split(",")))
    for name in names:
        if name not in SCENES:
            raise UnknownName("--scenes", "scene", name, SCENES)
    return names
