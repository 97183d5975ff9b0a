"""The continuous law is found again from samples, through its response, and never behind levels and ramps."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
import pytest
from fabricated import fabricate_dataset
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from cyclekit.cli.train import rule_lines
from cyclekit.dataset.cards import BadCard, DynamicsCard, TrainingCard, checked, plain, texts
from cyclekit.dataset.cards.rule import LawCard, MetresCard, RuleCard
from cyclekit.dataset.dataset import CARD, Dataset
from cyclekit.errors import DatasetError
from cyclekit.estimate.robot.safety import Dynamics, Follower
from cyclekit.estimate.validation.check import check_rollout
from cyclekit.estimate.whatif.alter import LearnedSafety, altered_safety
from cyclekit.estimate.whatif.change import Change
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.rules.law.law import LawShape, fit_law, shape_of
from cyclekit.learning.rules.law.law_evidence import LAW, find_law
from cyclekit.learning.rules.law.law_rows import LawRows, is_continuous, resting_rates
from cyclekit.learning.rules.safety import RuleSafety, predictor_of
from cyclekit.learning.rules.samples.distances import DISTANCES, TO_TCP
from cyclekit.learning.rules.words import verdict
from cyclekit.learning.safety_function.answer import read_zones
from cyclekit.learning.training import train
from cyclekit.storage.atomic import write_parquet
from cyclekit_sim import SimulationOptions, simulate
from cyclekit_sim.rules import IsoLaw, Rule

if TYPE_CHECKING:
    from pathlib import Path

HZ, SAMPLES, EXECUTIONS = 50, 30, 12
"""Rate of the simulation, seconds of an execution, how many."""
STOP_M, LINEAR_M, SQUARE_M = 0.5, 0.6, 0.15


def by_law(apart_m: np.ndarray, lowest: float = 0.0) -> np.ndarray:
    """The highest of 2001 speeds whose protective separation distance the operator keeps."""
    s = np.linspace(0.0, 1.0, 2001)
    found = np.searchsorted(STOP_M + LINEAR_M * s + SQUARE_M * s**2, apart_m, side="right") - 1
    return np.asarray(np.maximum(s[found.clip(min=0)], lowest))


def by_levels(apart_m: np.ndarray) -> np.ndarray:
    return np.array([0.1, 0.4, 0.7, 1.0])[np.searchsorted([0.7, 0.95, 1.2], apart_m)]


def rows(
    command: Any = by_law, *, latency_s: float = 0.0, down: float = 1e9, up: float = 1e9, noise_m: float = 0.0
) -> LawRows:
    """Rows at 10 Hz of somebody who walks about a robot; the scaling follows `command` late and limited."""
    rng = np.random.default_rng(3)
    t = np.arange(HZ * SAMPLES) / HZ
    parts = []
    for number in range(EXECUTIONS):
        phase = rng.uniform(0, 6.3, 4)
        robot = np.stack([0.4 * np.sin(t + phase[0]), 0.3 * np.sin(0.7 * t + phase[1]), 0 * t], axis=1)
        human = np.stack([1.1 + 0.9 * np.sin(0.5 * t + phase[2]), 0.9 * np.sin(0.45 * t + phase[3]), 0 * t], axis=1)
        wanted = command(np.linalg.norm(robot - human, axis=1))
        wanted = wanted[np.maximum(np.arange(len(t)) - round(latency_s * HZ), 0)]
        s = wanted.copy()
        for i in range(1, len(t)):
            s[i] = np.clip(wanted[i], s[i - 1] - down / HZ, s[i - 1] + up / HZ)
        human += rng.normal(0.0, noise_m, human.shape)
        parts.append((t[::5], s[::5], np.full(len(t[::5]), number), np.concatenate([robot, human], axis=1)[::5]))
    time, scaling, execution, at = (np.concatenate(column) for column in zip(*parts, strict=True))
    apart = {name: distance(at[:, :3], at[:, 3:]) for name, distance in DISTANCES.items()}
    return LawRows(time, scaling, execution, execution, apart, at)


HELD_OUT = np.arange(9, 12)


@given(st.floats(0, 3), st.floats(0.05, 3), st.floats(0, 2), st.floats(0, 1))
def test_the_scaling_of_a_law_is_the_inverse_of_its_distance(
    stop: float, linear: float, square: float, s: float
) -> None:
    found = LawShape(stop, linear, square).scaling(np.array([stop + linear * s + square * s * s]))
    assert found[0] == pytest.approx(s, abs=1e-6)


@pytest.mark.parametrize(
    ("latency_s", "down", "up", "lowest"), [(0.0, 1e9, 1e9, 0.0), (0.2, 1.0, 0.1, 0.0), (0.1, 1e9, 0.25, 0.2)]
)
def test_the_law_is_found_through_its_response(latency_s: float, down: float, up: float, lowest: float) -> None:
    found = find_law(
        rows(lambda apart: by_law(apart, lowest), latency_s=latency_s, down=down, up=up), held_out=HELD_OUT
    )
    assert found is not None
    assert found.rule is not None
    law = found.rule.law
    assert law is not None
    assert (law.distance, found.rule.limits) == (TO_TCP, ())
    for metres, true in ((law.stop, STOP_M), (law.linear, LINEAR_M), (law.square, SQUARE_M)):
        assert metres.value == pytest.approx(true, abs=0.02)
    assert law.latency_s == pytest.approx(latency_s, abs=0.02)
    assert law.ramp_up_per_s == (None if up > 1e8 else pytest.approx(up, rel=0.05))
    assert law.ramp_down_per_s in (None, pytest.approx(down, rel=0.05))
    assert law.lowest == pytest.approx(lowest, abs=0.005)
    assert found.rule.explained > 0.97
    assert verdict(found).startswith(f"the scaling is continuous: {LAW}, {TO_TCP} gives ")


@pytest.mark.parametrize("noise_m", [0.0, 0.03])
@pytest.mark.parametrize(("down", "up"), [(1.0, 0.05), (0.05, 0.05), (1.0, 0.1), (0.1, 0.1)])
def test_levels_seen_through_ramps_are_no_law(down: float, up: float, noise_m: float) -> None:
    stairs = rows(by_levels, down=down, up=up, noise_m=noise_m)
    assert not is_continuous(stairs)
    assert resting_rates(stairs).up_per_s == pytest.approx(up, rel=0.02)


def test_levels_that_look_continuous_are_no_law_either() -> None:
    stairs = rows(by_levels)
    noisy = replace(stairs, scaling=stairs.scaling + np.random.default_rng(0).normal(0.0, 0.02, len(stairs)))
    assert is_continuous(noisy)
    assert find_law(noisy, held_out=HELD_OUT) is None


def test_what_goes_by_more_than_a_distance_is_no_law() -> None:
    plain_rows = rows()
    slowed = np.where(plain_rows.at_m[:, 4] > 0.3, 0.6 * plain_rows.scaling, plain_rows.scaling)
    assert find_law(replace(plain_rows, scaling=slowed), held_out=HELD_OUT) is None


def test_noisy_positions_leave_the_law() -> None:
    found = find_law(rows(noise_m=0.02), held_out=HELD_OUT)
    assert found is not None
    assert fit_law(rows(noise_m=0.02)) is not None


def metres(value: float) -> MetresCard:
    return MetresCard(value=value, low=value - 0.01, high=value + 0.01)


LAW_CARD = LawCard(
    distance=TO_TCP,
    stop=metres(0.5),
    linear=metres(0.6),
    square=metres(0.15),
    lowest=0.1,
    latency_s=0.2,
    ramp_up_per_s=0.1,
)
RULE = RuleCard(family=f"{LAW}, {TO_TCP}", levels=(0.1, 1.0), law=LAW_CARD, explained=0.999)


def test_a_law_answers_and_its_response_goes_with_it() -> None:
    safety = RuleSafety(RULE, TrainingCard())
    X = np.zeros((4, 6))
    X[:, 3] = [0.3, 0.8375, 1.25, 3.0]
    assert safety.predict(X) == pytest.approx([0.1, 0.5, 1.0, 1.0])
    dynamics = Dynamics.of(DynamicsCard(ramp_up_per_s=0.7, hysteresis_m=0.3), safety)
    assert dynamics == Dynamics(latency_s=0.2, ramp_up_per_s=0.1)
    follower = Follower(safety, dynamics, 0.1)
    way = [3.0, 0.8375, 0.8375, 0.8375, 3.0, 3.0, 3.0]
    found = [float(follower.advance(np.zeros((1, 3)), np.array([[x, 0.0, 0.0]]))[0]) for x in way]
    assert found == pytest.approx([1.0, 1.0, 1.0, 0.5, 0.5, 0.5, 0.505])
    assert isinstance(altered_safety(Change("more", dynamics={"hysteresis_m": 0.3}), safety, dynamics), LearnedSafety)


def test_a_law_is_kept_as_data_and_written_as_a_person_would() -> None:
    card = TrainingCard(rule=RULE)
    assert checked(plain(card), TrainingCard) == card
    said = "\n".join(rule_lines(RULE))
    for part in ("from 10 % to 100 %", "0.500 m (95 % CI 0.490 to 0.510 m) + 0.600 m", "speed 10 % nearer than 0.56"):
        assert part in said
    assert "full speed from 1.250 m" in said
    assert "reaction time 0.200 s; rate of change up 10 %/s" in said


@pytest.mark.parametrize("damage", [{"square": {"value": -1.0}}, {"ramp_up_per_s": 0.0}, {"distance": "by eye"}])
def test_a_damaged_law_is_refused(damage: dict[str, Any]) -> None:
    values: Any = plain(TrainingCard(rule=RULE))
    values["rule"]["law"] |= damage
    with pytest.raises(BadCard):
        checked(values, TrainingCard)


def test_a_rule_needs_limits_or_a_law() -> None:
    with pytest.raises(ValueError, match="either limits or a law"):
        structs.replace(RULE, law=None)


@pytest.mark.slow
def test_a_cell_with_a_law_is_trained_estimated_and_read_back(tmp_path: Path) -> None:
    simulated = IsoLaw("tcp", 1.2, 0.3, 6.0, 0.35, 1.2, 0.1)
    options = SimulationOptions(rule=Rule(law=simulated), latency_s=0.2, ramp_up_per_s=0.1, ramp_down_per_s=1.0)
    simulate("scanner-visits", tmp_path / "logs", executions=12, seed=4, options=options)
    ingest([tmp_path / "logs"], tmp_path / "dataset")
    dataset = Dataset.open(tmp_path / "dataset")
    spec = ModelSpec.of("now", epochs=3)
    model = train(dataset, spec, rules=True)
    assert model.network == "regressor"
    rule = model.card.rule
    assert rule is not None
    assert rule.law is not None
    assert rule.law.stop.value == pytest.approx(simulated.distance_m(0.0), abs=0.01)
    assert sum(shape_of(rule.law)[:3]) == pytest.approx(simulated.distance_m(1.0), abs=0.01)
    check = check_rollout(predictor_of(model), dataset, seed=0)
    assert abs(check.own_bias) < 0.01
    found = read_zones(model, dataset)
    assert found.rule_sentences[0].startswith("speed = the highest s from 10 % to 100 %")


def test_a_scaling_without_levels_and_without_law_is_learned_by_regression(tmp_path):
    """No rule on values that are no levels, though most samples are at full speed, and no error message."""
    dataset = fabricate_dataset(tmp_path / "dataset", executions=10, seed=1)
    held = np.random.default_rng(0).uniform(0.2, 0.9, 10_000)
    apart = sum(((pl.col(f"robot_{axis}_m") - pl.col(f"human_{axis}_m")) ** 2 for axis in "xyz"), pl.lit(0.0)).sqrt()
    for file in (dataset.path / "samples").glob("*.parquet"):
        rows = pl.read_parquet(file)
        values = held[(rows["t_s"].to_numpy() / 0.7).astype(np.int64)]
        near = pl.when(apart < 1.9).then(pl.Series(values)).otherwise(1.0)
        write_parquet(rows.with_columns(scaling=near), file)
    card = json.loads((dataset.path / CARD).read_text())
    (dataset.path / CARD).write_text(json.dumps({**card, "files": None}))
    changed = Dataset.open(dataset.path)
    spec = ModelSpec.of(epochs=4, batch=256)
    with pytest.raises(DatasetError, match="--network regressor"):
        train(changed, spec)
    model = train(changed, spec, rules=True)
    assert (model.network, model.card.rule) == ("regressor", None)
    assert any("follows no law of one distance; the network answers" in said for said in texts(model.card.warnings))
