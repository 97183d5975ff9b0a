"""What can fail early fails early: before the inputs are opened, so none of them exists here."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from cyclekit.storage.outputs import check_writable, check_writable_folder

if TYPE_CHECKING:
    from .conftest import Shell

OUTPUTS = {
    "estimate": (["estimate", "model", "s.toml", "--dataset", "data", "--out"], ".json"),
    "plan": (["plan", "model", "jobs.toml", "--dataset", "data", "--out"], ".toml"),
    "whatif": (["whatif", "model", "s.toml", "changes.toml", "--dataset", "data", "--out"], ".json"),
    "zones": (["zones", "model", "data", "--out"], ".svg"),
    "levels": (["levels", "data", "--picture"], ".png"),
    "replay": (["replay", "data", "--execution", "1", "--out"], ".rrd"),
    "export": (["export", "model", "--out"], ".onnx"),
    "convert": (["convert", "log.csv", "--out"], ".parquet"),
    "report": (["report", "data", "--out"], ".html"),
    "report --pdf": (["report", "data", "--out", "page.html", "--pdf"], ".pdf"),
    "train": (["train", "data", "--out"], ""),
    "simulate": (["simulate", "box-picking", "--out"], ""),
    "demo": (["demo", "--out"], ""),
}
FILES = [name for name, (_, ending) in OUTPUTS.items() if ending]


@pytest.fixture(autouse=True)
def _empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("name", OUTPUTS)
def test_a_place_that_cannot_be_written_is_refused_before_anything_is_opened(cyclekit: Shell, name: str):
    Path("file").write_text("in the way", encoding="utf-8")
    words, ending = OUTPUTS[name]
    place = Path("file") / "below" / f"result{ending}"
    failed = cyclekit(*words, place, "--quiet")  # a busy machine takes so long that progress is told
    assert failed.code == 1
    assert failed.err.startswith(f"error: {place}: cannot be written (")
    assert [path.name for path in Path().iterdir()] == ["file"]


@pytest.mark.parametrize("name", FILES)
def test_an_ending_that_is_not_known_is_refused_before_anything_is_opened(cyclekit: Shell, name: str):
    failed = cyclekit(*OUTPUTS[name][0], "result.xyz")
    assert failed.code in (1, 2)  # report has always called it a wrong command line
    assert "xyz" in failed.err
    assert not list(Path().iterdir())


@pytest.mark.parametrize("name", FILES)
def test_a_folder_where_a_file_is_to_be_written_is_refused_before_anything_is_opened(cyclekit: Shell, name: str):
    words, ending = OUTPUTS[name]
    place = Path(f"result{ending}")
    place.mkdir()
    failed = cyclekit(*words, place)
    assert failed.code == 1
    assert failed.err.startswith(f"error: {place}: is a folder")


def test_a_folder_that_is_no_model_is_refused_before_the_training(cyclekit: Shell, tmp_path: Path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine", encoding="utf-8")
    failed = cyclekit("train", "data", "--out", tmp_path / "mine")
    assert failed.code == 1
    assert "is no model of cyclekit's, so it is not replaced" in failed.err


@pytest.mark.parametrize("words", [["demo"], ["train", "data", "--out", "model"], ["fleet", "all", "fleet.toml"]])
def test_without_torch_what_trains_ends_before_it_begins(
    cyclekit: Shell, words: list[str], monkeypatch: pytest.MonkeyPatch
):
    Path("fleet.toml").write_text('[[cell]]\nname = "a"\nsources = ["logs"]\n', encoding="utf-8")
    monkeypatch.setitem(__import__("sys").modules, "torch", None)
    failed = cyclekit(*words)
    assert failed.code == 1
    assert failed.err.splitlines()[0].endswith(" needs torch: not installed")
    assert [path.name for path in Path().iterdir()] == ["fleet.toml"]


def test_a_pdf_without_a_browser_is_refused_before_the_page_is_made(cyclekit: Shell, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("cyclekit.report.pdf.find_browser", lambda: None)
    failed = cyclekit("report", "data", "--out", "page.html", "--pdf", "page.pdf")
    assert failed.err.startswith("error: no browser is installed")


def test_what_can_be_written_leaves_no_trace_of_the_look(tmp_path: Path):
    (tmp_path / "old.json").write_text("{}", encoding="utf-8")
    for place in (tmp_path / "new.JSON", tmp_path / "a" / "b" / "new.json", tmp_path / "old.json"):
        check_writable(place, (".json",))
    check_writable(None, (".json",))
    check_writable_folder(tmp_path / "a" / "b")
    check_writable_folder(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["old.json"]
