"""A trained model: storage in two files, and prediction with numpy.

    MODEL/model.json           problem, levels, layer sizes, and the card of its training
    MODEL/weights.safetensors  the weights, float32, with batch normalisation and input scaling folded in

Only data, never code: no pickle is read. Everything about a file is checked before its numbers are used; a file that
fails is refused. Training is in `train`.
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit import schema
from cyclekit.dataset.cards import BadCard, TrainingCard, model_card, plain, read_json
from cyclekit.dataset.cards.task_model import FORMAT as TASK_TIMES
from cyclekit.dataset.cards.unseen import FORMAT as UNSEEN
from cyclekit.dataset.unknown_height import inputs_in_plane
from cyclekit.errors import ModelError, ShapeError, command_line
from cyclekit.learning.networks.kinds import is_classifier
from cyclekit.learning.networks.tensors import NotAModel, check_layout, parse_weights, sizes_of, to_safetensors
from cyclekit.learning.signal_inputs import as_inputs
from cyclekit.learning.windows import GROUPS, input_rows, inputs_of
from cyclekit.parallel.one_thread import one_thread
from cyclekit.storage.atomic import recover, staged
from cyclekit.storage.identify import MODEL_CARD, instead_of
from cyclekit.storage.outputs import check_writable_folder
from cyclekit.storage.remote.folders import is_url, local, published
from cyclekit.text.numbers import fixed
from cyclekit.text.plain_text import all_in_one_line
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from collections.abc import Mapping

    import polars as pl
    from numpy.typing import ArrayLike, NDArray

    from cyclekit.learning.networks.trees import Trees
    from cyclekit.learning.networks.weights import Weights
    from cyclekit.plots.drawing import Drawing
    from cyclekit.schema import Floats, Ints, Singles

FORMAT, MODEL_VERSION = "cyclekit-model", 3
CARD, WEIGHTS = MODEL_CARD, "weights.safetensors"
_MAX_CARD_BYTES = 16 << 20


@dataclass(frozen=True, repr=False)
class TrainedModel(Result):
    """A network with its weights.

    Attributes:
        problem: `now`, `ahead` or `average`.
        network: Its name, one of `networks.kinds.NETWORKS`.
        horizon_s: Horizon of the target, or length of its average, s.
        levels: Levels of the speed scaling, shape (P,), ascending; empty for a regressor of a scaling without levels.
        weights: The weights, and the groups of inputs that may be unknown.
        card: Training card: split, seed, metrics, data fingerprint, versions, `scaling_without_operator`.
        history: Number of samples that the network sees, and rows between them at the rate of the samples; (1, 1) =
            only the present one.
        past: Whether `last_second.PAST` is an input too.
    """

    problem: str
    network: str
    horizon_s: float
    levels: tuple[float, ...]
    weights: Weights | Trees
    card: TrainingCard = field(default_factory=TrainingCard)
    history: tuple[int, int] = (1, 1)
    past: bool = False

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the F inputs, in the order of the columns of X."""
        return inputs_of(self.problem, past=self.past)

    def plot(self) -> Drawing:
        """Return the error over the epochs and the levels of the logs learned from, as a matplotlib figure."""
        from cyclekit.plots.results import training_figure

        metrics = self.card.metrics
        return training_figure(
            [(one.epoch, one.validation_mse) for one in self.card.history or ()],
            [(one.value, one.share) for one in self.card.levels or ()],
            held_out=None if metrics is None else metrics.mse_mean,
            constant=None if metrics is None else metrics.mse_constant,
        )

    @one_thread()
    def predict(self, X: ArrayLike) -> Floats:
        """Return the scaling with the least expected squared error.

        For a classifier this is the probability-weighted mean of the levels, not the most likely level.

        Args:
            X: Inputs, metres (of `last_second.PAST`: s), base frame; columns as in `inputs`, of a frame also by these
                names. Shape (N, F), with a history (N, K, F), oldest sample first. All must be known except the groups
                in `weights.known`; if the logs never showed an absent operator, `card.scaling_without_operator` is
                None. If only the operator's height is unknown, that of the TCP is used.

        Returns:
            Shape (N,), in [0, 1].

        Raises:
            ShapeError: X has another shape, or a value that must be known is not finite.
            ModelError: The weights are so large that the output is not finite.
        """
        out = self._run(X)
        values = np.matmul(out, np.array(self.levels)) if is_classifier(self.network) else out[:, 0]
        return np.asarray(np.clip(values, 0.0, 1.0), np.float64)

    def predict_signals(self, robot_m: ArrayLike, signals: ArrayLike) -> Floats:
        """Return the scaling of a model on signals that detect people, shape (N,).

        Args:
            robot_m: The TCP, shape (N, 3), m.
            signals: Bits of the active signals, shape (N,), as in column `human_signals` of the model's dataset.
        """
        return self.predict(np.column_stack([robot_m, as_inputs(signals, len(self.card.operator_signals))]))

    def probabilities(self, X: ArrayLike) -> Floats:
        """Return the probability of every level, shape (N, P); rows sum to 1.

        Raises:
            ModelError: The network is no classifier.
            ShapeError: As `predict`.
        """
        if not is_classifier(self.network):
            msg = f"a {self.network} gives one value and no probabilities"
            raise ModelError(msg, cure="Train a classifier: cyclekit train DATASET --network classifier --out MODEL")
        return self._run(X).astype(np.float64)

    def steps(self, X: ArrayLike) -> Ints:
        """Return the index of the most likely level (of a regressor: the level nearest to its value), shape (N,).

        Raises:
            ModelError: The model has no levels.
            ShapeError: As `predict`.
        """
        if is_classifier(self.network):
            return np.asarray(self._run(X).argmax(axis=1), np.int64)
        if not self.levels:
            msg = "the model has no levels, so it predicts no step"
            raise ModelError(msg)
        levels = np.array(self.levels)
        return np.searchsorted((levels[1:] + levels[:-1]) / 2, self.predict(X)).astype(np.int64)

    def _run(self, inputs: ArrayLike) -> Singles:
        """Return the last layer's output: (N, P) probabilities of a classifier, (N, 1) otherwise."""
        X = input_rows(inputs, self.inputs)
        wanted = ("N", len(self.inputs)) if self.history[0] == 1 else ("N", self.history[0], len(self.inputs))
        if X.ndim != len(wanted) or X.shape[1:] != wanted[1:]:
            msg = f"inputs {X.shape} must be ({', '.join(map(str, wanted))}): {', '.join(self.inputs)}"
            raise ShapeError(msg)
        if np.isfinite(X).all():
            return self._finite(X)
        X = inputs_in_plane(X)
        needed = np.ones(len(self.inputs), np.bool_)
        for group in self.weights.known:
            needed[GROUPS[group]] = False
        bad = ~np.isfinite(X) & (needed | ~np.isnan(X))
        if bad.any():
            rows = int(bad.reshape(len(X), -1).any(axis=1).sum())
            msg = f"{rows} of {len(X)} rows hold an unknown input (NaN or infinite)"
            raise ShapeError(
                msg, cure="Leave these rows out; where the operator is absent, use scaling_without_operator."
            )
        return self._finite(X)

    def _finite(self, X: NDArray[np.floating[Any]]) -> Singles:
        """Run the network and check the output: finite weights may still be so large that it is not finite.

        Raises:
            ModelError: The output is not finite.
        """
        out = self.weights.run(X)
        if not np.isfinite(out).all():
            bad = int((~np.isfinite(out)).any(axis=1).sum())
            msg = f"the network gives no number in {bad} of {len(out)} rows: its weights are too large"
            raise ModelError(msg, cure=f"Train it again: {command_line('train', 'DATASET', '--out', 'MODEL')}")
        return out

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        card = self.card.to_dict()
        return {"metrics": card["metrics"], "card": card}

    def to_frame(self) -> pl.DataFrame:
        """Return one row per training epoch: the errors by which the best epoch was chosen."""
        import polars as pl

        return pl.DataFrame(plain(self.card, nulls=True)["history"] or [], infer_schema_length=None)

    def _lines(self) -> list[str]:
        levels = ", ".join(fixed(level, 2) for level in self.levels) or "none"
        metrics = self.card.metrics
        error = "" if metrics is None else f", held out: mean absolute error {fixed(metrics.mae, 4)}"
        return [f"{self.network} for problem {self.problem}, levels {levels}{error}"]


