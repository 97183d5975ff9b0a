"""`cyclekit adapters`: lists the log formats that can be read, with the package of each adapter."""

from __future__ import annotations

from cyclekit.cli.options import Json, Quiet
from cyclekit.cli.terminal import Terminal, table

EXAMPLE = "cyclekit adapters"


def adapters(json: Json = False, quiet: Quiet = False) -> None:
    """List the log formats that can be read."""
    from cyclekit.api.adapters import list_adapters

    found = list_adapters()
    rows = [[one["name"], one["reads"], f"{one['package']} {one['version']}"] for one in found.adapters]
    terminal = Terminal(json=json, quiet=quiet)
    terminal.answer(found.to_dict(), table(["adapter ", "reads ", "from "], rows))
