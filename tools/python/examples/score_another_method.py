"""Another method, scored as the field is: its depth against reference depth, its images against held-out cameras.

    python score_another_method.py run/clips/CLIP [--folder predictions]

`--folder` holds what the method made, `CAMERA_FRAME.npz` with `rgb [H, W, 3]` in 0..1 and `depth [H, W]` in metres (0 where
there is none), for the images of `rogs export clip run/clips/CLIP/clip.r4c --format nerfstudio`. Without it the method is a
simple one of four lines: what the nearest source camera sees at that time, as a cloud of points, drawn into the view.
"""

import argparse
import pathlib

import numpy as np
import rogs


def points_of(clip, robot, camera, frame):
    """What a camera sees, as points in the base frame: reference depth. [N, 3], [N, 3]"""
    view, depth = clip.camera(camera, frame, robot), clip.depth(camera, frame)
    known = np.isfinite(depth)
    seen = view.rays()[known] * depth[known][:, None]
    return seen @ view.pose[:3, :3].T + view.pose[:3, 3], clip.rgb(camera, frame)[known]


def drawn(points, colours, view):
    """Points drawn into a view, the nearest in front. [H, W, 3], [H, W]"""
    local = (points - view.pose[:3, 3]) @ view.pose[:3, :3]
    ahead = local[:, 2] > 0.05
    local, colours = local[ahead], colours[ahead]
    column = np.floor(view.fx * local[:, 0] / local[:, 2] + view.cx).astype(int)
    row = np.floor(view.fy * local[:, 1] / local[:, 2] + view.cy).astype(int)
    inside = (column >= 0) & (column < view.width) & (row >= 0) & (row < view.height)
    order = np.argsort(-local[inside, 2], kind="stable")
    place = row[inside][order], column[inside][order]
    image, depth = np.zeros((view.height, view.width, 3), np.uint8), np.zeros((view.height, view.width), np.float32)
    image[place], depth[place] = colours[inside][order], local[inside, 2][order]
    return image, depth


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("clip", type=pathlib.Path, help="folder of a clip in a run")
    parser.add_argument("--folder", type=pathlib.Path)
    args = parser.parse_args()
    clip, robot = rogs.open(args.clip / "clip.r4c"), rogs.open(args.clip / "robot.r4c")
    field = rogs.open(args.clip / "field-1.r4c")
    cameras = {camera["id"]: camera for camera in clip.head["cameras"]}
    with_depth = [name for name, camera in cameras.items() if camera["depth_range_m"]]
    sources = [name for name in with_depth if cameras[name]["role"] == "source"]

    rows = []
    for name in with_depth:
        for frame in clip.head["query_frames"]:
            time = clip.time(frame)
            if time not in field.times or not cameras[name]["has_rgb"]:
                continue
            view = clip.camera(name, frame, robot)
            if args.folder:
                with np.load(args.folder / f"{name}_{frame:06d}.npz") as made:
                    image, depth = made["rgb"], made["depth"]
            else:
                others = [source for source in sources if source != name] or sources
                clouds = [points_of(clip, robot, source, frame) for source in others]
                image, depth = drawn(*map(np.concatenate, zip(*clouds)), view)
            render = field.at(time).render(view)
            reference, truth = clip.rgb(name, frame), clip.depth(name, frame)
            pairs = ((image, depth), (render.image, render.depth))
            scores = [(rogs.psnr(a, reference), rogs.depth_scores(b, truth, cameras[name]["depth_range_m"])) for a, b in pairs]
            rows.append([(psnr, depth["absrel"] if depth else np.nan) for psnr, depth in scores])
    if not rows:
        raise SystemExit("no image with reference depth at a stored time")
    mean = np.nanmean(np.array(rows), axis=0)
    for method, (psnr, absrel) in zip(("other method", "rogs field"), mean):
        print(f"{method:14} PSNR {psnr:6.2f} dB   AbsRel {absrel:.4f}   ({len(rows)} images)")


if __name__ == "__main__":
    main()