def check_model_output(place: Path | str) -> None:
    """Refuse a path at which `save_model` could not write a model, before training starts.

    Raises:
        ModelError: The path exists and is no model.
        CyclekitError: The path cannot be written.
    """
    check_writable_folder(place)
    if not is_url(place):
        _refuse_other(Path(place))


def save_model(place: Path | str, model: TrainedModel) -> None:
    """Write `model` as a folder, at a path or a URL; an old model is replaced as a whole.

    Raises:
        ModelError: The path exists and is no model; it is left unchanged.
        CyclekitError: The path cannot be written.
    """
    with published(place) as path:
        _save(path, model)


def _save(path: Path, model: TrainedModel) -> None:
    recover(path)
    _refuse_other(path)
    weights = to_safetensors(model.weights)
    about = {
        "format": FORMAT,
        "model_version": MODEL_VERSION,
        "schema_version": schema.SCHEMA_VERSION,
        "problem": model.problem,
        "network": model.network,
        "horizon_s": model.horizon_s,
        "levels": list(model.levels),
        "history": list(model.history),
        "past": model.past,
        **sizes_of(model.weights),
        "weights_sha256": hashlib.sha256(weights).hexdigest(),
        "card": plain(model.card, nulls=True),
    }
    text = json.dumps(about, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    with staged(path) as folder:
        for name, content in ((WEIGHTS, weights), (CARD, text.encode())):
            with (folder / name).open("wb") as handle:
                handle.write(content)
                handle.flush()
                os.fsync(handle.fileno())


def _refuse_other(path: Path) -> None:
    if path.exists() and not (path.is_dir() and ((path / CARD).is_file() or not any(path.iterdir()))):
        msg = f"{path}: exists and is not a model, so it is not replaced"
        raise ModelError(msg, cure="Choose another folder with --out.")


def load_model(place: Path | str) -> TrainedModel:
    """Load the model at a path or a URL.

    Raises:
        ModelError: It is no model, is of another version, or has invalid content.
        StorageError: The URL cannot be read.
    """
    path = local(place)
    recover(path)
    file = path / CARD
    try:
        about = read_json(file, most_bytes=_MAX_CARD_BYTES)
        _check_versions(about)
        card = model_card(all_in_one_line(about))
        check_layout(card)
        file = path / WEIGHTS
        weights = parse_weights(file, card)
    except (BadCard, NotAModel) as cause:
        msg = f"{file}: {cause}"
        if isinstance(cause, TaskTimesInstead):
            plans = command_line("estimate", place, "SEQUENCES.toml", "--dataset", "DATASET")
            raise ModelError(msg, cure=f"Use it for plans of robot and operator: {plans}") from cause
        if isinstance(cause, UnseenInstead):
            asked = command_line("estimate", place, "SEQUENCES.toml", "--dataset", "DATASET")
            use = f"Leave it out here; use it for estimate, plan, whatif and report: {asked}"
            raise ModelError(msg, cure=use) from cause
        again = command_line("train", "DATASET", "--out", place)
        raise ModelError(msg, cure=f"Train it again: {again}") from cause
    except (FileNotFoundError, NotADirectoryError) as cause:
        raise _no_model(path) from cause
    except OSError as cause:
        msg = f"{file}: cannot be read ({cause.strerror or cause})"
        raise ModelError(msg, cure="Check the path and its permissions.") from cause
    made = (card.problem, card.network, card.horizon_s, card.levels)
    return TrainedModel(*made, weights, card.card, card.history, card.past)


def _no_model(path: Path) -> ModelError:
    """Return the error for a path without a model, naming what is there."""
    cures = {
        "nothing": f"Check the path, or train a model: {command_line('train', 'DATASET', '--out', path)}",
        "a folder of models": f"Choose one of them: {', '.join(models_in(str(path)))}.",
        "a dataset": f"Train a model on it: {command_line('train', path, '--out', 'MODEL')}",
        "else": f"Train one: {command_line('train', 'DATASET', '--out', 'MODEL')}",
    }
    seen, cure = instead_of(path, "model", CARD, cures)
    return ModelError(seen, cure=cure)


def models_in(place: str) -> list[str]:
    """Return the models in a folder that is not a model itself, by name; otherwise, and for a URL, `place` alone."""
    path = Path(place)
    if is_url(place) or not path.is_dir() or (path / CARD).is_file():
        return [place]
    return sorted(str(file.parent) for file in path.glob(f"*/{CARD}")) or [place]


class TaskTimesInstead(NotAModel):
    """The model was learned from task lists."""


class UnseenInstead(NotAModel):
    """The model was learned from a robot's log alone."""


def _check_versions(about: Mapping[str, object]) -> None:
    if about.get("format") == TASK_TIMES:
        msg = "a model of task times: it was learned without positions and knows no safety function"
        raise TaskTimesInstead(msg)
    if about.get("format") == UNSEEN:
        msg = "a model of an unseen operator: learned from the robot's log alone, it knows no positions of people"
        raise UnseenInstead(msg)
    if about.get("format") != FORMAT:
        raise NotAModel("not the card of a cyclekit model")
    expected = {"model_version": MODEL_VERSION, "schema_version": schema.SCHEMA_VERSION}
    for name, ours in expected.items():
        if about.get(name) != ours:
            kind = name.replace("_", " ")
            raise NotAModel(f"a model of {kind} {about.get(name)!r}; this cyclekit reads {kind} {ours}")
