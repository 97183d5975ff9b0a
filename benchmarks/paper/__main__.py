"""Reproduces the paper's comparison on simulated cells: `python -m benchmarks.paper --help`, in the repository's root.

Simulates, trains every network of the paper, and writes its tables and figures with rivals and noise floors. Existing
results are reused: an interrupted run can be continued.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path

from benchmarks.paper.cells import prepared
from benchmarks.paper.plan import SCENES
from benchmarks.paper.runs import Settings, benchmark_paper
from benchmarks.paper.tables import markdown, put_into, write_figures
from cyclekit.dataset.guard import check_output
from cyclekit.errors import CyclekitError
from cyclekit.extras import need
from cyclekit.parallel.engine import Engine
from cyclekit.storage.atomic import write_text


def main(words: list[str] | None = None) -> int:
    """Run the comparison; return 1 if it was refused or a training failed.

    Args:
        words: Arguments; None = those of the process.
    """
    asked = _arguments().parse_args(words)
    settings = Settings(asked.executions, asked.seeds, asked.scenes, asked.steps, asked.only, asked.done)
    try:
        refused = _run(settings, asked.out, asked.page, Engine(jobs=asked.jobs))
    except CyclekitError as error:
        refused = [str(error)]
    for line in refused:
        print(f"error: {line}", file=sys.stderr)
    return 1 if refused else 0


def _run(settings: Settings, out: Path, page: Path | None, engine: Engine) -> list[str]:
    if not settings.done:
        need("the comparison", "simulate", "train")
    check_output(out, "folder", [])
    check_output(out / "tables.md", "words", [])
    results, refused = benchmark_paper(settings, out, partial(prepared, settings.executions), _say, engine)
    text = markdown(results)
    write_text(out / "tables.md", f"{text}\n<!-- written by cyclekit -->\n")
    write_figures(results, out / "figures")
    if page is not None:
        put_into(page, text)
    print(text)
    return refused


def _arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.paper", description=__doc__)
    add = parser.add_argument
    add("--out", type=Path, default=Path("out/paper"), help="folder for datasets, results, tables and figures")
    add("--executions", type=int, default=1000, help="executions per scene and seed")
    add("--seeds", type=_seeds, default=(1, 2, 3), help="seeds, with commas between")
    add("--scenes", type=_scenes, default=SCENES, help="scenes, with commas between")
    add("--steps", type=int, help="steps of every training; default: by the data")
    add("--only", default="", help="only numbers whose name, as in OUT/results, contains this")
    add("--done", action="store_true", help="run nothing; tables and figures of existing results")
    add("--page", type=Path, help="also put the tables into the marked place of this Markdown file")
    add("--jobs", type=int, help="number of datasets, then of entries, processed at the same time")
    return parser


def _seeds(text: str) -> tuple[int, ...]:
    return tuple(dict.fromkeys(int(word) for word in text.split(",")))


def _scenes(text: str) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(word.strip() for word in text.split(",")))
    if unknown := set(names) - set(SCENES):
        msg = f"no scene {', '.join(sorted(unknown))}; known: {', '.join(SCENES)}"
        raise argparse.ArgumentTypeError(msg)
    return names


def _say(share: float, what: str) -> None:
    print(f"{share:4.0%} {what}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
