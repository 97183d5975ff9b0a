"""Names that come from data: none of them leads out of its folder, whatever it is."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from cyclekit.dataset.cards import dataset_card, plain
from cyclekit.dataset.dataset import Dataset
from cyclekit.dataset.trace import trace
from cyclekit.errors import CyclekitError, LogError, OutsideFolder
from cyclekit.fleet.months import days_of
from cyclekit.fleet.read import load_fleet
from cyclekit.ingest.ingest import ingest
from cyclekit.ingest.registry import adapter_named
from cyclekit.replay import write_replay
from cyclekit.report.template import Template
from cyclekit.storage.safe_path import name_problem, safe_path, valid_name

if TYPE_CHECKING:
    from simulated_cells import SimulatedCell

EVIL = [
    "..",
    ".",
    "",
    "../x",
    "/etc",
    "a/b",
    "..\\x",
    "C:",
    "C:x",
    "C:/x",
    "\\\\host\\share",
    "a\0b",
    "a\nb",
    "\x1b[2J",
]
EVIL += ["\ud800", "con", "NUL.txt", "com1", "lpt9.parquet", "aux .csv", "x.", "x ", "...", "a" * 256, "ä" * 128]
NAMES = st.one_of(
    st.text(alphabet=st.characters(), max_size=300),  # surrogates and control characters too
    st.lists(st.sampled_from([*EVIL, "a", "/", "\\", ".", " ", ":"]), max_size=6).map("".join),
)


@pytest.mark.parametrize("name", EVIL)
def test_a_name_that_is_none_or_leads_elsewhere_is_refused(name: str, tmp_path: Path):
    with pytest.raises(OutsideFolder, match="cannot be used as the name of a file") as caught:
        safe_path(tmp_path, "recordings", name, "robot.parquet")
    assert str(caught.value).replace("\n", "").isprintable()


@pytest.mark.parametrize("name", ["a", "day 1", "take.1", ".hidden", "Läufe", "console", "10.30"])
def test_a_plain_name_is_a_plain_path(name: str, tmp_path: Path):
    assert safe_path(tmp_path, name, "x.parquet") == tmp_path / name / "x.parquet"


@given(NAMES)
@example("../../outside")
def test_whatever_the_name_the_path_is_in_the_folder_or_there_is_none(name: str):
    folder = Path("folder").absolute()
    try:
        path = safe_path(folder, name)
    except OutsideFolder as error:
        refused = error
    else:
        assert path.parent == folder
        assert os.path.normpath(path) == str(path)
        return
    assert str(refused).replace("\n", "").isprintable()


@given(NAMES)
@example("NUL." + 300 * "x")  # must not be cut and marked in turn
@example(240 * "x" + ". " + 10 * "y")
def test_a_name_can_be_made_to_fit_and_then_stays_as_it_is(name: str):
    fit = valid_name(name)
    assert name_problem(fit) is None
    assert name_problem(f"{fit}-12.parquet") is None
    assert valid_name(fit) == fit


def test_links_within_the_folder_are_followed_and_others_only_when_that_is_meant(tmp_path: Path):
    folder, outside = tmp_path / "folder", tmp_path / "outside"
    for here in (folder / "real", outside):
        here.mkdir(parents=True)
        (here / "x").write_text("x")
    (folder / "near").symlink_to(folder / "real")
    (folder / "far").symlink_to(outside)
    (folder / "round").symlink_to(folder / "round")
    assert safe_path(folder, "near", "x").read_text() == "x"
    assert safe_path(folder, "far", "x", follow_links=True).read_text() == "x"
    assert safe_path(folder, "round") == folder / "round"
    with pytest.raises(OutsideFolder, match="a link there leads out of the folder"):
        safe_path(folder, "far", "x")


@pytest.fixture
def hostile(boxes: SimulatedCell, tmp_path: Path) -> tuple[Path, Path]:
    """A dataset whose card gives its first recording the id of a folder outside, and that folder."""
    folder, outside = tmp_path / "a" / "dataset", tmp_path / "outside"
    shutil.copytree(boxes.dataset.path, folder)
    card = json.loads((folder / "dataset.json").read_text("utf-8"))
    entry = next(record for record in card["recordings"] if "robot" in record["tables"])
    (folder / "recordings" / entry["id"]).rename(outside)
    (outside / "secret.txt").write_text("secret")
    entry["id"] = "../../../outside"
    card["fingerprint"] = "another"
    (folder / "dataset.json").write_text(json.dumps(card), "utf-8")
    return folder, outside


def test_a_recording_that_is_called_by_a_way_out_is_not_read(hostile: tuple[Path, Path], tmp_path: Path):
    dataset = Dataset.open(hostile[0])
    with pytest.raises(CyclekitError, match=r"outside|leads out"):
        dataset.recorded("../../../outside", "robot")
    with pytest.raises(CyclekitError, match=r"outside|leads out"):
        dataset.native_robot(dataset.executions["execution"][0])
    with pytest.raises(CyclekitError, match=r"outside|leads out"):
        write_replay(dataset, "1", tmp_path / "x.rrd")
    with pytest.raises(CyclekitError, match=r"outside|leads out"):
        trace(dataset, "1", 5.0)


def test_the_next_ingest_takes_nothing_from_outside(hostile: tuple[Path, Path], boxes: SimulatedCell, tmp_path: Path):
    folder, outside = hostile
    before = {file: file.stat().st_nlink for file in outside.iterdir()}
    report = ingest([boxes.logs], folder)
    assert report.recordings_new == 1
    assert {file: file.stat().st_nlink for file in outside.iterdir()} == before
    assert list(folder.rglob("secret.txt")) == []
    assert Dataset.open(folder).samples().equals(boxes.dataset.samples())


def test_only_the_tables_that_an_entry_names_are_taken_over(boxes: SimulatedCell, tmp_path: Path):
    folder = Path(shutil.copytree(boxes.dataset.path, tmp_path / "dataset"))
    (tmp_path / "private").write_text("secret")
    kept, linked = sorted(path for path in (folder / "recordings").iterdir())[:2]
    (kept / "stray.parquet").write_text("secret")
    (linked / "robot.parquet").unlink(missing_ok=True)
    (linked / "robot.parquet").symlink_to(tmp_path / "private")
    card = json.loads((folder / "dataset.json").read_text("utf-8"))
    (folder / "dataset.json").write_text(json.dumps(card | {"fingerprint": "another"}), "utf-8")
    ingest([boxes.logs], folder)
    files = [file for file in folder.rglob("*") if file.is_file()]
    assert not any(file.is_symlink() or file.name == "stray.parquet" for file in files)


def test_a_line_is_traced_only_in_the_folder_of_logs(boxes: SimulatedCell, tmp_path: Path):
    (tmp_path / "secret.txt").write_text("secret\n" * 100_000)
    (tmp_path / "logs").mkdir()
    for record in boxes.dataset.card.recordings:
        assert record.sources
    card = plain(boxes.dataset.card)
    for record in card["recordings"]:
        record["sources"] = [{"path": "../secret.txt", "sha256": None, "size": 1}]
    with pytest.raises(OutsideFolder, match="leads out of the folder"):
        trace(Dataset(boxes.dataset.path, dataset_card(card)), "1", 5.0, logs=tmp_path / "logs")


def test_the_day_of_a_log_is_looked_up_only_in_the_folder_of_logs(boxes: SimulatedCell, tmp_path: Path):
    (tmp_path / "secret.txt").write_text("secret")
    (tmp_path / "logs").mkdir()
    card = plain(boxes.dataset.card)
    for record in card["recordings"]:
        record["sources"] = [{"path": "../secret.txt", "sha256": None, "size": 1}]
    assert days_of(Dataset(boxes.dataset.path, dataset_card(card)), [tmp_path / "logs"]) == {}


def test_a_template_reads_its_own_folder_and_no_other(tmp_path: Path):
    (tmp_path / "secret.txt").write_text("secret")
    house = tmp_path / "house"
    house.mkdir()
    page = house / "page.html.jinja"
    for name in ("../secret.txt", str(tmp_path / "secret.txt"), "../../../../../../../../../../etc/hostname"):
        page.write_text(f'{{% include "{name}" %}}', "utf-8")
        with pytest.raises(CyclekitError):
            Template(house).render()
    page.write_text("plain", "utf-8")
    (house / "logo.svg").symlink_to(tmp_path / "secret.txt")
    with pytest.raises(OutsideFolder):
        Template(house).render()


@pytest.mark.parametrize("name", ["con", "a.", "../x", "a/b", "."])
def test_a_cell_of_a_fleet_is_called_as_a_folder_can_be(name: str, tmp_path: Path):
    (tmp_path / "fleet.toml").write_text(f'[[cell]]\nname = "{name}"\nsources = ["logs"]\n', "utf-8")
    with pytest.raises(CyclekitError, match="name = "):
        load_fleet(tmp_path / "fleet.toml")


def test_logs_and_folders_called_as_devices_become_recordings_all_the_same(tmp_path: Path, robot_log: Any):
    trip = [("stand", 0.5), ("move", 0.3), ("stand", 0.5), ("move", 0.0)]
    robot_log(tmp_path / "logs" / "aux" / "con.csv", trip)
    robot_log(tmp_path / "logs" / "b" / "..csv", trip)
    dataset = Dataset.open(ingest([tmp_path / "logs"], tmp_path / "dataset").dataset)
    assert dataset.recordings
    for record in dataset.recordings:
        assert dataset.recorded(record.id, "robot") is not None
    for file in dataset.path.rglob("*"):
        assert name_problem(file.name) is None


def test_a_bag_is_read_from_its_own_folder(tmp_path: Path):
    bag = tmp_path / "bag"
    bag.mkdir()
    text = "rosbag2_bagfile_information:\n  relative_file_paths: ['..\\\\..\\\\x.mcap']\n  compression_mode: ''\n"
    (bag / "metadata.yaml").write_text(text, "utf-8")
    (bag / "x.mcap").write_bytes(b"")
    adapter = adapter_named("rosbag")
    from cyclekit.adapter import ReadOptions

    with pytest.raises(LogError, match="cannot be used as the name of a file"):
        list(adapter.parts(bag, ReadOptions()))
