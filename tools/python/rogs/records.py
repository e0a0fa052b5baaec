"""Records: the `.r4c` files of a run."""

from __future__ import annotations

import json
import os
import tempfile
from dataclasses import dataclass

import numpy as np

from . import _rogs, r4c
from .camera import Camera
from .gaussians import Gaussians
from .program import run_program


@dataclass
class Stream:
    """What a file says of a stream."""

    name: str
    dtype: str
    shape: tuple
    """Of one element."""
    unit: str
    """`1`, `m`, `iu` (internal units, 3.5 per metre), `rad`, `px`, `s`."""
    frame: str
    """`none`, `recon`, `robot_base`, `camera`."""
    fill: str
    """What a NaN or 0 means."""


class Record:
    """An open `.r4c` file: its index is read and checked, everything else when it is asked for.

    Raises FileNotFoundError, DamagedError, or, for a stream that is not there, KeyError; messages name file and stream.
    """

    def __init__(self, path: str | os.PathLike):
        self.path = os.fspath(path)
        """The file."""
        self._container = _rogs.Container(path)
        self.streams = {stream[0]: Stream(stream[0], stream[1], tuple(stream[2]), *stream[3:]) for stream in self._container.streams()}
        """Streams by name."""
        self._head = None

    def __repr__(self) -> str:
        return f"<{self.schema} {'.'.join(map(str, self.version))} `{self.path}`>"

    @property
    def schema(self) -> str:
        """Name of the schema, e.g. `rogs.field`."""
        return self._container.schema

    @property
    def version(self) -> tuple[int, int]:
        """Version of the schema: breaking, additive."""
        return self._container.version

    @property
    def provenance(self) -> dict:
        """How the file was made (docs/spec/r4c.md section 3.6)."""
        return json.loads(self._container.provenance())

    @property
    def head(self) -> dict:
        """The small structured data (docs/spec/r4c.md section 5)."""
        if self._head is None:
            cursor = lambda name: r4c.Cursor(self._container.read(name).tobytes())
            self._head = r4c.head(self.schema, self.streams, cursor)
        return self._head

    def array(self, name: str) -> np.ndarray:
        """A whole stream, chunks one behind the other. [elements, *shape]"""
        raw = self._container.read(name)
        return self._shaped(name, raw)

    def chunk(self, name: str, *coordinates: int) -> np.ndarray:
        """One chunk of a stream by its coordinates; those left out are 0. [elements, *shape]"""
        place = (*coordinates, *[0] * (4 - len(coordinates)))
        raw = self._container.read_chunk(name, place)
        return self._shaped(name, raw)

    def chunks(self, name: str) -> list[tuple[tuple, int]]:
        """Coordinates and numbers of elements of the chunks of a stream."""
        return [(tuple(place), count) for place, count in self._container.chunks(name)]

    def _shaped(self, name, raw):
        stream = self.streams[name]
        return raw.view(stream.dtype).reshape(-1, *stream.shape)


class Field(Record):
    """A 4D Gaussian field."""

    def __init__(self, path: str | os.PathLike, refinement: str | os.PathLike | None = None):
        super().__init__(path)
        self._refinement = refinement
        self._field = _rogs.FieldFile(path, refinement)

    def refined(self, refinement: str | os.PathLike) -> Field:
        """The same field with the corrections of Stage 2 (`field-2.r4c`)."""
        return Field(self.path, refinement)

    @property
    def times(self) -> list[float]:
        """Stored normalised times, ascending, 0 to 1."""
        return self._field.times

    @property
    def recon_from_base(self) -> np.ndarray:
        """Base-to-reconstruction, metres. [4, 4]"""
        return matrix(self.head["recon_from_base"])

    def at(self, time: float) -> Gaussians:
        """The Gaussians at a normalised time.

        Stored times are read from the file. Others are answered by the network that the field was lifted with, for which
        the program `rogs` is called; they come as plain arrays in the reconstruction frame.
        """
        time = float(time)
        stored = [own for own in self.times if abs(own - time) < 1e-6]
        if stored:
            return Gaussians(self._field.at(stored[0]))
        with tempfile.TemporaryDirectory() as folder:
            out = os.path.join(folder, "field.npz")
            words = ["export", "field", self.path, "--format", "npz", "--times", repr(time), "--out", out]
            if self._refinement is not None:
                words += ["--refinement", self._refinement]
            run_program(*words)
            arrays = np.load(out)
            colour = {name: arrays[name][0] for name in ("rgb", "sh") if name in arrays}
            return Gaussians.from_arrays(
                arrays["means"][0], arrays["quats"][0], arrays["scales"][0], arrays["opacities"][0], **colour
            )

    def displacement(self, since: float, time: float) -> np.ndarray:
        """How far each Gaussian moves from a stored time to another, metres, reconstruction frame. [N, 3] float32"""
        return self._field.displacement_m(since, time)


