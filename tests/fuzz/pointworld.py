"""Writes corpus/pointworld: a first byte that says which file it is, then the file.

h5py 3.16 (HDF5 2.0) wrote the ones that are committed.
"""

import io
import json
from pathlib import Path

import h5py
import numpy as np

here = Path(__file__).parent / "corpus/pointworld"
pose = np.eye(4)


def write(name, role, data):
    (here / name).write_bytes(bytes([role]) + data)


def hdf5(fill, libver):
    data = io.BytesIO()
    with h5py.File(data, "w", libver=libver) as file:
        fill(file)
    return data.getvalue()


def put(group, name, value, **options):
    group.create_dataset(name, data=value, **options).attrs["write_complete"] = True


def depth(file):
    file.create_group("metadata").attrs.update({"uuid": "E", "camera_count": 1, "write_complete": True})
    maps = np.full((2, 6, 8), 900, "u2")
    put(file, "a+ext/depth", maps, compression="gzip", shuffle=True, chunks=(1, 6, 8))
    put(file, "a+ext/timestamps", np.array([0, 66], "i8"))


def flows(file):
    file.attrs.update({"uuid": "E", "canonical_timestamps": str([0, 66])})
    clip = file.create_group("0:2")
    put(clip, "joint_positions", np.full((2, 1), 0.1, "f4"))
    put(clip, "camera_a_ext/scene_flows", np.full((2, 3, 3), [0, 0, 1], "f2"))
    put(clip, "camera_a_ext/scene_visibility", np.ones((2, 3), bool))
    put(clip, "camera_a_ext/scene_depth_valid_mask", np.ones((2, 3), bool))
    put(clip, "camera_a_ext/initial_depth", np.full((6, 8), 900, "u2"))
    put(clip, "camera_a_ext/intrinsic", np.array([[8, 0, 3.5], [0, 8, 2.5], [0, 0, 1]], "f4"))
    put(clip, "camera_a_ext/extrinsic", pose.astype("f4"))


cameras = {"uuid": "E", "optimization_success": True, "optimization_summary": {"final_loss": 0.05},
           "a": {"optimized_extrinsics": pose.tolist()}}
write("cameras", 0, json.dumps(cameras).encode())
for libver in ["earliest", "latest"]:
    write(f"depth-{libver}", 1, hdf5(depth, libver))
    write(f"flows-{libver}", 2, hdf5(flows, libver))
