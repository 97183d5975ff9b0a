"""The gate: exit code 0 if enough cycles are within the takt, 1 if not, 2 with each cause for which nobody can tell."""

from __future__ import annotations

import json
import shutil
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ingested import without_checksums

from cyclekit.api.gate import GateVerdict
from cyclekit.estimate.answers import CycleEstimates
from cyclekit.estimate.finding import Finding
from cyclekit.estimate.result import CycleEstimate
from cyclekit.estimate.statistics.distribution import CycleDistribution
from cyclekit.estimate.validation.check import Check

if TYPE_CHECKING:
    from pathlib import Path

    from .conftest import Shell, Typed

SURELY = ("--takt", "1h", "--share", "0.5", "--json", "--quiet")
"""A takt that every cycle keeps: only a cause for which the number cannot be trusted is left."""


@pytest.fixture
def copied(dataset: Path, tmp_path: Path) -> Path:
    """A dataset of which a test may change the card."""
    return without_checksums(shutil.copytree(dataset, tmp_path / "dataset"))


def edited(dataset: Path, **people: dict[str, object]) -> None:
    """Change how clock and frame of the tracker's logs were found; the slow-downs confirm nothing."""
    file = dataset / "dataset.json"
    card = json.loads(file.read_text(encoding="utf-8"))
    card["dynamics"] = {"changes": 300, "spread_m": 0.3}
    for one in card["recordings"]:
        for part, values in people.items() if "people" in one["tables"] else ():
            one[part] |= values
    file.write_text(json.dumps(card), encoding="utf-8")


def checked_on(executions: int, bias: float, coverage: float) -> Check:
    """What the comparison with that many logged executions found."""
    return Check(
        executions, 0, bias, 0.001, bias, 0.0, tuple(np.linspace(-0.01, 0.01, executions)), coverage, None, (0.05, 0.95)
    )


@pytest.fixture
def found_good(monkeypatch: pytest.MonkeyPatch) -> None:
    """The comparison with the logged executions finds nothing to say; six of them would be too few to tell."""
    monkeypatch.setattr("cyclekit.estimate.limits.check_rollout", lambda *_, **__: checked_on(40, 0.0, 0.9))


@pytest.fixture
def asked(model: Path, copied: Path, sequences: Path, cyclekit: Shell) -> Any:
    """Ask the gate about the copied dataset."""

    def typed(*words: str | Path, file: Path = sequences) -> Typed:
        return cyclekit("gate", model, file, "--dataset", copied, *words)

    return typed


def said(typed: Typed) -> str:
    """What the document says of an unknown verdict; the warnings and the reasons say the same."""
    assert typed.code == 2, typed.out + typed.err
    assert (typed.document["answer"], typed.document["passed"], typed.document["level"]) == ("unknown", False, "red")
    (why,) = typed.document["why"]
    assert why in typed.document["warnings"]
    return str(why)


@pytest.mark.usefixtures("found_good")
def test_it_passes_with_0_and_fails_with_1_where_the_basis_is_sound(asked: Any) -> None:
    passed, failed = asked(*SURELY), asked("--takt", "1s", "--json", "--quiet")
    assert (passed.code, passed.document["answer"], passed.document["why"]) == (0, "passed", [])
    assert (failed.code, failed.document["answer"]) == (1, "failed")


@pytest.mark.usefixtures("found_good")
def test_it_cannot_tell_where_the_clock_is_only_assumed(asked: Any, copied: Path) -> None:
    edited(copied, clock={"method": "assumed-common-start", "test": None})
    text = said(asked(*SURELY))
    assert "assumed to start together" in text
    assert "--align-clocks logs" in text


@pytest.mark.usefixtures("found_good")
def test_it_cannot_tell_where_the_pose_is_only_assumed(asked: Any, copied: Path) -> None:
    given = {"method": "event-pairs"}
    edited(copied, clock=given, frame={"method": "assumed base frame", "xyz_m": None, "rotation": None}, facts={})
    text = said(asked(*SURELY, "--other-cell"))
    assert "the tracker's pose is not given" in text
    assert "give frame in the cell file" in text


