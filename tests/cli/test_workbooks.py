"""Results as Excel workbooks: the four sheets, and names out of logs that stay texts."""

from __future__ import annotations

import math
import re
import sys
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

import fastexcel
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.errors import CyclekitError, MissingExtra
from cyclekit.storage.workbook import write_workbook

if TYPE_CHECKING:
    from .conftest import Shell

SHEETS = ["answer", "tasks", "levels", "provenance"]
EVIL = [
    "=1+1",
    "=cmd|' /C calc'!A0",
    "+1+1",
    "-2+3",
    "@SUM(A1)",
    "\t=1",
    "http://example.test/x",
    "{=1}",
    "1e5",
    "{=A1}",
]


def rows_of(file: Path, sheet: str) -> list[dict[str, object]]:
    return fastexcel.read_excel(str(file)).load_sheet(sheet).to_polars().to_dicts()


def test_a_text_is_never_a_formula_a_link_or_a_number(tmp_path: Path) -> None:
    file = tmp_path / "x.xlsx"
    write_workbook(file, {"answer": [["what"], *([text] for text in EVIL)]})
    with zipfile.ZipFile(file) as packed:
        sheet = packed.read("xl/worksheets/sheet1.xml").decode()
        styles = packed.read("xl/styles.xml").decode()
        assert "<f>" not in sheet
        assert "hyperlink" not in sheet
        assert sheet.count('t="s"') == len(EVIL) + 1
        assert 'quotePrefix="1"' in styles  # so that a cell that is typed into again stays a text
        assert not any("externalLink" in name or "vba" in name for name in packed.namelist())
    read = [row["what"] for row in rows_of(file, "answer")]
    assert read == [text.replace("\t", "\\t") for text in EVIL]


def test_a_number_shows_three_decimals_and_holds_them_all(tmp_path: Path) -> None:
    file = tmp_path / "x.xlsx"
    write_workbook(file, {"answer": [["s"], [94.44398712345], [40], [95.0], [-0.00001]]})
    assert [row["s"] for row in rows_of(file, "answer")] == [94.44398712345, 40, 95.0, -0.00001]
    with zipfile.ZipFile(file) as packed:
        assert 'formatCode="0.000"' in packed.read("xl/styles.xml").decode()
        cells = re.findall(r'<c r="A\d"( s="\d")?><v>', packed.read("xl/worksheets/sheet1.xml").decode())
    assert [bool(cell) for cell in cells] == [True, False, False, False]


VALUES = st.one_of(st.floats(), st.integers(-(2**50), 2**50), st.booleans(), st.text(max_size=30))


@given(values=st.lists(VALUES, max_size=8))
def test_values_come_back(values: list[object], tmp_path_factory: pytest.TempPathFactory) -> None:
    file = tmp_path_factory.mktemp("book") / "x.xlsx"
    write_workbook(file, {"answer": [["value", "end"], *([value, "end"] for value in values)]})
    rows = rows_of(file, "answer")
    assert len(rows) == len(values)
    for row, value in zip(rows, values, strict=True):
        if isinstance(value, float) and not math.isfinite(value):
            assert row["value"] is None


def test_a_workbook_that_cannot_be_finished_leaves_the_old_one(tmp_path: Path) -> None:
    file = tmp_path / "x.xlsx"
    write_workbook(file, {"answer": [["a"]]})
    before = file.read_bytes()
    with pytest.raises(Exception, match="sheetname"):
        write_workbook(file, {"answer": [["b"]], "no [such] name": [["c"]]})
    assert file.read_bytes() == before
    assert [each.name for each in tmp_path.iterdir() if each.suffix == ".xlsx"] == ["x.xlsx"]
    with pytest.raises(CyclekitError):
        write_workbook(tmp_path / "x.xlsx" / "y.xlsx", {"answer": [["b"]]})


