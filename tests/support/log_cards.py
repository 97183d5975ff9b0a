"""Cards of logs that nobody read, for tests of what is done with cards alone."""

from __future__ import annotations

from typing import Any

from cyclekit.dataset.cards import FrameCard, LogCard, SourceFile
from cyclekit.dataset.cards.recording import LogClock


def log_card(path: str, *tables: Any, kind: Any = "relative", **known: Any) -> LogCard:
    """Return the card of a log with these tables, a minute long unless other times are given."""
    values: dict[str, Any] = {
        "id": path.replace("/", "."), "adapter": "csv", "adapter_package": "cyclekit", "adapter_version": "0",
        "up": "z", "joint_names": (), "rows": {}, "rows_are": "row", "rows_read": 0, "rows_set_aside": (),
        "first_s": 0.0, "last_s": 60.0, "duration_s": 60.0, "rate_hz": None, "warnings": (), "facts": {}, "key": "",
    }  # fmt: skip
    return LogCard(
        tables=tables,
        sources=(SourceFile(path=path),),
        clock=LogClock(kind=kind),
        frame=FrameCard(method="assumed base frame"),
        **{**values, **known},
    )
