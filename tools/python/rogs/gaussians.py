"""Gaussians at a time."""

from __future__ import annotations

import os

import numpy as np

from . import _rogs
from .camera import Camera, View


class Gaussians:
    """Gaussians at a time, in the reconstruction frame unless `frame` says `base`. Row n is the same one at all times."""

    def __init__(self, inner: _rogs.Gaussians):
        self._inner = inner

    @classmethod
    def from_arrays(cls, means, quats, scales, opacities, *, rgb=None, sh=None) -> Gaussians:
        """Gaussians of arrays: means [N, 3] and scales [N, 3] in metres, quats [N, 4] (w, x, y, z), opacities [N] in 0..1,
        and either rgb [N, 3] or harmonics sh [N, K, 3] of degree 0 to 3."""
        of = lambda values: None if values is None else np.ascontiguousarray(values, np.float32)
        arrays = [of(values) for values in (means, quats, scales, opacities)]
        return cls(_rogs.Gaussians.from_arrays(*arrays, rgb=of(rgb), sh=of(sh)))

    @classmethod
    def read_ply(cls, path: str | os.PathLike) -> Gaussians:
        """Gaussians of a 3DGS PLY file, plain or compressed."""
        return cls(_rogs.Gaussians.read_ply(path))

    def write_ply(self, path: str | os.PathLike) -> None:
        """Writes a 3DGS PLY file in metres."""
        self._inner.write_ply(path)

    def __len__(self) -> int:
        return len(self._inner)

    def __repr__(self) -> str:
        return f"<{len(self)} Gaussians, frame {self.frame}>"

    @property
    def frame(self) -> str:
        """`recon` or `base`."""
        return self._inner.frame

    @property
    def means(self) -> np.ndarray:
        """Centres, metres. [N, 3] float32"""
        return self._inner.means

    @property
    def scales(self) -> np.ndarray:
        """Standard deviations along the own axes, metres. [N, 3] float32"""
        return self._inner.scales

    @property
    def quats(self) -> np.ndarray:
        """Rotations (w, x, y, z), of any length but 0. [N, 4] float32"""
        return self._inner.quats

    @property
    def opacities(self) -> np.ndarray:
        """In 0..1. [N] float32"""
        return self._inner.opacities

    @property
    def rgb(self) -> np.ndarray:
        """Colours that do not depend on the direction. [N, 3] float32"""
        return self._inner.rgb

    @property
    def sh(self) -> np.ndarray:
        """Real spherical harmonics in the signs of 3DGS. [N, K, 3] float32"""
        return self._inner.sh

    def in_base(self) -> Gaussians:
        """The same in the frame of the robot's base."""
        return Gaussians(self._inner.in_base())

    def kept(self, keep) -> Gaussians:
        """Those whose flag in `keep` [N] is set."""
        return Gaussians(self._inner.kept(np.asarray(keep, bool).tolist()))

    def render(self, camera: Camera) -> View:
        """What a camera sees: bit for bit what `rogs render` makes of the same camera, time and field."""
        lens = [float(value) for value in (camera.fx, camera.fy, camera.cx, camera.cy)]
        size = (int(camera.width), int(camera.height))
        return View(**self._inner.render(size, lens, camera.pose.ravel().tolist(), camera.frame))
