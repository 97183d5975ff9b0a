"""A dataset that is not as it was written is never read in silence, and the next ingest makes it whole again."""

from __future__ import annotations

import json
import os
import random
import shutil
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl
import pytest
from blake3 import blake3
from examples import at_most
from hypothesis import given
from hypothesis import strategies as st

from cyclekit import schema
from cyclekit.cli import run
from cyclekit.dataset import checksums
from cyclekit.dataset import files as dataset_files
from cyclekit.dataset.cards import plain
from cyclekit.dataset.dataset import CARD, Dataset
from cyclekit.errors import CyclekitError, DatasetError
from cyclekit.ingest.ingest import ingest
from cyclekit.storage import parquet_layout as table_layout

if TYPE_CHECKING:
    from collections.abc import Iterator

RECORDED = "recordings/run_0/robot.parquet"


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two small logs of a robot that goes to and fro, with a spoilt row in one."""
    folder = tmp_path_factory.mktemp("damaged") / "logs"
    folder.mkdir()
    for number in range(2):
        lines = [f"{10 + i / 125:.3f} {0.3 * (i % 400 > 200):.1f} 0 0.4" for i in range(1200 + number)]
        lines[50 + number] = "9e99 0 0 0.4"
        text = "\n".join(["timestamp " + " ".join(f"actual_TCP_pose_{k}" for k in range(3)), *lines, ""])
        (folder / f"run_{number}.csv").write_text(text, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def made(logs: Path) -> Path:
    return ingest([logs], logs.parent / "dataset").dataset


@pytest.fixture
def dataset(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "dataset"))


def everything(path: Path) -> list[Any]:
    """Read all that a dataset holds."""
    data = Dataset.open(path)
    found: list[Any] = [
        data.samples(),
        data.tasks(),
        data.done_tasks(),
        data.quarantine(),
        data.summed_up(lambda samples: samples),
    ]
    for record in data.recordings:
        found += [data.recorded(record.id, name) for name in record.tables]
        found += [data.recorded_between(record.id, "robot", 11.0, 12.0), *data.times(record.id, "robot")]
    card = {key: value for key, value in plain(data.card).items() if key != "card_blake3"}
    return [*found, json.dumps(card, sort_keys=True)]


def same(ours: list[Any], theirs: list[Any]) -> bool:
    pairs = zip(ours, theirs, strict=False)
    return len(ours) == len(theirs) and all(
        a.equals(b) if isinstance(a, pl.DataFrame) and isinstance(b, pl.DataFrame) else a is b or a == b
        for a, b in pairs
    )


def bytes_of(path: Path) -> dict[str, bytes]:
    return {file.relative_to(path).as_posix(): file.read_bytes() for file in path.rglob("*") if file.is_file()}


@pytest.fixture(autouse=True)
def no_remarks_of_libraries() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def test_a_flipped_bit_in_the_name_of_the_cards_own_checksum_is_noticed(dataset: Path):
    card = dataset / CARD
    card.write_bytes(card.read_bytes().replace(b'"card_blake3"', b'"card_blakd3"'))
    with pytest.raises(DatasetError, match="not as it was written"):
        Dataset.open(dataset)


@pytest.mark.parametrize("bits", [60, pytest.param(300, marks=pytest.mark.slow)])
def test_of_many_flipped_bits_none_is_read_in_silence(dataset: Path, bits: int):
    true, luck = everything(dataset), random.Random(0)
    files = sorted(file for file in dataset.rglob("*") if file.is_file())
    sizes = [file.stat().st_size for file in files]
    noticed = 0
    for _ in range(bits):
        file = luck.choices(files, sizes)[0]
        whole = file.read_bytes()
        place, bit = luck.randrange(len(whole)), 1 << luck.randrange(8)
        file.write_bytes(whole[:place] + bytes([whole[place] ^ bit]) + whole[place + 1 :])
        try:
            silent = same(everything(dataset), true)
        except DatasetError as error:
            noticed += 1
            silent = str(dataset) in error.seen
        assert silent, f"byte {place} of {file.name}: another dataset, and not a word"
        file.write_bytes(whole)
    assert noticed >= 0.95 * bits


@pytest.mark.parametrize("name", ["samples/run_0.parquet", "tasks.parquet", "quarantine.parquet", RECORDED])
@pytest.mark.parametrize("harm", ["cut", "gone", "garbage", "bit"])
def test_what_is_damaged_is_named_and_made_anew_by_the_next_ingest(
    name: str, harm: str, dataset: Path, logs: Path, capsys: Any
):
    before, file = bytes_of(dataset), dataset / name
    spoil(file, harm)
    with pytest.raises(DatasetError, match=f"{file.name}: (damaged|missing)") as caught:
        everything(dataset)
    assert f"cyclekit ingest LOGS --out {dataset}" in str(caught.value)
    assert run(["inspect", str(dataset), "--verify"]) == 1
    assert name in capsys.readouterr().err
    report = ingest([logs], dataset)
    assert not report.unchanged
    assert name in report.warnings[0]
    assert report.recordings_new == (1 if name == RECORDED else 2 if name == "quarantine.parquet" else 0)
    assert bytes_of(dataset) == before
    assert ingest([logs], dataset).unchanged
    assert run(["inspect", str(dataset), "--verify", "--quiet"]) == 0
    assert "7 files, all as written" in capsys.readouterr().out


def spoil(file: Path, harm: str) -> None:
    whole = file.read_bytes()
    if harm == "gone":
        file.unlink()
    else:
        changed = {
            "cut": whole[:-50],
            "garbage": b"\x93" * len(whole),
            "bit": whole[:99] + bytes([whole[99] ^ 1]) + whole[100:],
        }
        file.write_bytes(changed[harm])


def test_a_damaged_card_is_refused_and_made_anew(dataset: Path, logs: Path):
    before = bytes_of(dataset)
    text = (dataset / CARD).read_text(encoding="utf-8")
    (dataset / CARD).write_text(text.replace('"rate_hz": 10.0', '"rate_hz": 10.4'), encoding="utf-8")
    with pytest.raises(DatasetError, match="not as it was written"):
        Dataset.open(dataset)
    assert "was damaged" in ingest([logs], dataset).warnings[0]
    assert bytes_of(dataset) == before


def test_a_dataset_without_checksums_is_read_as_before_and_damage_is_one_message(dataset: Path):
    true = everything(dataset)
    card = json.loads((dataset / CARD).read_text(encoding="utf-8"))
    del card["files"], card["card_blake3"]
    (dataset / CARD).write_text(json.dumps(card), encoding="utf-8")
    assert same(everything(dataset)[:-1], true[:-1])
    with pytest.raises(DatasetError, match="has no checksums"):
        Dataset.open(dataset).verify()
    for name in ("samples/run_0.parquet", "tasks.parquet", "quarantine.parquet", RECORDED):
        whole = (dataset / name).read_bytes()
        for changed in (b"", whole[:-50], b"\x93" * len(whole)):
            (dataset / name).write_bytes(changed)
            with pytest.raises(DatasetError, match=Path(name).parts[0]):
                everything(dataset)
        (dataset / name).write_bytes(whole)
    samples = pl.read_parquet(dataset / "samples" / "run_0.parquet")
    for wrong in (samples.with_columns(pl.col("robot_x_m").cast(pl.String)), samples.drop("robot_x_m")):
        wrong.write_parquet(dataset / "samples" / "run_0.parquet")
        with pytest.raises(DatasetError, match="robot_x_m"):
            everything(dataset)


def test_what_is_taken_over_keeps_its_checksum(logs: Path, tmp_path: Path):
    mine = Path(shutil.copytree(logs, tmp_path / "logs"))
    before = Dataset.open(ingest([mine], tmp_path / "dataset").dataset).card.files
    shutil.copy2(mine / "run_0.csv", mine / "run_9.csv")
    report = ingest([mine], tmp_path / "dataset")
    assert report.recordings_kept == 2
    after = Dataset.open(tmp_path / "dataset").card.files
    assert after[RECORDED] == before[RECORDED]
    assert Dataset.open(tmp_path / "dataset").verify() == len(after) + 1


@pytest.fixture
def large(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, pl.DataFrame]:
    """A dataset with a table that counts as large, and the table."""
    monkeypatch.setattr(checksums, "PIECE_BYTES", 512)
    monkeypatch.setattr(dataset_files, "PARTLY_BYTES", 4096)
    monkeypatch.setattr(dataset_files, "SMALL_TABLE_BYTES", 4096)
    monkeypatch.setattr(table_layout, "SMALL_BYTES", 4096)
    t_s = [i / 100 for i in range(20_000)]
    rows = schema.conform(pl.DataFrame({"t_s": t_s, "tcp_x_m": [t**0.5 % 1 for t in t_s]}), schema.ROBOT)
    rows.write_parquet(dataset / RECORDED, row_group_size=2_000)
    card = json.loads((dataset / CARD).read_text(encoding="utf-8"))
    card["files"] = {name: plain(entry) for name, entry in checksums.file_cards(dataset).items()}
    del card["files"][CARD]
    card["recordings"][0]["rows"]["robot"] = rows.height
    (dataset / CARD).write_text(json.dumps(card), encoding="utf-8")
    assert len(card["files"][RECORDED]["blake3"]) > 5
    return dataset, rows


def test_of_a_large_file_the_pieces_that_are_read_are_checked(large: tuple[Path, pl.DataFrame]):
    dataset, _ = large
    spoil(dataset / RECORDED, "bit")
    opened = Dataset.open(dataset)
    late = opened.recorded_between("run_0", "robot", 150.0, 160.0)
    assert late is not None
    assert late.height == 1001
    with pytest.raises(DatasetError, match="damaged"):
        opened.recorded_between("run_0", "robot", 1.0, 2.0)
    with pytest.raises(DatasetError, match="damaged"):
        opened.recorded("run_0", "robot")


def test_columns_of_a_large_file_are_those_of_the_whole_rows(large: tuple[Path, pl.DataFrame]):
    opened = Dataset.open(large[0])
    execution = opened.executions["execution"][0]
    every, some = opened.native_robot(execution), opened.native_robot(execution, ["tcp_x_m"])
    assert every is not None
    assert some is not None
    assert every.height > 100
    assert some.equals(every.select("tcp_x_m"))


def test_of_a_column_of_a_large_file_only_its_bytes_are_hashed(
    large: tuple[Path, pl.DataFrame], monkeypatch: pytest.MonkeyPatch
):
    hashed: list[int] = []
    before = checksums._hashed_pieces
    monkeypatch.setattr(
        checksums, "_hashed_pieces", lambda file, piece, n: (hashed.extend(n), before(file, piece, n))[1]
    )
    opened = Dataset.open(large[0])
    pl.concat(opened.times("run_0", "robot"))
    pieces = len(opened.card.files[RECORDED].blake3)
    assert 0 < len(set(hashed)) < 0.8 * pieces
    hashed.clear()
    opened.recorded("run_0", "robot")
    assert len(set(hashed)) == pieces


def test_a_column_of_a_large_file_with_a_flipped_bit_is_refused_or_whole(large: tuple[Path, pl.DataFrame]):
    dataset, rows = large
    file, chance = dataset / RECORDED, random.Random(5)
    whole, refused = file.read_bytes(), 0
    for number in range(60):
        place = chance.randrange(len(whole)) if number % 3 else len(whole) - 1 - chance.randrange(5000)
        file.write_bytes(whole[:place] + bytes([whole[place] ^ 1 << chance.randrange(8)]) + whole[place + 1 :])
        try:
            read = pl.concat(Dataset.open(dataset).times("run_0", "robot"))
        except DatasetError:
            refused += 1
        else:
            assert read.equals(rows.select("t_s"))
    assert 20 <= refused < 60


def test_files_listed_in_the_larger_pieces_of_an_earlier_version_are_checked(dataset: Path):
    card = json.loads((dataset / CARD).read_text(encoding="utf-8"))
    for name, entry in card["files"].items():
        whole = (dataset / name).read_bytes()
        card["files"][name] = {"size": entry["size"], "blake3": [blake3(whole).hexdigest()]}
    (dataset / CARD).write_text(json.dumps({k: v for k, v in card.items() if k != "card_blake3"}), encoding="utf-8")
    assert Dataset.open(dataset).verify() == len(card["files"]) + 1
    spoil(dataset / RECORDED, "bit")
    with pytest.raises(DatasetError, match="damaged"):
        Dataset.open(dataset).recorded("run_0", "robot")


def test_a_file_written_again_within_its_time_stamp_is_hashed_again(tmp_path: Path):
    file = tmp_path / "x"
    file.write_bytes(b"one")
    about = file.stat()
    entry = checksums.file_cards(tmp_path)["x"]
    file.write_bytes(b"two")
    os.utime(file, ns=(about.st_atime_ns, about.st_mtime_ns))
    assert checksums.damage_of(file, entry) == "damaged"


@at_most(50)
@given(st.dictionaries(st.text('ab\n"ü', max_size=3), st.text('ab\n"ü', max_size=9), min_size=1), st.data())
def test_a_seal_breaks_with_any_change_of_what_stands_before_it(content: dict[str, str], data: st.DataObject):
    text = checksums.with_checksum(json.dumps(content, indent=1, ensure_ascii=False) + "\n")
    assert json.loads(text) | content == json.loads(text)
    assert not checksums.is_damaged(text)
    place = data.draw(st.integers(0, text.rindex(',\n "card_blake3"') - 1))
    other = data.draw(st.sampled_from('ab\n"ü{ ').filter(lambda c: c != text[place]))
    assert checksums.is_damaged(text[:place] + other + text[place + 1 :])


def test_logs_that_are_no_dataset_cannot_be_verified(logs: Path, capsys: Any):
    assert run(["inspect", str(logs), "--verify"]) == 1
    assert "a dataset was expected" in capsys.readouterr().err
    with pytest.raises(CyclekitError):
        Dataset.open(logs)
