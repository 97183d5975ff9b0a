"""Plug-ins that fail: each is named with its package, and costs nothing but its own logs."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from cyclekit.adapter import ReadOptions, Recording
from cyclekit.cli import run
from cyclekit.errors import BrokenAdapter, LogError
from cyclekit.ingest import registry
from cyclekit.ingest.registry import Registered

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

HEAD = "from cyclekit.adapter import Recording\nclass A:\n"
ASKED = "    def recognises(self, path): return path.suffix == '.acme'\n"
READS = "    def read(self, path, options): return Recording()\n"
BROKEN = {
    "not there": "import a_library_that_is_not_installed",
    "leaves": "raise SystemExit(3)",
    "a class": HEAD + ASKED + READS + "ADAPTER = A",
    "no adapter": "ADAPTER = 5",
    "raises when asked": HEAD + "    def recognises(self, path): raise ValueError('boom')\n" + READS + "ADAPTER = A()",
    "no such tool": HEAD + "    def recognises(self, path): open('/no/such/tool')\n" + READS + "ADAPTER = A()",
}


def plug_in(site: Path, text: str, module: str = "acme_broken") -> Path:
    """A package as an installer leaves it."""
    facts = site / f"{module}-1.0.dist-info"
    facts.mkdir(parents=True)
    (facts / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n", encoding="utf-8")
    (facts / "entry_points.txt").write_text(f"[cyclekit.adapters]\nacme = {module}:ADAPTER\n", encoding="utf-8")
    (site / f"{module}.py").write_text(f'"""Acme."""\n{text}\n', encoding="utf-8")
    return site


@dataclass(frozen=True)
class Typed:
    """What came of one command line."""

    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def cyclekit(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Iterator[Callable[..., Typed]]:
    """Type a command line in this process, which has the packages of a folder as if they were installed."""

    def typed(site: Path, *words: str | Path) -> Typed:
        monkeypatch.syspath_prepend(site)
        monkeypatch.setattr(registry, "_broken", {})
        registry._loaded.cache_clear()
        code = run([str(word) for word in words])
        out, err = capsys.readouterr()
        return Typed(code, out, err)

    yield typed
    for module in ("acme_broken", "b_other"):
        sys.modules.pop(module, None)
    registry._loaded.cache_clear()


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    """A log of a built-in format."""
    folder = tmp_path / "logs"
    folder.mkdir()
    text = "time_s,signal,value\n0.5,goal,left_table\n12.25,sync_in,1\n30.0,goal,conveyor\n"
    (folder / "events.csv").write_text(text, encoding="utf-8")
    return folder


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_plug_in_is_named_once_and_the_other_formats_are_read(
    tmp_path: Path, logs: Path, kind: str, cyclekit: Callable[..., Typed]
):
    site = plug_in(tmp_path / "site", BROKEN[kind])
    done = cyclekit(site, "inspect", logs, "--json")
    assert done.returncode == 0, done.stderr
    assert len(json.loads(done.stdout)["logs"]) == 1
    assert done.stderr.count("warning: adapter 'acme' of package 'acme_broken' is left out") == 1


def test_the_list_of_adapters_holds_the_others_and_says_what_was_left_out(
    tmp_path: Path, cyclekit: Callable[..., Typed]
):
    site = plug_in(tmp_path / "site", BROKEN["not there"])
    done = cyclekit(site, "adapters", "--json")
    assert done.returncode == 0, done.stderr
    listed = json.loads(done.stdout)
    assert {"csv", "motive"} <= {entry["name"] for entry in listed["adapters"]}
    (left,) = listed["left_out"]
    assert (left["name"], left["package"]) == ("acme", "acme_broken")
    assert "a_library_that_is_not_installed" in left["reason"]


def test_a_plug_in_that_fails_while_it_reads_is_named_with_the_log_and_nothing_is_written(
    tmp_path: Path, logs: Path, cyclekit: Callable[..., Typed]
):
    text = HEAD + ASKED + "    def read(self, path, options): raise KeyError('speed')\nADAPTER = A()"
    site, log = plug_in(tmp_path / "site", text), logs / "run.acme"
    log.write_text("acme", encoding="utf-8")
    before = sorted(path for path in tmp_path.rglob("*") if "__pycache__" not in path.parts)
    refused = cyclekit(site, "ingest", log, "--out", tmp_path / "dataset", "--json")
    assert refused.returncode == 1
    error = json.loads(refused.stdout)["error"]
    assert error["kind"] == "BrokenAdapter"
    for word in (str(log), "'acme'", "'acme_broken'", "KeyError: 'speed'"):
        assert word in error["message"]
    assert "Traceback" not in refused.stderr
    assert sorted(path for path in tmp_path.rglob("*") if "__pycache__" not in path.parts) == before
    kept = cyclekit(site, "inspect", logs, "--json")  # the folder's other log is looked at
    assert kept.returncode == 0, kept.stderr
    assert [Path(entry["path"]).name for entry in json.loads(kept.stdout)["logs"]] == ["events.csv"]


def test_of_two_packages_with_the_same_format_the_second_is_left_out_and_named(
    tmp_path: Path, cyclekit: Callable[..., Typed]
):
    text = HEAD + ASKED + READS + "ADAPTER = A()"
    site = plug_in(plug_in(tmp_path / "site", text), text, "b_other")
    done = cyclekit(site, "adapters", "--json")
    assert [entry["package"] for entry in json.loads(done.stdout)["left_out"]] == ["b_other"]


class _Returning:
    def __init__(self, what: object) -> None:
        self.what = what

    def recognises(self, path: Path) -> bool:
        return True

    def read(self, path: Path, options: ReadOptions) -> Recording:
        if isinstance(self.what, BaseException):
            raise self.what
        return self.what  # type: ignore[return-value]


@pytest.mark.parametrize("what", [None, Recording(robot=5), ValueError("boom"), OSError(2, "gone", "/no/such/tool")])  # type: ignore[arg-type]
def test_what_is_no_recording_is_the_fault_of_the_adapter(tmp_path: Path, what: object):
    entry = Registered("acme", "acme-cyclekit", "1", "", _Returning(what))
    with pytest.raises(BrokenAdapter, match="adapter 'acme' of package 'acme-cyclekit'"):
        list(entry.parts(tmp_path / "run.acme", ReadOptions()))


def test_a_log_that_cannot_be_read_is_not_the_fault_of_the_adapter(tmp_path: Path):
    log = tmp_path / "run.acme"
    entry = Registered("acme", "acme-cyclekit", "1", "", _Returning(OSError(13, "Permission denied", str(log))))
    with pytest.raises(LogError, match="cannot be read") as caught:
        list(entry.parts(log, ReadOptions()))
    assert not isinstance(caught.value, BrokenAdapter)
