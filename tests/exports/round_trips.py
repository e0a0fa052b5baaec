"""Exports, read back by programs that are not ours, beside the numbers of the npz export (docs/exports.md).

    python round_trips.py WHAT FOLDER

WHAT is ply, spz, 4dgs, gltf, colmap or nerfstudio; FOLDER has `field.npz` (all stored times, base frame) and what is read:
`field.ply`, `field.spz` (first time), `field.4dgs`, `field.glb` (all times), folders `colmap`, `nerfstudio`. Prints the largest
differences; ends with an assertion where one is more than the format allows.
"""

import gzip
import json
import pathlib
import struct
import subprocess
import sys

import numpy as np


def say(what, **differences):
    print(what, " ".join(f"{name} {value:.3g}" for name, value in differences.items()))


def turned(quats, other):
    """Largest difference of unit quaternions, which mean the same with either sign."""
    quats, other = (q / np.linalg.norm(q, axis=1, keepdims=True) for q in (quats, other))
    return np.minimum(np.abs(quats - other).max(1), np.abs(quats + other).max(1)).max()


def colour_of(arrays, moment=0):
    return arrays["rgb"][moment] if "rgb" in arrays else arrays["sh"][moment][:, 0] * 0.28209479 + 0.5


def ply(folder, arrays):
    from plyfile import PlyData

    rows = PlyData.read(folder / "field.ply")["vertex"]
    column = lambda *names: np.stack([rows[name] for name in names], axis=1)
    centres = np.abs(column("x", "y", "z") - arrays["means"][0]).max()
    scales = np.abs(column("scale_0", "scale_1", "scale_2") - np.log(arrays["scales"][0])).max()
    colours = np.abs(column("f_dc_0", "f_dc_1", "f_dc_2") * 0.28209479 + 0.5 - colour_of(arrays)).max()
    opacities = np.abs(1 / (1 + np.exp(-rows["opacity"].astype(float))) - arrays["opacities"][0]).max()
    quats = turned(column("rot_0", "rot_1", "rot_2", "rot_3"), arrays["quats"][0])
    say("plyfile", centre_m=centres, log_scale=scales, colour=colours, opacity=opacities, rotation=quats)
    assert centres == 0 and scales < 1e-5 and colours < 1e-6 and opacities < 2e-6 and quats < 1e-6


def spz(folder, arrays):
    """By the description of the format (no reader of version 3 is needed): gzip and fixed point."""
    data = gzip.decompress((folder / "field.spz").read_bytes())
    magic, version, n, degree, bits, _, _ = struct.unpack_from("<4sIIBBBB", data)
    assert (magic, version) == (b"NGSP", 3)
    raw = np.frombuffer(data, np.uint8, offset=16)
    parts = np.split(raw, np.cumsum([9 * n, n, 3 * n, 3 * n, 4 * n]))
    fixed = parts[0].reshape(-1, 3).astype(np.int32)
    fixed = (fixed[:, 0] | fixed[:, 1] << 8 | fixed[:, 2] << 16) << 8 >> 8
    centres = fixed.reshape(n, 3) / (1 << bits)
    # x right, y up, z backward of a base whose z is up.
    x, y, z = arrays["means"][0].T
    difference = np.abs(centres - np.stack([x, z, -y], axis=1)).max()
    opacities = np.abs(parts[1] / 255 - arrays["opacities"][0]).max()
    # Bytes hold harmonics of degree 0 up to 3.33.
    colours = np.abs((parts[2].reshape(n, 3) / 255 - 0.5) / 0.15 * 0.28209479 + 0.5 - colour_of(arrays)).max()
    scales = np.maximum(np.log(arrays["scales"][0]), -10)
    scales = np.abs(parts[3].reshape(n, 3) / 16 - 10 - scales).max()
    say("spz", centre_m=difference, log_scale=scales, colour=colours, opacity=opacities)
    assert difference <= 0.51 / (1 << bits) + 1e-6 and scales <= 0.0313 and opacities <= 0.00197 and colours < 0.004


