"""`ingest_logs`: logs of any supported kind, in any mix, to one dataset."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from cyclekit.api.arguments import Place, Progress, checked
from cyclekit.config import Cell
from cyclekit.ingest.ingest import IngestReport, ingest
from cyclekit.parallel.engine import LOCAL, Engine


@checked
def ingest_logs(
    logs: Place | Sequence[Place],
    out: Place,
    *,
    cell: Cell | Place | None = None,
    engine: Engine = LOCAL,
    rate_hz: float | None = None,
    pseudonymise: bool = False,
    keep_skeletons: bool = False,
    checksums: bool = True,
    align_clocks: Literal["coarse"] | None = None,
    follow_links: bool = False,
    progress: Progress | None = None,
) -> IngestReport:
    """Read logs into the dataset `out`; what has not changed since the last time is not read again.

    Args:
        logs: Files and folders, by path or URL, one or any mix.
        out: Folder of the dataset, or the URL where it is published when it is complete.
        cell: Cell file; by default `cell.toml` beside the logs, if there is one.
        engine: Where logs are read, and how many at the same time.
        rate_hz: Rate of the samples; by default that of the cell file, or 10 Hz.
        pseudonymise: Keep neither the names that trackers give nor wall-clock time.
        keep_skeletons: Keep every joint of every person.
        checksums: Keep the BLAKE3 of each log.
        align_clocks: "coarse": last resort for unrelated clocks; hides the reaction time.
        follow_links: Also read what links in a folder of logs lead to outside of it.
        progress: Told the fraction done and what is being done.

    Raises:
        LogError: A log named explicitly cannot be used, or nothing in the folders can.
        ConfigError: The cell file cannot be followed.
        OutputError: The dataset would replace the logs, or what is no dataset.
        BusyPlace: Another process is writing the dataset.
        CyclekitError: The dataset cannot be written.
    """
    return ingest(
        [logs] if isinstance(logs, str | Path) else list(logs),
        out,
        cell=Path(cell) if isinstance(cell, str) else cell,
        engine=engine,
        rate_hz=rate_hz,
        pseudonymise=pseudonymise,
        keep_skeletons=keep_skeletons,
        checksums=checksums,
        align_clocks=align_clocks,
        follow_links=follow_links,
        progress=progress,
    )
