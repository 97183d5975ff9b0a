"""Parquet tables larger than memory: written in pieces, read by row ranges.

Equal rows in equal pieces give equal bytes. Row groups are large enough for a fast scan and small enough that a few of
them need little memory. Numbers are byte-split before compression, which makes measured values a fifth smaller.
"""

from __future__ import annotations

import errno
import threading
from collections import OrderedDict
from contextlib import contextmanager, suppress
from functools import lru_cache, partial
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq

from cyclekit.storage.background import BackgroundWriter
from cyclekit.storage.files import regular
from cyclekit.storage.parquet_layout import layout_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path
    from types import TracebackType
    from typing import IO, Self

    from numpy.typing import NDArray

    from cyclekit.schema import Column
    from cyclekit.storage.parquet_layout import TableLayout

    Columns = Mapping[str, NDArray[np.float64]]

GROUP_ROWS = 1 << 17
SMALL_ROWS = 1 << 14
"""Maximum number of rows of a table compressed by LZ4: zstd makes it a tenth smaller, but takes almost twice as long to
start."""
_KEPT_BYTES = 64 << 20
_LEVEL = 1  # of zstd: higher levels take longer and save one percent


class TableWriter:
    """Writer of one Parquet file; it is complete after `close` or the end of the `with` block.

    Raises:
        OSError: The file cannot be written.
    """

    def __init__(
        self, file: Path, columns: Mapping[str, Column], *, more: Sequence[str] = (), made_by: str | None = None
    ) -> None:
        """Open a table.

        Args:
            file: Path of the file; its folder is created.
            columns: Columns in order.
            more: Columns of numbers after them (joints).
            made_by: Name of the writer for the metadata, if any.
        """
        self.rows, self._pieces, self._waiting, self._path = 0, list[pl.DataFrame](), 0, file
        self._types = tuple((name, column.dtype) for name, column in columns.items())
        self._types += tuple((name, pl.Float64()) for name in more)
        self._made_by, self._background = made_by, BackgroundWriter()
        self._parquet: pq.ParquetWriter | None = None
        self._file: IO[bytes] | None = None

    def write(self, frame: pl.DataFrame) -> None:
        """Append rows; the frame has exactly the columns of the table."""
        self._pieces.append(frame)
        self._waiting += frame.height
        self.rows += frame.height
        while self._waiting >= GROUP_ROWS:
            self._put(GROUP_ROWS)

    def held(self) -> pl.DataFrame | None:
        """Return all rows if none has been written to disk, else None; do not use the writer afterwards."""
        return None if self._file is not None or not self._pieces else pl.concat(self._pieces)

    def close(self) -> None:
        """Write the remaining rows; `atomic.built` flushes the file to disk."""
        try:
            if self._waiting or self.rows == 0:
                self._put(self._waiting)
            self._background.end()
            with _as_os_error(self._path):
                if self._parquet is not None:
                    self._parquet.close()
                if self._file is not None:
                    self._file.close()
        except BaseException:
            self.abandon()
            raise

    def abandon(self) -> None:
        """Stop writing; the file is incomplete, and the caller removes it."""
        with suppress(Exception):
            self._background.end()
        if self._parquet is not None:
            self._parquet.is_open = False  # else its finalizer would try to complete the file, and fail
        if self._file is not None:
            with suppress(Exception):
                self._file.close()

    def _put(self, count: int) -> None:
        empty, layout, texts, numbers = _layout_of(self._types)
        frame = pl.concat(self._pieces) if self._pieces else empty
        if self._parquet is None:
            with _as_os_error(self._path):
                self._path.parent.mkdir(parents=True, exist_ok=True)
                self._file = self._path.open("wb")
                small = frame.height <= SMALL_ROWS
                self._parquet = _writer(self._file, layout, texts, numbers, small=small)
                if self._made_by:
                    self._parquet.add_key_value_metadata({"made_by": self._made_by})
        rest = frame[count:]
        self._pieces, self._waiting = ([rest] if rest.height else []), rest.height
        part = frame[:count]
        if self.rows > GROUP_ROWS:
            self._background.begin(partial(self._write_out, part))
        else:  # no thread for a small table
            self._write_out(part)

    def _write_out(self, part: pl.DataFrame) -> None:
        table = part.to_arrow(compat_level=pl.CompatLevel.oldest())
        with _as_os_error(self._path):
            self._parquet.write_table(table, row_group_size=GROUP_ROWS)  # type: ignore[union-attr]  # `_put` made it

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abandon()


