#!/usr/bin/env python3
"""Compares link poses of rogs with those of pinocchio, for every URDF below a folder.

    python3 -m venv venv && venv/bin/pip install pin example-robot-data
    venv/bin/python tests/robots/compare_with_pinocchio.py --rogs "target/release/rogs fk" [FOLDER]

Without FOLDER the robots of `example-robot-data` are taken. Each robot stands in `--states` random joint states within
its limits; joints that mimic another follow it by the numbers in the file, floating joints stay at their origin. A robot
passes when every link agrees to 1e-9 in every entry of its pose, or when both programs refuse it. `--pictures OUT` hands
`--picture OUT/NAME.png` on, for a command that draws (`cargo run --example robot -p rogs-robot --`).
"""

import argparse
import csv
import json
import pathlib
import random
import shlex
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as xml

import numpy as np
import pinocchio as pin

TOLERANCE = 1e-9
MOVING = ("revolute", "continuous", "prismatic")


def joints_of(urdf):
    """Name, type, limits and mimic of every joint, in the order of the file."""
    joints = {}
    for joint in xml.parse(urdf).getroot().findall("joint"):
        limit, mimic = joint.find("limit"), joint.find("mimic")
        number = lambda element, name, default: float(element.get(name, default)) if element is not None else default
        joints[joint.get("name")] = {
            "type": joint.get("type"),
            "range": (number(limit, "lower", -1.5), number(limit, "upper", 1.5)),
            "mimic": None
            if mimic is None
            else (mimic.get("joint"), number(mimic, "multiplier", 1.0), number(mimic, "offset", 0.0)),
        }
    return joints


def value_of(name, joints, driven):
    """Value of a joint: its own, or what the joint it mimics says."""
    joint = joints[name]
    if joint["type"] not in MOVING:
        return 0.0
    if name in driven:
        return driven[name]
    other, multiplier, offset = joint["mimic"]
    return multiplier * value_of(other, joints, driven) + offset


def states_of(joints, count, seed):
    driven = [
        name
        for name, joint in joints.items()
        if joint["type"] in MOVING and (joint["mimic"] is None or joint["mimic"][0] not in joints)
    ]
    generator = random.Random(seed)
    def pick(name):
        lower, upper = joints[name]["range"]
        return generator.uniform(max(lower, -3.0), min(upper, 3.0)) if lower < upper else lower
    return driven, [{name: pick(name) for name in driven} for _ in range(count)]


def poses_of_pinocchio(model, joints, driven):
    q = pin.neutral(model)
    for index in range(1, model.njoints):
        name = model.names[index]
        if joints[name]["type"] not in MOVING:
            continue
        value, at = value_of(name, joints, driven), model.joints[index].idx_q
        if model.joints[index].nq == 2:
            q[at], q[at + 1] = np.cos(value), np.sin(value)
        else:
            q[at] = value
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return {
        frame.name: data.oMf[index].homogeneous
        for index, frame in enumerate(model.frames)
        if frame.type == pin.FrameType.BODY
    }


def compare(urdf, command, count, picture):
    """Largest difference, number of links, what was said; None as difference where rogs refuses."""
    joints = joints_of(urdf)
    driven, states = states_of(joints, count, urdf.name)
    with tempfile.NamedTemporaryFile("w", suffix=".csv", newline="") as table:
        writer = csv.writer(table)
        writer.writerow(driven)
        writer.writerows([repr(state[name]) for name in driven] for state in states)
        table.flush()
        more = ["--picture", str(picture)] if picture else []
        done = subprocess.run([*command, str(urdf), "--joints", table.name, *more], capture_output=True, text=True)
    try:
        model = pin.buildModelFromUrdf(str(urdf))
    except Exception as error:  # whatever the bindings raise
        return ("both refuse" if done.returncode else "pinocchio refuses"), None, 0, f"{done.stderr.strip()} | {error}"
    if done.returncode:
        return "rogs refuses", None, 0, done.stderr.strip()
    worst, links = 0.0, 0
    for state, row in zip(states, json.loads(done.stdout)["items"]):
        expected = poses_of_pinocchio(model, joints, state)
        links = len(row["links"])
        if set(row["links"]) != set(expected):
            return "other links", None, links, str(set(row["links"]) ^ set(expected))
        for name, pose in row["links"].items():
            worst = max(worst, np.abs(np.array(pose).reshape(4, 4) - expected[name]).max())
    return ("agree" if worst <= TOLERANCE else "DIFFER"), worst, links, done.stderr.strip()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=pathlib.Path)
    parser.add_argument("--rogs", default="rogs fk", help="command that prints link poses")
    parser.add_argument("--states", type=int, default=5)
    parser.add_argument("--pictures", type=pathlib.Path)
    arguments = parser.parse_args()
    folder = arguments.folder
    if folder is None:
        above = (parent for place in sys.path for parent in (pathlib.Path(place), *pathlib.Path(place).parents))
        folder = next((p for p in (place / "share/example-robot-data" for place in above) if p.is_dir()), None)
    if folder is None:
        parser.error("example-robot-data is not installed: name a FOLDER")
    command = shlex.split(arguments.rogs)
    bad = worst = 0
    robots = sorted(folder.rglob("*.urdf"))
    for urdf in robots:
        picture = arguments.pictures and arguments.pictures / f"{urdf.stem}.png"
        verdict, difference, links, said = compare(urdf, command, arguments.states, picture)
        bad += verdict not in ("agree", "both refuse")
        worst = max(worst, difference or 0.0)
        shown = "" if difference is None else f" {difference:.1e} over {links} links"
        print(f"{urdf.stem}: {verdict}{shown}{': ' + said if said else ''}")
    print(f"{len(robots)} robots, {bad} fail, largest difference {worst:.1e}")
    return 1 if bad or not robots else 0


if __name__ == "__main__":
    sys.exit(main())
