"""The networks of the paper: their layers, and that folding them changes nothing."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from torch import nn

from cyclekit.errors import ConfigError, CyclekitError, UnknownName
from cyclekit.learning.networks.folding import fold
from cyclekit.learning.networks.kinds import NETWORKS, networks_for
from cyclekit.learning.networks.network import build
from cyclekit.learning.networks.saved import TrainedModel
from cyclekit.learning.networks.spec import FREEZE_NORM_AFTER, MUON_ROWS, ModelSpec
from cyclekit.learning.windows import GROUPS

LEVELS = (0.0, 0.25, 0.5, 0.75, 1.0)
PROBLEMS = ("now", "ahead", "average")
EVERY = [(problem, name) for problem in PROBLEMS for name in networks_for(problem) if not NETWORKS[name].trees]
WITH_DISTANCE = [(problem, name, (1.5, 4.0)) for problem, name in EVERY if not NETWORKS[name].lstm_layers]


def widths(network: nn.Sequential) -> list[int]:
    return [m.out_features for m in network if isinstance(m, nn.Linear)]


def test_the_classifier_is_four_layers_of_64_with_batch_normalisation():
    network = build(ModelSpec.of("now"), 6, LEVELS)
    assert widths(network) == [64, 64, 64, 64, 5]
    assert [type(m).__name__ for m in list(network)[:3]] == ["Linear", "BatchNorm1d", "ReLU"]


def test_the_regressor_is_five_layers_of_64_that_end_between_0_and_1():
    network = build(ModelSpec.of("now", "regressor"), 6, LEVELS)
    assert widths(network) == [64] * 5 + [1]
    assert isinstance(network[-1], nn.Hardtanh)


def test_the_mixed_net_ends_in_memberships_of_the_levels_and_a_linear_value():
    network = build(ModelSpec.of("average"), 12, LEVELS)
    assert widths(network) == [64] * 5 + [5, 1]
    assert [type(m).__name__ for m in list(network)[-3:]] == ["Linear", "Softmax", "Linear"]


def test_muon_moves_the_weights_where_it_was_measured_better():
    assert [ModelSpec.of(problem).for_rows(MUON_ROWS).optimiser for problem in PROBLEMS] == ["muon", "muon", "adamw"]
    few = ModelSpec.of().for_rows(MUON_ROWS - 1)
    assert (few.optimiser, few.freeze_norm_after) == ("adamw", FREEZE_NORM_AFTER["adamw"])
    asked = ModelSpec.of("average", optimiser="muon", freeze_norm_after=0.5).for_rows(1)
    assert (asked.optimiser, asked.freeze_norm_after) == ("muon", 0.5)


def test_without_normalisation_there_is_none():
    network = build(ModelSpec.of("now", norm="none"), 6, LEVELS)
    assert not any(isinstance(m, nn.BatchNorm1d) for m in network)


@pytest.mark.parametrize("norm", ["batch", "none"])
@pytest.mark.parametrize(("problem", "name", "distance"), [*((*each, None) for each in EVERY), *WITH_DISTANCE])
@pytest.mark.parametrize("known", [(), ("human",), ("human", "human_goal")])
def test_a_folded_network_predicts_what_the_network_predicts(problem, name, norm, known, distance):
    rng = np.random.default_rng(0)
    torch.manual_seed(0)
    inputs = 6 if problem == "now" else 12
    known = known if inputs == 12 else known[:1]
    spec = ModelSpec.of(problem, name, norm=norm, features="distance" if distance else "positions").at_rate(10.0)
    mean, scale = rng.normal(size=inputs), rng.uniform(0.5, 3, inputs)
    scale[5] = 0.0  # an operator who is always at the same height
    network = build(spec, inputs, LEVELS, known, scale)
    disturb(network)
    network.eval()
    X = rng.normal(size=(300, inputs) if spec.history[0] == 1 else (300, spec.history[0], inputs))
    for group in known:
        X[rng.random(X.shape[:-1]) < 0.2, GROUPS[group]] = np.nan
    flags = [np.isfinite(X[..., GROUPS[group]]).all(axis=-1, keepdims=True) for group in known]
    apart = []
    if distance:
        metres = np.linalg.norm(X[:, :3] - X[:, 3:6], axis=1, keepdims=True)
        apart = [np.nan_to_num((metres - distance[0]) * distance[1])]  # nobody there: as far as the offset
    fed = np.concatenate([np.nan_to_num((X - mean) * scale), *flags, *apart], axis=-1).astype(np.float32)
    with torch.no_grad():
        out = network(torch.from_numpy(fed))
        expected = torch.softmax(out, 1) @ torch.tensor(LEVELS) if name == "classifier" else out[:, 0].clamp(0, 1)
    folded = fold(network, mean, scale, known, distance=distance)
    model = TrainedModel(problem, name, spec.horizon_s, LEVELS, folded, history=spec.history)
    assert_allclose(model.predict(X), expected.numpy(), atol=5e-6)
    assert np.ptp(model.predict(X)) > 1e-3


def disturb(network: nn.Module) -> None:
    """Give batch normalisation statistics that are not those of nothing."""
    with torch.no_grad():
        for m in network.modules():
            if isinstance(m, nn.BatchNorm1d):
                m.running_mean.normal_(0, 0.1)
                m.running_var.uniform_(0.5, 2)
                m.weight.uniform_(0.5, 1.5)
                m.bias.uniform_(-0.1, 0.1)


def test_the_first_two_layers_of_lstm_1_are_lstm_layers_and_the_rest_is_the_regressor():
    network = build(ModelSpec.of("ahead", "lstm-1"), 12, LEVELS)
    assert (network.lstm.num_layers, network.lstm.hidden_size) == (2, 64)
    assert widths(network.rest) == [64, 64, 64, 1]


def test_lstm_2_forecasts_three_coordinates_that_the_regressor_sees_in_place_of_the_position():
    network = build(ModelSpec.of("ahead", "lstm-2"), 12, LEVELS)
    assert (network.lstm.num_layers, network.lstm.input_size, network.ahead.out_features) == (1, 3, 3)
    assert widths(network.rest) == [64] * 5 + [1]
    network.eval()
    x = torch.randn(4, 6, 12)
    moved = x.clone()
    moved[:, :-1, :3] += 1  # what the robot did before does not matter to it
    with torch.no_grad():
        assert torch.equal(network(x), network(moved))


def test_a_recurrent_network_answers_from_the_order_of_its_history():
    torch.manual_seed(0)
    network = build(ModelSpec.of("ahead", "lstm-1", norm="none"), 12, LEVELS)
    x = torch.randn(8, 6, 12)
    turned = torch.cat([x[:, :-1].flip(1), x[:, -1:]], dim=1)
    with torch.no_grad():
        assert not torch.allclose(network(x), network(turned), atol=1e-4)


@pytest.mark.parametrize(
    "settings",
    [
        {"network": "lstm-1", "history": (1, 1)},
        {"network": "lstm-1", "hidden": (64, 64)},
        {"network": "regressor", "history": (6, 2)},
        {"network": "lstm-2", "history": (6, 0)},
        {"network": "classifier", "noise_m": -0.1},
        {"network": "classifier", "patience": 0},
        {"network": "classifier", "balance": "rows"},
    ],
)
def test_extras_without_sense_are_refused(settings):
    with pytest.raises(CyclekitError):
        ModelSpec.of("ahead", **settings)


@pytest.mark.parametrize(("problem", "network"), [("average", "classifier"), ("now", "mixed"), ("now", "lstm-1")])
def test_a_network_that_does_not_solve_the_problem_is_refused(problem, network):
    with pytest.raises(ConfigError, match="does not solve"):
        ModelSpec.of(problem, network)


def test_a_misspelt_name_is_answered_with_the_nearest():
    with pytest.raises(UnknownName, match="nearest is 'classifier'"):
        ModelSpec.of("now", "clasifier")
    with pytest.raises(UnknownName, match="nearest is 'ahead'"):
        ModelSpec.of("ahed")


@pytest.mark.parametrize(
    "settings",
    [
        {"problem": "now", "horizon_s": 2.0},
        {"problem": "ahead", "horizon_s": 0.0},
        {"problem": "average", "horizon_s": float("nan")},
        {"epochs": -3},
        {"hidden": (64, 0)},
        {"batch": 1},
        {"learning_rate": 0.0},
        {"norm": "layer"},
        {"test_fraction": 1.5},
        {"freeze_norm_after": -1.0},
        {"seed": -1},
    ],
)
def test_settings_without_sense_are_refused_before_any_data_is_read(settings):
    with pytest.raises(CyclekitError):
        ModelSpec.of(**settings)
