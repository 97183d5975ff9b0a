"""Check what `model.json` says about a network before anything believes it.

A model folder may come from anywhere. So the sizes that `model.json` states are held against limits and against each
other; the weights file is then held against them (`tensors`).
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NoReturn

from cyclekit.models.cell import NO_CELL, is_cell
from cyclekit.models.spec import NETWORKS
from cyclekit.samples import GROUPS, INPUTS

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


_MAX_CARD_BYTES = 16 * 2**20
_MAX_HISTORY = 1000
_MAX_LAYERS, _MAX_WIDTH, _MAX_LEVELS = 32, 4096, 64


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
    recurrent: tuple[tuple[int, int], ...] = ()
    forecast: tuple[int, int] | None = None
    known: tuple[str, ...] = ()
    history: tuple[int, int] = (1, 1)
    distance: float | None = None

    @property
    def softmax_after(self) -> int | None:
        """Index of the layer behind which the softmax stands."""
        return {"classifier": len(self.layers) - 1, "mixed": len(self.layers) - 2}.get(self.network)

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
        if not is_cell(about["card"].get("cell", NO_CELL)):
            raise NotAModel("the cell that it was learned in is not written as it should be")
        levels = _levels(about.get("levels"), needed=network in ("classifier", "mixed"))
        layers, known = _sizes(about.get("layers"), least=2), _known(about.get("known"), problem)
        outputs = {"classifier": [len(levels)], "mixed": [len(levels), 1]}.get(str(network), [1])
        recurrent, forecast = _recurrent(str(network), about)
        distance = _distance(about.get("distance"))
        inputs = len(INPUTS[problem]) + len(known) + (distance is not None)
        first = recurrent[0][0] if recurrent and forecast is None else layers[0][0]
        fits = first == inputs and [out for _, out in layers[-len(outputs) :]] == outputs
        if recurrent and forecast is None:
            fits = fits and layers[0][0] == recurrent[-1][1]
        if forecast is not None:
            fits = fits and forecast == (recurrent[-1][1], 3) and recurrent[0][0] == 3 + ("human" in known)
        if not fits:
            raise NotAModel(f"layers {layers} do not fit a {network} of {len(levels)} levels for problem {problem!r}")
        history = _history(about.get("history"), needed=bool(recurrent))
        return cls(problem, str(network), horizon_s, levels, layers, recurrent, forecast, known, history, distance)


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


def _levels(stated: object, *, needed: bool) -> tuple[float, ...]:
    levels = [_number(level) for level in stated] if isinstance(stated, list) else [math.nan]
    rising = all(a < b for a, b in pairwise(levels)) and all(-0.5 <= level <= 1.5 for level in levels)
    if not rising or not 2 * needed <= len(levels) <= _MAX_LEVELS:
        raise NotAModel(f"levels {stated!r:.80} are not 2 to {_MAX_LEVELS} ascending fractions")
    return tuple(levels)


def _sizes(stated: object, least: int) -> tuple[tuple[int, int], ...]:
    def is_width(value: object) -> bool:
        return isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= _MAX_WIDTH

    if not isinstance(stated, list) or not least <= len(stated) <= _MAX_LAYERS:
        raise NotAModel(f"layers are {stated!r:.80}")
    for size in stated:
        if not isinstance(size, list) or len(size) != 2 or not all(is_width(value) for value in size):
            raise NotAModel(f"a layer of size {size!r:.80}")
    _check_chain(stated)
    return tuple((size[0], size[1]) for size in stated)


def _recurrent(network: str, about: dict[str, Any]) -> tuple[tuple[tuple[int, int], ...], tuple[int, int] | None]:
    """Return the sizes of the LSTM layers and of the forecast behind them."""
    count = {"lstm-1": 2, "lstm-2": 1}.get(network, 0)
    recurrent = _sizes(about.get("recurrent", []), least=0)
    forecast = _sizes([about["forecast"]], least=1)[0] if about.get("forecast") is not None else None
    if len(recurrent) != count or (forecast is not None) != (network == "lstm-2"):
        raise NotAModel(f"{len(recurrent)} LSTM layers do not fit a {network}")
    return recurrent, forecast


def _known(stated: object, problem: str) -> tuple[str, ...]:
    """Return the groups that may be unknown, each once, in the order of the columns."""
    there = [group for group, columns in GROUPS.items() if columns.start < len(INPUTS[problem])]
    if not isinstance(stated, list) or stated != [group for group in there if group in stated]:
        raise NotAModel(f"groups of inputs that may be unknown are {stated!r:.80}")
    return tuple(stated)


def _history(stated: object, *, needed: bool) -> tuple[int, int]:
    numbers = [_number(value) for value in stated] if isinstance(stated, list) and len(stated) == 2 else [math.nan] * 2
    whole = all(1 <= number <= _MAX_HISTORY and number == int(number) for number in numbers)
    if not whole or (numbers[0] > 1) != needed:
        raise NotAModel(f"history is {stated!r:.80}")
    return int(numbers[0]), int(numbers[1])


def _distance(stated: object) -> float | None:
    if stated is not None and not 0 <= _number(stated) <= 1e6:
        raise NotAModel(f"mean distance is {stated!r:.80}")
    return None if stated is None else _number(stated)


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
