"""Optimisers: AdamW, or Muon for the square matrices, with a learning rate that rises and falls once.

torch's optimiser classes import its compiler, which takes a second and is not used here; its functions do not.
"""

from __future__ import annotations

from math import cos, pi
from typing import TYPE_CHECKING, NamedTuple, Protocol

import torch
from torch.optim.adamw import adamw

if TYPE_CHECKING:
    from collections.abc import Iterable

    from torch import nn

    from cyclekit.learning.networks.spec import ModelSpec

_MUON_RATE = 0.04
"""Maximum learning rate of Muon; its steps are orthogonal matrices, independent of the gradient's size."""
_FASTER, _RISE = 2.0, (0.2, 0.1)
"""Factor on the learning rate of the other weights with Muon; share of the run in which the rate rises, without and
with Muon. Chosen together on 1000 executions: 0.84e-4 after 3000 steps, 1.04e-4 with AdamW's own rate and rise."""
MAX_NORM = 1.0
"""Maximum norm of a recurrent network's gradient (Pascanu et al. 2013), typically ten times its norm. A longer one,
when batch normalisation was frozen at the highest rate, has pushed LSTM-1 out of its range for good."""
_MOMENTUM, _TIMES = 0.95, 5
_A, _B, _C = 3.4445, -4.7750, 2.0315
"""Coefficients of the iteration that orthogonalises a matrix (Jordan et al. 2024)."""


_BETA2, _EPS = 0.999, 1e-8
_LEAST, _LESS_LEAST = 25.0, 1e4
"""Maximum learning rate divided by that at the start, and that by the one at the end."""
_MOMENTUM_RANGE = (0.95, 0.85)
"""Momentum of AdamW at the lowest and at the highest learning rate."""


class Pace(NamedTuple):
    """Learning rate and momentum of one step."""

    rate: float
    momentum: float


class Optimiser(Protocol):
    """Interface of the optimisers here."""

    def step(self, pace: Pace) -> None:
        """Move the parameters that have a gradient."""


class AdamW:
    """AdamW (Loshchilov and Hutter 2019) by torch's own function."""

    def __init__(self, params: Iterable[nn.Parameter], weight_decay: float) -> None:
        """Optimise `params`."""
        self._params: list[torch.Tensor] = list(params)
        self._decay = weight_decay
        self._means = [torch.zeros_like(p) for p in self._params]
        self._squares = [torch.zeros_like(p) for p in self._params]
        self._taken = [torch.zeros((), dtype=torch.float32, device=p.device) for p in self._params]

    @torch.no_grad()
    def step(self, pace: Pace) -> None:
        """Move every parameter that has a gradient."""
        on = [(at, p, p.grad) for at, p in enumerate(self._params) if p.grad is not None]
        adamw(
            [p for _, p, _ in on],
            [grad for _, _, grad in on],
            [self._means[at] for at, _, _ in on],
            [self._squares[at] for at, _, _ in on],
            [],
            [self._taken[at] for at, _, _ in on],
            fused=True,
            amsgrad=False,
            beta1=pace.momentum,
            beta2=_BETA2,
            lr=pace.rate,
            weight_decay=self._decay,
            eps=_EPS,
            maximize=False,
        )


class Muon:
    """Muon (Jordan et al. 2024) for square matrices of one size: the step is the orthogonalised momentum.

    torch's own processes the matrices one by one in bfloat16, which on a CPU took longer than the gradient. This one
    stacks them in single precision; for three of 64 x 64 a step took an eighth of the time.
    """

    def __init__(self, params: Iterable[nn.Parameter], weight_decay: float) -> None:
        """Optimise `params`, shape (n, n) each."""
        self._params: list[torch.Tensor] = list(params)
        self._decay = weight_decay
        self._mean = torch.zeros_like(torch.stack(self._params))

    @torch.no_grad()
    def step(self, pace: Pace) -> None:
        """Move every matrix by the rate along its orthogonal step, and towards zero by rate times decay."""
        gradient = torch.stack([grad for p in self._params if (grad := p.grad) is not None])
        self._mean.lerp_(gradient, 1 - _MOMENTUM)
        for p, along in zip(self._params, orthogonal(gradient.lerp(self._mean, _MOMENTUM)), strict=True):
            p.mul_(1 - pace.rate * self._decay).sub_(along, alpha=pace.rate)


def one_cycle(step: int, total: int, most: float, rise: float) -> Pace:
    """Return the pace of a step: the rate rises and falls once, along cosines (Smith and Topin 2018).

    Args:
        step: Number of steps before it.
        total: Number of steps of the run.
        most: Maximum learning rate.
        rise: Share of the run in which the rate rises.
    """
    begin, top = most / _LEAST, rise * total - 1
    least, fast = _MOMENTUM_RANGE
    if step <= top and top > 0:
        return Pace(_between(begin, most, step / top), _between(least, fast, step / top))
    part = (step - top) / (total - 1 - top)
    return Pace(_between(most, begin / _LESS_LEAST, part), _between(fast, least, part))


def _between(start: float, end: float, part: float) -> float:
    return end + (start - end) / 2.0 * (cos(pi * part) + 1)


def orthogonal(stack: torch.Tensor) -> torch.Tensor:
    """Return matrices (K, n, n) with the same singular vectors and singular values near 1, by Newton-Schulz steps."""
    x: torch.Tensor = stack / (torch.linalg.matrix_norm(stack, keepdim=True) + 1e-7)
    for _ in range(_TIMES):
        square = x @ x.mT
        x = torch.baddbmm(x, torch.baddbmm(square, square, square, beta=_B, alpha=_C), x, beta=_A)
    return x


class Steps:
    """The optimisers of one training run with their schedules."""

    def __init__(self, network: nn.Module, spec: ModelSpec, decay: float, total: int) -> None:
        """Prepare a schedule of `total` steps."""
        square: list[nn.Parameter] = []
        if spec.optimiser == "muon":
            width = spec.hidden[-1]
            square = [p for p in network.parameters() if p.shape == (width, width)]
        mine = {id(p) for p in square}
        rest = [p for p in network.parameters() if id(p) not in mine]
        rate = spec.learning_rate * (_FASTER if square else 1.0)
        self._optimisers: list[tuple[Optimiser, float]] = [(AdamW(rest, decay), rate)]
        if square:
            self._optimisers.append((Muon(square, decay * rate / _MUON_RATE), _MUON_RATE))
        self._params = list(network.parameters())
        self._shortened = self._params if spec.kind.lstm_layers else []
        self._step, self._total, self._rise = 0, total, _RISE[bool(square)]

    def take(self, loss: torch.Tensor) -> None:
        """Take one step down the gradient of `loss`."""
        for p in self._params:
            p.grad = None
        loss.backward()  # type: ignore[no-untyped-call]
        if self._shortened:
            torch.nn.utils.clip_grad_norm_(self._shortened, MAX_NORM)
        for optimiser, most in self._optimisers:
            optimiser.step(one_cycle(self._step, self._total, most, self._rise))
        self._step += 1
