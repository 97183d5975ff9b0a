"""Exit codes and the one message: 0 done, 1 our error, 2 usage, 130 interrupted; never a traceback for those."""

from __future__ import annotations

import gc
import json
import os
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from cyclekit.cli import main, without_warnings_of_libraries
from cyclekit.cli.simulate import SCENES as OF_THE_COMMAND
from cyclekit_sim import COUPLED, FIELD_SCENES, HABIT_SCENES, SCENES

if TYPE_CHECKING:
    from .conftest import Shell


def test_what_works_ends_with_0_and_json_alone_on_standard_output(cyclekit: Shell) -> None:
    done = cyclekit("adapters", "--json")
    assert done.code == 0
    assert {"csv", "motive", "rosbag", "ur-rtde", "ur-split"} <= {entry["name"] for entry in done.document["adapters"]}
    assert all(entry["reads"] and entry["package"] for entry in done.document["adapters"])


def test_our_error_is_one_message_with_the_cure_and_no_traceback(cyclekit: Shell, tmp_path: Path) -> None:
    failed = cyclekit("inspect", tmp_path / "nothing")
    assert failed.code == 1
    assert failed.out == ""
    assert failed.err.startswith(f"error: {tmp_path / 'nothing'}: no such file or folder\n")
    assert "Traceback" not in failed.err


def test_our_error_is_a_json_document_too_where_json_was_asked_for(cyclekit: Shell, tmp_path: Path) -> None:
    failed = cyclekit("inspect", tmp_path / "nothing", "--json")
    assert failed.code == 1
    assert failed.document["error"]["kind"] == "LogError"
    assert "no such file or folder" in failed.document["error"]["message"]
    assert failed.err.startswith("error: ")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["engest"], "ingest"),
        (["ingest"], "LOGS"),
        (["train", "d", "--out", "m", "--problem", "later"], "--problem"),
        (["train", "d", "--out", "m", "--problem", "ahead", "--horizon", "soon"], "14s"),
        (["train", "d", "--out", "m", "--horizon", "14s"], "--problem"),
        (["simulate", "box-picking", "--out", "x", "--operator-xyz", "1,2"], "x,y,z"),
        (["simulate", "circus", "--out", "x"], "laser-zones"),
        (["adapters", "--colour"], "--colour"),
    ],
)
def test_a_wrong_command_line_ends_with_2_and_says_what_would_be_right(
    cyclekit: Shell, words: list[str], said: str
) -> None:
    failed = cyclekit(*words)
    assert failed.code == 2
    assert failed.out == ""
    assert said in failed.err
    assert "error: " in failed.err
    assert cyclekit(*words, "--json").document["error"]["kind"] == "Usage"


def test_cyclekit_alone_shows_what_it_can_do(cyclekit: Shell) -> None:
    shown = cyclekit()
    assert shown.code == 0
    assert "estimate" in shown.out


def test_the_simulator_s_refusal_is_our_error(cyclekit: Shell, tmp_path: Path) -> None:
    failed = cyclekit("simulate", "box-picking", "--out", tmp_path / "logs", "--robot-rate", "100")
    assert failed.code == 1
    assert "robot_rate_hz is 100" in failed.err
    assert not (tmp_path / "logs").exists()


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="sends SIGINT")
def test_an_interruption_ends_with_130_and_one_line_and_leaves_nothing(tmp_path: Path) -> None:
    out = tmp_path / "logs"
    words = ["simulate", "box-picking", "--out", str(out), "--executions", "2000", "--quiet"]
    started = subprocess.Popen(
        [sys.executable, "-c", f"from cyclekit.cli import main; main({words!r})"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    limit_s = time.monotonic() + 120
    while not (tmp_path / ".logs.partial").exists() and time.monotonic() < limit_s:
        time.sleep(0.02)
    started.send_signal(signal.SIGINT)
    out_text, err = started.communicate(timeout=120)
    assert started.returncode == 130
    assert (out_text, err.strip()) == ("", "interrupted")
    assert list(tmp_path.iterdir()) == []


def test_a_terminal_that_cannot_write_a_name_gets_no_traceback(tmp_path: Path) -> None:
    words = ["inspect", str(tmp_path / "Kühlregal")]
    code = f"from cyclekit.cli import main; main({words!r})"
    environment = {**os.environ, "PYTHONIOENCODING": "iso8859-5:strict", "PYTHONUTF8": "0"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, env=environment, check=False)
    assert done.returncode == 1
    assert b"K\\xfchlregal: no such file or folder" in done.stderr


def test_the_end_of_a_command_looks_for_no_garbage_among_what_was_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cyclekit.cli.run", lambda _: 3)
    try:
        with pytest.raises(SystemExit, match="3"):
            main([])
        assert gc.get_freeze_count() > 0
    finally:
        gc.unfreeze()


def test_nothing_is_said_beside_the_document_with_quiet_and_json(cyclekit: Shell, dataset: Path) -> None:
    done = cyclekit("inspect", dataset, "--json", "--quiet")
    assert (done.code, done.err) == (0, "")
    assert done.document["kind"] == "dataset"
    assert "NaN" not in json.dumps(done.document)


def test_no_command_shows_a_warning_that_a_library_has_for_programmers(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("PYTHONWARNINGS", "")
    with warnings.catch_warnings(record=True) as shown:
        without_warnings_of_libraries()
        warnings.warn("All-NaN slice encountered", RuntimeWarning, stacklevel=1)
    assert shown == []
    assert os.environ["PYTHONWARNINGS"] == "ignore"  # processes begun from here


def test_simulate_knows_every_scene_of_the_simulator() -> None:
    assert set(OF_THE_COMMAND) == {*SCENES, *HABIT_SCENES, *FIELD_SCENES, *COUPLED}
