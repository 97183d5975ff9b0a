"""No command writes over what it reads, nor over what cyclekit did not write; devices and pipes are written into."""

from __future__ import annotations

import os
import shutil
import threading
from pathlib import Path
from typing import Any

import pytest
from fabricated import fabricate_dataset

from cyclekit.cli import run
from cyclekit.dataset.guard import check_output
from cyclekit.errors import CyclekitError, OutputError
from cyclekit.storage.atomic import replaced, write_text

WAYS = {
    "convert": "convert {log} --out {out}",
    "estimate": "estimate {model} {toml} --dataset {data} --out {out}",
    "export": "export {model} --out {out}",
    "levels": "levels {data} --picture {out}",
    "plan": "plan {model} {toml} --dataset {data} --out {out}",
    "replay": "replay {data} --execution 1 --out {out}",
    "report": "report {data} --model {model} --sequences {toml} --out {out} --format json",
    "pdf": "report {data} --out {page} --pdf {out}",
    "whatif": "whatif {model} {toml} {toml} --dataset {data} --out {out}",
    "zones": "zones {model} {data} --out {out}",
}
ENDING = {"convert": ".csv", "levels": ".svg"}


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A folder with one of everything that commands read."""
    folder = tmp_path_factory.mktemp("guarded")
    data = fabricate_dataset(folder / "data", executions=2, rounds=1).path
    (folder / "model").mkdir()
    (folder / "model" / "model.json").write_text("{}", encoding="utf-8")
    (folder / "s.toml").write_text('[[sequence]]\nname = "a"\nplaces = ["conveyor", "left"]\n', encoding="utf-8")
    lines = [f"{10 + i / 125:.3f} {0.3 * (i % 100 > 50):.1f} 0 0.4" for i in range(300)]
    text = "\n".join(["timestamp " + " ".join(f"actual_TCP_pose_{k}" for k in range(3)), *lines, ""])
    (folder / "r.csv").write_text(text, encoding="utf-8")
    return {
        "data": data,
        "model": folder / "model",
        "toml": folder / "s.toml",
        "log": folder / "r.csv",
        "page": folder / "page.html",
    }


def refused(way: str, out: Path, cell: dict[str, Path], capsys: Any) -> str:
    """Run a command that must refuse, and return what it said; no byte of the folder may have changed."""
    folder = cell["log"].parent
    before = {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()}
    capsys.readouterr()
    assert run([*WAYS[way].format(**cell, out=out).split(), "--quiet"]) == 1
    assert {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()} == before
    return capsys.readouterr().err


@pytest.mark.parametrize("way", WAYS)
def test_an_output_in_what_is_read_is_refused(way: str, cell: dict[str, Path], capsys: Any):
    ending = ENDING.get(way, ".json")
    inside = cell["log"] if way == "convert" else cell["model" if way == "export" else "data"] / f"new{ending}"
    said = refused(way, inside, cell, capsys)
    assert "is an input" in said or "lies in the input" in said


@pytest.mark.parametrize("way", WAYS)
def test_what_cyclekit_did_not_write_is_not_replaced(way: str, cell: dict[str, Path], capsys: Any):
    mine = cell["log"].with_name(f"thesis{ENDING.get(way, '.json')}")
    mine.write_text('{"chapter": "In the beginning"}\n', encoding="utf-8")
    try:
        assert "so it is not replaced" in refused(way, mine, cell, capsys)
    finally:
        mine.unlink()


@pytest.mark.parametrize("name", ["same", "dots", "link", "hard"])
def test_other_names_of_an_input_are_the_input(name: str, cell: dict[str, Path], tmp_path: Path, capsys: Any):
    log = cell["log"]
    other = {"same": log, "dots": log.parent / "model" / ".." / log.name}.get(name, tmp_path / "other.csv")
    if name == "link":
        other.symlink_to(log)
    if name == "hard":
        os.link(log, other)
    assert "is an input" in refused("convert", other, cell, capsys)


def test_other_letters_of_an_input_are_the_input_where_the_disk_takes_them_for_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    log = tmp_path / "r.csv"
    log.write_text("t_s\n1\n", encoding="utf-8")
    samefile = Path.samefile
    monkeypatch.setattr(Path, "samefile", lambda a, b: samefile(Path(str(a).lower()), Path(str(b).lower())))
    monkeypatch.setattr("os.path.realpath", lambda path: str(path))
    with pytest.raises(OutputError, match="is an input"):
        check_output(str(log).replace("r.csv", "R.CSV"), "table-csv", [log])


def test_a_dataset_is_not_put_into_the_logs_nor_around_them(cell: dict[str, Path], tmp_path: Path, capsys: Any):
    logs = tmp_path / "logs"
    logs.mkdir()
    shutil.copy(cell["log"], logs)
    assert run(["ingest", str(logs), "--out", str(logs / "dataset"), "--quiet"]) == 1
    assert "lies in the input" in capsys.readouterr().err
    data = tmp_path / "dataset"
    assert run(["ingest", str(logs), "--out", str(data), "--quiet"]) == 0
    shutil.move(logs, data / "logs")
    assert run(["ingest", str(data / "logs"), "--out", str(data), "--quiet"]) == 1
    assert "holds the input" in capsys.readouterr().err
    assert (data / "logs" / cell["log"].name).is_file()


def test_a_page_and_its_print_are_two_files(cell: dict[str, Path], capsys: Any):
    said = refused("pdf", cell["page"], cell, capsys)
    assert "is an input" in said


@pytest.mark.usefixtures("words_only")
@pytest.mark.parametrize("kind", ["report-json", "report-csv", "page", "words", "table-csv", "table-parquet", "replay"])
def test_what_cyclekit_wrote_as_that_kind_is_replaced_and_as_another_it_is_not(
    kind: Any, cell: dict[str, Path], tmp_path: Path, capsys: Any
):
    way = "convert" if kind.startswith("table") else "replay" if kind == "replay" else "report"
    ending = {"page": "html", "words": "md", "replay": "rrd"}.get(kind, kind.partition("-")[2])
    out = tmp_path / f"x.{ending}"
    words = {
        "convert": ["convert", cell["log"], "--out", out],
        "replay": ["replay", cell["data"], "--execution", "1", "--out", out],
        "report": ["report", cell["data"], "--out", out],
    }[way]
    for _ in range(2):
        assert run([*map(str, words), "--quiet"]) == 0, capsys.readouterr().err
    check_output(out, kind, [])
    with pytest.raises(OutputError, match="is not replaced"):
        check_output(out, "what-if", [])


@pytest.mark.skipif(os.name == "nt", reason="devices and pipes have other names there")
def test_a_device_and_a_pipe_are_written_into_and_stay_what_they_are(tmp_path: Path):
    device = tmp_path / "null"
    device.symlink_to("/dev/null")
    write_text(device, "gone")
    assert Path("/dev/null").is_char_device()
    assert device.is_symlink()
    pipe, heard = tmp_path / "pipe", list[str]()
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: heard.append(pipe.read_text(encoding="utf-8")))
    reader.start()
    write_text(pipe, "all of it")
    reader.join(10)
    assert heard == ["all of it"]
    assert pipe.is_fifo()
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["null", "pipe"]


def test_a_link_stays_a_link_and_its_file_is_replaced(tmp_path: Path):
    (tmp_path / "there").mkdir()
    link = tmp_path / "link.txt"
    link.symlink_to(tmp_path / "there" / "file.txt")
    write_text(link, "new")
    assert link.is_symlink()
    assert (tmp_path / "there" / "file.txt").read_text(encoding="utf-8") == "new"


def test_a_folder_where_a_file_is_to_be_written_is_named(tmp_path: Path):
    with pytest.raises(CyclekitError, match="folder"), replaced(tmp_path):
        pass


@pytest.mark.parametrize("ending", ["svg", *(pytest.param(end, marks=pytest.mark.slow) for end in ("png", "pdf"))])
def test_a_picture_that_cyclekit_drew_is_drawn_again(ending: str, cell: dict[str, Path], tmp_path: Path, capsys: Any):
    for _ in range(2):
        words = ["levels", str(cell["data"]), "--picture", str(tmp_path / f"x.{ending}"), "--quiet"]
        assert run(words) == 0, capsys.readouterr().err


def test_what_estimate_whatif_and_demo_write_is_known_as_theirs(tmp_path: Path):
    from cyclekit.cli.demo import sequences_toml
    from cyclekit.cli.estimate import as_csv
    from cyclekit.estimate.whatif import NO_PROOF
    from cyclekit.text.plain_json import json_text

    written: dict[Any, str] = {
        "estimates-csv": as_csv([]),
        "estimates-json": json_text({"sequences": [], "check": None}, ascii_only=True),
        "what-if": json_text({"safety": NO_PROOF, "answers": []}, ascii_only=True),
        "sequences": sequences_toml(set()),
    }
    for kind, text in written.items():
        (tmp_path / "x").write_text(text, encoding="utf-8")
        check_output(tmp_path / "x", kind, [])
        for other in written.keys() - {kind}:
            with pytest.raises(OutputError, match="is not replaced"):
                check_output(tmp_path / "x", other, [])