def test_estimate_plan_and_report_write_the_four_sheets(
    model: Path, dataset: Path, sequences: Path, jobs: Path, cyclekit: Shell, tmp_path: Path
) -> None:
    asked, file = ["--dataset", dataset, "--no-check", "--quiet"], tmp_path / "e.xlsx"
    typed = cyclekit("estimate", model, sequences, *asked, "--takt", "1h", "--json", "--out", file)
    assert typed.code == 0, typed.err
    assert fastexcel.read_excel(str(file)).sheet_names == ["light", *SHEETS]
    told = {one["name"]: one for one in typed.document["sequences"]}
    for row in rows_of(file, "answer"):
        assert row["expected_s"] == pytest.approx(told[row["name"]]["expected_s"])
        assert row["within_takt"] == 1.0
    tasks = rows_of(file, "tasks")
    assert len(tasks) == sum(len(one["tasks"]) for one in told.values())
    assert sum(row["expected_s"] for row in tasks) == pytest.approx(sum(one["expected_s"] for one in told.values()))
    assert {row["what"]: row["value"] for row in rows_of(file, "provenance")}["executions"] == "6"
    assert cyclekit("plan", model, jobs, *asked, "--out", tmp_path / "p.xlsx").code == 0
    assert fastexcel.read_excel(str(tmp_path / "p.xlsx")).sheet_names == ["light", *SHEETS]
    assert cyclekit("report", dataset, "--out", tmp_path / "r.xlsx", "--quiet").code == 0
    assert len(rows_of(tmp_path / "r.xlsx", "answer")) == 6


def test_a_workbook_of_others_is_not_replaced(
    model: Path, dataset: Path, sequences: Path, cyclekit: Shell, tmp_path: Path
) -> None:
    from xlsxwriter import Workbook

    file = tmp_path / "mine.xlsx"
    book = Workbook(str(file))
    book.add_worksheet()
    book.close()
    before = file.read_bytes()
    for content in (before, b"PK\x03\x04 no workbook", before[: len(before) // 2]):
        file.write_bytes(content)
        typed = cyclekit("estimate", model, sequences, "--dataset", dataset, "--no-check", "--quiet", "--out", file)
        assert typed.code == 1
        assert "no workbook of cyclekit's" in typed.err
        assert file.read_bytes() == content


def test_without_the_extra_the_command_that_installs_it_is_named(
    model: Path, dataset: Path, sequences: Path, cyclekit: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "xlsxwriter", None)
    for words in (["estimate", model, sequences, "--dataset", dataset], ["report", dataset]):
        typed = cyclekit(*words, "--out", tmp_path / "x.xlsx")
        assert typed.code == 1
        assert 'pip install "cyclekit[excel]"' in typed.err
    with pytest.raises(MissingExtra):
        write_workbook(tmp_path / "x.xlsx", {})
    assert list(tmp_path.iterdir()) == []


def test_a_place_is_shown_by_its_label(dataset: Path) -> None:
    from dataclasses import replace

    from msgspec import structs

    from cyclekit.api.workbooks import sheets_of_logs
    from cyclekit.config import NamedPlace
    from cyclekit.dataset.dataset import Dataset

    opened = Dataset.open(dataset)
    named = {"conveyor": NamedPlace((0.0, 0.0, 0.0), label="Conveyor, east end"), "home": NamedPlace((0.0, 0.0, 0.0))}
    opened.card = structs.replace(opened.card, settings=replace(opened.card.settings, places=named))
    assert opened.label("conveyor") == "Conveyor, east end"
    assert opened.task_label("home->conveyor") == "home->Conveyor, east end"
    assert opened.label("nowhere") == "nowhere"
    assert sheets_of_logs(opened)["provenance"][0] == ["what", "value"]


def test_a_label_is_read_from_the_cell_file_and_written_again(tmp_path: Path) -> None:
    from cyclekit.config import cell_to_toml, load_cell

    file = tmp_path / "cell.toml"
    file.write_text('[places.left_2]\nxyz_m = [0, 0, 0]\nlabel = "Left table, slot 2"\n', encoding="utf-8")
    cell = load_cell(file)
    assert cell.places["left_2"].label == "Left table, slot 2"
    file.write_text(cell_to_toml(cell), encoding="utf-8")
    assert load_cell(file).places == cell.places
