"""`cyclekit export`: writes a model for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cyclekit.cli.options import Json, ModelPlace, Quiet
from cyclekit.cli.terminal import Terminal

EXAMPLE = "cyclekit export model --out rule.json"


def export(
    model: ModelPlace,
    out: Annotated[Path, typer.Option(help="ONNX file of a network, or JSON file of a rule.", metavar="FILE")],
    network: Annotated[bool, typer.Option("--network", help="The network, also if a rule answers.")] = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write what answers: a rule as JSON, a network as ONNX.

    An ONNX file is checked against cyclekit's own prediction if onnxruntime is installed.
    """
    from cyclekit.api.export import export_model

    terminal = Terminal(json=json, quiet=quiet)
    done = export_model(model, out, network=network)
    terminal.done(done.to_dict(), repr(done).partition(": ")[2])
