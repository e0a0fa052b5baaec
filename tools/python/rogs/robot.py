"""Kinematics."""

from __future__ import annotations

import os

import numpy as np

from . import _rogs


class Robot:
    """A robot that a URDF describes."""

    def __init__(self, urdf: str | os.PathLike, base_link: str | None = None):
        self._model = _rogs.RobotModel(urdf, base_link)

    @property
    def name(self) -> str:
        """Name in the file."""
        return self._model.name

    @property
    def notes(self) -> list[str]:
        """What the file says that was left aside."""
        return self._model.notes

    @property
    def link_names(self) -> list[str]:
        """In the order of poses. [L]"""
        return self._model.link_names

    @property
    def joint_names(self) -> list[str]:
        """Joints that are driven; mimic joints follow them."""
        return self._model.joint_names

    def fk(self, joints) -> np.ndarray:
        """Poses of all links in the base link's frame, metres: [L, 4, 4], or [T, L, 4, 4] for T states.

        `joints` maps names of joints to values (radians, metres for prismatic ones) or to arrays of T values; joints that
        are not named are at 0.
        """
        names = list(joints)
        values = [np.asarray(joints[name], np.float64) for name in names]
        one = all(value.ndim == 0 for value in values)
        if not names:
            return self._model.fk([], np.zeros((1, 0)))[0]
        table = np.stack(np.broadcast_arrays(*[np.atleast_1d(value) for value in values]), axis=1)
        poses = self._model.fk(names, np.ascontiguousarray(table))
        return poses[0] if one else poses
