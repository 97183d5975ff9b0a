"""Bombs among binary logs: chunks that unpack to gigabytes, sizes and counts that lie, endless tables."""

from __future__ import annotations

import bz2
import sqlite3
import struct
import tempfile
from pathlib import Path

from reliability.explosives import CSV_CELL, GIB, bomb, put, sparse, zstd_of
from reliability.own_logs import own_logs
from sheet_files import frame_of, write_parts


def _record(op: int, body: bytes) -> bytes:
    return bytes([op]) + struct.pack("<Q", len(body)) + body


def _string(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()


def _mcap(*records: bytes) -> bytes:
    head = b"\x89MCAP0\r\n" + _record(1, _string("ros2") + _string("x"))
    return head + b"".join(records) + _record(15, bytes(4)) + _record(2, bytes(20)) + b"\x89MCAP0\r\n"


def _chunk(packed: bytes, states: int, kind: str = "zstd") -> bytes:
    return _record(6, struct.pack("<QQQI", 0, 1, states, 0) + _string(kind) + struct.pack("<Q", len(packed)) + packed)


def _bag(folder: Path, kind: str) -> bytes:
    (folder / "own").mkdir()
    log = next(log for log in own_logs(folder / "own") if log.name == f"bag {kind}")
    data = next(data for name, data in log.files.items() if not name.endswith(".yaml"))
    for path in sorted((folder / "own").rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    (folder / "own").rmdir()
    return data


def _own_logs_of_one_file() -> list[tuple[str, bytes]]:
    """Return name and content of our own logs that are single files, without the bags."""
    with tempfile.TemporaryDirectory() as folder:
        return [(log.name, next(iter(log.files.values()))) for log in own_logs(Path(folder)) if len(log.files) == 1]


@bomb("mcap of 262 kB with a chunk of 8 GiB")
def _(folder: Path) -> Path:
    return put(folder, "run.mcap", _mcap(_chunk(zstd_of(b"", bytes(1 << 20), 8 << 10), 8 * GIB)))


@bomb("mcap with a chunk of 8 GiB that says 100 bytes")
def _(folder: Path) -> Path:
    return put(folder, "run.mcap", _mcap(_chunk(zstd_of(b"", bytes(1 << 20), 8 << 10), 100)))


@bomb("mcap whose sizes are 2**63")
def _(folder: Path) -> Path:
    huge = struct.pack("<Q", 1 << 63)
    lies = [bytes([op]) + huge + b"x" * 40 for op in (3, 4, 5, 6)]
    return put(folder, "run.mcap", _mcap(_record(6, struct.pack("<QQQI", 0, 1, 1 << 62, 0) + _string("")), *lies))


@bomb("ROS 1 bag whose every length is 4 GiB")
def _(folder: Path) -> Path:
    data = bytearray(_bag(folder, "bag"))
    for at in range(13, len(data) - 4, 997):
        data[at : at + 4] = b"\xff\xff\xff\xff"
    return put(folder, "run.bag", bytes(data))


@bomb("ROS 1 bag with a bz2 chunk of 4 GiB")
def _(folder: Path) -> Path:
    pack = bz2.BZ2Compressor(9)
    packed = b"".join([*(pack.compress(bytes(1 << 24)) for _ in range(256)), pack.flush()])

    def header(**fields: bytes) -> bytes:
        cells = b"".join(struct.pack("<I", len(k) + 1 + len(v)) + k.encode() + b"=" + v for k, v in fields.items())
        return struct.pack("<I", len(cells)) + cells

    places = {"index_pos": bytes(8), "conn_count": bytes(4), "chunk_count": struct.pack("<I", 1)}
    first = header(op=b"\x03", **places)
    first += struct.pack("<I", 4096 - len(first) - 4) + b" " * (4096 - len(first) - 4)
    chunk = header(op=b"\x05", compression=b"bz2", size=struct.pack("<I", 0xFFFFFFFF))
    return put(folder, "run.bag", b"#ROSBAG V2.0\n" + first + chunk + struct.pack("<I", len(packed)) + packed)


@bomb("db3 whose messages are an endless view")
def _(folder: Path) -> Path:
    path = put(folder, "run.db3", _bag(folder, "db3"))
    with sqlite3.connect(path) as base:
        base.execute("ALTER TABLE messages RENAME TO kept")
        base.execute(
            "CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) "
            "SELECT i AS id, topic_id, timestamp + i AS timestamp, data FROM n, kept"
        )
    base.close()
    return path


@bomb("db3 whose header says 2**31 pages")
def _(folder: Path) -> Path:
    data = bytearray(_bag(folder, "db3"))
    data[28:32] = struct.pack(">I", (1 << 31) - 1)
    return put(folder, "run.db3", bytes(data))


@bomb("metadata.yaml that names itself a billion times")
def _(folder: Path) -> Path:
    (folder / "run").mkdir()
    levels = "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 10))
    text = f"rosbag2_bagfile_information:\n  version: 5\na0: &a0 [x, x]\n{levels}relative_file_paths: *a9\n"
    put(folder / "run", "metadata.yaml", text.encode())
    return put(folder / "run", "run_0.mcap", _bag(folder, "mcap")).parent


@bomb("C3D that announces 10**9 frames of 65,535 points")
def _(folder: Path) -> Path:
    data = bytearray(next(log for log in _own_logs_of_one_file() if log[0] == "c3d")[1])
    data[2:4] = b"\xff\xff"
    data[6:10] = b"\x01\x00\xff\xff"
    return sparse(put(folder, "run.c3d", bytes(data)), 60 << 20, bytes(data))


@bomb("C3D of 2 GB of zeros")
def _(folder: Path) -> Path:
    return sparse(folder / "run.c3d", 2 * GIB, next(log for log in _own_logs_of_one_file() if log[0] == "c3d")[1])


@bomb("RTDE recording of 10**9 rows of zeros")
def _(folder: Path) -> Path:
    names = " ".join(["timestamp", *(f"actual_TCP_pose_{i}" for i in range(3))])
    return sparse(folder / "run.bin", 2 * GIB, f"{names}\n{' '.join(['DOUBLE'] * 4)}\n".encode())


@bomb("RTDE recording whose row has 100,000 columns")
def _(folder: Path) -> Path:
    names = " ".join(["timestamp", *(f"actual_TCP_pose_{i}" for i in range(100_000))])
    return sparse(folder / "run.bin", GIB, f"{names}\n{' '.join(['DOUBLE'] * 100_001)}\n".encode())


_SHEET = (
    '<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><sheetData>{}</sheetData></worksheet>'
)
_HEAD = '<row r="1"><c t="str"><v>t</v></c><c t="str"><v>x</v></c><c t="str"><v>y</v></c></row>'


def _workbook(folder: Path, rows: str) -> Path:
    parts = {
        **frame_of(["S"]),
        "xl/sharedStrings.xml": "<sst/>",
        "xl/worksheets/sheet1.xml": _SHEET.format(_HEAD + rows),
    }
    write_parts(folder / "run.xlsx", parts)
    words = CSV_CELL.format(name="run.xlsx", role="robot", map='time = "t", x = "x", y = "y"')
    put(folder, "cell.toml", words.encode())
    return folder


@bomb("workbook with a cell in the last row and column")
def _(folder: Path) -> Path:
    return _workbook(folder, '<row r="1048576"><c r="XFD1048576"><v>1</v></c></row>')


@bomb("workbook of a few kB with a sheet of 1 GB")
def _(folder: Path) -> Path:
    return _workbook(folder, " " * (1 << 30))


@bomb("workbook as full as one may be", slow=True)
def _(folder: Path) -> Path:
    cells = "".join(f"<c><v>{(7919 * i) % 100_003}</v></c>" for i in range(200))
    return _workbook(folder, "".join(f"<row>{cells}</row>" for i in range(49_999)))
