"""`export_model`: what answers for a model, for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cyclekit.api.arguments import Place, checked
from cyclekit.api.given import place_of, trained_of
from cyclekit.dataset.cards import plain
from cyclekit.dataset.guard import check_output
from cyclekit.errors import ModelError
from cyclekit.learning.networks.onnx_file import write_onnx
from cyclekit.learning.networks.saved import TrainedModel
from cyclekit.learning.rules.safety import RuleSafety, predictor_of
from cyclekit.learning.rules.words import kind_of, sentences
from cyclekit.storage.atomic import write_text
from cyclekit.text.numbers import scientific
from cyclekit.text.plain_json import json_text
from cyclekit.text.results import Result


@dataclass(frozen=True, repr=False)
class ExportedModel(Result):
    """A model written for other programs.

    Attributes:
        path: The file: ONNX of a network, or JSON of a rule.
        difference: Largest difference between onnxruntime and our own prediction; None if it could not be checked.
    """

    path: Path
    difference: float | None

    @property
    def is_rule(self) -> bool:
        """Whether the file holds a rule."""
        return self.path.suffix.lower() == ".json"

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {"rule" if self.is_rule else "onnx": str(self.path), "difference": self.difference}

    def _lines(self) -> list[str]:
        if self.is_rule:
            return [f"{self.path}: the rule that answers"]
        off = self.difference
        checked = (
            "not checked: onnxruntime is not installed" if off is None else f"within {scientific(off, 0)} of cyclekit"
        )
        return [f"{self.path}: {checked}"]


@checked
def export_model(model: TrainedModel | Place, out: Place, *, network: bool = False) -> ExportedModel:
    """Write what answers for a model: its network as ONNX, or the rule in its place as JSON.

    An ONNX file is checked against our own prediction if onnxruntime is installed.

    Args:
        model: A model, its folder or its URL.
        out: The file: `.onnx` for a network, `.json` for a rule.
        network: Write the network even if a rule answers in its place.

    Raises:
        MissingExtra: The package onnx is not installed.
        ModelError: The file is for the other kind; the network is recurrent or has inputs that may be unknown, or the
            file does not predict the same.
        OutputError: The file would replace the model, or a file that cyclekit did not write.
    """
    file = Path(out)
    is_json = file.suffix.lower() == ".json"
    check_output(file, "rule" if is_json else "onnx", [place_of(model)], endings=(".onnx", ".json"))
    opened = trained_of(model)
    rule = opened.card.rule if isinstance(predictor_of(opened), RuleSafety) else None
    if is_json and (rule is None or network):
        seen = (
            f"{file}: {'the network is wanted' if network else 'no rule answers for this model'}, and JSON holds a rule"
        )
        raise ModelError(seen, cure="Write the network as an ONNX file: --out FILE.onnx")
    if not is_json and rule is not None and not network:
        seen = f"{file}: the rule {kind_of(rule)} answers for this model, and an ONNX file holds a network"
        cure = "Write the rule: --out FILE.json. Or write the network, whose estimates differ: --network"
        raise ModelError(seen, cure=cure)
    if rule is not None and is_json:
        alone = opened.card.scaling_without_operator
        document = {"rule": plain(rule), "in_words": list(sentences(rule)), "scaling_without_operator": alone}
        write_text(file, json_text(document) + "\n")
        return ExportedModel(file, None)
    return ExportedModel(file, write_onnx(file, opened))
