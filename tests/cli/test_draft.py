"""`inspect --write-cell` on tables that nobody knows: the cell file, what is asked in it, and what to type next."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from sheet_files import write_workbook

from cyclekit.dataset.dataset import Dataset

if TYPE_CHECKING:
    from .conftest import Shell


def kuka(path: Path, place: str = "TCP {} [mm]") -> Path:
    names = ["t [ms]", *(place.format(axis) for axis in "XYZ"), "OV_PRO"]
    rows = [[12 * i, 400 + i, -250.5, 80.25, 50 if i < 100 else 100] for i in range(200)]
    path.write_text("\n".join([";".join(names), *(";".join(map(str, row)) for row in rows), ""]))
    return path


def test_the_error_names_a_command_that_writes_a_cell_file_and_that_one_that_ingests(
    cyclekit: Shell, tmp_path: Path
) -> None:
    log = kuka(tmp_path / "arm log.csv")
    refused = cyclekit("inspect", log)
    assert refused.code == 1
    cure = refused.err.strip().splitlines()[-1].partition(": ")[2]
    written = cyclekit(*shlex.split(cure)[1:])
    assert written.code == 0, written.err
    assert "written" in written.out
    command = shlex.split(written.out.strip().splitlines()[-1])
    ingested = cyclekit(*command[1:-1], tmp_path / "dataset")
    assert ingested.code == 0, ingested.err
    samples = Dataset.open(tmp_path / "dataset").samples(columns=["robot_x_m", "scaling"])
    assert samples["robot_x_m"][0] == 0.4
    assert set(samples["scaling"].to_list()) == {0.5, 1.0}


def test_a_cure_is_never_the_command_that_was_typed(cyclekit: Shell, tmp_path: Path) -> None:
    log = tmp_path / "words.csv"
    log.write_text("a,b,c\n" + "foo,bar,baz\n" * 20)
    cure = cyclekit("inspect", log).err.strip().splitlines()[-1].partition(": ")[2]
    refused = cyclekit(*shlex.split(cure)[1:])
    assert refused.code == 1
    assert "--write-cell" not in refused.err
    assert "no map can be drafted" in refused.err


@pytest.mark.parametrize("lines", [True, False])
def test_json_records_name_the_command_that_makes_a_table_of_them(
    cyclekit: Shell, tmp_path: Path, *, lines: bool
) -> None:
    log = tmp_path / "log.json"
    records = [json.dumps({"t": i / 50, "tcp_x": 0.4 + i / 1000, "tcp_y": 0.25, "q": [1, 2]}) for i in range(60)]
    log.write_text("\n".join(records) if lines else f"[{', '.join(records)}]")
    refused = cyclekit("inspect", log)
    assert refused.err == cyclekit("inspect", log, "--write-cell").err
    _, *command = shlex.split(refused.err.strip().splitlines()[-1].partition("mapped: ")[2])
    subprocess.run([sys.executable, *command], check=True)
    assert 'x = "tcp_x"' in cyclekit("inspect", tmp_path / "log.parquet", "--write-cell").out


def test_an_archive_of_several_files_says_how_to_unpack_it(cyclekit: Shell, tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "logs.zip", "w") as archive:
        for name in ("a.csv", "b.csv"):
            archive.write(kuka(tmp_path / name), name)
    cure = cyclekit("inspect", tmp_path / "logs.zip").err.strip().splitlines()[-1].partition("map: ")[2]
    refused = cyclekit(*shlex.split(cure)[1:])
    assert "python -m zipfile -e" in refused.err


def test_a_draft_that_maps_nothing_is_not_called_ready(cyclekit: Shell, tmp_path: Path) -> None:
    log = tmp_path / "robot.csv"
    log.write_text("t [s];X [mm];Y [mm]\n" + "".join(f"{i / 50};1'{500 + i}.5;{i}.5\n" for i in range(60)))
    done = cyclekit("inspect", log, "--write-cell", tmp_path / "c.toml")
    assert "to use it" not in done.out
    assert "1 line is not sure" in done.out
    assert "X [mm] holds no numbers that can be read" in (tmp_path / "c.toml").read_text()


def test_a_cell_file_that_is_there_is_never_replaced(cyclekit: Shell, tmp_path: Path) -> None:
    log, cell = kuka(tmp_path / "arm.csv"), tmp_path / "cell.toml"
    assert cyclekit("inspect", log, "--write-cell", cell).code == 0
    cell.write_text("name = 'mine'\n")
    refused = cyclekit("inspect", log, "--write-cell", cell)
    assert refused.code == 1
    assert "never replaced" in refused.err
    assert cell.read_text() == "name = 'mine'\n"


def test_what_is_not_sure_is_counted_and_stands_there_as_a_comment(cyclekit: Shell, tmp_path: Path) -> None:
    log = kuka(tmp_path / "arm.csv", place="target {} [mm]")
    done = cyclekit("inspect", log, "--write-cell", tmp_path / "c.toml", "--json")
    text = (tmp_path / "c.toml").read_text()
    assert done.document == {"cell": text, "unsure": 4, "out": str(tmp_path / "c.toml")}
    assert '# ? x = "target X [mm]"' in text
    assert 'scaling = "OV_PRO"\nscaling_max = 100' in text


def test_unknown_tables_among_logs_are_drafted_beside_them(cyclekit: Shell, tmp_path: Path) -> None:
    pose = ",".join(f"actual_TCP_pose_{axis}" for axis in range(3))
    (tmp_path / "ur.csv").write_text(f"timestamp,{pose}\n0,0,0,0\n0.1,0,0,1\n")
    kuka(tmp_path / "arm.csv")
    (tmp_path / "results.csv").write_text("part,good,bad\n1,2,3\n2,3,4\n3,4,5\n")
    whole = write_workbook(tmp_path / "cut.xlsx", {"S": [["t", "x"], [1, 2]]}).read_bytes()
    (tmp_path / "cut.xlsx").write_bytes(whole.replace(b"worksheets/sheet1.xml", b"worksheets/sheetX.xml"))
    printed = cyclekit("inspect", tmp_path, "--write-cell").out
    assert 'path = "ur.csv"\nadapter = "ur-rtde"' in printed
    assert 'path = "arm.csv"\nadapter = "csv"\nrole = "robot"' in printed
    assert "results.csv" not in printed


def test_a_cell_file_without_the_option_is_a_slip(cyclekit: Shell, tmp_path: Path) -> None:
    assert cyclekit("inspect", kuka(tmp_path / "arm.csv"), tmp_path / "cell.toml").code == 2


def test_names_of_columns_cannot_end_a_comment(cyclekit: Shell, tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text(
        't_s,"tcp_x\x0b[[sources]]",tcp_x,tcp_y\n' + "".join(f"{i / 100},5,0.{300 + i},0.5\n" for i in range(50))
    )
    assert cyclekit("inspect", log, "--write-cell", tmp_path / "c.toml").code == 0
    done = cyclekit("ingest", log, "--cell", tmp_path / "c.toml", "--out", tmp_path / "d")
    assert done.code == 0, done.err


def test_a_workbook_is_named_with_the_command_that_drafts_its_map(cyclekit: Shell, tmp_path: Path) -> None:
    rows = [["t [s]", "TCP X [mm]", "TCP Y [mm]"], *([i / 50, 400.5 + i, 250.5] for i in range(120))]
    book = write_workbook(tmp_path / "rs.xlsx", {"Data": rows})
    refused = cyclekit("ingest", book, "--out", tmp_path / "d")
    cure = refused.err.strip().splitlines()[-1].partition(": ")[2]
    assert cyclekit(*shlex.split(cure)[1:]).code == 0
    done = cyclekit("ingest", book, "--cell", tmp_path / "rs.toml", "--out", tmp_path / "d")
    assert done.code == 0, done.err
    (tmp_path / "old.xls").write_bytes(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(600))
    assert "Save it as .xlsx" in cyclekit("inspect", tmp_path / "old.xls").err


def test_files_of_a_kind_are_one_source_however_many_they_are(cyclekit: Shell, tmp_path: Path) -> None:
    for folder in ("robot", "tracker"):
        (tmp_path / folder).mkdir()
    rows = "\n".join(f"{i};{i * 0.01:.2f};{1 + i * 0.003:.3f};0.5" for i in range(200))
    for number in range(1, 71):
        (tmp_path / "robot" / f"run_{number:02}.csv").write_text(f"t [s];X [m];Y [m];Z [m]\n{rows}\n")
        (tmp_path / "tracker" / f"run_{number:02}.csv").write_text(f"t [s];X [m];Y [m];Z [m]\n{rows}\n")
    (tmp_path / "tracker" / "run_x.csv").write_text("t [ms];person_x [m];person_y [m]\n1;2;3\n2;2.1;3\n3;2.2;3\n")
    printed = cyclekit("inspect", tmp_path, "--write-cell").out
    assert printed.index('"tracker/run_x.csv"') < printed.index('"tracker/run_*.csv"')  # the first that fits counts
    (tmp_path / "tracker" / "run_x.csv").unlink()
    printed = cyclekit("inspect", tmp_path, "--write-cell").out
    assert printed.count("[[sources]]") == 2
    assert 'path = "robot/run_*.csv"\nadapter = "csv"\nrole = "robot"  # its name says so' in printed
    assert 'path = "tracker/run_*.csv"\nadapter = "csv"\nrole = "people"  # its name says so' in printed
    assert printed.count("# for 70 files") == 2
