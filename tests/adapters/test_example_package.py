"""A third party's format: a package of its own, found through its entry point, with nothing of cyclekit changed."""

import json
import os
import re
import subprocess
import sys
import textwrap
import tomllib
from pathlib import Path

import polars as pl
import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = Path(__file__).parent / "example_package"
PROJECT = tomllib.loads((PACKAGE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
GROUP = "cyclekit.adapters"


@pytest.fixture
def installed(tmp_path):
    """The package as an installer leaves it: its module, and a dist-info made from its pyproject.toml."""
    site = tmp_path / "site"
    facts = site / f"{PROJECT['name'].replace('-', '_')}-{PROJECT['version']}.dist-info"
    facts.mkdir(parents=True)
    name, version = PROJECT["name"], PROJECT["version"]
    (facts / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n", encoding="utf-8")
    points = "".join(f"{key} = {value}\n" for key, value in PROJECT["entry-points"][GROUP].items())
    (facts / "entry_points.txt").write_text(f"[{GROUP}]\n{points}", encoding="utf-8")
    (site / "acme_cyclekit.py").write_bytes((PACKAGE / "acme_cyclekit.py").read_bytes())
    return site


def cyclekit(site, *words):
    paths = [str(site), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "cyclekit", *map(str, words)]
    return subprocess.run(command, env=environment, capture_output=True, encoding="utf-8", timeout=120, check=False)


def trace(path, seconds=8.0):
    """Acme's trace of an arm that goes to and fro over half a metre, a second each way and a second's rest."""
    rows = ["acme_t,acme_x,acme_y,acme_z"]
    for tick in range(int(seconds * 50)):
        phase = tick / 50 % 4
        way = min(phase, 1.0) if phase < 2 else max(3.0 - phase, 0.0)
        rows.append(f"{tick / 50},{500 * way:.3f},0,300")
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")


@pytest.mark.slow  # a clean environment
def test_the_adapter_is_listed_with_the_package_it_comes_from(installed, tmp_path):
    listed = json.loads(cyclekit(installed, "adapters", "--json").stdout)["adapters"]
    found = [entry for entry in listed if entry["name"] == "acme"]
    assert [(entry["package"], entry["version"]) for entry in found] == [("acme-cyclekit", "1.2.0")]
    assert found[0]["reads"].startswith("Acme arms: CSV")
    without = json.loads(cyclekit(tmp_path, "adapters", "--json").stdout)["adapters"]
    assert "acme" not in {entry["name"] for entry in without}


@pytest.mark.slow  # a clean environment; quick: test_broken_plugins
def test_ingest_reads_a_log_of_it_and_refuses_the_log_without_it(installed, tmp_path):
    logs = tmp_path / "logs"
    logs.mkdir()
    trace(logs / "arm.csv")
    done = cyclekit(installed, "ingest", logs, "--out", tmp_path / "dataset", "--json")
    assert done.returncode == 0, done.stderr
    samples = pl.concat([pl.read_parquet(file) for file in (tmp_path / "dataset" / "samples").glob("*.parquet")])
    assert samples["robot_z_m"].drop_nulls().unique().to_list() == pytest.approx([0.3])
    assert samples["robot_x_m"].max() == pytest.approx(0.5, abs=1e-3)
    refused = cyclekit(tmp_path, "ingest", logs, "--out", tmp_path / "other")
    assert refused.returncode != 0
    assert "arm.csv" in refused.stderr
    assert "Traceback" not in refused.stderr


def test_the_guide_shows_the_module_of_the_package():
    guide = (ROOT / "adapters/README.md").read_text(encoding="utf-8")
    shown = textwrap.dedent(re.search(r"```python\n(.*?)```", guide, re.DOTALL)[1])
    assert shown == (PACKAGE / "acme_cyclekit.py").read_text(encoding="utf-8")
