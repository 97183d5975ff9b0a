"""`cyclekit ingest`: reads logs of any supported formats into one dataset."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from cyclekit.cli.groups import grouped
from cyclekit.cli.options import EngineName, FollowLinks, Jobs, Json, Quiet, RayAddress, engine_of
from cyclekit.cli.terminal import Terminal
from cyclekit.errors import command_line

if TYPE_CHECKING:
    from cyclekit.ingest.report import IngestReport

EXAMPLE = "cyclekit ingest logs --out dataset"


def ingest(
    logs: Annotated[list[str], typer.Argument(help="Logs: files and folders, in any mix.", metavar="LOGS")],
    out: Annotated[str, typer.Option(help="Dataset to make: a folder or a URL.", metavar="DATASET")],
    cell: Annotated[Path | None, typer.Option(help="Cell file; default: cell.toml in the folder of logs.")] = None,
    engine: EngineName = "local",
    jobs: Jobs = None,
    ray_address: RayAddress = None,
    rate: Annotated[
        float | None, typer.Option(help="Samples per second; default: the cell file's, or 10.", metavar="HZ")
    ] = None,
    pseudonymise: Annotated[
        bool, typer.Option("--pseudonymise", help="Keep no track ids and no wall-clock time (docs/privacy.md).")
    ] = False,
    keep_skeletons: Annotated[
        bool, typer.Option("--keep-skeletons", help="Keep every joint of every person (docs/privacy.md).")
    ] = False,
    no_checksums: Annotated[
        bool,
        typer.Option(
            "--no-checksums", help="No checksums of the logs (BLAKE3): a later change of a log is then not noticed."
        ),
    ] = False,
    align_clocks: Annotated[
        Literal["logs"] | None,
        typer.Option(
            help="logs: align clocks by what the logs show, also in doubt and against what is stated (docs/clocks.md)."
        ),
    ] = None,
    accept_bad_logs: Annotated[
        bool,
        typer.Option(
            "--accept-bad-logs",
            help="Go on without the only log of its kind if it is unreadable, and with values that cannot be.",
        ),
    ] = False,
    follow_links: FollowLinks = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Read logs of any supported format into one dataset.

    Repeated, it reads only what has changed. `cyclekit adapters` lists the formats.
    """
    from cyclekit.api.ingest import ingest_logs
    from cyclekit.errors import ConfigError, LogError
    from cyclekit.ingest.free_text import key_file
    from cyclekit.ingest.ingest import left_by

    terminal, work = Terminal(json=json, quiet=quiet), engine_of(engine, jobs, ray_address)
    try:
        with terminal.progress("ingesting") as progress:
            report = ingest_logs(
                logs,
                out,
                cell=cell,
                engine=work,
                rate_hz=rate,
                keep_skeletons=keep_skeletons,
                checksums=not no_checksums,
                pseudonymise=pseudonymise,
                align_clocks=align_clocks,
                accept_bad_logs=accept_bad_logs,
                follow_links=follow_links,
                progress=progress,
            )
    except (KeyboardInterrupt, ConfigError, LogError):
        if left := left_by(out):
            kept = "what was read, people included, is kept for the next ingest; remove it if none follows"
            terminal.remark(f"{left}: {kept}")
        raise
    for line in grouped(report.not_read):
        terminal.remark(f"not read: {line}")
    if pseudonymise and (key := key_file(report.dataset)).exists():
        terminal.remark(f"{key}: the next ingest gives words the same codes by it; keep it to yourself, or delete it")
    terminal.warnings(grouped(report.said))
    terminal.done(report.to_dict(), summary(report))


def summary(report: IngestReport) -> str:
    """Return the result of an ingest in two or three lines."""
    if report.unchanged:
        return f"{report.place}: up to date ({report.recordings_kept} recordings, nothing read again)"
    kept = f", {report.recordings_kept} kept" if report.recordings_kept else ""
    train = f", or {command_line('train', report.place, '--out', 'model')}" if report.samples and report.tasks else ""
    return (
        f"{report.place}: {report.executions} executions, {report.tasks} tasks, {report.samples} samples\n"
        f"  recordings: {report.recordings_new} read{kept}; files not read: {len(report.not_read)}\n"
        f"next: {command_line('inspect', report.place)}{train}"
    )
