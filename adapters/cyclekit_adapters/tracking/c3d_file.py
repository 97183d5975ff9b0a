"""Reader of C3D files: header, parameters and points, without trust in the sizes that the file states.

The file consists of blocks of 512 bytes. The header gives the positions of parameters and data. Parameters are groups
of named arrays. A frame is four numbers per point (x, y, z, residual with camera mask), then the analog samples.
Numbers are 16-bit integers with a scale, or floats, in the byte order of the writing machine: Intel, MIPS, or DEC with
its own floats. The adapter interprets units and labels.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.errors import DamagedLog, LogError
from cyclekit.text.numbers import given

if TYPE_CHECKING:
    from pathlib import Path
    from typing import BinaryIO

    from numpy.typing import NDArray

_BLOCK = 512
_HEAD_BLOCKS = 100 + 255  # parameters start in block 100 at the latest, and one byte counts their blocks
_KEY = 0x50
_INTEL, _DEC, _MIPS = 84, 85, 86
_CURE = "Write the file again, or check the copy."
_SIZES = {-1: 1, 1: 1, 2: 2, 4: 4}
_MAX_COUNT = 65535  # maximum number of frames or points in 16 bits


@dataclass(frozen=True)
class C3dFile:
    """Content of a C3D file.

    Attributes:
        points: Marker positions in the file's unit, shape (T, M, 3), NaN = not seen.
        labels: M names.
        rate_hz: Frames per second.
        first_frame: Number of the first frame, from 1.
        frames_stated: Number of frames according to the file.
        by_size: Whether that is its size, because the counter of frames is at its bound.
        texts: Text parameters, by (group, name).
    """

    points: NDArray[np.float64]
    labels: tuple[str, ...]
    rate_hz: float
    first_frame: int
    frames_stated: int
    texts: dict[tuple[str, str], list[str]]
    by_size: bool = False

    def text(self, group: str, name: str) -> str:
        """Return the first text of a parameter; "" if there is none."""
        found = self.texts.get((group, name), [])
        return found[0].strip() if found else ""


@dataclass(frozen=True)
class _Parameter:
    kind: int
    shape: tuple[int, ...]
    raw: bytes


_Parameters = dict[tuple[str, str], _Parameter]


def is_c3d(path: Path) -> bool:
    """Return whether a file starts like a C3D file and has parameters at the position in its first byte."""
    try:
        if not path.is_file():
            return False
        with path.open("rb") as log:
            head = log.read(_BLOCK)
            if len(head) < _BLOCK or head[1] != _KEY or not 2 <= head[0] <= 100:
                return False
            log.seek((head[0] - 1) * _BLOCK)
            begin = log.read(4)
    except OSError:
        return False
    return len(begin) == 4 and begin[3] in (_INTEL, _DEC, _MIPS)


def read_c3d(path: Path) -> C3dFile:
    """Read the points of a C3D file.

    Raises:
        LogError: The file cannot be opened, is damaged, or holds no points.
    """
    try:
        with path.open("rb") as log:
            return _read(_Open(path, log, path.stat().st_size, log.read(_HEAD_BLOCKS * _BLOCK)))
    except OSError as error:
        raise LogError(path, f"cannot be read: {error.strerror}", cure="Check the path and its permissions.") from error


class _Open(NamedTuple):
    """An open file, its size, and its first blocks, which hold all parameters."""

    path: Path
    log: BinaryIO
    size: int
    head: bytes


def _read(file: _Open) -> C3dFile:
    """Read the parameters, then the stated number of frames; data after them is ignored."""
    path, raw = file.path, file.head
    if len(raw) < 2 * _BLOCK or raw[1] != _KEY or not 2 <= raw[0] <= 100:
        raise DamagedLog(path, "no header of a C3D file", cure=_CURE)
    at = (raw[0] - 1) * _BLOCK
    processor = raw[at + 3] if at + 4 <= len(raw) else 0
    if processor not in (_INTEL, _DEC, _MIPS):
        raise DamagedLog(path, f"unknown processor type {processor} in its parameters", cure=_CURE)
    parameters = _parameters(raw, at, max(raw[at + 2], 1) * _BLOCK, processor)
    texts = {key: _texts(item) for key, item in parameters.items() if item.kind == -1}
    return _points(file, processor, parameters, texts)


def _parameters(raw: bytes, begin: int, size: int, processor: int) -> _Parameters:
    """Read the chain of groups and parameters; stop at a garbled entry and keep the entries before it."""
    order = ">" if processor == _MIPS else "<"
    end = min(begin + size, len(raw))
    groups: dict[int, str] = {}
    loose: list[tuple[int, str, _Parameter]] = []
    at = begin + 4
    while at + 4 < end:
        length, group = abs(struct.unpack_from("b", raw, at)[0]), struct.unpack_from("b", raw, at + 1)[0]
        after = at + 2 + length
        if not length or not group or after + 2 > end:
            break
        name = raw[at + 2 : after].decode("latin-1").strip().upper()
        (step,) = struct.unpack_from(order + "H", raw, after)
        if group < 0:
            groups[-group] = name
        elif (item := _parameter(raw, after + 2, end)) is not None:
            if 0 < step < 4 + len(item.shape) + len(item.raw):
                break  # the next one would begin inside of it
            loose.append((group, name, item))
        if not step:
            break
        at = after + step
    return {(groups.get(group, ""), name): item for group, name, item in loose}


def _parameter(raw: bytes, at: int, end: int) -> _Parameter | None:
    if at + 2 > end:
        return None
    kind, count = struct.unpack_from("bB", raw, at)
    shape = tuple(raw[at + 2 : at + 2 + count])
    if kind not in _SIZES or count > 7:
        return None
    size = _SIZES[kind]
    for edge in shape:
        size *= edge
    start = at + 2 + count
    return _Parameter(kind, shape, raw[start : start + size]) if start + size <= end else None


def _texts(item: _Parameter) -> list[str]:
    text = item.raw.decode("utf-8", "replace") if item.raw.isascii() else item.raw.decode("latin-1")
    width = item.shape[0] if item.shape else 1
    return [text[i : i + width].strip(" \0") for i in range(0, len(text), width)] if width else []


def _numbers(item: _Parameter | None, processor: int) -> list[float]:
    if item is None or item.kind == -1:
        return []
    if item.kind == 1:
        return [float(value) for value in item.raw]
    found = _floats(item.raw, processor) if item.kind == 4 else _words(item.raw, processor).astype(np.float64)
    return [float(value) for value in found]


def _words(raw: bytes, processor: int) -> NDArray[np.uint16]:
    return np.frombuffer(raw, ">u2" if processor == _MIPS else "<u2").astype(np.uint16)


def _floats(raw: bytes, processor: int) -> NDArray[np.float32]:
    """Return 32-bit floats; a DEC float has swapped halves and four times the value."""
    if processor == _DEC:
        halves = np.frombuffer(raw, "<u2").reshape(-1, 2)[:, ::-1]
        with np.errstate(all="ignore"):
            return (halves.copy().view("<f4")[:, 0] / 4.0).astype(np.float32)
    return np.frombuffer(raw, ">f4" if processor == _MIPS else "<f4").astype(np.float32)


def _points(file: _Open, processor: int, parameters: _Parameters, texts: dict[tuple[str, str], list[str]]) -> C3dFile:
    path, raw = file.path, file.head
    order = ">" if processor == _MIPS else "<"
    count, analog, first, last = struct.unpack_from(order + "4H", raw, 2)
    header_scale, header_rate = _floats(raw[12:16], processor)[0], _floats(raw[20:24], processor)[0]
    (block,) = struct.unpack_from(order + "H", raw, 16)

    def stated(name: str, otherwise: float, group: str = "POINT") -> float:
        found = _numbers(parameters.get((group, name)), processor)
        return found[0] if found and np.isfinite(found[0]) else otherwise

    markers, block = int(stated("USED", count)), int(stated("DATA_START", block))
    rate_hz, scale = float(stated("RATE", header_rate)), float(stated("SCALE", header_scale))
    if not 0 < markers <= _MAX_COUNT or block < 2 or not 0.0 < rate_hz < 1e6 or not np.isfinite(scale) or scale == 0.0:
        cause = "no positions: no points" if markers == 0 else "its header contradicts itself"
        raise DamagedLog(path, f"{cause} ({markers} points at {given(rate_hz)} Hz from block {block})", cure=_CURE)
    frames = _frames_stated(parameters, processor, int(stated("FRAMES", max(last - first + 1, 0))))
    width = 4 * markers + analog
    frame = width * (4 if scale < 0.0 else 2)
    held = max(file.size - (block - 1) * _BLOCK, 0) // frame
    by_size = frames == _MAX_COUNT < held
    frames = held if by_size else frames
    used = min(frames, held)
    if used <= 0:
        raise DamagedLog(path, f"a header of {frames} frames and no whole frame of data", cure=_CURE)
    file.log.seek((block - 1) * _BLOCK)
    data = file.log.read(used * frame)
    used = len(data) // frame  # fewer if the file was truncated meanwhile
    over = used - _MAX_COUNT if by_size else 0
    while over > 0 and file.size - (block - 1) * _BLOCK - (used - 1) * frame <= _BLOCK:
        if any(data[(used - 1) * frame : used * frame]):
            break
        used, frames, over = used - 1, frames - 1, over - 1  # the last block is filled up with zeros
    points = _places(data[: used * frame], processor, scale, used, width, markers)
    labels = _labels(texts, markers)
    return C3dFile(points, labels, rate_hz, _first_frame(parameters, processor, first), frames, texts, over > 0)


def _places(data: bytes, processor: int, scale: float, frames: int, width: int, markers: int) -> NDArray[np.float64]:
    """Return positions (T, M, 3), NaN for a marker that was not seen (negative fourth number)."""
    with np.errstate(all="ignore"):
        if scale < 0.0:
            table = _floats(data, processor).reshape(frames, width)[:, : 4 * markers].reshape(frames, markers, 4)
            places = table[:, :, :3].astype(np.float64)
        else:
            words = _words(data, processor).view(np.int16)
            whole = words.reshape(frames, width)[:, : 4 * markers].reshape(frames, markers, 4)
            places, table = whole[:, :, :3].astype(np.float64) * scale, whole.astype(np.float32)
        places[(table[:, :, 3] < 0) | ~np.isfinite(places).all(axis=2)] = np.nan
    return places


def _frames_stated(parameters: _Parameters, processor: int, counted: int) -> int:
    """Return the stated number of frames; above 16 bits it is in separate first and last fields."""
    first, last = (_field(parameters, processor, name) for name in ("ACTUAL_START_FIELD", "ACTUAL_END_FIELD"))
    if first is not None and last is not None and last >= first and last - first + 1 >= counted:
        return last - first + 1
    longer = _numbers(parameters.get(("POINT", "LONG_FRAMES")), processor)
    return int(longer[0]) if longer and np.isfinite(longer[0]) and longer[0] > counted else counted


def _first_frame(parameters: _Parameters, processor: int, counted: int) -> int:
    found = _field(parameters, processor, "ACTUAL_START_FIELD")
    return found if found else max(counted, 1)


def _field(parameters: _Parameters, processor: int, name: str) -> int | None:
    item = parameters.get(("TRIAL", name))
    if item is None or item.kind != 2 or len(item.raw) < 4:
        return None
    low, high = (int(word) for word in _words(item.raw[:4], processor))
    return low + (high << 16)


def _labels(texts: dict[tuple[str, str], list[str]], markers: int) -> tuple[str, ...]:
    """Return a name for each point; above 255 names continue in LABELS2, LABELS3, ..."""
    found = list(texts.get(("POINT", "LABELS"), []))
    for more in range(2, 260):
        if ("POINT", f"LABELS{more}") not in texts:
            break
        found += texts["POINT", f"LABELS{more}"]
    names: list[str] = []
    taken: set[str] = set()
    for index in range(markers):
        name = found[index] if index < len(found) and found[index] else f"*{index}"
        name = name if name not in taken else f"{name}#{index}"
        taken.add(name)
        names.append(name)
    return tuple(names)
