"""Muon: its step is the orthogonal part of the momentum, and what a training run leaves of torch's settings."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn

from cyclekit.learning.networks.fitting import one_fast_thread
from cyclekit.learning.networks.optimiser import MAX_NORM, Muon, Steps, orthogonal
from cyclekit.learning.networks.spec import ModelSpec


def test_an_orthogonal_step_keeps_the_singular_vectors_and_evens_out_the_values():
    stack = torch.randn(3, 16, 16, generator=torch.Generator().manual_seed(0))
    for before, after in zip(stack.numpy(), orthogonal(stack).numpy(), strict=True):
        u, _, v = np.linalg.svd(before)
        values = u.T @ after @ v.T
        assert np.abs(values - np.diag(np.diag(values))).max() < 1e-3
        assert 0.3 < np.diag(values).min() < np.diag(values).max() < 1.3


def test_each_matrix_of_a_stack_is_moved_by_its_own_gradient():
    generator = torch.Generator().manual_seed(1)
    first, second = (nn.Parameter(torch.randn(8, 8, generator=generator)) for _ in range(2))
    before = first.detach().clone(), second.detach().clone()
    first.grad, second.grad = torch.eye(8), torch.zeros(8, 8)
    Muon([first, second], lr=0.1, weight_decay=0.5).step()
    assert torch.allclose(second, before[1] * (1 - 0.1 * 0.5))
    moved = (before[0] * (1 - 0.1 * 0.5) - first).detach()
    assert torch.allclose(moved, torch.eye(8) * moved[0, 0], atol=1e-6)
    assert 0.07 < float(moved[0, 0]) < 0.13


def test_a_run_on_one_fast_thread_leaves_torch_as_it_was():
    threads = torch.get_num_threads()
    with one_fast_thread():
        assert torch.get_num_threads() == 1
        assert float(torch.tensor(1e-40) * 0.5) == 0.0
    assert torch.get_num_threads() == threads
    assert float(torch.tensor(1e-40) * 0.5) > 0.0


@pytest.mark.parametrize("network", ["lstm-1", "lstm-2", "regressor"])
def test_only_recurrent_networks_have_their_gradients_shortened(network: str):
    layer = nn.Linear(4, 1)
    spec = ModelSpec.of("ahead", network, 2.0, optimiser="adamw")
    Steps(layer, spec, 0.0, 20).take(1e3 * layer(torch.ones(1, 4)).sum())
    norm = float(torch.cat([p.grad.ravel() for p in layer.parameters() if p.grad is not None]).norm())
    assert norm == pytest.approx(1e3 * 5**0.5 if network == "regressor" else MAX_NORM, rel=1e-4)
