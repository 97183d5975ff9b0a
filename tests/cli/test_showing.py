"""Replay and report from the command line: what is missing is said and is no error; formats, PDF, server."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from typing import TYPE_CHECKING

import browser
import pytest
from fabricated import fabricate_dataset

if TYPE_CHECKING:
    from pathlib import Path

    from conftest import Shell

pytestmark = pytest.mark.usefixtures("words_only")


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fabricate_dataset(tmp_path_factory.mktemp("cell") / "dataset", executions=3, rounds=1).path


@pytest.fixture(scope="module")
def empty_cell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fabricate_dataset(tmp_path_factory.mktemp("empty") / "dataset", executions=2, rounds=1, operator=False).path


def test_without_a_model_the_report_is_about_the_logs(cyclekit: Shell, cell: Path, tmp_path: Path) -> None:
    done = cyclekit("report", cell, "--out", tmp_path / "r.html", "--json")
    assert done.code == 0, done.err
    assert "No model was given: this report contains no predictions." in done.document["missing"]
    assert "A logged execution takes" in (tmp_path / "r.html").read_text("utf-8")


def test_a_cell_without_an_operator_gives_an_honest_page_and_replay(
    cyclekit: Shell, empty_cell: Path, tmp_path: Path
) -> None:
    page = cyclekit("report", empty_cell, "--out", tmp_path / "r.html", "--json")
    assert page.code == 0, page.err
    assert any("no operator position" in text for text in page.document["missing"])
    replay = cyclekit("replay", empty_cell, "--execution", "1", "--out", tmp_path / "x.rrd", "--json")
    assert replay.code == 0, replay.err
    assert any("No operator position" in text for text in replay.document["notes"])


@pytest.mark.parametrize("kind", ["json", "csv", "md"])
def test_the_ending_of_the_file_says_the_format(cyclekit: Shell, cell: Path, tmp_path: Path, kind: str) -> None:
    out = tmp_path / f"r.{kind}"
    assert cyclekit("report", cell, "--out", out).code == 0
    text = out.read_text("utf-8")
    begins = {"json": "{", "csv": "sequence,order,task", "md": "# Cycle time report"}
    assert text.startswith(begins[kind])


def test_a_format_that_there_is_not_is_a_usage_error(cyclekit: Shell, cell: Path, tmp_path: Path) -> None:
    for options in (["--out", tmp_path / "r.docx"], ["--out", tmp_path / "r.html", "--format", "docx"]):
        failed = cyclekit("report", cell, *options)
        assert failed.code == 2
        assert "'docx' is not one of html, json, csv, md" in failed.err
    assert list(tmp_path.iterdir()) == []


def test_sequences_without_a_model_are_a_usage_error(cyclekit: Shell, cell: Path, tmp_path: Path) -> None:
    file = tmp_path / "s.toml"
    file.write_text('[[sequence]]\nname = "a"\nplaces = ["conveyor", "left"]\n', "utf-8")
    failed = cyclekit("report", cell, "--sequences", file, "--out", tmp_path / "r.html")
    assert failed.code == 2
    assert "--model" in failed.err


@pytest.mark.slow
@pytest.mark.skipif(browser.find_browser() is None, reason="no Chromium, Chrome or Edge is installed")
def test_the_page_is_printed_beside_it(cyclekit: Shell, cell: Path, tmp_path: Path) -> None:
    done = cyclekit("report", cell, "--out", tmp_path / "r.html", "--pdf", tmp_path / "r.pdf", "--json")
    assert done.code == 0, done.err
    assert (tmp_path / "r.pdf").read_bytes().startswith(b"%PDF-")
    assert done.document["pdf"] == str(tmp_path / "r.pdf")


def test_a_replay_says_its_size_and_opens_where_it_is_told(cyclekit: Shell, cell: Path, tmp_path: Path) -> None:
    done = cyclekit("replay", cell, "--execution", "1", "--execution", "2", "--out", tmp_path / "x.rrd", "--at", "3s")
    assert done.code == 0, done.err
    size = (tmp_path / "x.rrd").stat().st_size
    assert f"{size / 1000:.0f} kB" in done.out
    failed = cyclekit("replay", cell, "--execution", "1", "--out", tmp_path / "y.rrd", "--at", "nowhere")
    assert failed.code == 2
    assert "neither slowdown nor error" in failed.err


@pytest.mark.slow  # a kill
@pytest.mark.skipif(os.name == "nt", reason="sends SIGINT")
def test_ctrl_c_ends_the_server_too(cell: Path, tmp_path: Path) -> None:
    for _ in range(20):
        with socket.socket() as one:
            one.bind(("127.0.0.1", 0))
            port = one.getsockname()[1]
        if port < 65000:
            break
    settings = {**os.environ, "HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path)}
    command = [
        "replay",
        str(cell),
        "--execution",
        "1",
        "--out",
        str(tmp_path / "x.rrd"),
        "--serve",
        "--port",
        str(port),
    ]
    running = subprocess.Popen(
        [sys.executable, "-m", "cyclekit", *command], env=settings, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert _listens(port, wanted=True), running.stderr.read() if running.poll() is not None and running.stderr else ""
    running.send_signal(signal.SIGINT)
    _, err = running.communicate(timeout=60)
    assert running.returncode == 130
    assert f"http://127.0.0.1:{port}/" in err.decode()
    assert _listens(port, wanted=False)


def _listens(port: int, *, wanted: bool) -> bool:
    for _ in range(600):
        with socket.socket() as caller:
            if (caller.connect_ex(("127.0.0.1", port)) == 0) is wanted:
                return True
        time.sleep(0.1)
    return False


def test_what_was_tried_comes_from_what_estimate_writes(cyclekit: Shell, cell: Path, tmp_path: Path) -> None:
    file = tmp_path / "e.json"
    each = {"name": "a", "expected_s": 10.0, "expected_low_s": 9.0, "expected_high_s": 11.0}
    file.write_text(json.dumps({"sequences": [each]}), "utf-8")
    done = cyclekit("report", cell, "--out", tmp_path / "r.md", "--what-if", f"slower = faster={file}")
    assert done.code == 0, done.err
    assert "| slower = faster | a | 10.0 |" in (tmp_path / "r.md").read_text("utf-8")
    failed = cyclekit("report", cell, "--out", tmp_path / "r.md", "--what-if", "no file")
    assert failed.code == 2
