"""`export_model`: a model for other runtimes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cyclekit.api.arguments import Place, checked
from cyclekit.api.given import place_of, trained_of
from cyclekit.dataset.guard import check_output
from cyclekit.learning.networks.onnx_file import write_onnx
from cyclekit.learning.networks.saved import TrainedModel
from cyclekit.text.results import Result


@dataclass(frozen=True, repr=False)
class ExportedModel(Result):
    """A model written for other runtimes.

    Attributes:
        path: The ONNX file.
        difference: Largest difference between onnxruntime and our own prediction; None if it could not be checked.
    """

    path: Path
    difference: float | None

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {"onnx": str(self.path), "difference": self.difference}

    def _lines(self) -> list[str]:
        off = self.difference
        return [f"{self.path}: {'not checked' if off is None else f'within {off:.0e} of cyclekit'}"]


@checked
def export_model(model: TrainedModel | Place, out: Place) -> ExportedModel:
    """Write a model as an ONNX file, checked against our own prediction if onnxruntime is installed.

    Args:
        model: A feed-forward model, its folder or its URL.
        out: The file, `.onnx`.

    Raises:
        MissingExtra: The package onnx is not installed.
        ModelError: The model is recurrent or has inputs that may be unknown, or the file does not predict the same.
        OutputError: The file would replace the model, or a file that is not an ONNX file of cyclekit.
    """
    file = Path(out)
    check_output(file, "onnx", [place_of(model)], endings=(".onnx",))
    return ExportedModel(file, write_onnx(file, trained_of(model)))
