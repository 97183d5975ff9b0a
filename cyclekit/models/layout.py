"""Check the two files of a model, byte for byte, before anything believes them.

A model folder may come from anywhere. So the sizes that `model.json` states are held against limits and against each
other, and the weights file against those sizes, before a single number is read.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from cyclekit.models.spec import NETWORKS
from cyclekit.samples import INPUTS

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

_MAX_CARD_BYTES = 16 * 2**20
_MAX_HEADER_BYTES = 64 * 2**10
_MAX_LAYERS, _MAX_WIDTH, _MAX_LEVELS = 32, 4096, 64

Layers = tuple[tuple["NDArray[np.float32]", "NDArray[np.float32]"], ...]


class NotAModel(Exception):
    """Why a file is not part of a model; `load_model` tells it as a ModelError, with the file and the cure."""


@dataclass(frozen=True)
class Layout:
    """What `model.json` says about the network, checked."""

    problem: str
    network: str
    horizon_s: float
    levels: tuple[float, ...]
    layers: tuple[tuple[int, int], ...]

    @classmethod
    def of(cls, about: dict[str, Any]) -> Layout:
        """Check the stated network.

        Raises:
            NotAModel: Something is missing, of the wrong type, out of bounds, or does not fit the rest.
        """
        problem, network, horizon_s = about.get("problem"), about.get("network"), _number(about.get("horizon_s"))
        if not isinstance(problem, str) or network not in NETWORKS.get(problem, ()):
            raise NotAModel(f"no known network: problem {problem!r}, network {network!r}")
        if not 0 <= horizon_s <= 1e6 or (horizon_s == 0) != (problem == "now"):
            raise NotAModel(f"horizon_s is {about.get('horizon_s')!r} for problem {problem!r}")
        if not isinstance(about.get("card"), dict):
            raise NotAModel("the card is missing")
        levels = _levels(about.get("levels"), needed=network != "regressor")
        layers = _sizes(about.get("layers"))
        outputs = {"classifier": [len(levels)], "mixed": [len(levels), 1], "regressor": [1]}[network]
        if layers[0][0] != len(INPUTS[problem]) or [out for _, out in layers[-len(outputs) :]] != outputs:
            raise NotAModel(f"layers {layers} do not fit a {network} of {len(levels)} levels for problem {problem!r}")
        return cls(problem, str(network), horizon_s, levels, layers)


def parse_model(file: Path) -> dict[str, Any]:
    """Return the content of `model.json`.

    Raises:
        NotAModel: It cannot be read, is too large, or is no JSON object.
    """
    try:
        if file.stat().st_size > _MAX_CARD_BYTES:
            raise NotAModel(f"larger than {_MAX_CARD_BYTES >> 20} MiB, which no card is")
        about = json.loads(file.read_text(encoding="utf-8"), parse_constant=_no_constant)
    except (OSError, ValueError, RecursionError) as error:
        raise NotAModel(f"cannot be read as JSON ({error})") from error
    if not isinstance(about, dict):
        raise NotAModel("not a JSON object")
    return about


def parse_weights(file: Path, layout: Layout, sha256: str) -> Layers:
    """Return the weights of `layout`.

    Raises:
        NotAModel: The file is not exactly the safetensors file that the layout calls for.
    """
    shapes = {name: shape for i, size in enumerate(layout.layers) for name, shape in _tensors(i, size)}
    numbers = 4 * sum(math.prod(shape) for shape in shapes.values())
    try:
        with file.open("rb") as handle:
            content = handle.read(8 + _MAX_HEADER_BYTES + numbers + 1)
    except OSError as error:
        raise NotAModel(f"cannot be read ({error.strerror})") from error
    header = int.from_bytes(content[:8], "little")
    if len(content) < 8 or header > _MAX_HEADER_BYTES or len(content) != 8 + header + numbers:
        raise NotAModel(f"not a safetensors file of {numbers} bytes of weights, as {file.parent.name} calls for")
    if hashlib.sha256(content).hexdigest() != sha256:
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
    return tuple((found[f"layer{i}.weight"], found[f"layer{i}.bias"]) for i in range(len(layout.layers)))


def to_safetensors(layers: Layers) -> bytes:
    """Return the weights as the content of a safetensors file."""
    arrays = {}
    for i, (weight, bias) in enumerate(layers):
        arrays[f"layer{i}.weight"] = np.ascontiguousarray(weight, np.float32)
        arrays[f"layer{i}.bias"] = np.ascontiguousarray(bias, np.float32)
    return save(arrays)


def _tensors(index: int, size: tuple[int, int]) -> list[tuple[str, tuple[int, ...]]]:
    return [(f"layer{index}.weight", size), (f"layer{index}.bias", (size[1],))]


def _levels(stated: object, *, needed: bool) -> tuple[float, ...]:
    levels = [_number(level) for level in stated] if isinstance(stated, list) else [math.nan]
    rising = all(a < b for a, b in pairwise(levels)) and all(-0.5 <= level <= 1.5 for level in levels)
    if not rising or not 2 * needed <= len(levels) <= _MAX_LEVELS:
        raise NotAModel(f"levels {stated!r:.80} are not 2 to {_MAX_LEVELS} ascending fractions")
    return tuple(levels)


def _sizes(stated: object) -> tuple[tuple[int, int], ...]:
    def is_width(value: object) -> bool:
        return isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= _MAX_WIDTH

    if not isinstance(stated, list) or not 2 <= len(stated) <= _MAX_LAYERS:
        raise NotAModel(f"layers are {stated!r:.80}")
    for size in stated:
        if not isinstance(size, list) or len(size) != 2 or not all(is_width(value) for value in size):
            raise NotAModel(f"a layer of size {size!r:.80}")
    _check_chain(stated)
    return tuple((size[0], size[1]) for size in stated)


def _check_chain(sizes: Sequence[Sequence[int]]) -> None:
    if any(a[1] != b[0] for a, b in pairwise(sizes)):
        raise NotAModel(f"layers {sizes!r:.200} do not join")


def _number(value: object) -> float:
    """Return a JSON number, NaN for anything else (NaN fails every comparison that follows)."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e300:
        return math.nan
    return float(value)


def _no_constant(name: str) -> NoReturn:
    msg = f"{name} is no JSON number"
    raise ValueError(msg)
