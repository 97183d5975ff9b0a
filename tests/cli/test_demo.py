"""The demo: everything that the two commands of the README promise, on a cell small enough for a test."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from cyclekit.cli.demo import SCENE, SEQUENCES, sequences_toml
from cyclekit.config.sequences import load_sequences
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit_sim import scene_places

if TYPE_CHECKING:
    from .conftest import Shell


@pytest.mark.usefixtures("words_only")
def test_the_demo_goes_the_whole_way_and_ends_with_a_table(
    cyclekit: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ModelSpec, "of", partial(ModelSpec.of, epochs=16))  # a training of two seconds
    out = tmp_path / "out"
    done = cyclekit("demo", "--out", out, "--executions", "6")
    assert done.code == 0, done.err
    made = {"replay.rrd", "report.html", "sequences.toml", "jobs.toml", "changes.toml", "estimates.json"}
    assert made <= {path.name for path in out.iterdir()}
    page = (out / "report.html").read_text(encoding="utf-8")
    told = " ".join(done.out.split())
    assert "The order found takes" in told
    assert "within the takt of 100 s" in told
    for promised in ("order found", "half as many visits", "m tighter"):
        assert promised in page
    found = json.loads((out / "estimates.json").read_text(encoding="utf-8"))["sequences"]
    assert {entry["name"] for entry in found} == set(SEQUENCES)
    assert all(entry["expected_s"] > entry["nominal_s"] > 0 for entry in found)
    wide = [line for line in done.out.splitlines() if len(line) > 60 and str(tmp_path) not in line]
    assert wide == []
    for name in SEQUENCES:
        assert sum(f". {name} " in line for line in done.out.splitlines()) == 1
    for entry in found:
        assert done.out.count(f"{entry['expected_low_s']:.1f} to {entry['expected_high_s']:.1f}") == 1
    command = next(line.split() for line in done.out.splitlines() if line.strip().startswith("cyclekit estimate"))
    assert cyclekit(*command[1:], "--json", "--quiet").document["sequences"] == found
    steps = [line for line in done.err.splitlines() if line.startswith("[")]
    assert [line[:5] for line in steps] == [f"[{number}/6]" for number in range(1, 7)]


def test_the_demo_s_sequences_visit_every_slot_of_the_cell_once(tmp_path: Path) -> None:
    slots = set(scene_places(SCENE)) - {"home", "conveyor"}
    (tmp_path / "s.toml").write_text(sequences_toml({"left_3->home", "right_2->home"}), encoding="utf-8")
    for sequence in load_sequences(tmp_path / "s.toml"):
        visited = [place for place in sequence.places if place in slots]
        assert sorted(visited) == sorted(slots)
        assert sequence.places[-2:] in {("left_3", "home"), ("right_2", "home")}


@pytest.mark.parametrize("logged", [set(), {"left_1->conveyor"}])
def test_where_nobody_saw_the_robot_go_home_the_sequences_end_at_their_last_slot(
    logged: set[str], tmp_path: Path
) -> None:
    (tmp_path / "s.toml").write_text(sequences_toml(logged), encoding="utf-8")
    assert all(sequence.places[-1] != "home" for sequence in load_sequences(tmp_path / "s.toml"))
