"""Cards, manifests, cell files and sequence files as somebody writes them who means harm; Hypothesis draws them.

Each is a real one with one or two places replaced by hostile values, one whose parts fit together and lead out of its
folder, any JSON, or any bytes. `benchmarks/hostile_input.py` opens them.
"""

from __future__ import annotations

import contextlib
import copy
import json
from collections.abc import Iterator
from hashlib import sha256
from typing import Any

from hypothesis import strategies as st

from cyclekit.storage.remote.manifest import part_of

SECRET = "secret of another folder"
"""What lies beside the folder of a document; nothing may read it."""
TEXTS = (
    "", "a", "../../outside", "..", "/etc/passwd", "C:/x", "C:\\x", "..\\..\\x", "a/b", "\x1b]0;title\x07", "\x1b[2J",
    "x\nFORGED: all is well", "x\rFORGED", "\u202egnp.exe", "\u0000", "\x9b31m", "n" * 300, "ü" * 130, "<script>",
    "\ud800", "NaN", "2026-02-31", "0" * 64, "CON", "x:y", "../secret.txt", "=1+1",
)  # fmt: skip
NUMBERS = (0, -1, 1, 3.4e38, -3.4e38, 1e308, 1e-308, 10**400, 2**63, 2**64, -(2**63), 10**18, 0.5, 1.0, True, False)
VALUES = st.one_of(
    st.sampled_from([*TEXTS, *NUMBERS, None]),
    st.text(max_size=8),
    st.recursive(
        st.sampled_from([*TEXTS, *NUMBERS, None]),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(TEXTS), inner, max_size=3),
        max_leaves=4,
    ),
)
TOML_VALUES = (
    '""', "nan", "-inf", "1e308", "0", "-1", "2026-01-01", "07:30:00", "true", "[]", "{}", "[[]]", "[1, 'a']",
    f"{10**400}", '"\\u001b[2J"', '"x\\nFORGED"', '"../../x"', '"\\u202ex"', f'"{"n" * 300}"', "[" * 2000,
    "{a = 1979-05-27T07:32:00Z}", "{a = nan}", "[nan, nan, nan]", "[0, 0]", "[1e300, 0, 0]", "'home'", '"\\u0000"',
)  # fmt: skip
CELL = """
name = "cell"
ignore = ["*.txt"]
reference = ["free/*"]
levels = [0.0, 0.5, 1.0]
rate_hz = 10.0
bridge_s = 0.3
[[sources]]
path = "robot.csv"
adapter = "csv"
role = "robot"
clock_rate = 1.0
clock_offset_s = 0.5
rate_hz = 125.0
frame = {xyz_m = [0, 0, 0], yaw_deg = 90}
map = {time = "t", x = "x"}
[[sources]]
path = "people.csv"
sync = {robot = "register", other = "button"}
start = "2026-03-02T14:03:11+01:00"
[[sources]]
path = "other.csv"
sync_events = [[1.0, 2.0], [3.0, 4.0]]
[places.home]
xyz_m = [0.4, 0.0, 0.4]
radius_m = 0.05
[human_places.desk]
xyz_m = [1.4, 0.0, 0.4]
[furniture.table]
xyz_m = [1.4, 0.0, 0.4]
size_m = [1, 1, 1]
yaw_deg = 30
[executions]
begin = "signal"
gap_s = 2.0
home = "home"
bit = 3
signal = "start=1"
"""
SEQUENCES = """
[[sequence]]
name = "A"
places = ["home", "left", "home"]
operator = ["desk", "shelf"]
[[sequence]]
name = "B"
tasks = ["home->left", "left->home"]
"""


