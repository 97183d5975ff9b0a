"""Warnings are codes with values; the sentence is made where it is shown, and datasets of sentences still open."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.dataset.cards import TEXT, Note, checked, note, plain
from cyclekit.dataset.cards.notes import SENTENCES, UNPROVEN, changed
from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.inspect.describe import describe

if TYPE_CHECKING:
    from collections.abc import Callable

SOURCE = Path(__file__).parents[2] / "cyclekit"
TRIP = [("stand", 0.5), ("move", 0.3), ("stand", 0.5), ("move", 0.0), ("stand", 0.5)]
SAID = "clock: the offset of its clock to the robot's is unknown"
VALUES = st.dictionaries(st.text(), st.text() | st.integers(-(2**53), 2**53) | st.floats(allow_nan=False))


def test_every_code_in_the_source_has_a_sentence_and_every_sentence_is_used() -> None:
    source = {file: file.read_text(encoding="utf-8") for file in SOURCE.rglob("*.py")}
    made = {UNPROVEN} | set(re.findall(r'(?:note|_warned)\(\s*"([a-z-]+)"', "".join(source.values())))
    assert made <= set(SENTENCES)
    chosen = set(
        re.findall(r'"([a-z]+-[a-z-]+)"', "".join(text for name, text in source.items() if name.name != "notes.py"))
    )
    assert set(SENTENCES) <= made | chosen | {"text", "read"}


@given(code=st.sampled_from(sorted(SENTENCES)) | st.text(), values=VALUES)
def test_a_note_of_any_card_is_one_sentence(code: str, values: dict[str, Any]) -> None:
    assert isinstance(Note(code, values).text, str)


@given(values=VALUES)
def test_a_note_is_read_as_it_was_written(values: dict[str, Any]) -> None:
    known = Note("clock-assumed", values)
    assert checked(json.loads(json.dumps(plain(known))), Note) == known


def test_a_number_that_was_taken_out_leaves_a_gap_in_the_sentence() -> None:
    late = note("clock-stamps-late", late_s=0.25)
    assert "typically 0.25 s later" in late.text
    assert "typically … s later" in changed(late, str.upper, lambda number: "…").text


@pytest.fixture
def logs(tmp_path: Path, robot_log: Callable[..., object]) -> Path:
    """A robot's log and events in another clock, of which nothing says how it relates."""
    robot_log(tmp_path / "logs" / "robot.csv", TRIP)
    (tmp_path / "logs" / "plc.csv").write_text("time_s,signal,value\n10,light,1\n11,light,0\n", encoding="utf-8")
    return tmp_path / "logs"


def as_an_earlier_version(path: Path) -> None:
    """Write the card as it was when warnings were sentences, those of the clock among those of the log."""
    card = json.loads((path / "dataset.json").read_text(encoding="utf-8"))
    del card["card_blake3"]
    known = {record.id: record for record in Dataset.open(path).recordings}
    card["warnings"] = []
    for record in card["recordings"]:
        record["warnings"] = known[record["id"]].said
        del record["clock"]["warnings"], record["listed"]
    (path / "dataset.json").write_text(json.dumps(card, indent=1) + "\n", encoding="utf-8")


def test_a_dataset_whose_warnings_are_sentences_opens_and_shows_them(logs: Path, tmp_path: Path) -> None:
    out = ingest([logs], tmp_path / "dataset").dataset
    shown = [text for text in describe(out).warnings if SAID in text]  # type: ignore[union-attr]
    assert len(shown) == 1
    as_an_earlier_version(out)
    assert [text for text in describe(out).warnings if SAID in text] == shown  # type: ignore[union-attr]
    codes = [one.code for record in Dataset.open(out).recordings for one in record.warnings]
    assert set(codes) == {TEXT}


def test_logs_of_such_a_dataset_are_read_again_where_their_warnings_may_be_others(logs: Path, tmp_path: Path) -> None:
    out = ingest([logs], tmp_path / "dataset").dataset
    as_an_earlier_version(out)
    again = ingest([logs], out, rate_hz=5.0)
    assert len([text for text in again.warnings if SAID in text]) == 1


def test_a_log_called_like_a_word_of_a_warning_changes_no_warning(logs: Path, tmp_path: Path) -> None:
    hidden = ingest([logs], tmp_path / "hidden", pseudonymise=True)
    assert [text for text in hidden.warnings if SAID in text]
