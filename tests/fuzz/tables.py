"""Makes the corpus of the targets `lerobot`, `published` and `calibration`; needs pyarrow: python3 tests/fuzz/tables.py"""

import io
import json
import pathlib

import pyarrow as pa
import pyarrow.parquet as pq

MARK = b"\n====\n"
PLACE = pathlib.Path(__file__).parent / "corpus"


def parquet(columns, compression):
    out = io.BytesIO()
    pq.write_table(pa.table(columns), out, compression=compression, store_schema=False)
    return out.getvalue()


def write(target, name, content):
    folder = PLACE / target
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(content)


def lerobot():
    info = {
        "codebase_version": "v2.1",
        "robot_type": "arm",
        "fps": 15,
        "chunks_size": 1000,
        "data_path": "data/rows.parquet",
        "video_path": "v/{video_key}/{episode_index:06d}.mp4",
        "features": {
            "observation.state": {"dtype": "float32", "shape": [3], "names": ["j1.pos", "j2.pos", "gripper.pos"]},
            "observation.images.top": {"dtype": "video", "shape": [6, 8, 3], "names": None},
        },
    }
    rows = 3
    columns = {
        "observation.state": pa.array([[0.1, 0.2, 0.5]] * rows, pa.list_(pa.float32())),
        "timestamp": pa.array([at / 15 for at in range(rows)], pa.float32()),
        "frame_index": pa.array(range(rows), pa.int64()),
        "episode_index": pa.array([0] * rows, pa.int64()),
        "index": pa.array(range(rows), pa.int64()),
        "task_index": pa.array([0] * rows, pa.int64()),
    }
    lines = json.dumps({"episode_index": 0, "tasks": ["lift"], "length": rows}).encode() + b"\n"
    task = json.dumps({"task_index": 0, "task": "lift"}).encode()
    head = json.dumps(info).encode()
    write("lerobot", "v21", b"\0" + MARK.join([head, lines, task, parquet(columns, "none")]))
    fixed = dict(columns)
    fixed["observation.state"] = pa.array([[0.1, 0.2, 0.5]] * rows, pa.list_(pa.float64(), 3))
    write("lerobot", "v21-snappy", b"\0" + MARK.join([head, lines, task, parquet(fixed, "snappy")]))
    info["codebase_version"] = "v3.0"
    head = json.dumps(info).encode()
    key = "videos/observation.images.top"
    episodes = {
        "episode_index": pa.array([0, 1], pa.int64()),
        "tasks": pa.array([["lift"], ["lift"]], pa.list_(pa.string())),
        "length": pa.array([rows, rows], pa.int64()),
        "data/chunk_index": pa.array([0, 0], pa.int64()),
        "data/file_index": pa.array([0, 0], pa.int64()),
        "dataset_from_index": pa.array([0, rows], pa.int64()),
        "dataset_to_index": pa.array([rows, 2 * rows], pa.int64()),
        f"{key}/chunk_index": pa.array([0, 0], pa.int64()),
        f"{key}/file_index": pa.array([0, 0], pa.int64()),
        f"{key}/from_timestamp": pa.array([0.0, 0.2], pa.float64()),
        f"{key}/to_timestamp": pa.array([0.2, 0.4], pa.float64()),
    }
    tasks = {"task_index": pa.array([0], pa.int64()), "task": pa.array(["lift"], pa.string())}
    pieces = [head, parquet(episodes, "none"), parquet(tasks, "none"), parquet(columns, "none")]
    write("lerobot", "v30", b"\1" + MARK.join(pieces))


def published():
    six = [0.3, -0.6, 0.5, -2.0, 0.1, 2.5]
    uuid, serial = "A+0+1", "24400334"
    at = "gs://x/LAB/success/2023-07-07/A+0+1"
    files = [
        {uuid: {serial: six, serial + "_iou": 0.6, "relative_path": "LAB"}},
        {uuid: {serial: {"extrinsics": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.5], [0, 0, 0, 1]], "loss": 0.2}}},
        {uuid: {serial + "-22008760": six}},
        {uuid: {serial: {"cameraMatrix": [524.3, 639.8, 524.5, 370.3], "width": 1280, "height": 720}}},
        {uuid: {"wrist_cam_serial": "1", "ext1_cam_serial": 2, "ext2_cam_serial": "3"}},
        {uuid: "LAB/success/2023-07-07/A+0+1/"},
        {serial: {"mean_mat": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.1], [0, 0, 0, 1]], "wrist_cam_serial": serial}},
        {f"{at}/recordings/MP4--{at}/trajectory.h5": [[0, 3], [5, 9]]},
    ]
    for role, value in enumerate(files):
        write("published", str(role), bytes([role]) + json.dumps(value).encode())
    conf = b"[LEFT_CAM_HD]\nfx=532.0\nfy=531.9\ncx=637.9\ncy=369.1\n[STEREO]\nBaseline=120.06\n"
    write("published", "8", bytes([8]) + conf)


def calibration():
    lens = [[8, 0, 4], [0, 8, 3], [0, 0, 1]]
    poses = [
        [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.5], [0, 0, 0, 1]],
        [0.1, 0.2, 0.3, 0, 0, 1.5],
        {"translation": [0.1, 0.2, 0.3], "rotation": [0, 0, 0, 1]},
    ]
    for index, pose in enumerate(poses):
        camera = {"intrinsic": lens, "camera_to_base": pose, "distortion": [0, 0.0]}
        if index == 1:
            camera = {"intrinsic": lens, "camera_to_link": pose, "link": "hand"}
        file = {"image_size": [8, 6], "pixel_centres": "integer", "status": "made", "cameras": {"a": camera}}
        write("calibration", str(index), json.dumps(file).encode())


lerobot()
published()
calibration()