@lru_cache(maxsize=64)  # thousands of small tables have the same columns
def _layout_of(types: tuple[tuple[str, pl.DataType], ...]) -> tuple[pl.DataFrame, pa.Schema, list[str], list[str]]:
    """Return an empty table, its Arrow schema, its text columns and its columns of floating-point numbers."""
    empty = pl.DataFrame(schema=dict(types))
    texts = [name for name, dtype in types if dtype == pl.String()]
    numbers = [name for name, dtype in types if dtype.is_float()]
    return empty, empty.to_arrow(compat_level=pl.CompatLevel.oldest()).schema, texts, numbers


@contextmanager
def _as_os_error(file: Path) -> Iterator[None]:
    try:
        yield
    except pa.ArrowException as error:
        raise OSError(errno.EIO, str(error), str(file)) from error
    except OSError as error:  # from the file system, without file name
        raise OSError(error.errno, error.strerror or str(error), str(file)) from error


class StoredTable:
    """Numbers of a Parquet table, read by row ranges, with a cache of decoded columns (`keeping`).

    The file is open only during reads, as a dataset has thousands of files.
    """

    def __init__(self, file: Path, columns: Sequence[str]) -> None:
        """Read the layout of the table.

        Args:
            file: The Parquet file.
            columns: Columns to read, all of numbers.
        """
        self._file, self._key, self._columns = file, str(file), list(columns)
        self.columns = tuple(columns)
        about = regular(file).stat()
        self._written_ns, self._bytes = about.st_mtime_ns, about.st_size
        layout = self._layout()
        self.names, self.rows = layout.names, layout.starts[-1]
        self.groups = [(begin, end) for begin, end in pairwise(layout.starts) if end > begin]
        self._unknown = {name: layout.unknown[name] for name in columns}

    def _layout(self) -> TableLayout:
        return layout_of(self._key, self._written_ns, self._bytes)

    def unknown(self, column: str) -> int:
        """Return the number of rows without a value in a column, by the file's statistics; without these, all rows."""
        return self._unknown[column]

    def read(self, first: int, end: int) -> Columns:
        """Return rows `first` to `end` - 1 as float64, NaN = unknown; read-only."""
        return self._rows(self._columns, first, end)

    def column(self, name: str, first: int, end: int) -> NDArray[np.float64]:
        """Return one column of rows `first` to `end` - 1, shape (N,), as `read`, without decoding the others."""
        return self._rows([name], first, end)[name]

    def _rows(self, names: Sequence[str], first: int, end: int) -> Columns:
        if len(self.groups) == 1:
            return {name: values[first:end] for name, values in self._group(0, names).items()}
        parts = [
            {name: values[max(first - begin, 0) : end - begin] for name, values in self._group(number, names).items()}
            for number, (begin, after) in enumerate(self.groups)
            if begin < end and after > first
        ]
        if len(parts) == 1:
            return parts[0]
        return {name: np.concatenate([np.empty(0), *(part[name] for part in parts)]) for name in names}

    def whole_numbers(self, number: int, column: str) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return an integer column of one row group with all 64 bits, and the mask of known values, shape (N,) each."""
        if (whole := self._layout().whole) is not None:
            begin, end = self.groups[number]
            values = whole[column][begin:end]
        else:
            with pq.ParquetFile(self._file) as parquet:
                values = pl.DataFrame(parquet.read_row_group(number, columns=[column], use_threads=False))[column]
        return values.fill_null(0).cast(pl.Int64).to_numpy(), values.is_not_null().to_numpy()

    def states(self, column: str) -> Iterator[tuple[int, int, str]]:
        """Yield first row, last row and text of each sequence of equal texts in a text column, without unknown ones."""
        pending: tuple[int, int, str] | None = None
        for first, last, text in self._stretches(column):
            if pending is not None and pending[2] == text:
                pending = (pending[0], last, text)
                continue
            if pending is not None:
                yield pending
            pending = None if text is None else (first, last, text)
        if pending is not None:
            yield pending

    def _stretches(self, column: str) -> Iterator[tuple[int, int, str | None]]:
        """Yield sequences of equal texts within each chunk of the table, from the codes of dictionary encoding."""
        begin = 0
        with pq.ParquetFile(self._file, read_dictionary=[column]) as parquet:
            for number in range(len(self.groups)):
                table = parquet.read_row_group(number, columns=[column], use_threads=False)
                for piece in table.column(0).chunks:
                    texts = piece.dictionary.to_pylist()
                    coded = pl.DataFrame(pa.table({"code": piece.indices}))  # a Series would import half of Arrow
                    index = coded["code"].fill_null(-1).to_numpy()
                    edges = np.flatnonzero(np.diff(index, prepend=index[:1] - 1, append=index[-1:] - 1))
                    for first, end in pairwise(edges.tolist()):
                        at = int(index[first])
                        yield begin + first, begin + end - 1, texts[at] if at >= 0 else None
                    begin += len(index)

    def _group(self, number: int, names: Sequence[str]) -> Columns:
        known = {name: _decoded.get((self._key, name, number)) for name in names}
        columns = {name: values for name, values in known.items() if values is not None}
        if missing := [name for name in names if name not in columns]:
            frame = self._layout().whole
            if frame is None:
                with pq.ParquetFile(self._file) as parquet:
                    table = parquet.read_row_group(number, columns=missing)
                frame = pl.DataFrame(table)  # not Arrow's conversion to numpy, which imports pandas if installed
            else:
                frame = frame[slice(*self.groups[number])]
            for name in missing:
                columns[name] = _floats(frame[name])
                _decoded.keep((self._key, name, number), columns[name])
        return columns


class _Decoded:
    """Thread-safe cache of decoded columns, up to a limit; the latest column stays, however large."""

    def __init__(self) -> None:
        self.most_bytes = _KEPT_BYTES
        self._parts: OrderedDict[tuple[str, str, int], NDArray[np.float64]] = OrderedDict()
        self.bytes = 0
        self._lock = threading.Lock()

    def get(self, key: tuple[str, str, int]) -> NDArray[np.float64] | None:
        with self._lock:
            if key in self._parts:
                self._parts.move_to_end(key)
            return self._parts.get(key)

    def keep(self, key: tuple[str, str, int], values: NDArray[np.float64]) -> None:
        with self._lock:
            before = self._parts.pop(key, None)  # another thread may have read it meanwhile
            self._parts[key] = values
            self.bytes += values.nbytes - (0 if before is None else before.nbytes)
            while len(self._parts) > 1 and self.bytes > self.most_bytes:
                self.bytes -= self._parts.popitem(last=False)[1].nbytes

    def clear(self) -> None:
        with self._lock:
            self._parts.clear()
            self.bytes = 0


_decoded = _Decoded()


@contextmanager
def keeping(most_bytes: int) -> Iterator[None]:
    """Keep up to `most_bytes` of decoded columns inside the block, for repeated reads of the same rows."""
    _decoded.most_bytes = most_bytes
    try:
        yield
    finally:
        _decoded.most_bytes = _KEPT_BYTES
        if _decoded.bytes > _KEPT_BYTES:
            forget()


def forget() -> None:
    """Clear the cache of decoded columns and free its memory."""
    _decoded.clear()
    pa.default_memory_pool().release_unused()  # else Arrow keeps it for the next table


def _floats(values: pl.Series) -> NDArray[np.float64]:
    return (values if values.dtype == pl.Float64 else values.cast(pl.Float64)).to_numpy()


def parts_of(file: Path) -> Iterator[pl.DataFrame]:
    """Yield a Parquet table by row groups; it may be larger than memory."""
    with pq.ParquetFile(file) as parquet:
        for group in range(parquet.metadata.num_row_groups):
            yield pl.DataFrame(parquet.read_row_group(group, use_threads=False))


def shift_times(file: Path, shift_s: float, *, column: str = "t_s") -> None:
    """Subtract `shift_s` from the times in a column of a table that is still under construction."""
    import pyarrow.compute as pc  # its import takes as long as reading a small log

    table = pq.ParquetFile(file)
    about, part = table.schema_arrow, file.with_suffix(".part")
    texts = [field.name for field in about if pa.types.is_string(field.type) or pa.types.is_large_string(field.type)]
    numbers = [field.name for field in about if pa.types.is_floating(field.type)]
    small = table.metadata.num_rows <= SMALL_ROWS
    with part.open("wb") as handle, _as_os_error(file), _writer(handle, about, texts, numbers, small=small) as writer:
        for group in range(table.metadata.num_row_groups):
            rows = table.read_row_group(group, use_threads=False)
            place = rows.schema.get_field_index(column)
            shifted = pc.subtract(rows.column(place), shift_s)
            writer.write_table(rows.set_column(place, rows.schema.field(place), shifted), row_group_size=GROUP_ROWS)
    table.close()
    part.replace(file)


def _writer(
    handle: IO[bytes], layout: pa.Schema, texts: Sequence[str], numbers: Sequence[str], *, small: bool
) -> pq.ParquetWriter:
    return pq.ParquetWriter(
        handle,
        layout,
        compression="lz4" if small else "zstd",
        compression_level=None if small else _LEVEL,
        use_dictionary=list(texts),
        use_byte_stream_split=list(numbers),
        store_schema=False,
    )
