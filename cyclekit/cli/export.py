"""`cyclekit export`: writes a model for other runtimes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cyclekit.cli.options import Json, ModelPlace, Quiet
from cyclekit.cli.terminal import Terminal
from cyclekit.text.numbers import scientific

EXAMPLE = "cyclekit export model --out model.onnx"


def export(
    model: ModelPlace,
    out: Annotated[Path, typer.Option(help="The ONNX file to write.", metavar="FILE")],
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write a model as an ONNX file.

    The file is checked against cyclekit's own prediction if onnxruntime is installed.
    """
    from cyclekit.api.export import export_model

    terminal = Terminal(json=json, quiet=quiet)
    done = export_model(model, out)
    off = done.difference
    checked = "not checked: onnxruntime is not installed" if off is None else f"within {scientific(off, 0)} of cyclekit"
    terminal.done(done.to_dict(), f"{out}: {checked}")
