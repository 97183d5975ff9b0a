"""Bombs among text logs: packed ones, endless lines and headers, JSON too deep or too long, times that cannot be."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

from reliability.explosives import CSV_CELL, GIB, UR, UR_HEADER, bomb, gzip_of, put, repeated, sparse, zstd_of


@bomb("zstd CSV of 8 GiB of zeros")
def _(folder: Path) -> Path:
    return put(folder, "run.csv.zst", zstd_of(UR.encode(), b"0" * (1 << 20), 8 << 10))


@bomb("gzip CSV of 1 GiB of rows", slow=True)
def _(folder: Path) -> Path:
    row = UR.split("\r\n")[1].encode() + b"\r\n"
    return put(folder, "run.csv.gz", gzip_of(UR.encode(), row * 5000, GIB // (5000 * len(row))))


@bomb("gzip CSV of 2 GiB without a line end")
def _(folder: Path) -> Path:
    return put(folder, "run.csv.gz", gzip_of(UR_HEADER.encode(), bytes(1 << 20), 2 << 10))


@bomb("gzip in gzip in gzip of 2 GiB")
def _(folder: Path) -> Path:
    return put(folder, "run.csv.gz", gzip.compress(gzip.compress(gzip_of(UR.encode(), bytes(1 << 20), 2 << 10))))


@bomb("17,000 columns")
def _(folder: Path) -> Path:
    names = [*UR_HEADER.split(","), *(f"signal_{i}" for i in range(17_000))]
    rows = [line + ",0" * 17_000 for line in UR.split("\r\n")[1:-1]]
    return put(folder, "run.csv", "\r\n".join([",".join(names), *rows, ""]).encode())


@bomb("1,000,000 columns")
def _(folder: Path) -> Path:
    names = [*UR_HEADER.split(","), *(f"s{i}" for i in range(1_000_000))]
    return put(folder, "run.csv", (",".join(names) + "\n" + ",".join(["0"] * len(names)) + "\n").encode())


@bomb("header line of 100 MB")
def _(folder: Path) -> Path:
    return repeated(folder / "run.csv", b"x" * (1 << 20), 100, (UR_HEADER + ",").encode(), b"\r\n1\r\n")


@bomb("line of 1 GB of NULs below a header")
def _(folder: Path) -> Path:
    return sparse(folder / "run.csv", GIB, UR.encode())


@bomb("line of 1 GB of digits", slow=True)
def _(folder: Path) -> Path:
    return repeated(folder / "run.csv", b"1" * (1 << 24), 64, UR.encode())


@bomb("1 GB of one cell after another", slow=True)
def _(folder: Path) -> Path:
    return repeated(folder / "run.csv", b"1," * (1 << 23), 64, UR.encode())


@bomb("200 MB of line feeds")
def _(folder: Path) -> Path:
    return repeated(folder / "run.csv", b"\n" * (1 << 20), 200, UR.encode())


@bomb("200 MB of carriage returns")
def _(folder: Path) -> Path:
    return repeated(folder / "run.csv", b"\r" * (1 << 20), 200, UR.encode())


@bomb("60 MB of delimiters in lines")
def _(folder: Path) -> Path:
    return repeated(folder / "run.csv", (b"," * 19 + b"\n") * 50_000, 60, UR.encode())


@bomb("60 MB of single characters in lines")
def _(folder: Path) -> Path:
    return repeated(folder / "run.csv", b"7\n" * 500_000, 60, UR.encode())


@bomb("quoted cell of 200 MB that is never closed")
def _(folder: Path) -> Path:
    rows = b't,x,y,id\n0,1,2,a\n1,1,2,"'
    repeated(folder / "people.csv", b"x,y\n" * (1 << 18), 200, rows)
    words = CSV_CELL.format(name="people.csv", role="people", map='time = "t", x = "x", y = "y", person = "id"')
    put(folder, "cell.toml", words.encode())
    return folder


@bomb("JSON nested 100,000 deep")
def _(folder: Path) -> Path:
    deep = b'{"1700000000000": {"body_list": [{"keypoint": ' + b"[" * 100_000 + b"]" * 100_000 + b"}]}}"
    return put(folder, "bodies.json", deep)


@bomb("JSON of one text of 500 MB", slow=True)
def _(folder: Path) -> Path:
    return repeated(folder / "bodies.json", b"a" * (1 << 20), 500, b'{"1700000000000": {"body_list": "', b'"}}')


@bomb("JSON of 20 million empty lists")
def _(folder: Path) -> Path:
    return repeated(folder / "bodies.json", b"[]," * 1_000_000, 20, b"[", b"[]]")


@bomb("JSON with numbers of a million digits")
def _(folder: Path) -> Path:
    return put(folder, "bodies.json", b'{"1700000000000": {"body_list": [], "timestamp": ' + b"9" * 1_000_000 + b"}}")


@bomb("log whose time jumps ahead by 300 years")
def _(folder: Path) -> Path:
    rows = UR.split("\r\n")
    rows[-5:-1] = [row.replace(row.split(",")[0], f"{1e10 + i}", 1) for i, row in enumerate(rows[-5:-1])]
    return put(folder, "run.csv", "\r\n".join(rows).encode())


@bomb("people seen once in 300 years")
def _(folder: Path) -> Path:
    put(folder, "people.csv", b"t,x,y,id\n0,1,2,a\n1,1,2,a\n1e10,1,2,a\n")
    words = CSV_CELL.format(name="people.csv", role="people", map='time = "t", x = "x", y = "y", person = "id"')
    put(folder, "cell.toml", words.encode())
    return folder


@bomb("200,000 people of one row each")
def _(folder: Path) -> Path:
    rows = "".join(f"{i * 0.01:.2f},1,2,p{i}\n" for i in range(200_000))
    put(folder, "people.csv", f"t,x,y,id\n{rows}".encode())
    words = CSV_CELL.format(name="people.csv", role="people", map='time = "t", x = "x", y = "y", person = "id"')
    put(folder, "cell.toml", words.encode())
    return folder


@bomb("JSON that is a list of numbers of NaN and Infinity")
def _(folder: Path) -> Path:
    body = {"id": 1, "keypoint": [[float("nan"), float("inf"), -float("inf")]] * 34}
    text = json.dumps({str(1_700_000_000_000 + i): {"is_tracked": True, "body_list": [body]} for i in range(50)})
    return put(folder, "bodies.json", text.encode())
