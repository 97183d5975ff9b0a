"""Closed streams, full disks, no locale, no working directory, long names: a message, or the work done all the same."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from fabricated import fabricate_dataset

from cyclekit.cli.surroundings import explained, with_home
from cyclekit.config.project import load_project
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import CyclekitError, DatasetError
from cyclekit.storage.atomic import locked, replaced, staged
from cyclekit.storage.files import shortened

if TYPE_CHECKING:
    from .conftest import Shell

ON_POSIX = pytest.mark.skipif(os.name == "nt", reason="streams are closed and devices named otherwise on Windows")
COMMAND = (sys.executable, "-m", "cyclekit")
TABLE = "t,x,y,z,s\n" + "".join(f"{k / 10:.1f},{0.01 * (k % 30):.2f},0,0,1\n" for k in range(100))
CELL = """
name = "Zelle Süd"
[[sources]]
path = "*.csv"
adapter = "csv"
[sources.map]
time = "t"
time_unit = "s"
length_unit = "m"
x = "x"
y = "y"
z = "z"
scaling = "s"
"""


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of two executions; nothing writes into it."""
    return fabricate_dataset(tmp_path_factory.mktemp("small") / "Kühlzelle", executions=2, rounds=1).path


def in_shell(line: str, folder: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    words = ["sh", "-c", line, *COMMAND]
    environment = {**os.environ, **variables}
    return subprocess.run(
        words, cwd=folder, env=environment, capture_output=True, text=True, encoding="utf-8", timeout=120, check=False
    )


@ON_POSIX
def test_a_command_works_with_standard_output_closed(small: Path, tmp_path: Path) -> None:
    told = in_shell(f'"$0" "$@" report "{small}" --out r.csv >&-', tmp_path)
    assert (told.returncode, told.stderr.count("Traceback")) == (0, 0)
    assert "conveyor" in (tmp_path / "r.csv").read_text(encoding="utf-8").splitlines()[1]


@pytest.mark.slow  # quick: above
@ON_POSIX
@pytest.mark.parametrize("closed", ["2>&-", ">&- 2>&- <&-", ">&-"])
def test_every_command_works_with_standard_streams_closed(small: Path, tmp_path: Path, closed: str) -> None:
    told = in_shell(f'"$0" "$@" replay "{small}" --execution 1 --out r.rrd {closed}', tmp_path)
    assert told.returncode == 0
    assert (tmp_path / "r.rrd").read_bytes()[:3] == b"RRF"
    told = in_shell(f'"$0" "$@" inspect "{small}" --json {closed}', tmp_path)
    assert told.returncode == 0
    assert "Traceback" not in told.stderr


@pytest.mark.slow
@ON_POSIX
def test_an_answer_that_cannot_be_written_is_a_message(small: Path, tmp_path: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    for line in (f'inspect "{small}"', "inspect nothing --json", "--help"):
        told = in_shell(f'"$0" "$@" {line} > /dev/full', tmp_path)
        assert told.returncode == 1
        assert (
            told.stderr
            == "error: standard output: No space left on device\n  Free some space, or write somewhere else.\n"
        )


@pytest.mark.slow  # quick: names in test_hostile_names
@ON_POSIX
def test_names_with_umlauts_are_read_where_there_is_no_locale(tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    (folder / "Kühl.csv").write_text(TABLE, encoding="utf-8")
    (folder / "cell.toml").write_text(CELL, encoding="utf-8")
    bare = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    for words in ("ingest logs --out Süd --quiet", "inspect Süd", "report Süd --out Süd.html"):
        told = in_shell(f'"$0" "$@" {words}', tmp_path, **bare)
        assert told.returncode == 0, told.stderr
    assert Dataset.open(tmp_path / "Süd").recordings[0].shown == "Kühl.csv"
    assert "Zelle Süd" in (tmp_path / "Süd.html").read_text(encoding="utf-8")


@ON_POSIX
def test_a_working_directory_that_is_gone_is_named(tmp_path: Path) -> None:
    (tmp_path / "gone").mkdir()
    told = in_shell('rmdir ../gone && "$0" "$@" inspect somewhere', tmp_path / "gone")
    assert told.returncode == 1
    assert told.stderr.startswith("error: the working directory cannot be used")
    assert "Traceback" not in told.stderr


@ON_POSIX
def test_a_loop_of_links_is_a_message(cyclekit: Shell, tmp_path: Path) -> None:
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    for words in (
        ["inspect", loop],
        ["levels", loop],
        ["ingest", loop, "--out", "x"],
        ["export", loop, "--out", "x.onnx"],
    ):
        told = cyclekit(*words)
        assert told.code == 1
        assert told.err.startswith(f"error: {loop}")


@pytest.mark.parametrize("name", ["n" * 250, "ü" * 125, "🤖" * 60])
def test_a_folder_with_the_longest_name_there_is_can_be_written_and_replaced(tmp_path: Path, name: str) -> None:
    if os.name == "nt":
        pytest.skip("paths are short on Windows")
    for text in ("old", "new"):
        with staged(tmp_path / name) as folder:
            (folder / "x").write_text(text)
        with replaced(tmp_path / f"{name[:-5]}.txt") as file:
            file.write_text(text)
    with locked(tmp_path / name):
        assert sum(entry.name.startswith(".") for entry in tmp_path.iterdir()) == 1
    assert (tmp_path / name / "x").read_text() == "new"
    assert len(list(tmp_path.iterdir())) == 2


def test_long_names_are_cut_between_characters_and_stay_apart() -> None:
    first, second = shortened("ü" * 130 + "a"), shortened("ü" * 130 + "b")
    assert first != second
    assert max(len(first.encode()), len(second.encode())) <= 200
    assert shortened("ü" * 100) == "ü" * 100


@ON_POSIX
def test_logs_deep_in_folders_with_long_names_are_ingested(cyclekit: Shell, tmp_path: Path) -> None:
    deep = tmp_path / "logs" / ("a" * 250) / ("b" * 250)
    deep.mkdir(parents=True)
    (deep / "run.csv").write_text(TABLE, encoding="utf-8")
    cell = CELL.replace("*.csv", "*run.csv")
    (tmp_path / "logs" / "cell.toml").write_text(cell, encoding="utf-8")
    told = cyclekit("ingest", tmp_path / "logs", "--out", tmp_path / "out")
    assert told.code == 0, told.err
    assert Dataset.open(tmp_path / "out").samples().height == 100


def test_a_name_that_is_too_long_is_a_message(cyclekit: Shell, tmp_path: Path) -> None:
    for words in (["inspect", tmp_path / ("n" * 500)], ["ingest", tmp_path / ("n" * 500), "--out", tmp_path / "x"]):
        told = cyclekit(*words)
        assert told.code == 1
        assert told.err.startswith("error: ")


def test_what_may_not_be_read_is_a_message(
    cyclekit: Shell, small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copied = Path(shutil.copytree(small, tmp_path / "ds"))

    def refuse(path: Path, *_: object, **__: object) -> os.stat_result:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    with monkeypatch.context() as patched:
        patched.setattr(Path, "stat", refuse)
        told = cyclekit("inspect", copied)
        assert told.code == 1
        assert "Permission denied" in told.err
        assert "Check" in told.err
        with pytest.raises((DatasetError, CyclekitError), match="Permission denied"):
            Dataset.open(copied)


def test_a_refusal_of_the_system_names_the_file_and_the_cure() -> None:
    full = OSError(errno.ENOSPC, "No space left on device", "a/b.parquet")
    assert explained(full) == "a/b.parquet: No space left on device\n  Free some space, or write somewhere else."
    assert explained(OSError("Permission denied: x")).startswith("Permission denied: x\n  Check")


def test_samples_that_cannot_be_listed_are_a_message_and_no_empty_dataset(
    cyclekit: Shell, small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refusing(real):  # type: ignore[no-untyped-def]
        def listing(path="."):  # type: ignore[no-untyped-def]
            if os.fspath(path) == str(small / "samples"):
                raise PermissionError(errno.EACCES, "Permission denied", str(path))
            return real(path)

        return listing

    for name in ("listdir", "scandir"):
        monkeypatch.setattr(os, name, refusing(getattr(os, name)))
    failed = cyclekit("inspect", small)
    assert failed.code == 1
    assert failed.err.startswith(f"error: {small / 'samples'}: cannot be listed (Permission denied)\n")


def test_more_memory_than_there_is_is_one_message(
    cyclekit: Shell, small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def greedy(*_: object) -> None:
        raise MemoryError("Unable to allocate 458. MiB for an array")

    monkeypatch.setattr("cyclekit.inspect.describe._describe_dataset", greedy)
    failed = cyclekit("inspect", small)
    assert failed.code == 1
    assert failed.err.startswith("error: this needs more memory than the process may take (Unable to allocate 458. MiB")
    assert "Traceback" not in failed.err


def test_the_home_folder_is_meant_where_the_shell_left_it() -> None:
    home = str(Path.home())
    typed = ["ingest", "~/logs", "--out=~/dataset", "--cell", "~", "a~/b", "~you/logs", "--what-if", "x=~/changed.json"]
    expected = ["ingest", f"{home}/logs", f"--out={home}/dataset", *typed[3:]]
    assert with_home(typed) == expected


def test_paths_of_the_home_folder_work_quoted_and_in_a_project(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cyclekit: Shell
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    fabricate_dataset(tmp_path / "dataset", executions=2)
    assert cyclekit("inspect", "~/dataset", "--quiet").code == 0
    (tmp_path / "cyclekit.toml").write_text('logs = ["~/logs"]\ndataset = "~/dataset"\n', encoding="utf-8")
    project = load_project(tmp_path)
    assert (project.logs, project.dataset) == ((str(tmp_path / "logs"),), str(tmp_path / "dataset"))
