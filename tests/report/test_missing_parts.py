from __future__ import annotations

import json
import shutil

import polars as pl
import pytest
from report_pages import DistanceModel, Page

from cyclekit.dataset.dataset import CARD, Dataset
from cyclekit.report import compose_report
from cyclekit.storage.atomic import write_parquet


@pytest.mark.parametrize(
    ("absent", "sentence"),
    [
        (["scaling", "scaling_origin", "step"], "Speed scaling is unknown in these logs"),
        ([f"human_{axis}_m" for axis in "xyz"], "The logs hold no operator position"),
        ([f"robot_{axis}_m" for axis in "xyz"], "Too few samples"),
        (["robot_moving", "robot_task", "human_task", "step"], "No sequence was estimated"),
    ],
)
def test_what_the_logs_lack_is_said_on_the_page(dataset, tmp_path, absent, sentence):
    path = tmp_path / "poor"
    shutil.copytree(dataset.path, path)
    for file in (path / "samples").glob("*.parquet"):
        rows = pl.read_parquet(file)
        write_parquet(rows.with_columns(pl.lit(None).cast(rows.schema[c]).alias(c) for c in absent), file)
    facts = compose_report(Dataset.open(path), None, tmp_path / "r.html")
    page = Page(facts.path.read_text("utf-8"))
    assert page.faults == []
    assert sentence in page.text
    assert "No model was given" in page.text


def test_a_tracker_alone_shows_where_people_were_and_no_robot(dataset, tmp_path):
    path = tmp_path / "tracker"
    shutil.copytree(dataset.path, path)
    for file in (path / "samples").glob("*.parquet"):
        rows = pl.read_parquet(file)
        gone = [name for name in rows.columns if name.startswith(("robot_", "scaling"))] + ["step"]
        write_parquet(rows.with_columns(pl.lit(None).cast(rows.schema[c]).alias(c) for c in gone), file)
    facts = compose_report(Dataset.open(path), None, tmp_path / "r.html")
    page = Page(facts.path.read_text("utf-8"))
    assert any("The logs hold no robot" in text for text in facts.missing)
    assert "Operator positions while the robot was slowed" not in page.text
    assert "Operator positions" in page.text
    (floor,) = [words for words in facts.path.read_text("utf-8").split("<figure>")[1:] if "Floor plan" in words]
    assert ">robot<" not in floor
    assert "robot speed" not in floor


def test_a_dataset_without_tasks_executions_or_provenance_still_gives_a_page(dataset, tmp_path):
    path = tmp_path / "bare"
    shutil.copytree(dataset.path, path)
    card = json.loads((path / CARD).read_text())
    bare = {key: card[key] for key in ("schema_version", "name", "rows", "places", "human_places")}
    (path / CARD).write_text(json.dumps({**bare, "executions": [], "levels": [], "recordings": []}))
    write_parquet(pl.read_parquet(path / "tasks.parquet").head(0), path / "tasks.parquet")
    for file in (path / "samples").glob("*.parquet"):
        write_parquet(pl.read_parquet(file).head(0), file)
    facts = compose_report(Dataset.open(path), DistanceModel(), tmp_path / "r.html")
    assert "no complete execution" in facts.headline
    assert facts.pictures == 0


@pytest.mark.usefixtures("words_only")
def test_provenance_is_put_together_where_alike_and_counted(dataset, tmp_path):
    path = tmp_path / "many"
    shutil.copytree(dataset.path, path)
    card = json.loads((path / CARD).read_text())
    record = {
        "id": "r",
        "session": "session-1",
        "tables": ["robot"],
        "adapter": "ur-rtde",
        "adapter_package": "cyclekit",
        "adapter_version": "0.1.0",
        "sources": [{"path": "run.csv", "sha256": "ab" * 32, "size": 3}],
        "clock": {"kind": "uptime", "method": "own", "offset_s": 0.0, "rate": 1.0},
        "frame": {"method": "robot base"},
        **{"up": "z", "joint_names": [], "facts": {}, "key": "", "rows": {"robot": 998}, "rows_are": "row"},
        "rows_read": 1000,
        "rows_set_aside": [{"reason": "time goes back", "count": 2}],
        **{"rate_hz": 125.0, "first_s": 0.0, "last_s": 8.0, "duration_s": 8.0},
        "warnings": ["Scaling is null while the program is paused."],
    }
    card["recordings"] = [{**record, "id": f"r{n}"} for n in range(40)]
    card["not_read"] = [{"path": "notes.txt", "reason": "no adapter recognises this content"}]
    (path / CARD).write_text(json.dumps(card))
    text = Page(compose_report(Dataset.open(path), None, tmp_path / "r.html").path.read_text("utf-8")).text
    assert "time goes back 80" in text
    assert "Scaling is null while the program is paused. (40 recordings)" in text
    assert "28 more are in dataset.json." in text
    assert "notes.txt" in text
    assert text.count("ur-rtde (cyclekit 0.1.0)") == 1
