"""`cyclekit adapters`: which formats can be read, and from which package."""

from __future__ import annotations

from cyclekit.cli.options import Json, Quiet
from cyclekit.cli.terminal import Terminal, table

EXAMPLE = "cyclekit adapters"


def adapters(json: Json = False, quiet: Quiet = False) -> None:
    """List the log formats that can be read."""
    from cyclekit.ingest.registry import adapters as registered
    from cyclekit.ingest.registry import left_out

    terminal = Terminal(json=json, quiet=quiet)
    found = list(registered().values())
    document = {
        "adapters": [
            {"name": entry.name, "package": entry.package, "version": entry.version, "reads": entry.summary}
            for entry in found
        ],
        "left_out": [vars(entry) for entry in left_out()],
    }
    rows = [[entry.name, entry.summary, f"{entry.package} {entry.version}"] for entry in found]
    terminal.answer(document, table(["adapter ", "reads ", "from "], rows))
