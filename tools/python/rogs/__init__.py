"""4D Gaussian fields of robot videos: read, render, measure (docs/python/README.md).

    import rogs
    field = rogs.open("run/clips/CLIP/field-1.r4c")
    now = field.at(field.times[3])            # Gaussians: now.means [N, 3] metres, now.rgb [N, 3], ...
    clip, robot = rogs.open(".../clip.r4c"), rogs.open(".../robot.r4c")
    camera = clip.camera("ext1", frame=4, robot=robot)
    view = now.render(camera)                 # view.image [H, W, 3] uint8, view.depth [H, W] metres
    rogs.psnr(view.image, clip.rgb("ext1", 4))

Lengths are metres, times are normalised to 0..1 over the clip, cameras have OpenCV axes and pixel centres at + 0.5.
"""

from ._rogs import DamagedError, RogsError, WrongKindError
from .camera import Camera, View
from .gaussians import Gaussians
from .metrics import compare, depth_scores, psnr, ssim
from .program import find_program, run, run_program
from .records import Clip, Conditioning, Field, Record, References, Refinement, RobotMaps, Scores, Stream, open
from .robot import Robot

__all__ = [
    "Camera",
    "Clip",
    "Conditioning",
    "DamagedError",
    "Field",
    "Gaussians",
    "Record",
    "References",
    "Refinement",
    "Robot",
    "RobotMaps",
    "RogsError",
    "Scores",
    "Stream",
    "View",
    "WrongKindError",
    "compare",
    "depth_scores",
    "find_program",
    "open",
    "psnr",
    "run",
    "run_program",
    "ssim",
]
__version__ = "0.1.0"
