"""Bombs: small bags that unpack to gigabytes or contain false sizes; each is read in a separate process.

Each file also holds an intact recording of one second (125 poses), so the best result is these poses and a warning
about the rest. Printed for each: the result of the reader's process, its wall and CPU time, and its peak memory. A run
that ends with a traceback, takes over a minute or uses more than 1.5 GiB is marked.

    python benchmarks/bag_bombs.py      # Linux, which reports the peak memory of a process
"""

from __future__ import annotations

import argparse
import bz2
import re
import sqlite3
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache
from io import BytesIO
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]  # no type stubs
from backports import zstd
from bag_damage import write
from mcap.reader import make_reader
from rich.console import Console
from rich.table import Table

from cyclekit.adapter import ReadOptions
from cyclekit.errors import CyclekitError
from cyclekit_adapters.rosbag import ADAPTER

GIB = 1 << 30
LIMIT_BYTES, LIMIT_S = 3 * GIB // 2, 60


@cache
def zeros(kind: str, size: int) -> bytes:
    """Return `size` zeros as a small compressed frame."""
    piece = bytes(1 << 24)
    pack = {"zstd": zstd.ZstdCompressor(), "bz2": bz2.BZ2Compressor(), "lz4": lz4.frame.LZ4FrameCompressor()}[kind]
    begin = pack.begin() if kind == "lz4" else b""
    return begin + b"".join(pack.compress(piece) for _ in range(size // len(piece))) + pack.flush()


def mcap_chunk(stored: bytes, size: int, compression: str = "zstd") -> bytes:
    """Return a chunk record of an mcap."""
    name = compression.encode()
    body = struct.pack("<QQQII", 0, 1, size, 0, len(name)) + name + struct.pack("<Q", len(stored)) + stored
    return struct.pack("<BQ", 6, len(body)) + body


def bag_record(fields: dict[str, bytes], data: bytes) -> bytes:
    """Return a record of a ROS 1 bag."""
    header = b"".join(
        struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value for name, value in fields.items()
    )
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def bag_chunk(stored: bytes, size: int, compression: str) -> bytes:
    """Return a chunk of a ROS 1 bag."""
    return bag_record({"op": b"\5", "compression": compression.encode(), "size": struct.pack("<I", size)}, stored)


def mcaps(whole: bytes) -> dict[str, bytes]:
    """Return the bombs as mcap: before the first chunk, or at the end of a truncated file."""
    summary = make_reader(BytesIO(whole)).get_summary()
    assert summary is not None
    at = summary.chunk_indexes[0].chunk_start_offset

    def before(record: bytes) -> bytes:
        return whole[:at] + record + whole[at:]

    eight = zeros("zstd", 8 * GIB)
    half = struct.pack("<BQ", 5, 1 << 62)  # message record with a length of 2^62 bytes
    many = struct.pack("<BQ", 5, 0) * 10_000_000
    cut = mcap_chunk(eight, 8 * GIB)
    return {
        f"{len(eight) // 1000} kB that unpack to 8 GiB, and say so": before(mcap_chunk(eight, 8 * GIB)),
        "8 GiB that say they are 100 bytes": before(mcap_chunk(eight, 100)),
        "8 GiB that say they are just below a thousand times what is stored": before(
            mcap_chunk(eight, min(GIB, 999 * len(eight)))
        ),
        "8 GiB in lz4 that say they are 100 MB": before(mcap_chunk(zeros("lz4", 8 * GIB), 100 << 20, "lz4")),
        "100 bytes that say they are 2^63": before(mcap_chunk(bytes(100), 1 << 63)),
        "a record that says it is 2^62 bytes": before(half),
        "ten million empty records in one chunk": before(mcap_chunk(many, len(many), "")),
        "8 GiB in the chunk within which the file ends": whole[:at] + cut[: len(cut) // 2],
    }


def bags(whole: bytes) -> dict[str, bytes]:
    """Return the bombs as ROS 1 bag."""
    head = whole.index(b"\n") + 1
    head += 4 + struct.unpack_from("<I", whole, head)[0]
    head += 4 + struct.unpack_from("<I", whole, head)[0]
    four, small = 4 * GIB - 1, zeros("bz2", GIB)
    return {
        f"{len(small)} bytes of bz2 that say they are 4 GiB": whole[:head]
        + bag_chunk(small, four, "bz2")
        + whole[head:],
        "1 GiB of bz2 that says it is 1000 bytes": whole[:head] + bag_chunk(small, 1000, "bz2") + whole[head:],
        "8 GiB of lz4 that say they are 1 GiB": whole[:head]
        + bag_chunk(zeros("lz4", 8 * GIB), GIB, "lz4")
        + whole[head:],
        "a header that says it is 4 GiB": whole[:head] + b"\xff" * 8 + whole[head:],
        "a chunk without compression that says it is 4 GiB": whole[:head]
        + bag_chunk(bytes(50), four, "none")
        + whole[head:],
    }


def lying_db3(path: Path, new: Callable[[bytes], bytes]) -> None:
    """Change every twentieth payload of a sqlite bag."""
    with sqlite3.connect(path) as base:
        for number, data in base.execute("SELECT id, data FROM messages WHERE id % 20 = 0").fetchall():
            base.execute("UPDATE messages SET data = ? WHERE id = ?", (new(data), number))
    base.close()


def make(folder: Path) -> dict[str, Path]:
    """Write all bombs; return their paths by name."""
    found: dict[str, Path] = {}
    for kind, bombs in (("mcap", mcaps), ("ros1", bags)):
        (folder / kind).mkdir()
        whole = write(folder / kind, kind, 1)
        for number, (name, content) in enumerate(bombs(whole.read_bytes()).items()):
            found[f"{kind}: {name}"] = folder / f"{kind}{number}{whole.suffix}"
            found[f"{kind}: {name}"].write_bytes(content)
    lies = {
        "payloads that say their lists are 2^32 long": lambda raw: raw[:12] + b"\xff" * 4 + raw[16:],
        "payloads of 5 MB of zeros": lambda raw: raw[:8] + bytes(5 << 20),
        "empty payloads": lambda _: b"",
    }
    for number, (name, lie) in enumerate(lies.items()):
        (folder / f"db{number}").mkdir()
        found[f"db3: {name}"] = write(folder / f"db{number}", "db3", 1)
        lying_db3(found[f"db3: {name}"], lie)
    return found


def once(path: Path) -> None:
    """Read one bag; print the result, the CPU time in seconds, and the peak memory of the process in bytes."""
    try:
        log = ADAPTER.read(path, ReadOptions())
    except CyclekitError as refusal:
        print(f"refused: {str(refusal).replace(str(path), '').splitlines()[0][:70]}")
    else:
        rows, aside = (table.height if table is not None else 0 for table in (log.robot, log.set_aside))
        print(f"{rows} rows, {aside} set aside, {len(log.warnings)} warnings")
    # getrusage on Linux starts with the peak memory of the parent
    peak = int(re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())[1]) * 1024  # type: ignore[index]
    print(time.process_time(), peak)


def main() -> None:
    """Write the bombs, read each, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--once", type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.once:
        once(asked.once)
        return
    table = Table(title="bombs")
    for name in ("bomb", "kB", "result", "s", "cpu s", "MiB", ""):
        table.add_column(name)
    with tempfile.TemporaryDirectory() as folder:
        for name, path in make(Path(folder)).items():
            kb, begin = f"{path.stat().st_size / 1000:.0f}", time.perf_counter()
            call = [sys.executable, __file__, "--once", str(path)]
            try:
                done = subprocess.run(call, check=False, capture_output=True, text=True, timeout=LIMIT_S)
            except subprocess.TimeoutExpired:
                table.add_row(name, kb, f"nothing after {LIMIT_S} s", "", "", "", "BAD")
                continue
            seconds = time.perf_counter() - begin
            said, _, told = done.stdout.strip().rpartition("\n")
            cpu_s, peak = map(float, told.split() or ("nan", "nan"))
            bad = done.returncode != 0 or bool(done.stderr) or peak > LIMIT_BYTES
            said = said or done.stderr.strip().rpartition("\n")[2]
            row = [kb, said, f"{seconds:.1f}", f"{cpu_s:.1f}", f"{peak / 2**20:.0f}"]
            table.add_row(name, *row, "BAD" if bad else "")
            print(".", end="", file=sys.stderr, flush=True)
    Console(width=170).print(table)


if __name__ == "__main__":
    main()
