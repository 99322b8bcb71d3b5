"""Tables of telemetry in each format, sound or with their structure changed."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import scipy.io
import scipy.sparse
from pyarrow import parquet

from analyses.data_quality.damage import Columns, Random, as_bytes, changed_columns, mutated_array

_MATLAB_HEAD = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
_COMPRESSIONS = ("snappy", "gzip", "zstd", "none")


def csv_bytes(columns: Columns) -> bytes:
    """Columns as CSV."""
    rows = zip(*columns.values(), strict=True)
    cells = (",".join("" if np.isnan(v) else f"{v:.12g}" for v in row) for row in rows)
    return "\n".join([",".join(columns), *cells, ""]).encode()


def parquet_bytes(columns: Columns, random: Random | None = None) -> bytes:
    """Columns as Parquet; with `random` in other types, groups and compressions."""
    options: dict[str, Any] = {}
    if random is None:
        arrays = {name: pa.array(v, from_pandas=True) for name, v in columns.items()}
    else:
        changed = changed_columns(columns, random)
        arrays = {name: _arrow(v, random) for name, v in changed.items()}
        shortest = min(len(v) for v in arrays.values())
        arrays = {name: v.slice(0, shortest) for name, v in arrays.items()}
        options = {
            "compression": str(random.choice(_COMPRESSIONS)),
            "row_group_size": int(random.integers(1, 50)),
            "use_dictionary": bool(random.random() < 0.5),
            "data_page_version": str(random.choice(["1.0", "2.0"])),
        }
    return as_bytes(lambda file: parquet.write_table(pa.table(arrays), file, **options))


def _arrow(values: Any, random: Random) -> pa.Array:
    """A changed column in some Arrow type."""
    plain = np.atleast_1d(np.asarray(values))
    if plain.dtype.kind == "c":
        plain = plain.real
    if plain.ndim > 1:
        return pa.array(plain.reshape(len(plain), -1).tolist())
    array = pa.array(plain.astype(plain.dtype.newbyteorder("=")))
    kind = random.random()
    if kind < 0.1:
        return array.dictionary_encode()
    if kind < 0.2:
        return pa.array(np.arange(len(plain)) * 10**9).cast(pa.timestamp("ns"))
    if kind < 0.3:
        return pa.nulls(len(array))
    return array


def hdf5_bytes(columns: Columns, random: Random | None = None) -> bytes:
    """Columns as HDF5; with `random` in other types, shapes, links, layouts and groups."""

    def write(file: io.BytesIO) -> None:
        latest = random is not None and random.random() < 0.3
        with h5py.File(file, "w", libver="latest" if latest else None) as store:
            if random is None:
                for name, values in columns.items():
                    store[name] = values
                return
            group = store if random.random() < 0.7 else store.create_group("logs/first")
            for name, values in changed_columns(columns, random).items():
                _dataset(group, name, values, random)
            for _ in range(int(random.integers(3))):
                _odd_member(store, str(random.choice(list(columns))), random)

    return as_bytes(write)


def _dataset(group: h5py.Group, name: str, values: Any, random: Random) -> None:
    array = np.asarray(values)
    if array.dtype.kind == "U":
        group.create_dataset(name, data=array.astype("S"))
        return
    options: dict[str, Any] = {}
    if array.ndim and array.size and random.random() < 0.4:
        options = {"chunks": tuple(max(1, n // 3) for n in array.shape)}
        options["compression"] = random.choice(["gzip", "lzf"])
        options["shuffle"] = bool(random.random() < 0.5)
        options["fletcher32"] = bool(random.random() < 0.3)
    group.create_dataset(name, data=array, **options)


def _odd_member(store: h5py.File, name: str, random: Random) -> None:
    """Something that a table has not: links, references, objects, huge claims."""
    makers: tuple[Callable[[], Any], ...] = (
        lambda: h5py.SoftLink("/nowhere"),
        lambda: h5py.SoftLink(f"/{name}"),
        lambda: h5py.ExternalLink("/etc/passwd", "/x"),
        lambda: store["/"],
        lambda: np.zeros(3, dtype=[("a", "f8"), ("b", "S4")]),
        lambda: np.array([b"x", b"yy"], dtype=object).astype("S2"),
    )
    if name in store:
        del store[name]
    kind = int(random.integers(len(makers) + 3))
    if kind < len(makers):
        store[name] = makers[kind]()
    elif kind == len(makers):
        store.create_dataset(name, shape=(10**11,), dtype="f8", chunks=(1000,))
    elif kind == len(makers) + 1:
        store.create_dataset(name, data=["text", "more"], dtype=h5py.string_dtype())
    else:
        store.create_dataset(name, data=[store.ref], dtype=h5py.ref_dtype)


def mat_bytes(columns: Columns, random: Random | None = None) -> bytes:
    """Columns as a MAT file of version 5; with `random` as structs, cells, sparse matrices."""
    if random is None:
        return as_bytes(lambda file: scipy.io.savemat(file, dict(columns)))
    changed = {k.strip() or "x": v for k, v in changed_columns(columns, random).items()}
    name = next(iter(changed))
    odd: tuple[Any, ...] = (
        np.array([changed[name], "text", {"a": 1.0}], dtype=object),
        {"Time": np.arange(4.0), "Data": {"deep": [1.0, "x"]}},
        scipy.sparse.csc_matrix(np.eye(3)),
        "text",
        [],
        True,
        np.array([[{"a": 1.0}, {"a": 2.0}]]),
    )
    if random.random() < 0.5:
        changed[name] = odd[int(random.integers(len(odd)))]
    content = {"log": changed} if random.random() < 0.3 else changed
    packed = bool(random.random() < 0.5)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return as_bytes(lambda file: scipy.io.savemat(file, content, do_compression=packed))


def mat73_bytes(columns: Columns, random: Random | None = None) -> bytes:
    """Columns as MATLAB writes version 7.3: HDF5 behind a head, with the classes of its arrays."""

    def write(file: io.BytesIO) -> None:
        with h5py.File(file, "w", userblock_size=512) as store:
            changed = dict(columns) if random is None else changed_columns(columns, random)
            for name, values in changed.items():
                array = _as_hdf5(values)
                store[name] = array if array.dtype.kind == "S" else np.atleast_2d(array)
                matlab = "double"
                if random is not None and random.random() < 0.1:
                    matlab = str(random.choice(["char", "cell", "struct", "string", "logical"]))
                store[name].attrs["MATLAB_class"] = np.bytes_(matlab)
                if random is not None and random.random() < 0.05:
                    store[name].attrs["MATLAB_empty"] = np.uint8(1)
            if random is not None and random.random() < 0.3:
                extra = store.create_group("#refs#")
                extra["a"] = _as_hdf5(mutated_array(np.arange(5.0), random)).real
                store["cells"] = np.array([[extra["a"].ref]], dtype=h5py.ref_dtype)
                store["cells"].attrs["MATLAB_class"] = np.bytes_("cell")

    made = as_bytes(write)
    return _MATLAB_HEAD + made[len(_MATLAB_HEAD) :]


def _as_hdf5(values) -> np.ndarray:
    """An array of a kind that HDF5 has: text as bytes."""
    array = np.asarray(values)
    return array.astype("S") if array.dtype.kind == "U" else array


WRITERS: dict[str, Callable[..., bytes]] = {
    ".parquet": parquet_bytes,
    ".h5": hdf5_bytes,
    ".mat": mat_bytes,
    ".73.mat": mat73_bytes,
}
