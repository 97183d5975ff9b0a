"""`cyclekit init`: writes the project file for a folder of logs."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cyclekit.cli.groups import grouped
from cyclekit.cli.options import FollowLinks, Json, Quiet, Takt, seconds
from cyclekit.cli.terminal import Terminal, bullet, table
from cyclekit.errors import command_line
from cyclekit.text.numbers import fixed

if TYPE_CHECKING:
    from cyclekit.api.init import StartedProject

EXAMPLE = "cyclekit init logs --takt 105s"


def init(
    logs: Annotated[Path, typer.Argument(help="Folder of logs; default: this one.", metavar="FOLDER")] = Path(),
    takt: Takt = None,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Ask no questions.")] = False,
    follow_links: FollowLinks = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Look at a folder of logs and write cyclekit.toml here.

    The file holds the paths of logs, dataset, model, sequences and report. In its folder, commands take missing
    arguments from it, and `cyclekit run` brings everything up to date. Also writes a cell file if there is none.
    """
    from cyclekit.api.init import start_project

    terminal = Terminal(json=json, quiet=quiet)
    if takt is None and not (yes or json or quiet) and sys.stdin.isatty():
        takt = typer.prompt("Takt time, such as 105s (Enter: none)", default="", show_default=False, err=True).strip()
    if takt:
        seconds(takt)
    with terminal.progress("looking") as progress:
        found = start_project(logs, takt=takt or None, follow_links=follow_links, progress=progress)
    for line in grouped(found.not_read):
        terminal.remark(f"not read: {line}")
    terminal.warnings(grouped(found.warnings))
    if found.unread_bytes:
        terminal.remark(f"not read yet: {fixed(found.unread_bytes / 1e9, 1)} GB; their warnings: cyclekit inspect LOGS")
    terminal.done(found.to_dict(), _said(found))


def _said(found: StartedProject) -> str:
    rows = [[adapter, str(count)] for adapter, count in Counter(adapter for _, adapter in found.logs).most_common()]
    written = [f"{file}: written" for file in found.written]
    first = f'look for "# ?" in cell.toml ({found.unsure} lines are not sure), then type' if found.unsure else "type"
    return "\n".join([*([table(["logs read by ", "count"], rows)] if rows else []), bullet(written, mark="")]) + (
        f"\nnext: {first}\n  {command_line('run')}"
    )
