"""`cyclekit export`: a model for other runtimes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cyclekit.cli.options import Json, ModelPlace, Quiet
from cyclekit.cli.terminal import Terminal

EXAMPLE = "cyclekit export model --out model.onnx"


def export(
    model: ModelPlace,
    out: Annotated[Path, typer.Option(help="The ONNX file to write.", metavar="FILE")],
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write a model as an ONNX file, checked against cyclekit's own prediction where onnxruntime is installed."""
    from cyclekit.dataset.guard import check_output
    from cyclekit.learning.networks.onnx_file import write_onnx
    from cyclekit.learning.networks.saved import load_model

    terminal = Terminal(json=json, quiet=quiet)
    check_output(out, "onnx", [model], endings=(".onnx",))
    off = write_onnx(out, load_model(model))
    checked = "not checked: onnxruntime is not installed" if off is None else f"within {off:.0e} of cyclekit"
    terminal.done({"onnx": str(out), "difference": off}, f"{out}: {checked}")