def places_in(value: object, way: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Yield the way to every value in a JSON document."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        yield (*way, key)
        yield from places_in(inner, (*way, key))


def documents(real: dict[str, Any]) -> st.SearchStrategy[bytes]:
    """Return a strategy of texts: `real` with places replaced, any JSON, any bytes."""
    ways = list(places_in(real))

    def changed(changes: list[tuple[tuple[str | int, ...], Any]]) -> bytes:
        document = copy.deepcopy(real)
        for way, value in changes:
            inner: Any = document
            with contextlib.suppress(KeyError, IndexError, TypeError):
                for key in way[:-1]:
                    inner = inner[key]
                if value == "\ud800":
                    del inner[way[-1]]
                else:
                    inner[way[-1]] = value
        return json.dumps(document).encode()

    def at(way: tuple[str | int, ...]) -> object:
        found: Any = real
        for key in way:
            found = found[key]
        return found

    def alike(way: tuple[str | int, ...]) -> st.SearchStrategy[tuple[tuple[str | int, ...], Any]]:
        old = at(way)
        kind = TEXTS if isinstance(old, str) else NUMBERS if isinstance(old, int | float) else None
        return st.tuples(st.just(way), st.sampled_from(kind) if kind else VALUES)  # else nearly all are refused at once

    some, texts = st.sampled_from(ways), st.sampled_from([way for way in ways if isinstance(at(way), str)])
    change = st.one_of(some.flatmap(alike), texts.flatmap(alike), texts.flatmap(alike), st.tuples(some, VALUES))
    plain = st.lists(change, min_size=1, max_size=2).map(changed)
    cut = st.tuples(plain, st.integers(0, 200)).map(lambda found: found[0][: -found[1] or None])
    deep = st.sampled_from([b"[" * 100_000, b'{"a":' * 5000, b"NaN", b"", b"\xff\xfe", b'{"a": 1e999}'])
    anything = VALUES.map(lambda value: json.dumps(value).encode())
    return mostly(plain, st.one_of(cut, anything, st.binary(), deep))


def mostly(usual: st.SearchStrategy[bytes], other: st.SearchStrategy[bytes]) -> st.SearchStrategy[bytes]:
    """Return a strategy that draws from `usual` nine times of ten."""
    return st.integers(0, 9).flatmap(lambda number: usual if number else other)


def toml_texts(real: str) -> st.SearchStrategy[bytes]:
    """Return a strategy of texts: `real` with values of lines replaced, lines doubled and dropped, any bytes."""
    lines = real.strip().splitlines()

    def changed(changes: list[tuple[int, str, str]]) -> bytes:
        text = list(lines)
        for at, how, value in changes:
            key = text[at].partition("=")[0]
            ways = {"value": f"{key}= {value}", "drop": "", "twice": f"{text[at]}\n{text[at]}", "key": f"{value} = 1"}
            text[at] = ways[how]
        return "\n".join(text).encode("utf-8", "surrogatepass")

    hows = st.sampled_from(["value", "value", "value", "drop", "twice", "key"])
    change = st.tuples(st.integers(0, len(lines) - 1), hows, st.sampled_from(TOML_VALUES))
    return mostly(st.lists(change, min_size=1, max_size=2).map(changed), st.binary())


def entry_of(part: str, data: bytes) -> dict[str, Any]:
    """Return what a manifest says of a file that is kept as this part."""
    return {"part": part, "size": len(data), "sha256": sha256(data).hexdigest()}


def manifest_of(files: dict[str, dict[str, Any]]) -> bytes:
    """Return a manifest of these files."""
    return json.dumps({"format": "cyclekit-folder", "version": 1, "files": files}).encode()


def forged_cards(real: dict[str, Any]) -> st.SearchStrategy[bytes]:
    """Return a strategy of dataset cards that are right but for a recording whose tables would lie elsewhere."""

    def forged(ident: str) -> bytes:
        first, *others = real["recordings"]
        return json.dumps({**real, "recordings": [{**first, "id": ident}, *others]}).encode()

    return st.sampled_from(("../../outside", "a/../../../outside", "..", "/etc", "..\\..\\outside")).map(forged)


def forged_manifests() -> st.SearchStrategy[bytes]:
    """Return a strategy of manifests in which all fits together, but a name or a part leads out of the folder."""

    def forged(name: str, follow: bool) -> bytes:
        data = b"one" if follow else SECRET.encode()
        entry = entry_of("../secret.txt", data)
        if follow:
            with contextlib.suppress(ValueError):  # no part can be called like that
                entry["part"] = part_of(name, entry["sha256"])
        return manifest_of({name: entry})

    names = st.sampled_from([*TEXTS, "../../../outside.txt", "b/../../../outside.txt"]) | st.text(max_size=8)
    return st.builds(forged, names, st.booleans())


def forged_parts(content: bytes, known: dict[str, bytes]) -> dict[str, bytes]:
    """Return the parts that a manifest speaks of and that are not there yet, where it can be read."""
    try:
        entries = json.loads(content)["files"].values()
        parts = [entry["part"] for entry in entries]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}
    return {part: b"one" for part in parts if str(part).startswith("parts/") and part not in known}