def fourdgs(folder, arrays):
    from fourdgs import keyframe_delta_file as kdf

    data = (folder / "field.4dgs").read_bytes()
    decoded = kdf.decode_streamed(data)
    indexed, _ = kdf.decode_indexed(data)
    starts = [chunk.t0 for chunk in decoded.chunks]
    assert starts == [chunk.t0 for chunk in indexed.chunks] and len(starts) == len(arrays["times"])
    worst = dict.fromkeys(("centre_m", "log_scale", "colour", "opacity", "rotation", "halfway_m"), 0.0)
    keep = lambda name, value: worst.update({name: max(worst[name], float(value))})
    for moment, start in enumerate(starts):
        state = kdf.render_at(decoded, start)
        order = np.argsort(state["ids"]) if "ids" in state else slice(None)
        pick = lambda *names: next(np.asarray(state[name])[order] for name in names if name in state)
        keep("centre_m", np.abs(pick("centers", "center", "positions") - arrays["means"][moment]).max())
        keep("log_scale", np.abs(np.log(pick("scales", "scale")) - np.log(arrays["scales"][moment])).max())
        quats = pick("orientations", "rotations", "rotation")[:, [3, 0, 1, 2]]
        keep("rotation", turned(quats, arrays["quats"][moment]))
        rgba = pick("rgb", "colors", "color")
        keep("colour", np.abs(rgba[:, :3] - colour_of(arrays, moment).clip(0, 1)).max())
        opacity = pick("opacity", "opacities") if {"opacity", "opacities"} & set(state) else rgba[:, 3]
        keep("opacity", np.abs(opacity - arrays["opacities"][moment]).max())
        if moment + 1 < len(starts):
            half = kdf.render_at(decoded, (start + starts[moment + 1]) / 2)
            places = next(np.asarray(half[name])[order] for name in ("centers", "center", "positions") if name in half)
            middle = (arrays["means"][moment] + arrays["means"][moment + 1]) / 2
            keep("halfway_m", np.abs(places - middle).max())
    say("fourdgs", **worst)
    assert worst["centre_m"] < 6e-5 and worst["halfway_m"] < 2e-4 and worst["log_scale"] < 0.0051
    assert worst["colour"] < 6e-4 and worst["opacity"] < 6e-4 and worst["rotation"] < 1e-3
    words = [sys.executable, "-m", "fourdgs.cli", "validate", str(folder / "field.4dgs")]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def gltf(folder, arrays):
    """By the description of the format; the validator of Khronos is run by `validate_gltf.mjs`."""
    data = (folder / "field.glb").read_bytes()
    _, _, total, length = struct.unpack_from("<4sIII", data)
    document = json.loads(data[20 : 20 + length])
    blob = data[28 + length :]
    assert total == len(data)

    def read(index):
        accessor = document["accessors"][index]
        view = document["bufferViews"][accessor["bufferView"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        kind = {5126: "<f4", 5121: "u1", 5125: "<u4"}[accessor["componentType"]]
        return np.frombuffer(blob, kind, accessor["count"] * width, view["byteOffset"]).reshape(-1, width)

    primitive = document["meshes"][0]["primitives"][0]
    attribute = lambda name: read(primitive["attributes"][f"KHR_gaussian_splatting:{name}"])
    centre = read(primitive["attributes"]["POSITION"])
    worst = np.abs(centre - arrays["means"][0]).max()
    for moment, target in enumerate(primitive.get("targets", []), 1):
        worst = max(worst, np.abs(centre + read(target["POSITION"]) - arrays["means"][moment]).max())
    scales = np.abs(attribute("SCALE") - np.log(arrays["scales"][0])).max()
    quats = turned(attribute("ROTATION")[:, [3, 0, 1, 2]], arrays["quats"][0])
    colours = np.abs(attribute("SH_DEGREE_0_COEF_0") * 0.28209479 + 0.5 - colour_of(arrays)).max()
    say("gltf", centre_m=worst, log_scale=scales, rotation=quats, colour=colours)
    assert worst < 1e-6 and scales < 1e-5 and quats < 1e-6 and colours < 1e-6
    weights = [channel for channel in document["animations"][0]["channels"] if channel["target"]["path"] == "weights"]
    sampler = document["animations"][0]["samplers"][weights[0]["sampler"]]
    assert len(read(sampler["input"])) == len(arrays["times"])


def colmap(folder, _):
    import pycolmap

    model = pycolmap.Reconstruction(str(folder / "colmap/sparse/0"))
    worst = 0.0
    for image in model.images.values():
        camera = model.cameras[image.camera_id]
        pose = image.cam_from_world
        pose = pose() if callable(pose) else pose
        for seen in image.points2D:
            point = model.points3D[seen.point3D_id]
            projected = camera.img_from_cam(pose * point.xyz)
            worst = max(worst, np.abs(np.asarray(projected).ravel()[:2] - seen.xy).max())
    say(f"pycolmap {len(model.images)} images {len(model.points3D)} points", reprojection_px=worst)
    assert len(model.points3D) and worst < 1e-6


def nerfstudio(folder, _):
    """The formula of nerfstudio's loader: camera-to-world with OpenGL axes, pixel centres at + 0.5."""
    root = folder / "nerfstudio"
    meta = json.loads((root / "transforms.json").read_text())
    header, points = (root / "points3D.ply").read_bytes().split(b"end_header\n", 1)
    rows = np.frombuffer(points, [("xyz", "<f4", 3), ("rgb", "u1", 3)])
    best = np.full(len(rows), np.inf)
    for frame in meta["frames"]:
        matrix = np.array(frame["transform_matrix"])
        assert (root / frame["file_path"]).is_file() and abs(np.linalg.det(matrix[:3, :3]) - 1) < 1e-6
        local = (rows["xyz"] - matrix[:3, 3]) @ matrix[:3, :3]
        ahead = local[:, 2] < -1e-3
        z = np.where(ahead, -local[:, 2], 1)
        u, v = frame["fl_x"] * local[:, 0] / z + frame["cx"], -frame["fl_y"] * local[:, 1] / z + frame["cy"]
        # Each point was taken at the centre of a pixel of one of the images.
        off = np.maximum(np.abs(u % 1 - 0.5), np.abs(v % 1 - 0.5))
        best = np.where(ahead, np.minimum(best, off), best)
    say(f"nerfstudio {len(meta['frames'])} images {len(rows)} points", pixel_px=best.max())
    assert len(rows) and best.max() < 1e-2
    assert set(meta["train_filenames"]).isdisjoint(meta["test_filenames"])


if __name__ == "__main__":
    what, place = sys.argv[1], pathlib.Path(sys.argv[2])
    checks = {"ply": ply, "spz": spz, "4dgs": fourdgs, "gltf": gltf, "colmap": colmap, "nerfstudio": nerfstudio}
    with np.load(place / "field.npz") as npz:
        checks[what](place, dict(npz))
