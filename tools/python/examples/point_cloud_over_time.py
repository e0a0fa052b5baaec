"""A field as a point cloud over time, in the frame of the robot's base, for planners and for Open3D.

    python point_cloud_over_time.py run/clips/CLIP out.npz [--opacity 0.5] [--moving 0.005]

Writes `times [T]`, `points [T, N, 3]` metres, `colours [N, 3]` of the first time, `moving [N]`: which points travel farther
than `--moving` metres, and `link [N]`: the robot's link that a point is anchored to, or 255.
"""

import argparse
import pathlib

import numpy as np
import rogs


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("clip", type=pathlib.Path, help="folder of a clip in a run")
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("--opacity", type=float, default=0.5, help="leave out what is less opaque at every time")
    parser.add_argument("--moving", type=float, default=0.005, help="metres")
    args = parser.parse_args()

    field = rogs.open(args.clip / "field-1.r4c")
    correction = args.clip / "field-2.r4c"
    if correction.exists():
        field = field.refined(correction)
    moments = [field.at(time).in_base() for time in field.times]
    keep = np.max([moment.opacities for moment in moments], axis=0) >= args.opacity
    points = np.stack([moment.means[keep] for moment in moments])
    travelled = np.linalg.norm(points - points[0], axis=2).max(axis=0)
    np.savez_compressed(
        args.out,
        times=np.array(field.times),
        points=points,
        colours=moments[0].rgb[keep].clip(0, 1),
        moving=travelled > args.moving,
        link=field.array("link")[keep],
    )
    print(f"{keep.sum()} of {len(keep)} points at {len(moments)} times, {np.sum(travelled > args.moving)} of them move")


if __name__ == "__main__":
    main()