@pytest.mark.parametrize(("bias", "coverage", "told"), [(0.0, 0.6, "only 60 %"), (0.05, 0.9, "bias +5.0 %")])
def test_it_cannot_tell_where_the_backtest_says_that_the_model_is_wrong(
    bias: float, coverage: float, told: str, asked: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cyclekit.estimate.limits.check_rollout", lambda *_, **__: checked_on(40, bias, coverage))
    text = said(asked(*SURELY))
    assert told in text
    assert "cyclekit inspect" in text


@pytest.mark.usefixtures("found_good")
def test_it_cannot_tell_where_most_of_the_cycle_was_never_logged(asked: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("limits", "soundness", "entry"):  # as if no logged position were near enough
        monkeypatch.setattr(f"cyclekit.estimate.{module}.MIN_SUPPORT", 1.1)
    refused = asked(*SURELY)
    assert (refused.code, refused.document["error"]["kind"]) == (2, "EstimateError")
    text = said(asked(*SURELY, "--extrapolate"))
    assert text.startswith("EXTRAPOLATED")
    assert "log this part of the cell" in text


def test_few_executions_do_not_show_a_share(asked: Any) -> None:
    unknown = asked("--json", "--quiet", "--takt", "1h")  # six do not show 95 %
    assert unknown.code == 2, unknown.err
    assert (unknown.document["answer"], unknown.document["passed"]) == ("unknown", False)
    assert {one["at_most"] for one in unknown.document["sequences"]} == {1.0}
    assert all(0.5 < one["at_least"] < 0.95 for one in unknown.document["sequences"])
    assert any("log more executions" in text for text in unknown.document["why"])
    assert {one["level"] for one in unknown.document["findings"]} >= {"amber"}
    failed = asked("--no-check", "--quiet", "--takt", "1s", "--sequence", "one way")
    assert failed.code == 1
    assert failed.out.startswith("failed: 0.0 % of the cycles of 'one way' are within 1 s")
    old = asked("--takt", "1h", "--confidence", "0.9")
    assert old.code == 2
    assert "--share" in old.err


@pytest.mark.parametrize(
    "words", [["--takt", "soon"], ["--takt", "9s", "--share", "95"], ["--takt", "9s", "--sequence", "other"], []]
)
def test_it_ends_with_2_where_it_cannot_be_asked(
    words: list[str], model: Path, dataset: Path, sequences: Path, cyclekit: Shell, tmp_path: Path
) -> None:
    assert cyclekit("gate", model, sequences, "--dataset", dataset, "--no-check", *words).code == 2
    assert cyclekit("gate", tmp_path / "none", sequences, "--dataset", dataset, "--takt", "9s").code == 2


def test_it_cannot_tell_where_nothing_shows_who_moves_the_slider(asked: Any, copied: Path) -> None:
    file = copied / "dataset.json"
    card = json.loads(file.read_text(encoding="utf-8"))
    values = {"turns": 40, "hours": 1.0, "sliders": "", "share": 0.3}
    card["warnings"].append({"code": "override-unknown", "values": values})
    file.write_text(json.dumps(card), encoding="utf-8")
    told = asked("--takt", "1h", "--share", "0.01", "--confidence", "0.5")
    assert told.code == 2
    assert 'set_override = "people"' in told.err


def judged(takt_s: float, *findings: Finding, confidence: float = 0.95, executions: int = 100) -> GateVerdict:
    """What the gate says of cycles of 9 to 10 s, if 0.8 of them must be within the takt."""
    zero = dict.fromkeys(("expected_low_s", "expected_high_s", "safety_loss_s", "dwell_s", "wait_s"), 0.0)
    one = CycleEstimate(
        name="a", places=("x", "y"), expected_s=9.5, support=1.0, tracks=1, limits=(), tasks=(), nominal_s=5.0,
        distribution=CycleDistribution(np.linspace(9.0, 10.0, 101), executions=executions),
        safety_by_activity_s={}, durations_s=(), executions=executions, findings=findings, **zero,
    )  # fmt: skip
    return GateVerdict(takt_s, 0.8, confidence, CycleEstimates((one,)))


GREEN, AMBER, RED = (
    Finding("bias", "green", "none"),
    Finding("bias", "amber", "some"),
    Finding("clock", "red", "assumed"),
)


@pytest.mark.parametrize(
    ("takt_s", "findings", "answer"),
    [
        (9.95, (GREEN, AMBER), "passed"),  # what is covered by the interval is in the verdict
        (9.5, (GREEN,), "failed"),
        (9.8, (GREEN,), "unknown"),  # too close to tell
        (9.95, (RED,), "unknown"),
        (9.5, (RED,), "unknown"),
        (4.9, (RED,), "failed"),  # the motion alone takes longer
        (9.95, (Finding("support", "amber", "far", covered=False),), "unknown"),
    ],
)
def test_it_passes_and_fails_only_what_is_known(takt_s: float, findings: Any, answer: str) -> None:
    found = judged(takt_s, *findings)
    assert found.answer == answer
    assert bool(found) is found.passed is (answer == "passed")
    assert found.exit_code == {"passed": 0, "failed": 1, "unknown": 2}[answer]
    assert bool(found.to_dict()["why"]) is (answer == "unknown")


def test_at_a_confidence_of_one_half_the_best_estimate_decides() -> None:
    assert [judged(at_s, confidence=0.5).answer for at_s in (9.79, 9.82)] == ["failed", "passed"]
    assert judged(9.9, executions=20).answer == "unknown"


@given(takt_s=st.floats(8.0, 11.0), executions=st.integers(1, 40))
def test_an_interval_holds_its_share_and_has_a_width(takt_s: float, executions: int) -> None:
    (row,) = judged(takt_s, executions=executions).to_dict()["sequences"]
    assert row["at_least"] <= row["share"] <= row["at_most"]
    assert row["at_most"] - row["at_least"] > 0.02
