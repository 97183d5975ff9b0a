"""A trained network as plain matrices on raw inputs, and its prediction with numpy.

Batch normalisation, standardisation of the inputs and the temperature of a classifier are folded in. Rows are processed
in blocks whose layers fit in the processor's cache, which is several times faster than all rows at once.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit.learning.windows import GROUPS
from cyclekit.parallel.one_thread import one_thread

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.schema import Singles

    Layer = tuple[Singles, Singles]
    Cell = tuple[Singles, Singles, Singles]

_BLOCK = 1024
_MANY = 50_000
"""Number of rows from which two threads share the blocks, with one thread per product. In products this small, BLAS
threads mostly wait for each other; with another program on one core, a prediction took three to five times the
processor time. The blocks are the same as with one thread."""
_CHUNK, _THREADS = 32 * _BLOCK, min(2, os.cpu_count() or 1)
_HUMAN = GROUPS["human"]


@dataclass(frozen=True)
class Weights:
    """A network.

    Attributes:
        layers: Weight (inputs, outputs) and bias (outputs,) of every feed-forward layer.
        softmax_after: Index of the layer followed by a softmax; None for none.
        recurrent: Per LSTM layer the weight on its input (inputs, 4H), the weight on its state (H, 4H) and the bias
            (4H,); gates in the order input, forget, cell, output.
        forecast: Weight (H, 3) and bias (3,) from the last state to the operator's future position, m, which replaces
            the present one as input of the layers. None if the layers get the last state itself.
        known: Groups of inputs with an additional input, 1 = known, 0 = unknown, appended in this order.
        distance: Replacement, m, for the distance ||x_r - x_h|| of an absent operator; the distance is then the last
            input. None if the network sees positions only.
        middle: Replacement for unknown inputs, shape (F,); empty without such groups.
    """

    layers: tuple[Layer, ...]
    softmax_after: int | None = None
    recurrent: tuple[Cell, ...] = ()
    forecast: Layer | None = None
    known: tuple[str, ...] = ()
    distance: float | None = None
    middle: Singles = field(default_factory=lambda: np.empty(0, np.float32))

    @property
    def count(self) -> int:
        """Number of weights."""
        arrays = [array for part in (*self.layers, *self.recurrent, self.forecast or ()) for array in part]
        return sum(int(array.size) for array in arrays)

    @one_thread()
    def run(self, X: NDArray[np.floating[Any]]) -> Singles:
        """Return the outputs of the last layer, shape (N, outputs).

        Args:
            X: Raw inputs, shape (N, F), with LSTM layers (N, K, F), oldest first; NaN only in groups of `known`.
        """
        out = np.empty((len(X), self.layers[-1][1].size), np.float32)
        if len(X) <= _MANY:
            self._fill(out, X)
            return out
        chunks = [slice(first, first + _CHUNK) for first in range(0, len(X), _CHUNK)]
        with ThreadPoolExecutor(_THREADS) as threads:
            list(threads.map(lambda chunk: self._fill(out[chunk], X[chunk]), chunks))
        return out

    def _fill(self, out: Singles, X: NDArray[np.floating[Any]]) -> None:
        """Write the outputs of the last layer for `X` into `out`, block by block."""
        with np.errstate(over="ignore", invalid="ignore"):  # large weights may overflow; the caller checks
            for start in range(0, len(X), _BLOCK):
                out[start : start + _BLOCK] = self._block(self._completed(X[start : start + _BLOCK]))

    def _completed(self, X: NDArray[np.floating[Any]]) -> Singles:
        """Return the inputs with unknown ones replaced, followed by one flag per group (1 = known) and the distance."""
        values = X.astype(np.float32)
        if not self.known and self.distance is None:
            return values
        apart = [] if self.distance is None else [distance(values, self.distance)]
        flags = [~np.isnan(values[..., GROUPS[group]]).any(axis=-1, keepdims=True) for group in self.known]
        if self.known:
            values = np.where(np.isnan(values), self.middle, values)
        for flag, group in zip(flags, self.known, strict=True):
            part = values[..., GROUPS[group]]
            values[..., GROUPS[group]] = np.where(flag, part, self.middle[GROUPS[group]])
        return np.concatenate([values, *[flag.astype(np.float32) for flag in flags], *apart], axis=-1)

    def _block(self, values: Singles) -> Singles:
        if self.recurrent:
            values = self._after_history(values)
        for index, (weight, bias) in enumerate(self.layers):
            values = values @ weight
            values += bias
            if index == self.softmax_after:
                values = _softmax(values)
            elif index < len(self.layers) - 1:
                np.maximum(values, _zeros(weight.shape[1])[: len(values)], out=values)
        return values

    def _after_history(self, values: Singles) -> Singles:
        """Return the feed-forward layers' input: the last state, or the last sample with the forecast position."""
        if self.forecast is None:
            return _lstm(values, self.recurrent)
        presence = [values.shape[-1] - len(self.known) + self.known.index("human")] if "human" in self.known else []
        state = _lstm(values[:, :, [*range(_HUMAN.start, _HUMAN.stop), *presence]], self.recurrent)
        now = values[:, -1].copy()
        now[:, _HUMAN] = state @ self.forecast[0] + self.forecast[1]
        return now


def distance(X: Singles, unknown: float) -> Singles:
    """Return ||x_r - x_h||, shape (..., 1), m; `unknown` for unknown positions."""
    apart = np.linalg.norm(X[..., :3] - X[..., _HUMAN], axis=-1, keepdims=True)
    return np.asarray(np.where(np.isnan(apart), np.float32(unknown), apart), np.float32)


@lru_cache(maxsize=8)
def _zeros(width: int) -> Singles:
    """Return zeros (_BLOCK, width): numpy compares with an array several times faster than with a scalar."""
    return np.zeros((_BLOCK, width), np.float32)


def _softmax(values: Singles) -> Singles:
    """Return the softmax of each row (N, outputs); few long rows are faster than many short ones."""
    values = np.ascontiguousarray(values.T)
    values -= values.max(axis=0)
    np.exp(values, out=values)
    values /= values.sum(axis=0)
    return values.T


def _lstm(values: Singles, cells: tuple[Cell, ...]) -> Singles:
    """Return the last state (N, H) of LSTM layers over sequences (N, K, inputs)."""
    steps = [values[:, k] for k in range(values.shape[1])]
    for weight, recurrent, bias in cells:
        width = recurrent.shape[0]
        state = np.zeros((len(values), width), np.float32)
        cell, states = np.zeros_like(state), []
        for step in steps:
            gates = step @ weight + state @ recurrent + bias
            keep, use = _sigmoid(gates[:, : 2 * width]), _sigmoid(gates[:, 3 * width :])
            cell = keep[:, width:] * cell + keep[:, :width] * np.tanh(gates[:, 2 * width : 3 * width])
            state = use * np.tanh(cell)
            states.append(state)
        steps = states
    return steps[-1]


def _sigmoid(values: Singles) -> Singles:
    half = np.tanh(values * np.float32(0.5))
    return np.asarray(np.float32(0.5) * half + np.float32(0.5), np.float32)
