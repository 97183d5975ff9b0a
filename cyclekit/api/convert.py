"""`convert_log`: one log to one table, for other tools."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cyclekit.api.arguments import Place, Progress, checked
from cyclekit.config import Cell, load_cell
from cyclekit.dataset.guard import Kind, check_output
from cyclekit.ingest.convert import Converted, convert


@checked
def convert_log(
    log: Place,
    out: Place,
    *,
    table: str | None = None,
    rate_hz: float | None = None,
    columns: Sequence[str] = (),
    cell: Cell | Place | None = None,
    progress: Progress | None = None,
) -> Converted:
    """Write one table of a log as Parquet or CSV: SI units, the log's own clock and frame.

    Args:
        log: A file, or a folder that is one log.
        out: `.parquet` or `.csv`; replaced as a whole.
        table: robot, people, events, task_list, safety or skeletons; by default the first that the log has.
        rate_hz: Rows a second, averaged; by default every row.
        columns: Columns to write; by default all that hold anything, `t_s` always.
        cell: Cell file that says how the log is to be read; by default the one beside it.
        progress: Told the fraction done and what is being done.

    Raises:
        LogError: The log cannot be used, or has no such table.
        ConfigError: A name, a rate or the kind of output is not known.
        OutputError: The output would replace the log, or what no conversion wrote.
        CyclekitError: The output cannot be written.
    """
    file = Path(out)
    inputs = [log, None if isinstance(cell, Cell) else cell]
    kind: Kind = "table-csv" if file.suffix.lower() == ".csv" else "table-parquet"
    check_output(file, kind, inputs, endings=(".parquet", ".csv"))
    settings = cell if cell is None or isinstance(cell, Cell) else load_cell(Path(cell))
    return convert(log, file, table=table, rate_hz=rate_hz, columns=columns, cell=settings, progress=progress)
