"""The example notebooks run from beginning to end, and what they show is what they were saved with."""

from __future__ import annotations

from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[1] / "docs" / "notebooks").glob("*.ipynb"))


def pictures(cells):
    return [any("image/png" in out.get("data", {}) for out in cell.get("outputs", ())) for cell in cells]


@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
def test_a_saved_notebook_holds_its_pictures_and_no_place_of_a_machine(file):
    nbformat = pytest.importorskip("nbformat")
    book = nbformat.read(file, as_version=4)
    drawn = [".plot()" in cell.source for cell in book.cells]
    assert sum(drawn) >= 1
    assert pictures(book.cells) == drawn
    shown = [str(out.get("text", "")) + str(out.get("data", {}).get("text/html", "")) for cell in book.cells
             for out in cell.get("outputs", ())]  # fmt: skip
    assert not any(place in text for text in shown for place in ("/tmp", "/home", "/work", "C:\\", "Traceback"))


@pytest.mark.slow  # simulates, ingests and trains in a kernel of its own
@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
def test_a_notebook_runs_from_beginning_to_end(file, tmp_path):
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    book = nbformat.read(file, as_version=4)
    nbclient.NotebookClient(book, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert pictures(book.cells) == [".plot()" in cell.source for cell in book.cells]
