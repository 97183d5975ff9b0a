"""Check what `model.json` says about a network before anything believes it.

A model folder may come from anywhere. So the sizes that `model.json` states are held against limits (`cards`) and
against each other, here; the weights file is then held against them (`tensors`).
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

from cyclekit.learning.networks.kinds import NETWORKS, networks_for
from cyclekit.learning.windows import GROUPS, INPUTS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.cards import ModelCard


class NotAModel(Exception):
    """Why a file is not part of a model; `load_model` tells it as a ModelError, with the file and the cure."""


def softmax_after(about: ModelCard) -> int | None:
    """Return the index of the layer that the softmax follows; None without one."""
    kind = NETWORKS[about.network]
    return len(about.layers) - len(kind.outputs(len(about.levels))) if kind.needs_levels else None


def check_layout(about: ModelCard) -> None:
    """Check that the parts of the stated network fit each other.

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
    if (about.history[0] > 1) != bool(about.recurrent):
        raise NotAModel(f"history is {about.history} for a {network}")


def _fits(about: ModelCard) -> bool:
    """Tell whether inputs, hidden layers and outputs have the widths that go with each other."""
    levels, recurrent, forecast = len(about.levels), about.recurrent, about.forecast
    inputs = len(INPUTS[about.problem]) + len(about.known) + (about.distance is not None)
    outputs = NETWORKS[about.network].outputs(levels)
    first = recurrent[0][0] if recurrent and forecast is None else about.layers[0][0]
    fits = first == inputs and [out for _, out in about.layers[-len(outputs) :]] == outputs
    if recurrent and forecast is None:
        fits = fits and about.layers[0][0] == recurrent[-1][1]
    if forecast is not None:
        fits = fits and forecast == (recurrent[-1][1], 3) and recurrent[0][0] == 3 + ("human" in about.known)
    return fits


def _check_recurrent(about: ModelCard) -> None:
    kind = NETWORKS[about.network]
    if len(about.recurrent) != kind.lstm_layers or (about.forecast is not None) != kind.forecasts:
        raise NotAModel(f"{len(about.recurrent)} LSTM layers do not fit a {about.network}")
    _check_chain(about.recurrent)


def _check_known(about: ModelCard) -> None:
    """Refuse groups that may be unknown unless each is there once, in the order of the columns."""
    there = [group for group, columns in GROUPS.items() if columns.start < len(INPUTS[about.problem])]
    if about.known != tuple(group for group in there if group in about.known):
        raise NotAModel(f"groups of inputs that may be unknown are {about.known!r:.80}")


def _check_chain(sizes: Sequence[tuple[int, int]]) -> None:
    if any(a[1] != b[0] for a, b in pairwise(sizes)):
        raise NotAModel(f"layers {sizes!r:.200} do not join")
