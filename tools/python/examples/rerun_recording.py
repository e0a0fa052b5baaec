"""A clip as a Rerun recording: the field's points over time, cameras with their images, the robot's links.

    pip install rogs rerun-sdk
    python rerun_recording.py run/clips/CLIP out.rrd && rerun out.rrd

Times are seconds of the clip; the frame is that of the robot's base, metres, z up.
"""

import argparse
import pathlib

import numpy as np
import rerun as rr
import rogs


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("clip", type=pathlib.Path, help="folder of a clip in a run")
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("--opacity", type=float, default=0.5)
    args = parser.parse_args()
    field, clip = rogs.open(args.clip / "field-1.r4c"), rogs.open(args.clip / "clip.r4c")
    robot = rogs.open(args.clip / "robot.r4c")
    if (args.clip / "field-2.r4c").exists():
        field = field.refined(args.clip / "field-2.r4c")

    rr.init("rogs", recording_id=clip.head["clip_id"])
    rr.save(str(args.out))
    rr.log("base", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    length = (clip.frame_count - 1) / clip.head["fps"]
    links = robot.base_from_link
    for frame in range(clip.frame_count):
        rr.set_time("clip", duration=frame / clip.head["fps"])
        for index, name in enumerate(robot.link_names):
            pose = links[frame, index]
            rr.log(f"base/robot/{name}", rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
        for camera in clip.head["cameras"]:
            view = clip.camera(camera["id"], frame, robot)
            place = f"base/cameras/{camera['id']}"
            rr.log(place, rr.Transform3D(translation=view.pose[:3, 3], mat3x3=view.pose[:3, :3]))
            rr.log(place, rr.Pinhole(image_from_camera=view.intrinsics, width=view.width, height=view.height))
            if camera["has_rgb"]:
                rr.log(f"{place}/rgb", rr.Image(clip.rgb(camera["id"], frame)))
    for time in field.times:
        rr.set_time("clip", duration=time * length)
        now = field.at(time).in_base()
        keep = now.opacities >= args.opacity
        radii = now.scales[keep].max(axis=1)
        colours = (now.rgb[keep].clip(0, 1) * 255).astype(np.uint8)
        rr.log("base/field", rr.Points3D(now.means[keep], colors=colours, radii=radii))
    print(f"{args.out}: {clip.frame_count} frames, {len(field.times)} times of the field")


if __name__ == "__main__":
    main()
