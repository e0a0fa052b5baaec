"""Writes old.h5 and new.h5, which tests/hdf5.rs reads, and the corpus of the fuzz target hdf5.

h5py 3.16 (HDF5 2.0) wrote the ones that are committed.
"""

from pathlib import Path

import h5py
import numpy as np


def write(path, libver):
    with h5py.File(path, "w", libver=libver) as file:
        file.attrs["text"] = "grün"
        file.attrs["bytes"] = np.bytes_(b"fixed")
        file.attrs["true"] = True
        file.attrs["whole"] = np.int64(-7)
        file.attrs["large"] = np.uint64(2**64 - 1)
        file.attrs["real"] = 0.25
        file.attrs["numbers"] = np.arange(6, dtype="f4").reshape(2, 3)
        file.attrs["texts"] = ["a", "bc"]
        file.attrs["nothing"] = h5py.Empty("f4")
        file.attrs["record"] = np.array((1, 2.0), dtype=[("a", "i4"), ("b", "f8")])
        numbers = file.create_group("numbers")
        ramp = np.arange(12).reshape(4, 3)
        for name in ["f2", "f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", ">f8", ">i2"]:
            numbers.create_dataset(name.replace(">", "big_"), data=ramp.astype(name))
        numbers["truth"] = ramp % 2 == 1
        numbers["wide"] = np.array([2**63 - 1, -(2**63)], dtype="i8")
        numbers["single"] = 1.5
        numbers["none"] = np.zeros((0, 5))
        numbers["f4"].attrs["write_complete"] = True
        packed = file.create_group("packed")
        table = np.arange(240, dtype="i4").reshape(20, 12)
        for name, options in {
            "gzip": {"compression": "gzip"},
            "lzf": {"compression": "lzf"},
            "all": {"compression": "gzip", "shuffle": True, "fletcher32": True},
            "lzf_shuffle": {"compression": "lzf", "shuffle": True},
            "grown": {"maxshape": (None, 12)},
            "plain": {},
        }.items():
            packed.create_dataset(name, data=table, chunks=(7, 5), **options)
        packed.create_dataset("sparse", shape=(1 << 20, 1 << 10), dtype="f4", chunks=(64, 64))
        texts = file.create_group("texts")
        texts["fixed"] = np.array([b"one", b"three"], dtype="S5")
        texts.create_dataset("free", data=["eins", "", "zwei"], dtype=h5py.string_dtype())
        images = texts.create_dataset("images", (2,), dtype=h5py.vlen_dtype(np.uint8))
        images[0] = np.frombuffer(b"\xff\xd8 jpeg", dtype="u1")
        images[1] = np.frombuffer(b"x", dtype="u1")
        many = file.create_group("many")
        for index in range(12):
            many.create_group(f"{index}:{index + 11}")
        file["soft"] = h5py.SoftLink("/numbers/f8")
        file["away"] = h5py.ExternalLink("other.h5", "/x")
        file["loop"] = h5py.SoftLink("/loop")


def write_small(path, libver, options):
    with h5py.File(path, "w", libver=libver) as file:
        file.attrs["text"] = "a"
        file.create_dataset("g/n", data=np.arange(24, dtype=">i2").reshape(6, 4), **options)
        file["g/n"].attrs["write_complete"] = True
        file["g/t"] = ["x", "yz"]


folder = Path(__file__).parent
write(folder / "old.h5", "earliest")
write(folder / "new.h5", "latest")
corpus = folder.parents[3] / "tests/fuzz/corpus/hdf5"
corpus.mkdir(exist_ok=True)
for libver in ["earliest", "latest"]:
    for name, options in {
        "plain": {},
        "packed": {"chunks": (4, 3), "compression": "gzip", "shuffle": True, "fletcher32": True},
        "lzf": {"chunks": (4, 3), "compression": "lzf", "maxshape": (None, 4)},
    }.items():
        write_small(corpus / f"{libver}-{name}", libver, options)
