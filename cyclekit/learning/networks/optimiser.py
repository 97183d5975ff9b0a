"""Optimisers: AdamW, or Muon for the square matrices, with a learning rate that rises and falls once."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

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


class Muon(torch.optim.Optimizer):
    """Muon (Jordan et al. 2024) for square matrices of one size: the step is the orthogonalised momentum.

    torch's own processes the matrices one by one in bfloat16, which on a CPU took longer than the gradient. This one
    stacks them in single precision; for three of 64 x 64 a step took an eighth of the time.
    """

    def __init__(self, params: Iterable[nn.Parameter], lr: float, weight_decay: float) -> None:
        """Optimise `params`, shape (n, n) each."""
        super().__init__(params, {"lr": lr, "weight_decay": weight_decay})

    @torch.no_grad()
    def step(self, closure: None = None) -> None:  # type: ignore[override]
        """Move every matrix by the rate along its orthogonal step, and towards zero by rate times decay."""
        del closure
        for group in self.param_groups:
            params = group["params"]
            gradient = torch.stack([p.grad for p in params])
            state = self.state[params[0]]
            mean = state.setdefault("mean", torch.zeros_like(gradient))
            mean.lerp_(gradient, 1 - _MOMENTUM)
            for p, along in zip(params, orthogonal(gradient.lerp(mean, _MOMENTUM)), strict=True):
                p.mul_(1 - group["lr"] * group["weight_decay"]).sub_(along, alpha=group["lr"])


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
        parts: list[tuple[torch.optim.Optimizer, float]] = [
            (torch.optim.AdamW(rest, lr=rate, weight_decay=decay, fused=True), rate)
        ]
        if square:
            muon = Muon(square, lr=_MUON_RATE, weight_decay=decay * rate / _MUON_RATE)
            parts.append((muon, _MUON_RATE))
        self._shortened = list(network.parameters()) if spec.kind.lstm_layers else []
        self._optimisers = [optimiser for optimiser, _ in parts]
        self._schedules = [
            torch.optim.lr_scheduler.OneCycleLR(
                optimiser, most, total, pct_start=_RISE[bool(square)], cycle_momentum=most == rate
            )
            for optimiser, most in parts
        ]

    def take(self, loss: torch.Tensor) -> None:
        """Take one step down the gradient of `loss`."""
        for optimiser in self._optimisers:
            optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        if self._shortened:
            torch.nn.utils.clip_grad_norm_(self._shortened, MAX_NORM)
        for optimiser, schedule in zip(self._optimisers, self._schedules, strict=True):
            optimiser.step()
            schedule.step()
