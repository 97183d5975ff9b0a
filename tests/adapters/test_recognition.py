"""Each log has one reader, and what is no log has none."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from tracker_logs import ALL_WRITERS

from cyclekit.ingest.registry import adapters

ROOT = Path(__file__).parents[2]
TEXTS = {".toml", ".md", ".py", ".json", ".csv", ".txt", ".yml", ".yaml", ".cff", ".html", ".css", ".js", ".svg"}


def readers(path):
    return [name for name, entry in adapters().items() if entry.adapter.recognises(path)]


@pytest.mark.parametrize(("name", "write"), ALL_WRITERS, ids=[write.__name__ for _, write in ALL_WRITERS])
@pytest.mark.parametrize("frames", [2, 40])
def test_a_log_has_exactly_one_reader(tmp_path, name, write, frames):
    path = write(tmp_path, frames)
    assert readers(path) == [name]


def test_nothing_of_this_repository_is_a_log_but_its_samples():
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False).stdout.split(
        "\n"
    )
    files = [ROOT / name for name in listed if Path(name).suffix in TEXTS or "." not in Path(name).name]
    if not any(file.is_file() for file in files):
        pytest.skip("no checkout")
    claimed = {str(file.relative_to(ROOT)): found for file in files if file.is_file() and (found := readers(file))}
    assert {name: found for name, found in claimed.items() if not name.startswith("sim_fixtures/data")} == {}


def test_folders_of_code_are_no_logs():
    assert [path for path in (ROOT, ROOT / "tests", ROOT / "cyclekit") if readers(path)] == []


@pytest.mark.parametrize(
    "text",
    [
        "a,b,c\n1,2,3\n",
        "time,price,volume\n1,2.5,100\n2,2.6,90\n",
        "id,name,date,value\n7,bolt,2024-05-01,3.5\n",
        '{"name": "x", "version": 1}',
        "[[1, 2], [3, 4]]",
        "1 2 3 4\n5 6 7 8\n",
        "0.1 0.2 0.3 0.4\n",
        "[]extra",
        "# a comment\n",
        "Trajectories of planets\n100\n",
    ],
)
def test_tables_and_documents_of_others_are_no_logs(tmp_path, text):
    path = tmp_path / "a.csv"
    path.write_text(text)
    assert readers(path) == []
