"""A trained model as a thing to keep and to ask: two files on the disk, numpy to predict.

    MODEL/model.json           what it is: problem, levels, layer sizes, and the card of its training
    MODEL/weights.safetensors  the numbers, float32, batch normalisation and input scaling folded in

Data, never code: no pickle is read, whatever a file claims to be. Everything about a file is checked before its numbers
are used, and a file that fails is refused, never read by another route. How a model comes about is `train`'s business.
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit import schema
from cyclekit.atomic import recover, staged
from cyclekit.errors import ModelError, ShapeError
from cyclekit.models.layout import Layout, NotAModel, parse_model, parse_weights, to_safetensors
from cyclekit.samples import INPUTS

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

FORMAT, MODEL_VERSION = "cyclekit-model", 1
CARD, WEIGHTS = "model.json", "weights.safetensors"
_BLOCK = 16_384
"""Rows predicted at once: a block and its layers stay in the cache, which is several times faster than all at once."""
_RETRAIN = "Train it again: cyclekit train DATASET --out MODEL"


@dataclass(frozen=True)
class TrainedModel:
    """A network with its weights.

    Attributes:
        problem: `now`, `ahead` or `average`.
        network: `classifier`, `regressor` or `mixed`.
        horizon_s: How far ahead the target lies or reaches, s.
        levels: Staircase levels, shape (P,), ascending; empty for a regressor of a scaling without levels.
        layers: Weight (inputs, outputs) and bias (outputs,) of every layer, float32.
        card: How it came about: split, seed, metrics, data fingerprint, versions, `scaling_without_operator`.
    """

    problem: str
    network: str
    horizon_s: float
    levels: tuple[float, ...]
    layers: tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]
    card: dict[str, Any] = field(default_factory=dict)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the F inputs, in the order of the columns of X."""
        return INPUTS[self.problem]

    def predict(self, X: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Return the scaling with the least expected squared error.

        For a classifier that is the mean of the levels under its probabilities, not the level of the likeliest step.

        Args:
            X: Inputs, shape (N, F), metres, base frame; columns as in `inputs`. All must be known: where nobody is
                there, `card["scaling_without_operator"]` holds what the logs show.

        Returns:
            Shape (N,), in [0, 1].

        Raises:
            ShapeError: X is not (N, F), or holds a value that is not finite.
        """
        out = self._run(X)
        values = np.matmul(out, np.array(self.levels)) if self.network == "classifier" else out[:, 0]
        return np.asarray(np.clip(values, 0.0, 1.0), np.float64)

    def probabilities(self, X: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Return the probability of every step, shape (N, P); rows sum to 1.

        Raises:
            ModelError: The network is no classifier.
            ShapeError: As `predict`.
        """
        if self.network != "classifier":
            msg = f"a {self.network} gives one value and no probabilities"
            raise ModelError(msg, cure="Train a classifier: cyclekit train DATASET --out MODEL --network classifier")
        return self._run(X).astype(np.float64)

    def steps(self, X: NDArray[np.floating[Any]]) -> NDArray[np.int64]:
        """Return the index of the likeliest step (of a regressor: of the level nearest to its value), shape (N,).

        Raises:
            ModelError: The model knows no levels.
            ShapeError: As `predict`.
        """
        if self.network == "classifier":
            return np.asarray(self._run(X).argmax(axis=1), np.int64)
        if not self.levels:
            msg = "the model knows no levels, so it cannot name a step"
            raise ModelError(msg)
        levels = np.array(self.levels)
        return np.searchsorted((levels[1:] + levels[:-1]) / 2, self.predict(X)).astype(np.int64)

    def _run(self, X: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
        """Return the last layer's output: (N, P) probabilities of a classifier, (N, 1) otherwise."""
        if X.ndim != 2 or X.shape[1] != len(self.inputs):
            msg = f"inputs {X.shape} must be (N, {len(self.inputs)}): {', '.join(self.inputs)}"
            raise ShapeError(msg)
        if not np.isfinite(X).all():
            bad = int((~np.isfinite(X).all(axis=1)).sum())
            msg = f"{bad} of {len(X)} rows hold an unknown input (NaN or infinite)"
            raise ShapeError(msg, cure="Leave these rows out; where nobody is there, use scaling_without_operator.")
        out = np.empty((len(X), self.layers[-1][1].size), np.float32)
        for start in range(0, len(X), _BLOCK):
            out[start : start + _BLOCK] = self._run_block(X[start : start + _BLOCK].astype(np.float32))
        return out

    def _run_block(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        softmax_after = {"classifier": len(self.layers) - 1, "mixed": len(self.layers) - 2}.get(self.network)
        for index, (weight, bias) in enumerate(self.layers):
            values = values @ weight
            values += bias
            if index == softmax_after:
                values -= values.max(axis=1, keepdims=True)
                np.exp(values, out=values)
                values /= values.sum(axis=1, keepdims=True)
            elif index < len(self.layers) - 1:
                np.maximum(values, 0, out=values)
        return values


def save_model(path: Path, model: TrainedModel) -> None:
    """Write `model` as the folder `path`: the old model or the new one is there at any time, never half.

    Raises:
        ModelError: `path` is there already and is no model; it is left as it is.
        CyclekitError: The place cannot be written.
    """
    recover(path)
    if path.exists() and not (path.is_dir() and ((path / CARD).is_file() or not any(path.iterdir()))):
        msg = f"{path}: is there already and is no model, so it is not replaced"
        raise ModelError(msg, cure="Choose another folder with --out.")
    weights = to_safetensors(model.layers)
    about = {
        "format": FORMAT,
        "model_version": MODEL_VERSION,
        "schema_version": schema.SCHEMA_VERSION,
        "problem": model.problem,
        "network": model.network,
        "horizon_s": model.horizon_s,
        "levels": list(model.levels),
        "layers": [list(weight.shape) for weight, _ in model.layers],
        "weights_sha256": hashlib.sha256(weights).hexdigest(),
        "card": model.card,
    }
    text = json.dumps(about, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    with staged(path) as folder:
        for name, content in ((WEIGHTS, weights), (CARD, text.encode())):
            with (folder / name).open("wb") as handle:
                handle.write(content)
                handle.flush()
                os.fsync(handle.fileno())


def load_model(path: Path) -> TrainedModel:
    """Open the model folder `path`.

    Raises:
        ModelError: It is no model, is of another version, or any of its content is not what it should be.
    """
    recover(path)
    if not path.is_dir() or not (path / CARD).is_file():
        seen = "no such folder" if not path.exists() else f"no {CARD} in it, so it is no cyclekit model"
        msg = f"{path}: {seen if path.is_dir() or not path.exists() else 'a file, not a model folder'}"
        raise ModelError(msg, cure=_RETRAIN)
    file = path / CARD
    try:
        about = parse_model(file)
        _check_versions(about)
        layout = Layout.of(about)
        file = path / WEIGHTS
        layers = parse_weights(file, layout, str(about.get("weights_sha256")))
    except NotAModel as cause:
        msg = f"{file}: {cause}"
        raise ModelError(msg, cure=_RETRAIN) from cause
    return TrainedModel(layout.problem, layout.network, layout.horizon_s, layout.levels, layers, dict(about["card"]))


def _check_versions(about: dict[str, Any]) -> None:
    if about.get("format") != FORMAT:
        raise NotAModel("not the card of a cyclekit model")
    expected = {"model_version": MODEL_VERSION, "schema_version": schema.SCHEMA_VERSION}
    for name, ours in expected.items():
        if about.get(name) != ours:
            kind = name.replace("_", " ")
            raise NotAModel(f"a model of {kind} {about.get(name)!r}; this cyclekit reads {kind} {ours}")
