"""`list_adapters`: the formats that can be read, and the package of each."""

from __future__ import annotations

from dataclasses import dataclass

from cyclekit.api.arguments import checked
from cyclekit.ingest.registry import adapters, left_out
from cyclekit.text.results import Result


@dataclass(frozen=True, repr=False)
class AdapterList(Result):
    """The log formats that can be read; as a frame one row per adapter.

    Attributes:
        adapters: Name, package, version and description of each adapter.
        left_out: Adapters that could not be used, with the reason.
    """

    adapters: tuple[dict[str, str], ...]
    left_out: tuple[dict[str, str], ...]

    def _frame_rows(self) -> tuple[dict[str, str], ...]:
        return self.adapters

    def _lines(self) -> list[str]:
        return [f"{len(self.adapters)} log formats", ", ".join(one["name"] for one in self.adapters)]


@checked
def list_adapters() -> AdapterList:
    """List the log formats that can be read."""
    found = [
        {"name": one.name, "package": one.package, "version": one.version, "reads": one.summary}
        for one in adapters().values()
    ]
    return AdapterList(tuple(found), tuple(dict(vars(one)) for one in left_out()))
