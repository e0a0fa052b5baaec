"""FK conditioning maps with numpy, dense and on supported pixels only. Called by the bench `fk_maps` with a folder.

The folder holds `sizes.i64` (views, queries, height, width, links), `ids.u8` ([S, H, W], 255 = none), `depth.f32`
([S, H, W]), `focal.f32`, `camera.f32` ([S, 4, 4]), `source.f32` ([S, L, 4, 4]) and `query.f32` ([Q, L, 4, 4]). Prints one
line a variant, `NAME MEDIAN_MS BEST_MS PROCESSOR_MS PEAK_MIB` (mean processor time of all threads), and writes map (1, 2) as NAME.map.
"""

import os
import resource
import statistics
import sys
import time

import numpy as np

folder = sys.argv[1]


def load(name, kind):
    return np.fromfile(os.path.join(folder, name), kind)


views, queries, height, width, count = load("sizes.i64", np.int64)
ids = load("ids.u8", np.uint8).reshape(views, height, width)
depth = load("depth.f32", np.float32).reshape(views, height, width)
focal = load("focal.f32", np.float32)[0]
camera = load("camera.f32", np.float32).reshape(views, 4, 4)
source = load("source.f32", np.float32).reshape(views, count, 4, 4)
query = load("query.f32", np.float32).reshape(queries, count, 4, 4)
rows, columns = np.mgrid[0:height, 0:width] + 0.5
rays = np.stack([(columns - width / 2) / focal, (rows - height / 2) / focal, np.ones_like(rows)], -1).astype(np.float32)


def inverse(poses):
    rotation = np.swapaxes(poses[..., :3, :3], -1, -2)
    result = np.zeros_like(poses)
    result[..., :3, :3] = rotation
    result[..., :3, 3] = -(rotation @ poses[..., :3, 3:])[..., 0]
    result[..., 3, 3] = 1
    return result


def supported_only():
    result = np.zeros((views, queries, 5, height, width), np.float32)
    back = inverse(source)
    for view in range(views):
        mask = ids[view] != 255
        link = ids[view][mask]
        points = (rays[mask] * depth[view][mask][:, None]) @ camera[view, :3, :3].T + camera[view, :3, 3]
        result[view, :, 0] = mask
        result[view, :, 1] = np.where(mask, depth[view], 0)
        motion = query @ back[view]
        for moment in range(queries):
            chosen = motion[moment][link]
            moved = np.einsum("nij,nj->ni", chosen[:, :3, :3], points) + chosen[:, :3, 3]
            result[view, moment, 2:, mask] = (moved - points) * np.float32(3.5)
    return result


def dense():
    result = np.zeros((views, queries, 5, height, width), np.float32)
    back = inverse(source)
    for view in range(views):
        mask = ids[view] != 255
        link = np.where(mask, ids[view], 0)
        points = (rays * depth[view][..., None]) @ camera[view, :3, :3].T + camera[view, :3, 3]
        motion = query @ back[view]
        for moment in range(queries):
            chosen = motion[moment][link]
            moved = np.einsum("hwij,hwj->hwi", chosen[..., :3, :3], points) + chosen[..., :3, 3]
            result[view, moment, 0] = mask
            result[view, moment, 1] = depth[view] * mask
            result[view, moment, 2:] = np.moveaxis((moved - points) * (3.5 * mask[..., None]), -1, 0)
    return result


def fill():
    buffer.fill(1)
    return buffer


buffer = np.zeros((views, queries, 5, height, width), np.float32)
for name, work, runs in (("numpy-supported-only", supported_only, 9), ("numpy-dense", dense, 3), ("fill-of-the-output", fill, 9)):
    work()
    times = []
    processor = time.process_time()
    for _ in range(runs):
        start = time.perf_counter()
        result = work()
        times.append((time.perf_counter() - start) * 1e3)
    processor = (time.process_time() - processor) * 1e3 / runs
    result[1, 2].tofile(os.path.join(folder, name + ".map"))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{name} {statistics.median(times):.3f} {min(times):.3f} {processor:.3f} {memory:.0f}", flush=True)
