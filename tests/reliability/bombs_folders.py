"""Bombs in the place of a log: folders too large, too deep or in circles, what is no file, cell files."""

from __future__ import annotations

import os
import socket
from pathlib import Path

from reliability.explosives import GIB, UR, bomb, put, repeated, sparse, with_a_log


@bomb("cell file nested 100,000 deep")
def _(folder: Path) -> Path:
    put(folder, "run.csv", UR.encode())
    put(folder, "cell.toml", b"x = " + b"[" * 100_000)
    return folder


@bomb("cell file of 50 MB")
def _(folder: Path) -> Path:
    put(folder, "run.csv", UR.encode())
    repeated(folder / "cell.toml", b"# no words\n" * 100_000, 46)
    return folder


@bomb("folder with 50,000 files")
def _(folder: Path) -> Path:
    for number in range(50_000):
        (folder / f"note_{number}.txt").write_bytes(b"nothing of interest\n")
    return with_a_log(folder)


@bomb("folder with links in circles")
def _(folder: Path) -> Path:
    below = folder / "a" / "b"
    below.mkdir(parents=True)
    for name in ("up", "top", "again", "more"):
        (below / name).symlink_to(folder, target_is_directory=True)
    (folder / "self").symlink_to("self")
    (folder / "one").symlink_to("two")
    (folder / "two").symlink_to("one")
    return with_a_log(folder)


@bomb("folder with a pipe, a socket and devices")
def _(folder: Path) -> Path:
    os.mkfifo(folder / "pipe.csv")
    os.mkfifo(folder / "pipe.bag")
    for name, device in (("zero.csv", "/dev/zero"), ("null.bag", "/dev/null"), ("random.mcap", "/dev/urandom")):
        (folder / name).symlink_to(device)
    here = Path.cwd()
    os.chdir(folder)  # the name of a socket must be short
    try:
        with socket.socket(socket.AF_UNIX) as door:
            door.bind("socket.csv")
    finally:
        os.chdir(here)
    return with_a_log(folder)


@bomb("pipe named as the log")
def _(folder: Path) -> Path:
    os.mkfifo(folder / "run.csv")
    return folder / "run.csv"


@bomb("device named as the log")
def _(folder: Path) -> Path:
    (folder / "run.csv").symlink_to("/dev/zero")
    return folder / "run.csv"


@bomb("folder 2,000 deep")
def _(folder: Path) -> Path:
    with_a_log(folder)
    here = os.open(folder, os.O_RDONLY)
    for _ in range(2_000):
        os.mkdir("d", dir_fd=here)  # such a path cannot be named
        below = os.open("d", os.O_RDONLY, dir_fd=here)
        os.close(here)
        here = below
    os.close(here)
    return folder


@bomb("names that are no text")
def _(folder: Path) -> Path:
    for name in (b"run\xff.csv", b"run\n.csv", b"run\x1b[2J.csv", b"run\r.csv", b'run"; rm.csv'):
        (folder / os.fsdecode(name)).write_bytes(UR.encode())
    return folder


@bomb("2 GB of zeros under every name")
def _(folder: Path) -> Path:
    for ending in ("csv", "mcap", "bag", "db3", "c3d", "json", "tsv", "bin"):
        sparse(folder / f"run.{ending}", 2 * GIB)
    return with_a_log(folder)


@bomb("magic words with nothing behind them")
def _(folder: Path) -> Path:
    heads = {"mcap": b"\x89MCAP0\r\n", "bag": b"#ROSBAG V2.0\n", "db3": b"SQLite format 3\0", "csv.gz": b"\x1f\x8b",
             "csv.zst": b"\x28\xb5\x2f\xfd", "c3d": b"\x02\x50", "json": b'{"1700000000000": {"body_list"'}  # fmt: skip
    for ending, head in heads.items():
        sparse(folder / f"zeros.{ending}", GIB, head)
        put(folder, f"short.{ending}", head)
    return with_a_log(folder)
