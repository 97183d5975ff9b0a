"""Reads and writes a model's weights as a safetensors file; a file that does not match `model.json` is refused.

A model folder may come from anywhere. So the sizes in `model.json` are checked against limits (`cards`) and against
each other first, then the file against them. No other loader is tried, and no number is read before sizes, names,
shapes and checksum match.
"""

from __future__ import annotations

import hashlib
import math
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from cyclekit.learning.last_second import count_features
from cyclekit.learning.networks.kinds import NETWORKS, networks_for
from cyclekit.learning.networks.trees import COLUMNS, Trees, sound
from cyclekit.learning.networks.weights import Weights
from cyclekit.learning.windows import GROUPS, inputs_of
from cyclekit.storage.files import regular

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from cyclekit.dataset.cards import ModelCard
    from cyclekit.schema import Singles


_MAX_HEADER_BYTES = 64 * 2**10


def parse_weights(file: Path, about: ModelCard) -> Weights | Trees:
    """Return the weights described by a checked `about`.

    Raises:
        NotAModel: The file is not exactly the safetensors file that `about` describes.
        OSError: The file cannot be read.
    """
    shapes = _shapes(about)
    numbers = 4 * sum(math.prod(shape) for shape in shapes.values())
    if not file.exists():
        raise NotAModel("no such file")
    with regular(file).open("rb") as handle:
        content = handle.read(8 + _MAX_HEADER_BYTES + numbers + 1)
    header = int.from_bytes(content[:8], "little")
    if len(content) < 8 or header > _MAX_HEADER_BYTES or len(content) != 8 + header + numbers:
        raise NotAModel(f"not a safetensors file of {numbers} bytes of weights, as {file.parent.name} calls for")
    if hashlib.sha256(content).hexdigest() != about.weights_sha256:
        raise NotAModel("changed since the model was saved: its checksum is not the one in model.json")
    try:
        found = load(content)
    except (SafetensorError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise NotAModel(f"not a safetensors file ({error})") from error
    if {name: (array.shape, array.dtype) for name, array in found.items()} != {
        name: (shape, np.dtype(np.float32)) for name, shape in shapes.items()
    }:
        raise NotAModel("holds other arrays than the layers in model.json")
    if not all(np.isfinite(array).all() for array in found.values()):
        raise NotAModel("holds weights that are not finite")
    return _weights(about, found)


def to_safetensors(weights: Weights | Trees) -> bytes:
    """Return the weights as the content of a safetensors file."""
    if isinstance(weights, Trees):
        return save({"trees": weights.nodes})
    arrays: dict[str, Singles] = {}
    for i, (weight, bias) in enumerate(weights.layers):
        arrays |= {f"layer{i}.weight": weight, f"layer{i}.bias": bias}
    for i, (weight, state, bias) in enumerate(weights.recurrent):
        arrays |= {f"lstm{i}.weight": weight, f"lstm{i}.state": state, f"lstm{i}.bias": bias}
    if weights.forecast is not None:
        arrays |= {"forecast.weight": weights.forecast[0], "forecast.bias": weights.forecast[1]}
    if weights.known:
        arrays["middle"] = weights.middle
    return save({name: np.ascontiguousarray(array, np.float32) for name, array in arrays.items()})


def sizes_of(weights: Weights | Trees) -> dict[str, object]:
    """Return the sizes of the weights for `model.json`."""
    if isinstance(weights, Trees):
        return {"layers": [], "trees": list(weights.nodes.shape[:2]), "known": list(weights.known)}
    return {
        "layers": [list(weight.shape) for weight, _ in weights.layers],
        "recurrent": [[weight.shape[0], state.shape[0]] for weight, state, _ in weights.recurrent],
        "forecast": None if weights.forecast is None else list(weights.forecast[0].shape),
        "known": list(weights.known),
        "distance": weights.distance,
    }


def _shapes(about: ModelCard) -> dict[str, tuple[int, ...]]:
    if about.trees is not None:
        return {"trees": (*about.trees, COLUMNS)}
    shapes: dict[str, tuple[int, ...]] = {}
    for i, (inputs, outputs) in enumerate(about.layers):
        shapes |= {f"layer{i}.weight": (inputs, outputs), f"layer{i}.bias": (outputs,)}
    for i, (inputs, width) in enumerate(about.recurrent):
        shapes[f"lstm{i}.weight"], shapes[f"lstm{i}.state"] = (inputs, 4 * width), (width, 4 * width)
        shapes[f"lstm{i}.bias"] = (4 * width,)
    if about.forecast is not None:
        shapes |= {"forecast.weight": about.forecast, "forecast.bias": (about.forecast[1],)}
    if about.known:
        shapes["middle"] = (len(_inputs(about)),)
    return shapes


def _weights(about: ModelCard, found: Mapping[str, Singles]) -> Weights | Trees:
    if about.trees is not None:
        if not sound(found["trees"], count_features(about.history[0], len(_inputs(about)))):
            raise NotAModel("holds trees with a node that leads nowhere")
        return Trees(found["trees"], about.known)
    return Weights(
        tuple((found[f"layer{i}.weight"], found[f"layer{i}.bias"]) for i in range(len(about.layers))),
        softmax_after(about),
        tuple(
            (found[f"lstm{i}.weight"], found[f"lstm{i}.state"], found[f"lstm{i}.bias"])
            for i in range(len(about.recurrent))
        ),
        (found["forecast.weight"], found["forecast.bias"]) if about.forecast is not None else None,
        about.known,
        about.distance,
        found["middle"] if about.known else np.empty(0, np.float32),
    )


class NotAModel(Exception):
    """A file is not part of a model; `load_model` raises it as a ModelError with the file and the cure."""


def softmax_after(about: ModelCard) -> int | None:
    """Return the index of the layer that the softmax follows; None without one."""
    kind = NETWORKS[about.network]
    return len(about.layers) - len(kind.outputs(len(about.levels))) if kind.needs_levels else None


def check_layout(about: ModelCard) -> None:
    """Check that the layers of a network match.

    Raises:
        NotAModel: They do not.
    """
    problem, network = about.problem, about.network
    if network not in networks_for(problem):
        raise NotAModel(f"no known network: problem {problem!r}, network {network!r}")
    if (about.horizon_s == 0) != (problem == "now"):
        raise NotAModel(f"horizon_s is {about.horizon_s!r} for problem {problem!r}")
    if NETWORKS[network].needs_levels and len(about.levels) < 2:
        raise NotAModel(f"a {network} needs two levels or more, and has {len(about.levels)}")
    _check_recurrent(about)
    _check_known(about)
    _check_chain(about.layers)
    if not _fits(about):
        named = f"layers {about.layers} do not fit a {network}"
        raise NotAModel(f"{named} of {len(about.levels)} levels for problem {problem!r}")
    kind = NETWORKS[network]
    if (about.history[0] > 1) != kind.sees_history or (about.past and not kind.sees_history):
        raise NotAModel(f"history is {about.history} for a {network}")


def _fits(about: ModelCard) -> bool:
    """Return whether the widths of inputs, hidden layers and outputs match."""
    trees = NETWORKS[about.network].trees
    if trees or len(about.layers) < 2:
        return trees and about.trees is not None and not about.layers and about.distance is None
    levels, recurrent, forecast = len(about.levels), about.recurrent, about.forecast
    inputs = len(_inputs(about)) + len(about.known) + (about.distance is not None)
    outputs = NETWORKS[about.network].outputs(levels)
    first = recurrent[0][0] if recurrent and forecast is None else about.layers[0][0]
    fits = first == inputs and [out for _, out in about.layers[-len(outputs) :]] == outputs
    if recurrent and forecast is None:
        fits = fits and about.layers[0][0] == recurrent[-1][1]
    if forecast is not None:
        fits = fits and forecast == (recurrent[-1][1], 3) and recurrent[0][0] == 3 + ("human" in about.known)
    return fits


def _inputs(about: ModelCard) -> tuple[str, ...]:
    return inputs_of(about.problem, past=about.past)


def _check_recurrent(about: ModelCard) -> None:
    kind = NETWORKS[about.network]
    if len(about.recurrent) != kind.lstm_layers or (about.forecast is not None) != kind.forecasts:
        raise NotAModel(f"{len(about.recurrent)} LSTM layers do not fit a {about.network}")
    _check_chain(about.recurrent)


def _check_known(about: ModelCard) -> None:
    """Refuse groups that may be unknown unless each occurs once, in the order of the columns."""
    there = [group for group, columns in GROUPS.items() if columns.start < len(_inputs(about))]
    if about.known != tuple(group for group in there if group in about.known):
        raise NotAModel(f"groups of inputs that may be unknown are {about.known!r:.80}")


def _check_chain(sizes: Sequence[tuple[int, int]]) -> None:
    if any(a[1] != b[0] for a, b in pairwise(sizes)):
        raise NotAModel(f"layers {sizes!r:.200} do not join")
