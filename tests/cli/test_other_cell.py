"""A dataset of another cell than the model's is refused by every command that takes both, before anything is read."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from cyclekit import Dataset, load_model, save_model
from cyclekit.fleet import stages

if TYPE_CHECKING:
    from .conftest import Shell


@pytest.fixture
def elsewhere(dataset: Path, tmp_path: Path) -> Path:
    """What another cell says of itself: other logs, and every place 0.3 m farther."""
    card = json.loads((dataset / "dataset.json").read_text(encoding="utf-8"))
    for number, record in enumerate(card["recordings"]):
        for source in record["sources"]:
            source["blake3"] = f"{number:064x}"
    for place in card["places"].values():
        place["xyz_m"][0] += 0.3
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / "dataset.json").write_text(json.dumps({**card, "files": None, "card_blake3": None}), encoding="utf-8")
    return folder


@pytest.mark.parametrize(
    "words",
    [
        "estimate MODEL SEQUENCES --dataset ELSEWHERE --out OUT.json",
        "plan MODEL JOBS --dataset ELSEWHERE --out OUT.toml",
        "whatif MODEL SEQUENCES CHANGES --dataset ELSEWHERE --out OUT.json",
        "report ELSEWHERE --model MODEL --sequences SEQUENCES --out OUT.html",
        "zones MODEL ELSEWHERE --out OUT.svg",
        "evaluate MODEL ELSEWHERE",
        "replay ELSEWHERE --execution 1 --model MODEL --out OUT.rrd",
    ],
    ids=lambda words: words.split()[0],
)
def test_every_command_refuses_it_and_names_the_flag(
    words: str,
    model: Path,
    elsewhere: Path,
    sequences: Path,
    jobs: Path,
    tmp_path: Path,
    cyclekit: Shell,
):
    changes = tmp_path / "changes.toml"
    changes.write_text('[[change]]\nname = "seldom"\nfrequency = 0.9\n', encoding="utf-8")
    stand_for = {"MODEL": model, "ELSEWHERE": elsewhere, "SEQUENCES": sequences, "JOBS": jobs, "CHANGES": changes}
    typed = cyclekit(*(stand_for.get(w, tmp_path / w if w.startswith("OUT") else w) for w in words.split()))
    assert typed.code == 1
    assert "not the cell" in typed.err
    assert "places are not where they were in training" in typed.err
    assert "--other-cell" in typed.err
    assert not list(tmp_path.glob("OUT*"))
    assert "--other-cell" in cyclekit(words.split()[0], "--help").out


def test_a_large_bias_stands_above_the_numbers_and_in_the_json(
    model: Path, dataset: Path, sequences: Path, tmp_path: Path, cyclekit: Shell
):
    learned = load_model(model)
    save_model(tmp_path / "slow", replace(learned, levels=tuple(0.6 * level for level in learned.levels)))
    words = ("estimate", tmp_path / "slow", sequences, "--dataset", dataset, "--extrapolate", "--other-cell", "--quiet")
    typed = cyclekit(*words, "--json")
    assert typed.code == 0, typed.err
    assert typed.document["warnings"][0].startswith("backtest with their own operators: bias +")
    assert [one["level"] for one in typed.document["findings"] if one["code"] == "bias"] == ["red"]
    shown = cyclekit(*words).out
    above = " ".join(shown.split("seconds:")[0].split())
    assert "bias: backtest with their own operators: bias +" in above
    assert " s RED" in shown


def test_with_trained_on_two_datasets_are_compared_whatever_has_changed(
    model: Path, dataset: Path, elsewhere: Path, cyclekit: Shell
):
    shutil.copytree(dataset / "samples", elsewhere / "samples")
    typed = cyclekit("evaluate", model, elsewhere, "--trained-on", dataset, "--quiet")
    assert typed.code == 0, typed.err
    assert "the safety function: " in typed.out


def test_a_fleet_trains_again_where_the_cell_is_another_one(model: Path, dataset: Path, elsewhere: Path):
    learned = load_model(model)
    assert stages._still_good(learned, Dataset.open(dataset)) == "trained on these logs"
    assert stages._still_good(learned, Dataset.open(elsewhere)) is None
