"""Automatic exposure: a camera that walks out of a dim corridor into the sun closes its aperture, a moment later."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from panobench.cameras.erp import ErpCamera
from panobench.rooms import render
from panobench.rooms.scene import Scene

#: Frames between two measurements, and the deviation over which gains are smoothed, in measurements.
EVERY, SMOOTHING = 10, 1.5
#: Mean display value that is aimed at, and how much of the difference is corrected.
AIM, SHARE = 0.3, 0.6


def auto_exposure(scene: Scene, T_wc: NDArray[np.float64], exposure: float) -> NDArray[np.float64]:
    """Factors (N,) on ``exposure`` for frames at T_wc (N, 4, 4), from small renders of the scene."""
    camera = ErpCamera(64, 32)
    bundle, weights = render.ray_bundle(camera), camera.solid_angle()
    measured = np.arange(0, len(T_wc), EVERY)

    def brightness(index: int) -> float:
        image = render.radiance(scene, bundle, T_wc[index], gain=exposure, sub=1)
        return float(np.average(image.mean(axis=-1), weights=weights))

    with ThreadPoolExecutor(render.worker_count()) as pool:
        seen = np.array(list(pool.map(brightness, measured)))
    stops = gaussian_filter1d(SHARE * np.log(AIM / np.maximum(seen, 0.02)), SMOOTHING, mode="nearest")
    return np.asarray(np.exp(np.interp(np.arange(len(T_wc)), measured, stops)))
