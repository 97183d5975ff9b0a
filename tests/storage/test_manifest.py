"""Manifests that nobody's cyclekit wrote: one message, nothing fetched, nothing written outside of the cache."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.errors import CyclekitError, StorageError
from cyclekit.storage.remote import folders as storage
from cyclekit.storage.remote.manifest import MANIFEST, ManifestEntry, check, parsed, part_of

SHA = "3f9a" * 16
URL = "s3://user:key@plant/cell"


def manifest(name: str = "card", **changes: Any) -> dict[str, Any]:
    entry = {"part": part_of("card", SHA), "size": 5, "sha256": SHA} | changes
    return {"format": "cyclekit-folder", "version": 1, "files": {name: entry}}


def without(key: str) -> dict[str, Any]:
    whole = manifest()
    for part in (whole, whole["files"]["card"]):
        part.pop(key, None)
    return whole


def both(*names: str) -> dict[str, Any]:
    return {name: manifest(name, part=part_of(name, SHA))["files"][name] for name in names}


WRONG: dict[str, Any] = {
    "a way up": manifest("../../../x"),
    "an absolute path": manifest("/etc/x"),
    "a drive": manifest("C:/x"),
    "a backslash": manifest("..\\x"),
    "a NUL": manifest("a\0b"),
    "a surrogate": manifest("a\ud800"),
    "an escape": manifest("\x1b]0;title\x07"),
    "a device": manifest("recordings/nul/robot.parquet"),
    "a dot at the end": manifest("a/.. "),
    "not a name": manifest(""),
    "a hidden file": manifest(".complete"),
    "a long name": manifest("a" * 300),
    "a part outside": manifest(part="../../secret.txt"),
    "a part of another name": manifest(part="parts/other-3f9a3f9a3f9a3f9a3f9a"),
    "an absolute part": manifest(part="/secret.txt"),
    "no checksum": manifest(sha256=None),
    "a short checksum": manifest(sha256="00"),
    "a checksum with a line": manifest(sha256=SHA[:-1] + "\n"),
    "a checksum and a line": manifest(sha256=SHA + "\n"),
    "a size below zero": manifest(size=-1),
    "a size that is text": manifest(size="5"),
    "no part": without("part"),
    "no size": without("size"),
    "no sha256": without("sha256"),
    "no files": without("files"),
    "no format": without("format"),
    "another format": manifest() | {"format": "zip"},
    "another version": manifest() | {"version": 2},
    "files that are a list": manifest() | {"files": ["card"]},
    "an entry that is none": manifest() | {"files": {"card": None}},
    "a list": [],
    "null": None,
    "a file that is a folder": manifest() | {"files": both("a", "a/b")},
}
TEXTS = {why: json.dumps(value).encode() for why, value in WRONG.items()}
TEXTS |= {
    "nested": b'{"files":' * 100_000,
    "nested lists": b"[" * 100_000,
    "nested, closed": b'{"format":"cyclekit-folder","version":1,"x":' + b"[" * 5000 + b"]" * 5000 + b',"files":{}}',
    "no UTF-8": b'{"format": "\xff\xfe"}',
    "nothing": b"",
    "a number without end": b'{"version": 1' + b"0" * 100_000 + b"}",
}


@pytest.mark.parametrize("why", TEXTS)
def test_a_manifest_that_is_wrong_is_one_message_with_place_and_cure(why: str) -> None:
    with pytest.raises(StorageError, match=r"plant/cell: its manifest.json is not one of cyclekit's \(") as caught:
        parsed(TEXTS[why], URL)
    assert caught.value.cure
    assert "key" not in str(caught.value).partition("(")[0]
    assert all(line.isprintable() for line in str(caught.value).splitlines())


def test_a_manifest_that_is_right_is_taken() -> None:
    assert parsed(json.dumps(manifest()).encode(), URL).files == {"card": ManifestEntry(part_of("card", SHA), 5, SHA)}


PIECES = ["..", "/", "\\", "C:", "a", "\0", "\ud800", ".", "con", " ", "\x1b"]
NAMES = st.one_of(
    st.text(max_size=40),
    st.lists(st.sampled_from(["..", "/", "\\", "C:", "a", "\0", "\ud800", ".", "con", " ", "\x1b"]), max_size=7).map(
        "".join
    ),
)
VALUES = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), NAMES),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(NAMES, inner, max_size=3)),
    max_leaves=8,
)
ENTRIES = st.fixed_dictionaries(
    {}, optional={"part": NAMES | VALUES, "size": st.integers() | VALUES, "sha256": st.just(SHA) | VALUES}
)
DOCUMENTS = st.fixed_dictionaries(
    {"format": st.just("cyclekit-folder"), "version": st.just(1)},
    optional={"files": st.dictionaries(NAMES, ENTRIES, max_size=3) | VALUES},
)


@given(DOCUMENTS | VALUES)
def test_no_manifest_ends_in_a_traceback_or_outside(document: Any) -> None:
    for text in (json.dumps(document), json.dumps(document, ensure_ascii=False)):
        try:
            found = parsed(text.encode("utf-8", "surrogatepass"), URL)
        except StorageError as error:
            said = str(error)
        else:
            said = ""
            assert all(part_of(name, entry.sha256) == entry.part for name, entry in found.files.items())
        assert said.replace("\n", "").isprintable()


@given(NAMES)
def test_no_name_with_its_own_part_leads_outside(name: str) -> None:
    try:
        part = part_of(name, SHA)
        check({name: ManifestEntry(part, 1, SHA)})
    except ValueError:
        return
    assert ".." not in Path(name).parts
    assert not Path(name).is_absolute()
    assert "\\" not in name


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    pytest.importorskip("fsspec")
    monkeypatch.setenv("CYCLEKIT_CACHE", str(tmp_path / "cache"))
    storage.write_text(f"memory://{tmp_path.name}/secret.txt", "whole")
    return f"memory://{tmp_path.name}/thing"


@pytest.mark.parametrize("why", ["a way up", "a part outside", "no checksum", "a hidden file", "nested", "a drive"])
def test_of_a_wrong_manifest_nothing_is_fetched_and_nothing_written(why: str, place: str, tmp_path: Path) -> None:
    storage.write_text(f"{place}/{MANIFEST}", TEXTS[why].decode())
    with pytest.raises(StorageError, match="not one of cyclekit's"):
        storage.local(place)
    assert [file for file in tmp_path.rglob("*") if file.is_file()] == []


def test_a_part_larger_than_its_manifest_says_is_not_kept(place: str, tmp_path: Path) -> None:
    with storage.published(place) as folder:
        folder.mkdir(parents=True)
        (folder / "card").write_text("x" * 100)
    document = json.loads(storage.read_text(f"{place}/{MANIFEST}") or "")
    document["files"]["card"]["size"] = 5
    storage.write_text(f"{place}/{MANIFEST}", json.dumps(document))
    with pytest.raises(StorageError, match="does not match its manifest"):
        storage.local(place)


def test_what_a_cached_folder_was_made_of_may_be_cut(place: str, tmp_path: Path) -> None:
    with storage.published(place) as folder:
        folder.mkdir(parents=True)
        (folder / "card").write_text("one")
    for text in ("", "{", '{"card": 1}', "[" * 100_000):
        folder.with_name(f"{folder.name}.json").write_text(text)
        assert (storage.local(place) / "card").read_text() == "one"


def test_what_a_link_leads_to_and_what_is_hidden_is_not_published(place: str, tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("secret")
    with storage.published(place) as folder:
        folder.mkdir(parents=True)
        (folder / "card").write_text("one")
        (folder / "stolen").symlink_to(tmp_path / "secret")
        (folder / ".DS_Store").write_text("x")
    document = json.loads(storage.read_text(f"{place}/{MANIFEST}") or "")
    assert list(document["files"]) == ["card"]


def test_a_folder_that_nobody_could_fetch_is_not_published(place: str) -> None:
    def published() -> None:
        with storage.published(place) as folder:
            folder.mkdir(parents=True)
            (folder / "a\\b").write_text("one")

    with pytest.raises(CyclekitError, match="cannot be published"):
        published()


@pytest.mark.parametrize("key", ["..\\..\\x.csv", "con.csv", "a\nb.csv"])
def test_logs_at_a_url_stay_in_the_cache(key: str, place: str, tmp_path: Path) -> None:
    from cyclekit.storage.remote.file_system import opened, put

    system, base = opened(f"{place}/logs")
    put(system, f"{base}/{key}", b"x")
    with pytest.raises(StorageError, match="cannot be used as the name of a file"):
        storage.mirrored(f"{place}/logs")


def test_the_checks_stand_in_an_optimised_interpreter_too() -> None:
    document = msgspec.json.encode(manifest("../../../x")).decode()
    program = (
        "from cyclekit.errors import StorageError\nfrom cyclekit.storage.remote.manifest import parsed\n"
        f"try:\n    parsed({document.encode()!r}, 's3://b/x')\nexcept StorageError:\n    print('refused', __debug__)\n"
    )
    done = subprocess.run([sys.executable, "-O", "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "refused False"
