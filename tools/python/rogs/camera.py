"""Cameras, and what they see."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass

import numpy as np


@dataclass
class Camera:
    """A pinhole camera at a pose.

    Pixel (column, row) has its centre at (column + 0.5, row + 0.5); camera axes are x right, y down, z forward.
    """

    width: int
    """Pixels."""
    height: int
    """Pixels."""
    fx: float
    """Focal length along x, pixels."""
    fy: float
    """Focal length along y, pixels."""
    cx: float
    """Principal point, pixels."""
    cy: float
    """Principal point, pixels."""
    pose: np.ndarray
    """Camera-to-frame, metres. [4, 4]"""
    frame: str = "base"
    """What `pose` leads to: `base` (the robot's base) or `recon` (the reconstruction frame)."""

    def __post_init__(self):
        self.pose = np.asarray(self.pose, np.float64)
        if self.pose.shape != (4, 4):
            raise ValueError(f"a pose of shape {self.pose.shape}: expected [4, 4]")
        if self.frame not in ("base", "recon"):
            raise ValueError(f"frame `{self.frame}`: expected `base` or `recon`")

    @classmethod
    def read(cls, path: str | os.PathLike) -> Camera:
        """A camera of a JSON file, as `rogs render --camera FILE` takes it."""
        with open(path) as file:
            spec = json.load(file)
        frame = "base" if "base_from_camera" in spec else "recon"
        lens = spec["intrinsics"]
        pose = spec[f"{frame}_from_camera"]
        return cls(spec["width"], spec["height"], lens["fx"], lens["fy"], lens["cx"], lens["cy"], pose, frame)

    @property
    def intrinsics(self) -> np.ndarray:
        """Pixels. [3, 3]"""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    def resized(self, width: int, height: int) -> Camera:
        """The same view in pictures of another size."""
        x, y = width / self.width, height / self.height
        return Camera(width, height, self.fx * x, self.fy * y, self.cx * x, self.cy * y, self.pose, self.frame)

    def rays(self) -> np.ndarray:
        """Directions of pixel centres in the camera's frame, z = 1: depth times ray is a point. [H, W, 3]"""
        x = (np.arange(self.width) + 0.5 - self.cx) / self.fx
        y = (np.arange(self.height) + 0.5 - self.cy) / self.fy
        x, y = np.meshgrid(x, y)
        return np.stack([x, y, np.ones_like(x)], axis=-1)


@dataclass
class View:
    """What a camera sees of Gaussians."""

    rgb: np.ndarray
    """Colours over black, not clipped. [H, W, 3] float32"""
    alpha: np.ndarray
    """Accumulated opacity. [H, W] float32"""
    depth: np.ndarray
    """Expected depth, camera z, metres; 0 where nothing is. [H, W] float32"""
    image: np.ndarray
    """The pixels that `rogs render` writes. [H, W, 3] uint8"""
