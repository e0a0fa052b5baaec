"""The metrics of the paper, by the functions that scoring uses."""

from __future__ import annotations

import json
import os

import numpy as np

from . import _rogs


def _image(values):
    values = np.asarray(values)
    return values if values.dtype == np.uint8 else values.astype(np.float32, copy=False)


def psnr(prediction, reference) -> float:
    """PSNR in dB of images [H, W, 3], uint8 or floats in 0..1."""
    return _rogs.psnr(_image(prediction), _image(reference))


def ssim(prediction, reference, variant: str = "skimage-sample-cov") -> float:
    """SSIM of images [H, W, 3], uint8 or floats in 0..1; variants: skimage-sample-cov (the paper's), skimage, torchmetrics."""
    return _rogs.ssim(_image(prediction), _image(reference), variant)


def depth_scores(prediction, reference, range_m=(0.1, 5.0)) -> dict | None:
    """`absrel`, `rmse_m`, `delta1` and `pixels` of depth [H, W] in metres where the reference lies in the open range; None
    where no pixel does."""
    own, other = (np.asarray(values, np.float32) for values in (prediction, reference))
    scores = _rogs.depth_scores(own, other, *map(float, range_m))
    return scores and dict(zip(("absrel", "rmse_m", "delta1", "pixels"), scores))


def compare(
    prediction: str | os.PathLike,
    reference: str | os.PathLike,
    variant: str = "skimage-sample-cov",
    units_m: tuple[float | None, float | None] = (None, None),
) -> dict:
    """Scores of two files or two folders of images, depth or arrays, as `rogs metrics --json` gives them; `units_m` are the
    metres of one step of depth in the prediction and in the reference, None for what the files usually hold."""
    return json.loads(_rogs.score_paths(prediction, reference, variant, list(units_m)))
