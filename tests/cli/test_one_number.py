"""One question has one number: whoever is asked how long a sequence takes says the same."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import cyclekit as library
from cyclekit.cli import demo
from cyclekit.cli.terminal import Terminal
from cyclekit.dataset.cards import CellLedger
from cyclekit.fleet import stages
from cyclekit.fleet.read import FleetCell

if TYPE_CHECKING:
    from cyclekit.estimate.answers import CycleEstimates

    from .conftest import Shell

CHANGE = '[[change]]\nname = "small"\nlevels = [0.0, 0.25, 0.5, 0.75, 1.0]\nthresholds_m = [0.6, 0.8, 1.2, 1.6]\n'


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("one")
    (made / "changes.toml").write_text(CHANGE, encoding="utf-8")
    return made


@pytest.fixture(scope="module")
def slow(model: Path, folder: Path) -> Path:
    """The model with every level 4 % too slow: its bias is no chance, so what corrects it shows in every number."""
    learned = library.load_model(model)
    library.save_model(folder / "model", replace(learned, levels=tuple(0.96 * level for level in learned.levels)))
    return folder / "model"


@pytest.fixture
def planned(slow: Path, dataset: Path, jobs: Path, folder: Path, cyclekit: Shell) -> tuple[Path, dict]:
    """The planned order as a sequence file, and what `plan` says of it; planned once."""
    file, said = folder / "planned.toml", folder / "planned.json"
    if not said.exists():
        typed = cyclekit("plan", slow, jobs, "--dataset", dataset, "--out", file, "--json", "--quiet")
        assert typed.code == 0, typed.err
        said.write_text(typed.out, encoding="utf-8")
    return file, json.loads(said.read_text(encoding="utf-8"))


def test_every_command_the_fleet_and_python_say_the_same(
    slow: Path,
    dataset: Path,
    jobs: Path,
    folder: Path,
    planned: tuple[Path, dict],
    cyclekit: Shell,
    monkeypatch: pytest.MonkeyPatch,
):
    file, plan = planned
    more = ("--dataset", dataset, "--json", "--quiet")
    (estimated,) = cyclekit("estimate", slow, file, *more).document["sequences"]
    (tried,) = cyclekit("whatif", slow, file, folder / "changes.toml", *more).document["answers"]
    asked = ("--sequences", file, "--plan", jobs, "--what-if", folder / "changes.toml", "--quiet")
    assert cyclekit("report", dataset, "--model", slow, *asked, "--out", folder / "page.json").code == 0
    page = json.loads((folder / "page.json").read_text(encoding="utf-8"))
    logs, learned = library.Dataset.open(dataset), library.load_model(slow)
    (python,) = library.estimate_cycles(learned, logs, library.load_sequences(file))
    monkeypatch.setattr(demo, "sequences_toml", lambda _: file.read_text(encoding="utf-8"))
    (shown,) = demo._estimates(demo._Run(Terminal(json=False, quiet=True), folder), logs, learned)
    numbers = {
        "plan": plan["expected_s"],
        "what-if": tried["before"]["expected_s"],
        "page": page["sequences"][0]["expected_s"],
        "page, planned": page["plan"]["expected_s"],
        "python": python.expected_s,
        "demo": shown.expected_s,
        "fleet": by_the_fleet(dataset, slow, file, monkeypatch),
    }
    assert python.check is not None
    assert python.check.factor < 0.99, "the bias of this model shows in the numbers"
    (on_page,) = page["what_if"]
    assert (on_page["expected_s"], on_page["saves_s"]) == (tried["after"]["expected_s"], tried["saves_s"])
    assert numbers == dict.fromkeys(numbers, estimated["expected_s"])


def by_the_fleet(dataset: Path, model: Path, file: Path, monkeypatch: pytest.MonkeyPatch) -> float:
    """Return what the page of a fleet's cell is given."""
    given: list[float] = []
    monkeypatch.setattr(stages, "dataset_of", lambda _: library.Dataset.open(dataset))

    class Enough(Exception):
        """The page itself is the business of other tests."""

    def compose_report(*_: object, estimates: CycleEstimates, check: object, **__: object) -> None:
        assert check is estimates.check
        given.extend(each.expected_s for each in estimates)
        raise Enough

    monkeypatch.setattr("cyclekit.api.report.compose_report", compose_report)
    cell = FleetCell("cell", (), str(model.parent), sequences=str(file))
    with pytest.raises(Enough):
        stages._report(stages.CellAtWork(cell, CellLedger(cell="cell")))
    return given[0]


def test_what_a_plan_saves_is_the_difference_of_estimates(planned: tuple[Path, dict], folder: Path):
    _, plan = planned
    assert plan["against_s"] - plan["expected_s"] == pytest.approx(plan["saves_s"][0])
    assert plan["expected_low_s"] < plan["expected_s"] < plan["expected_high_s"]
    page = json.loads((folder / "page.json").read_text(encoding="utf-8"))
    assert page["plan"]["saves_s"] == plan["saves_s"]
    best, today = page["verdict"]["best"], page["verdict"]["today"]
    assert best["expected_s"] == plan["expected_s"]
    assert best["saves_s"] == (None if today is None else pytest.approx(plan["saves_s"][0]))
