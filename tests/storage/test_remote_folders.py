"""Folders on shared storage, against a real S3 server: whole or not at all, fetched once, never half."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from pyarrow import fs

from cyclekit.cli import run
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import DatasetError, StorageError
from cyclekit.learning.networks.saved import load_model
from cyclekit.storage.remote import folders as storage
from cyclekit.storage.remote import parts


@pytest.fixture(params=["s3", "memory"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """A URL where nothing is, of an object store and of a file system of fsspec's."""
    if request.param == "s3":
        return f"{request.getfixturevalue('bucket')}/{tmp_path.name}/thing"
    pytest.importorskip("fsspec")
    return f"memory://{tmp_path.name}/thing"


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Return a way to become another machine, whose cache is empty."""

    def become(name: str) -> None:
        monkeypatch.setenv("CYCLEKIT_CACHE", str(tmp_path / name))

    become("first")
    return become


def publish(place: str, **files: str) -> None:
    """Publish exactly these files; `_` in a name is a folder."""
    with storage.published(place) as folder:
        for old in [path for path in folder.rglob("*") if path.is_file()]:
            old.unlink()
        for name, text in files.items():
            file = folder / name.replace("_", "/")
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")


def seen(place: str) -> dict[str, str]:
    folder = storage.local(place)
    files = [file for file in folder.rglob("*") if file.is_file()]
    return {file.relative_to(folder).as_posix(): file.read_text(encoding="utf-8") for file in files}


def test_what_is_published_is_what_another_machine_finds(place: str, elsewhere) -> None:
    publish(place, card="one", sub_part="a")
    elsewhere("second")
    assert seen(place) == {"card": "one", "sub/part": "a"}
    elsewhere("first")
    publish(place, card="two", more_part="b")
    elsewhere("second")
    assert seen(place) == {"card": "two", "more/part": "b"}


def test_only_what_is_new_is_sent_and_fetched(bucket: str, tmp_path: Path, elsewhere, monkeypatch) -> None:
    place, moved = f"{bucket}/{tmp_path.name}/thing", []
    for module, name in ((parts, "send"), (parts, "fetch")):
        whole = getattr(module, name)
        monkeypatch.setattr(module, name, lambda *a, _n=name, _w=whole: (moved.append(_n), _w(*a)))
    publish(place, one="1", two="2", three="3")
    publish(place, one="1", two="2", three="changed")
    assert moved == ["send"] * 4
    elsewhere("second")
    assert seen(place)["three"] == "changed"
    assert seen(place)["three"] == "changed"
    assert moved[4:] == ["fetch"] * 3


def test_until_the_manifest_is_put_who_reads_finds_the_old_folder(place: str, elsewhere, monkeypatch) -> None:
    publish(place, card="old", part="old")

    def broken(*_: object) -> None:
        raise OSError("the line is down")

    with monkeypatch.context() as patch:
        patch.setattr(parts, "put", broken)  # all parts are there by then
        with pytest.raises(StorageError, match=r"cannot be written \(the line is down\)"):
            publish(place, card="new", part="new")
    assert seen(place) == {"card": "old", "part": "old"}  # on the machine that failed as well
    elsewhere("second")
    assert seen(place) == {"card": "old", "part": "old"}


def test_work_that_fails_publishes_nothing(place: str, elsewhere) -> None:
    publish(place, card="old")

    def fails() -> None:
        with storage.published(place) as folder:
            (folder / "card").write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fails()
    assert seen(place) == {"card": "old"}


def test_a_part_that_is_damaged_on_its_way_is_refused(bucket: str, tmp_path: Path, elsewhere) -> None:
    place = f"{bucket}/{tmp_path.name}/thing"
    publish(place, card="whole")
    system, base = fs.FileSystem.from_uri(place)
    (part,) = system.get_file_info(fs.FileSelector(f"{base}/parts"))
    with system.open_output_stream(part.path) as stream:
        stream.write(b"whale")
    elsewhere("second")
    with pytest.raises(StorageError, match="does not match its manifest"):
        storage.local(place)


def test_a_manifest_that_leads_out_of_the_folder_is_refused(bucket: str, tmp_path: Path, elsewhere) -> None:
    place = f"{bucket}/{tmp_path.name}/thing"
    publish(place, card="whole")
    manifest = json.loads(storage.read_text(f"{place}/manifest.json") or "")
    manifest["files"]["../../evil"] = manifest["files"].pop("card")
    storage.write_text(f"{place}/manifest.json", json.dumps(manifest))
    elsewhere("second")
    with pytest.raises(StorageError, match="not one of cyclekit's"):
        storage.local(place)


def test_parts_that_nobody_can_be_reading_any_more_are_removed(bucket: str, tmp_path: Path, elsewhere, monkeypatch):
    place = f"{bucket}/{tmp_path.name}/thing"
    publish(place, card="one")
    publish(place, card="two")
    system, base = fs.FileSystem.from_uri(place)
    assert len(system.get_file_info(fs.FileSelector(f"{base}/parts"))) == 2
    monkeypatch.setattr(parts, "_GRACE", -parts._GRACE)
    publish(place, card="three")
    assert len(system.get_file_info(fs.FileSelector(f"{base}/parts"))) == 1
    assert seen(place) == {"card": "three"}


def test_a_file_url_is_the_folder_itself(tmp_path: Path) -> None:
    with storage.published((tmp_path / "a b").as_uri()) as folder:
        assert folder == tmp_path / "a b"
    storage.write_text((tmp_path / "note").as_uri(), "ü")
    assert storage.read_text((tmp_path / "note").as_uri()) == "ü"
    assert storage.read_text((tmp_path / "none").as_uri()) is None


@pytest.mark.parametrize("path", ["logs", "C:\\logs", "C://logs", "/a/b", "../x", "a:b"])
def test_a_path_is_no_url(path: str) -> None:
    assert not storage.is_url(path)
    assert storage.local(path) == Path(path)


@pytest.mark.parametrize(
    ("place", "name", "whole"),
    [
        ("s3://b/x/", "y", "s3://b/x/y"),
        ("s3://b/x?endpoint_override=h", "y", "s3://b/x/y?endpoint_override=h"),
        ("a", "b", str(Path("a") / "b")),
    ],
)
def test_a_name_is_joined_to_a_place(place: str, name: str, whole: str) -> None:
    assert storage.join(place, name) == whole


def test_an_address_that_is_none_or_empty_says_so_without_its_secrets(bucket: str, elsewhere) -> None:
    with pytest.raises(StorageError, match="nothing is published there"):
        Dataset.open(f"{bucket}/nowhere")
    with pytest.raises(StorageError, match="not a usable address") as caught:
        Dataset.open("nosuch://user:secret@host/x?key=hidden")
    assert "secret" not in str(caught.value).partition(":")[2].partition("(")[0]
    with pytest.raises(DatasetError, match="no such folder"):
        Dataset.open("nowhere")


@pytest.mark.slow  # quick: the parts of it here
def test_logs_in_a_bucket_become_a_dataset_and_a_model_in_it(
    bucket: str, small_cell: Path, elsewhere, capsys: pytest.CaptureFixture[str]
) -> None:
    system, _ = fs.FileSystem.from_uri(bucket)
    logs = [file for file in (small_cell / "logs").rglob("*") if file.is_file()]
    for file in logs:
        with system.open_output_stream(f"plant/logs/{file.relative_to(small_cell / 'logs').as_posix()}") as stream:
            stream.write(file.read_bytes())
    words = ["ingest", f"{bucket}/logs", "--out", f"{bucket}/dataset", "--json", "--quiet"]
    assert run(words) == 0
    done = json.loads(capsys.readouterr().out)
    assert (done["dataset"], done["recordings_new"], done["unchanged"]) == (f"{bucket}/dataset", 6, False)
    assert run(words) == 0
    assert json.loads(capsys.readouterr().out)["unchanged"]
    system.delete_dir_contents("plant/logs/day_1")
    elsewhere("second")
    assert run(words) == 0
    assert json.loads(capsys.readouterr().out)["recordings_new"] == 3
    kept = Dataset.open(f"{bucket}/dataset")
    assert kept.executions["session"].unique().to_list() == ["day_0"]
    assert kept.tasks().height > 0
    storage_model = f"{bucket}/model"
    from cyclekit.learning.networks.saved import save_model

    save_model(storage_model, load_model(small_cell / "model"))
    elsewhere("third")
    assert load_model(storage_model).card == load_model(small_cell / "model").card
    assert run(["inspect", storage_model, "--json"]) == 0
