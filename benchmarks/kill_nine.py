"""Kills every writing command with kill -9 at random times: afterwards, either the old or the new result must exist.

Each command repeatedly overwrites an earlier result and is killed at times spread evenly over its usual duration. After
each kill the result is read: it must be one of the two complete ones. Finally the command runs once to its end, and no
other files may remain next to its result.

    python benchmarks/kill_nine.py --times 200
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import multiprocessing
import os
import random
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console
from rich.table import Table

PRELOAD = [
    "cyclekit.ingest.ingest",
    "cyclekit.learning.training",
    "cyclekit.estimate.rollout",
    "cyclekit.replay",
    "cyclekit.report",
    "cyclekit.learning.evaluation.evaluate",
    "cyclekit.ingest.convert",
    "cyclekit.cli",
    "cyclekit_sim",
]


@dataclass(frozen=True)
class Victim:
    """A command to be killed.

    Attributes:
        name: Name of the command.
        words: Two command lines for the same target, whose results differ.
        target: Path that both write.
    """

    name: str
    words: tuple[list[str], list[str]]
    target: Path


@dataclass
class Count:
    """Results of the kills of one command.

    Attributes:
        name: Name of the command.
        took_s: Usual duration of the command, s.
        killed: Number of kills while it ran.
        ended_first: Number of runs that ended before the kill.
        old: Number of kills after which the earlier result existed.
        new: Number of kills after which the new result existed.
        readings: Number of kills that left recordings next to the target, which the next run reuses.
        broken: Other states after a kill.
    """

    name: str
    took_s: float
    killed: int = 0
    ended_first: int = 0
    old: int = 0
    new: int = 0
    readings: int = 0
    broken: list[str] = field(default_factory=list)


def _type(words: list[str]) -> None:
    from cyclekit.cli import main

    with Path(os.devnull).open("w", encoding="utf-8") as silence:
        os.dup2(silence.fileno(), 1)
        os.dup2(silence.fileno(), 2)
        main(words)


class Terminal:
    """Runs command lines in new processes that can be killed."""

    def __init__(self) -> None:
        """Prepare a process with all imports, from which others are forked quickly."""
        forks = "forkserver" in multiprocessing.get_all_start_methods()
        self._context = multiprocessing.get_context("forkserver" if forks else "spawn")
        if forks:
            self._context.set_forkserver_preload(PRELOAD)

    def start(self, words: list[str]) -> multiprocessing.process.BaseProcess:
        """Start a command line."""
        process = self._context.Process(target=_type, args=(words,))  # type: ignore[attr-defined]
        process.start()
        return process  # type: ignore[no-any-return]

    def run(self, words: list[str]) -> float:
        """Run a command line to its end; return its duration, s.

        Raises:
            RuntimeError: The command failed.
        """
        begin = time.perf_counter()
        process = self.start(words)
        process.join()
        if process.exitcode != 0:
            raise RuntimeError(f"{words} ended with {process.exitcode}")
        return time.perf_counter() - begin


def state_of(target: Path) -> str:
    """Return a digest of a file, or of a folder with its contents; empty if it does not exist."""
    files = sorted(f for f in target.rglob("[!.]*") if f.is_file()) if target.is_dir() else [target][: target.exists()]
    if not files:
        return ""
    if target.suffix == ".rrd":  # rerun names the parts of a file differently every time
        return _content(target)
    whole = hashlib.sha256()
    for file in files:
        whole.update(file.relative_to(target.parent).as_posix().encode())
        whole.update(file.read_bytes())
    return whole.hexdigest()


def _content(replay: Path) -> str:
    from rerun.chunk import RrdReader

    try:
        parts = [(str(c.entity_path), c.num_rows, c.num_columns) for c in RrdReader(replay).stream()]
    except Exception as error:  # any error of rerun for a broken file
        return f"broken: {error}"
    return hashlib.sha256(repr(sorted(parts)).encode()).hexdigest()


def _beside(target: Path) -> list[str]:
    return sorted(entry.name for entry in target.parent.iterdir() if entry != target)


def _readings(target: Path) -> bool:
    return any(target.with_name(f".{target.name}.read").glob("*/entry.json"))


def kill(victim: Victim, times: int, terminal: Terminal, clean_up: Callable[[Path], None], seed: int = 0) -> Count:
    """Kill a command `times` times and return the resulting states.

    Args:
        victim: The command.
        times: Number of kills.
        terminal: Runs the command lines.
        clean_up: First step of a reader of the result (`recover` for folders).
        seed: Seed of the times.
    """
    chance = random.Random(seed)
    terminal.run(victim.words[1])
    other = state_of(victim.target)
    took_s = terminal.run(victim.words[0])
    first = state_of(victim.target)
    if first == other:
        raise RuntimeError(f"{victim.name}: both results are the same, so which one is there cannot be told")
    whole = {first: victim.words[0], other: victim.words[1]}
    count = Count(victim.name, took_s)
    now = first
    for number in range(times):
        words = victim.words[1] if now == first else victim.words[0]
        process = terminal.start(words)
        process.join(chance.uniform(0.0, took_s * 1.05))
        if process.exitcode is None:
            count.killed += 1
        else:
            count.ended_first += 1
        process.kill()
        process.join()
        count.readings += _readings(victim.target)
        clean_up(victim.target)
        left = state_of(victim.target)
        if left not in whole:
            count.broken.append(f"kill {number}: {left[:8] or 'nothing'}")
            terminal.run(victim.words[0])
            left = first
        elif left == now:
            count.old += 1
        else:
            count.new += 1
        now = left
    terminal.run(victim.words[1] if now == first else victim.words[0])
    if state_of(victim.target) not in whole or _beside(victim.target):
        count.broken.append(f"the next run left {_beside(victim.target)}")
    return count


@contextlib.contextmanager
def victims(root: Path, terminal: Terminal, *, executions: int = 3, few: bool = False) -> Iterator[list[Victim]]:
    """Make a small cell under `root` and yield every command that writes, each with a separate folder.

    Args:
        root: An empty folder.
        terminal: Runs the command lines.
        executions: Number of executions of the cell.
        few: Leave out the commands that need a second model or dataset.
    """
    from cyclekit.dataset.dataset import Dataset

    logs, others, data, elsewhere = (root / name for name in ("logs", "others", "dataset", "elsewhere"))
    model, another = root / "model", root / "another"
    quiet = "--quiet"
    simulate = ["simulate", "box-picking", "--executions", str(executions), quiet]
    terminal.run([*simulate, "--out", str(logs)])
    terminal.run([*simulate, "--seed", "7", "--out", str(others)])
    terminal.run(["ingest", str(logs), "--out", str(data), quiet])
    train = ["train", str(data), "--problem", "now", quiet]
    terminal.run([*train, "--out", str(model)])
    if not few:
        terminal.run([*train, "--seed", "3", "--out", str(another)])
        terminal.run(["ingest", str(others), "--out", str(elsewhere), quiet])
    tasks = Dataset.open(data).tasks()["task"].unique(maintain_order=True).to_list()
    one, two, three = [task.partition("->")[2] for task in tasks if task.startswith("conveyor->")][:3]
    sequence, jobs, other_jobs, changes, other_changes = (root / f"{name}.toml" for name in ("s", "j", "k", "c", "d"))
    sequence.write_text(f'[[sequence]]\nname = "one"\nplaces = ["conveyor", "{one}"]\n', encoding="utf-8")
    for file, other in ((jobs, two), (other_jobs, three)):
        work = f'start = "conveyor"\nvia = "conveyor"\nvisit = ["{one}", "{other}"]\n'
        file.write_text(work, encoding="utf-8")
    for file, far_m in ((changes, 1.6), (other_changes, 1.4)):
        rule = f"levels = [0.0, 0.25, 0.5, 0.75, 1.0]\nthresholds_m = [0.6, 0.8, 1.2, {far_m}]\n"
        file.write_text(f'[[change]]\nname = "to {far_m} m"\n{rule}', encoding="utf-8")
    names = Dataset.open(data).executions["execution"].to_list()

    def place(name: str) -> Path:
        (root / name).mkdir()
        return root / name / "result"

    def victim(name: str, one: list[str], two: list[str], suffix: str = "") -> Victim:
        target, command = place(name).with_suffix(suffix), name.partition(" ")[0]
        out = ["--out", str(target), quiet]
        return Victim(name, ([command, *one, *out], [command, *two, *out]), target)

    known = ["--dataset", str(data)]
    asked, anyhow = [str(model), str(sequence)], [*known, "--extrapolate", "--no-check"]
    estimate = [*asked, *anyhow]
    robot = str(logs / "session_000" / "robot.csv")
    report = [str(data), "--model", str(model), *(["--no-check"] if few else [])]
    yield [
        victim("simulate", ["box-picking", "--executions", "2"], ["box-picking", "--executions", "2", "--seed", "5"]),
        victim("ingest", [str(logs)], [robot]),
        victim("ingest of other logs", [str(logs)], [str(others)]),  # each reads two logs of more than 1 MiB each
        victim("convert to csv", [robot], [robot, "--rate", "50"], ".csv"),
        victim("convert to parquet", [robot], [robot, "--rate", "50"], ".parquet"),
        victim("train", train[1:-1], [*train[1:-1], "--seed", "1"]),
        victim("estimate", estimate, [*estimate, "--seed", "1"], ".json"),
        victim("plan", [str(model), str(jobs), *known], [str(model), str(other_jobs), *known], ".toml"),
        victim("whatif", [*asked, str(changes), *anyhow], [*asked, str(other_changes), *anyhow], ".json"),
        *(
            []
            if few
            else [
                victim("zones", [str(model), str(data)], [str(model), str(elsewhere)], ".svg"),
                victim("export", [str(model)], [str(another)], ".onnx"),
            ]
        ),
        victim("replay", [str(data), "--execution", names[0]], [str(data), "--execution", names[1]], ".rrd"),
        victim("report", report, [*report, "--sequences", str(sequence)], ".html"),
    ]


def main() -> None:
    """Kill each command and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--times", type=int, default=20, help="kills per command")
    parser.add_argument("--only", nargs="*", help="these commands")
    times, only = parser.parse_args().times, parser.parse_args().only
    from cyclekit.storage.atomic import recover

    terminal = Terminal()
    table = Table("command", "duration", "killed", "ended before", "old", "new", "recordings left", "broken")
    with tempfile.TemporaryDirectory() as folder, victims(Path(folder), terminal) as found:
        for victim in found:
            if only is None or victim.name in only:
                count = kill(victim, times, terminal, recover)
                numbers = (count.killed, count.ended_first, count.old, count.new, count.readings)
                table.add_row(count.name, f"{count.took_s:.2f} s", *map(str, numbers), ", ".join(count.broken) or "0")
    Console().print(table)


if __name__ == "__main__":
    main()
