import re
import textwrap
import tomllib
from dataclasses import fields
from pathlib import Path

import pytest

from cyclekit.adapter import ReadOptions
from cyclekit.errors import LogError
from cyclekit_adapters.formats import mapped_csv
from cyclekit_adapters.mapped import csv_map
from cyclekit_adapters.rosbag import roles

ROOT = Path(__file__).parents[2]
PROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
DOCS = (ROOT / "docs/adapters.md").read_text(encoding="utf-8")


def test_the_adapter_of_the_guide_works_as_it_stands(tmp_path):
    guide = (ROOT / "adapters/README.md").read_text(encoding="utf-8")
    code = textwrap.dedent(re.search(r"```python\n(.*?)```", guide, re.DOTALL)[1])
    module = {"__name__": "acme"}
    exec(code, module)
    log = tmp_path / "trace.csv"
    log.write_text("acme_t,acme_x,acme_y,acme_z\n0.5,1000,-20,3\n")
    assert module["ADAPTER"].recognises(log)
    assert not module["ADAPTER"].recognises(tmp_path)
    robot = module["ADAPTER"].read(log, ReadOptions()).robot
    assert robot.select("t_s", "tcp_x_m", "tcp_y_m", "tcp_z_m").rows() == [(0.5, 1.0, -0.02, 0.003)]
    log.write_text("acme_t,acme_x\n0.5,x\n")
    with pytest.raises(LogError):
        module["ADAPTER"].read(log, ReadOptions())


def test_every_key_of_a_mapped_table_is_documented():
    table = DOCS.partition("## csv")[2]
    assert [item.name for item in fields(csv_map.CsvMap) if f"`{item.name}`" not in table] == []


def test_every_key_of_a_bag_is_documented():
    assert [key for key in roles._KEYS if f"`{key}`" not in DOCS.partition("## rosbag")[2]] == []


def test_the_cell_file_of_the_documentation_reads_a_kuka_table(tmp_path):
    source = tomllib.loads(re.search(r"```toml\n(.*?)```", DOCS, re.DOTALL)[1])["sources"][0]
    log = tmp_path / "kuka_1.csv"
    log.write_text("IPOC;X_RIst;Y_RIst;Z_RIst;OV_PRO\n12;1279,5;0;80,4;50\n24;1280;0;80,4;100\n")
    options = ReadOptions(role=source["role"], map=source["map"])
    robot = mapped_csv.ADAPTER.read(log, options).robot
    assert robot["t_s"].to_list() == pytest.approx([0.012, 0.024])
    assert robot["tcp_x_m"].to_list() == pytest.approx([1.2795, 1.28])
    assert robot["scaling"].to_list() == [0.5, 1.0]


@pytest.mark.parametrize("name", tomllib.loads(PROJECT)["project"]["entry-points"]["cyclekit.adapters"])
def test_every_adapter_has_its_section_and_its_rows(name):
    assert f"## {name}:" in DOCS
    assert f"| `{name}` |" in DOCS


@pytest.mark.parametrize(
    ("name", "keys"),
    [
        ("qualisys", ["markers", "up"]),
        ("vicon", ["markers", "up"]),
        ("c3d", ["markers", "up"]),
        ("zed", ["unit", "axes"]),
        ("pedestrian", ["columns", "unit"]),
    ],
)
def test_every_key_of_a_tracker_is_documented(name, keys):
    section = DOCS.partition(f"## {name}:")[2].partition("\n## ")[0]
    assert [key for key in keys if f"`{key}" not in section] == []
