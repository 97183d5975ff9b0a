"""The paper's comparison: its floors against chance, its tables and figures, and that it goes on where it stopped."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.paper import Settings, benchmark_paper
from benchmarks.paper.__main__ import main
from benchmarks.paper.floors import bayes, plug_in
from benchmarks.paper.plan import FLOORS, PAPER, RIVALS_AHEAD, entries
from benchmarks.paper.rivals import predict_by
from benchmarks.paper.tables import BEGIN, END, markdown, put_into
from cyclekit.errors import ConfigError
from cyclekit.learning.windows import INPUTS, Samples

DISTANCE = {"kind": "DistanceStaircase", "levels": [0.0, 0.25, 0.5, 0.75, 1.0], "thresholds_m": [1.2, 1.5, 1.9, 2.4]}
ZONES = {
    "kind": "FloorZones",
    "levels": [0.0, 0.5, 0.75, 1.0],
    "zones": [
        {"name": "presence", "x_m": [-1.6, 2.6], "y_m": [-2.4, 2.4], "step": 2},
        {"name": "warning", "x_m": [-1.2, 1.7], "y_m": [-1.9, 1.7], "step": 1},
        {"name": "protective", "x_m": [-0.9, 1.1], "y_m": [-1.1, 1.4], "step": 0},
    ],
}


@pytest.mark.parametrize("safety", [DISTANCE, ZONES], ids=["distance", "zones"])
@pytest.mark.parametrize("delta_m", [0.02, 0.3])
def test_the_bayes_estimate_is_the_mean_of_the_true_staircase_over_the_noise(safety, delta_m):
    rng = np.random.default_rng(0)
    robot, human = rng.uniform(-0.5, 0.5, (40, 3)), rng.uniform(-2.7, 2.7, (40, 3))
    drawn = [plug_in(safety, robot, human + rng.normal(0, delta_m, human.shape)) for _ in range(4000)]
    assert bayes(safety, robot, human, delta_m) == pytest.approx(np.mean(drawn, axis=0), abs=0.035)


def test_without_noise_the_bayes_estimate_is_the_true_staircase():
    near, far = np.zeros((2, 3)), np.array([[1.2, 0, 0], [2.5, 0, 0]])
    assert bayes(DISTANCE, near, far, 0.0).tolist() == [0.0, 1.0]


def test_under_noise_the_bayes_estimate_is_the_better_of_the_two():
    rng = np.random.default_rng(1)
    robot, human = np.zeros((20_000, 3)), rng.uniform(-2.5, 2.5, (20_000, 3))
    seen = human + rng.normal(0, 0.05, human.shape)
    truth = plug_in(DISTANCE, robot, human)
    errors = [np.mean((p - truth) ** 2) for p in (bayes(DISTANCE, robot, seen, 0.05), plug_in(DISTANCE, robot, seen))]
    assert errors[0] < 0.8 * errors[1]


def test_the_plan_holds_every_network_of_the_paper_with_its_settings():
    plain = {(e.problem, e.delta_m, e.name) for e in entries() if not e.settings}
    assert set(PAPER) <= plain
    assert {e.name for e in entries() if not e.is_network} == {*FLOORS, *RIVALS_AHEAD}
    assert len({e.key for e in entries()}) == len(entries())


@pytest.fixture(scope="module")
def out(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("paper")


COMMAND = ("--executions", "10", "--seeds", "1", "--scenes", "box-picking", "--steps", "10")


@pytest.fixture(scope="module")
def table(out) -> str:
    for only in ("now_0s_0.02m_classifier_norm", "now_0s_0.02m_Bayes", "ahead_2s_0m_lstm-1_norm", "2s_0m_persistence"):
        assert main([*COMMAND, "--out", str(out), "--only", only]) == 0
    return (out / "tables.md").read_text()


@pytest.mark.slow
def test_the_command_writes_tables_and_figures(out, table):
    assert "### box-picking" in table
    results = [json.loads(file.read_text()) for file in (out / "results").iterdir()]
    assert len(results) == 4
    whole = markdown(sorted(results, key=lambda r: r["problem"]))
    assert "| Bayes estimate, flat prior |" in whole
    assert "| persistence |" in whole
    assert all(0 < r["mse"] < 0.3 and r["rows"] > 500 for r in results)
    assert (out / "figures" / "box-picking-ahead-2s-lstm-1-none-heatmap.svg").is_file()


@pytest.mark.slow
def test_it_goes_on_where_it_stopped(out, table):
    before = {file: file.stat().st_mtime_ns for file in (out / "results").iterdir()}
    assert main([*COMMAND, "--out", str(out), "--only", "now_0s_0.02m_Bayes"]) == 0
    assert {file: file.stat().st_mtime_ns for file in (out / "results").iterdir()} == before


@pytest.mark.slow
def test_tables_of_what_is_done_run_nothing(out, table):
    before = sorted(out.rglob("*.json"))
    assert main([*COMMAND, "--seeds", "1,2", "--out", str(out), "--done"]) == 0
    text = (out / "tables.md").read_text()
    assert "| persistence |" in text
    assert "| Bayes estimate, flat prior |" in text
    assert "seed 1;" in text
    assert sorted(out.rglob("*.json")) == before


@pytest.mark.slow
def test_a_result_that_is_missing_is_made_again_and_equal(out, table):
    file = next(f for f in (out / "results").iterdir() if "classifier" in f.name)
    old = json.loads(file.read_text())
    file.unlink()
    settings = Settings(10, (1,), ("box-picking",), 10, "now_0s_0.02m_classifier_norm")
    (new,), refused = benchmark_paper(
        settings, out, lambda _scene, _seed, folder: folder / "dataset", lambda _a, _b: None
    )
    assert new["mse"] == old["mse"]
    assert refused == []


@pytest.mark.slow
def test_a_training_that_fails_is_named_and_keeps_nothing_else_from_being_done(out, table, monkeypatch, capsys):
    wanted = [e for e in entries() if e.key in ("now_0s_0.02m_classifier_norm-none", "ahead_2s_0m_persistence")]
    network, rival = (out / "results" / f"box-picking_10_1_10_{entry.key}.json" for entry in wanted)
    kept = {file: file.read_bytes() for file in (network, rival)}
    network.unlink()
    rival.unlink()

    def fails(*_: object) -> None:
        raise ConfigError("it diverged", cure="Choose another --seed.")

    monkeypatch.setattr("benchmarks.paper.runs.train", fails)
    monkeypatch.setattr("benchmarks.paper.runs.entries", lambda: wanted)
    assert main([*COMMAND, "--out", str(out)]) != 0
    said = " ".join(capsys.readouterr().err.split())
    assert "box-picking, seed 1: now_0s_0.02m_classifier_norm-none: it diverged" in said
    assert rival.is_file()
    assert not network.exists()
    assert "| persistence |" in (out / "tables.md").read_text()
    for file, content in kept.items():
        file.write_bytes(content)


def test_the_table_takes_its_place_in_a_page_and_nothing_else(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    put_into(page, "| new |\n")
    put_into(page, "| newer |\n")
    text = page.read_text()
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "newer" in text
    assert "old" not in text
    page.write_text("no place")
    with pytest.raises(ConfigError, match="no place for the tables"):
        put_into(page, "x")


@pytest.mark.parametrize("name", ["distance staircase", "MLP"])
def test_a_rival_that_learns_beats_the_constant_mean(name):
    rng = np.random.default_rng(2)
    positions = rng.uniform([-0.5] * 3 + [-2.5] * 3, [0.5] * 3 + [2.5] * 3, (1500, 6)).astype(np.float32)
    truth = plug_in(DISTANCE, positions[:, :3].astype(float), positions[:, 3:].astype(float))
    nothing = np.zeros(1500, np.int64)
    weight = np.ones(1500, np.float32)
    rows = Samples(positions, nothing.astype(np.int32), truth, nothing, ("a",), truth, INPUTS["now"], weight)
    learn, judge = rows.where(np.arange(1500) < 1200), rows.where(np.arange(1500) >= 1200)
    predicted = predict_by(name, learn, judge, DISTANCE["levels"], judge.scaling)
    assert np.mean((predicted - judge.scaling) ** 2) < 0.5 * judge.scaling.var()


def test_spread_over_seeds_is_shown():
    base = {"scene": "laser-zones", "executions": 10, "rows": 5, "problem": "now", "horizon_s": 0.0, "delta_m": 0.0}
    base |= {"name": "persistence", "settings": [], "bias": 0.0}
    rows = [{**base, "seed": seed, "mse": mse} for seed, mse in ((1, 1e-4), (2, 3e-4))]
    assert "2.00 ± 1.41" in markdown(rows)


@pytest.mark.parametrize("words", [["--seeds", "one"], ["--scenes", "boxpicking"]])
def test_a_slip_in_seeds_or_scenes_is_refused(out, words):
    with pytest.raises(SystemExit) as left:
        main([*COMMAND, "--out", str(out), *words])
    assert left.value.code == 2
