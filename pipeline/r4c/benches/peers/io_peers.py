"""Writes and reads back arrays through common containers and prints one JSON line a measurement.

Usage: io_peers.py FOLDER NAME DTYPE SHAPE [NAME DTYPE SHAPE ...]; FOLDER/NAME.bin holds the raw values. Chunks are one
entry of the first axis, as in our own container. Equality is checked. `REPEATS` (default 5) measurements, the best counts,
in wall time and in processor time (all threads) each.
"""
import json
import os
import shutil
import sys
import time

import numpy as np

FOLDER, ITEMS, REPEATS = sys.argv[1], sys.argv[2:], int(os.environ.get("REPEATS", "5"))


def best(run):
    walls, processors = [], []
    for _ in range(REPEATS + 1):
        wall, processor = time.perf_counter(), time.process_time()
        result = run()
        walls.append(time.perf_counter() - wall)
        processors.append(time.process_time() - processor)
    return [min(walls[1:]), min(processors[1:])], result


def size(path):
    if os.path.isdir(path):
        return sum(os.path.getsize(os.path.join(top, name)) for top, _, names in os.walk(path) for name in names)
    return os.path.getsize(path)


def measure(peer, name, array, path, write, read):
    seconds, _ = best(write)
    stored = size(path)
    read_seconds, back = best(read)
    assert np.array_equal(np.asarray(back).reshape(array.shape), array), peer
    shutil.rmtree(path) if os.path.isdir(path) else os.remove(path)
    print(json.dumps(dict(peer=peer, data=name, ratio=array.nbytes / stored, write=seconds, read=read_seconds)), flush=True)


def hdf5(name, array, chunk):
    import h5py
    import hdf5plugin

    path = f"{FOLDER}/{name}.h5"

    def write():
        with h5py.File(path, "w") as file:
            file.create_dataset("a", data=array, chunks=chunk, shuffle=array.itemsize > 1, **hdf5plugin.Zstd(clevel=3))

    def read():
        with h5py.File(path) as file:
            return file["a"][:]

    measure("HDF5 zstd-3 + shuffle", name, array, path, write, read)


def blosc(name, array, chunk):
    import blosc2

    blosc2.set_nthreads(2)
    path = f"{FOLDER}/{name}.b2nd"
    options = dict(codec=blosc2.Codec.ZSTD, clevel=3)
    write = lambda: blosc2.save_array(np.ascontiguousarray(array), path, mode="w", cparams=options)
    measure("blosc2 zstd-3 + shuffle, 2 threads", name, array, path, write, lambda: blosc2.load_array(path))


def zarr(name, array, chunk):
    import zarr
    from zarr.codecs import BloscCodec

    path = f"{FOLDER}/{name}.zarr"
    codec = BloscCodec(cname="zstd", clevel=3, shuffle="shuffle" if array.itemsize > 1 else "noshuffle")

    def write():
        shutil.rmtree(path, ignore_errors=True)
        zarr.create_array(store=path, shape=array.shape, chunks=chunk, dtype=array.dtype, compressors=codec)[:] = array

    measure("zarr v3 blosc zstd-3 + shuffle", name, array, path, write, lambda: zarr.open_array(path, mode="r")[:])


def parquet(name, array, chunk):
    import pyarrow
    import pyarrow.parquet as pq

    path = f"{FOLDER}/{name}.parquet"
    width = array.shape[-1] if array.ndim > 3 else 1
    columns = array.reshape(-1, width)
    encoding = {f"c{i}": "BYTE_STREAM_SPLIT" for i in range(width)} if array.dtype == np.float32 else None

    def write():
        table = pyarrow.table({f"c{i}": np.ascontiguousarray(columns[:, i]) for i in range(width)})
        pq.write_table(table, path, compression="zstd", compression_level=3, use_dictionary=False, column_encoding=encoding)

    def read():
        table = pq.read_table(path)
        return np.stack([table[f"c{i}"].to_numpy() for i in range(width)], 1)

    measure("parquet zstd-3 byte-stream-split", name, array, path, write, read)


for name, dtype, shape in zip(ITEMS[0::3], ITEMS[1::3], ITEMS[2::3]):
    shape = [int(dim) for dim in shape.split("x")]
    array = np.fromfile(f"{FOLDER}/{name}.bin", dtype).reshape(shape)
    for peer in (hdf5, blosc, zarr, parquet):
        try:
            peer(name, array, (1, *array.shape[1:]))
        except ImportError as missing:
            print(json.dumps(dict(skipped=f"{peer.__name__}: {missing}")), flush=True)