class Clip(Record):
    """A clip: images, cameras, robot states, references."""

    @property
    def camera_names(self) -> list[str]:
        """Names of the cameras: sources first."""
        return [camera["id"] for camera in self.head["cameras"]]

    @property
    def frame_count(self) -> int:
        """Number of frames."""
        return len(self.head["episode_frames"])

    def time(self, frame: int) -> float:
        """Normalised time of a frame."""
        return frame / (self.frame_count - 1) if self.frame_count > 1 else 0.0

    def rgb(self, camera: str, frame: int, generated: bool = False) -> np.ndarray:
        """The recorded image, or that of the world model in a rollout. [H, W, 3] uint8"""
        name = "generated_rgb" if generated else "rgb"
        return self.chunk(name, self._index(camera), frame)[0]

    def depth(self, camera: str, frame: int) -> np.ndarray:
        """Reference depth, camera z in metres, NaN where unknown. [H, W] float32"""
        return self.chunk("depth_m", self._index(camera), frame)[0]

    def joints(self) -> dict[str, np.ndarray]:
        """Joint values by name, [F] radians (metres for prismatic joints), as `Robot.fk` takes them."""
        robot = self.head["robot"]
        names = robot["joint_names"]
        return dict(zip(names, np.reshape(robot["positions"], (-1, len(names))).T))

    def camera(self, name: str, frame: int, robot: RobotMaps) -> Camera:
        """A camera at a frame; `robot` is the clip's `robot.r4c`, which has the poses of cameras that move with the robot."""
        index, head = self._index(name), self.head
        if robot.head["clip_id"] != head["clip_id"]:
            raise ValueError(f"`{robot.path}` is of clip `{robot.head['clip_id']}`, `{self.path}` of `{head['clip_id']}`")
        lens = head["cameras"][index]["intrinsics"]
        pose = robot.base_from_camera(index, frame, self.frame_count)
        return Camera(head["width"], head["height"], lens["fx"], lens["fy"], lens["cx"], lens["cy"], pose)

    def _index(self, name):
        if name not in self.camera_names:
            raise KeyError(f"`{self.path}` has no camera `{name}` (cameras: {', '.join(self.camera_names)})")
        return self.camera_names.index(name)


class RobotMaps(Record):
    """Where links and cameras are, and how source cameras see the robot."""

    @property
    def link_names(self) -> list[str]:
        """Names of the links; a link id is an index into it. [L]"""
        return self.head["link_names"]

    @property
    def base_from_link(self) -> np.ndarray:
        """Poses of the links at every frame, metres. [F, L, 4, 4]"""
        poses = np.stack([matrix(pose) for pose in self.head["base_from_link"]])
        return poses.reshape(-1, len(self.link_names), 4, 4)

    def base_from_camera(self, camera: int, frame: int, frames: int) -> np.ndarray:
        """Pose of a camera of the clip, by its index, at one of so many frames. [4, 4]"""
        if not 0 <= frame < frames:
            raise IndexError(f"frame {frame} is outside the clip, which has frames 0 to {frames - 1}")
        return matrix(self.head["base_from_camera"][camera * frames + frame])

    def mesh_depth(self, camera: int, frame: int) -> np.ndarray:
        """Depth of the robot's mesh, camera z in metres, 0 where it is not. [H, W] float32"""
        return self.chunk("mesh_depth_m", camera, frame)[0]

    def links(self, camera: int, frame: int) -> np.ndarray:
        """Link id of each pixel, 255 where no link is. [H, W] uint8"""
        return self.chunk("link", camera, frame)[0]


class Conditioning(Record):
    """How far kinematics moves each pixel of the robot."""


class References(Record):
    """Depth and tracks that the pipeline made."""


class Refinement(Record):
    """Corrections of Stage 2; `Field.refined` applies them."""


class Scores(Record):
    """Metrics of a clip."""

    @property
    def images(self) -> list[dict]:
        """A dict for every image that was scored: camera, frame, psnr, ssim, lpips, absrel, ..."""
        return self.head["images"]


KINDS = {
    "rogs.clip": Clip,
    "rogs.robot": RobotMaps,
    "rogs.conditioning": Conditioning,
    "rogs.references": References,
    "rogs.field": Field,
    "rogs.refinement": Refinement,
    "rogs.scores": Scores,
}


def open(path: str | os.PathLike) -> Record:
    """Opens any `.r4c` file."""
    schema = _rogs.Container(path).schema
    return KINDS.get(schema, Record)(path)


def matrix(pose: dict) -> np.ndarray:
    """A pose of a head as a matrix. [4, 4]"""
    out = np.eye(4)
    out[:3, :3] = np.reshape(pose["rotation"], (3, 3))
    out[:3, 3] = pose["translation"]
    return out
