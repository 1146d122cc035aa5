"""``align`` on a device: the whole loop runs there, and the host waits for the answer alone.

The kernels, and how they take turns, are in ``gpu/kernels/align.cu``.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from panobench.geometry import renormalise
from panobench.gpu.device import Device, blocks_of, download
from panobench.photometric.align import MOVING_SHARE, Alignment
from panobench.photometric.pyramid import F32
from panobench.photometric.reference import AlignOptions, Reference

#: Offsets in the state and its size, the size of the sums, and tasks of ``align_judge``; see align.cu.
_POSE, _TRIAL, _HUBER, _CUT, _COST, _SEEN, _SIGMA, _COUNT, _ENDED, _H, _STATE = (
    0, 12, 25, 26, 27, 28, 29, 30, 31, 32, 65,
)  # fmt: skip
_SUMS = 32 + 1024
_THRESHOLDS, _FIRST, _NEXT, _LAST = range(4)
_THREADS, _MOST_BLOCKS = 256, 264


def align_on_device(
    device: Device,
    reference: Reference,
    frame: list[F32],
    T_fr: NDArray[np.float64],
    options: AlignOptions,
    *,
    finest: int = 0,
    coarsest: int | None = None,
    gain: float = 0.0,
    offset: float = 0.0,
) -> Alignment:
    """As ``align``, for a panorama's ``reference`` and without ``options.exposure``."""
    top = min(len(reference.levels), len(frame)) - 1
    first = top if coarsest is None else min(coarsest, top)
    T = renormalise(T_fr)
    host = np.zeros(_STATE)
    host[_POSE : _POSE + 12] = host[_TRIAL : _TRIAL + 12] = [*T[:3, :3].ravel(), *T[:3, 3]]
    host[_COST], host[_HUBER], host[_CUT] = 1e300, 1.0, 10.0
    state, sums = device.upload(host), device.zeros(_SUMS, dtype=torch.float64)
    factor, free = float(np.exp(gain)), 3 if options.rotation_only else 0
    for step, index in enumerate(range(first, min(finest, first) - 1, -1)):
        level, image = reference.levels[index], device.uploaded(frame[index])
        n, total = len(level.value), level.total
        if step:  # the level before ended somewhere; the next one begins there
            state[_TRIAL : _TRIAL + 12] = state[_POSE : _POSE + 12]
            state[_HUBER], state[_CUT], state[_ENDED] = 1.0, 10.0, 0.0
        arrays = [device.uploaded(a) for a in (level.points, level.jacobian, level.value, level.weight)]
        h, w = frame[index].shape
        cut = options.cut if index < options.cut_levels else 0.0
        moving = min(options.cut_moving, 1e30)
        numbers = [
            options.huber_min, options.huber, cut, moving, options.cut_moving_min, MOVING_SHARE, options.step_m,
            options.step_rad,
        ]  # fmt: skip
        chosen = device.upload(np.array(numbers))
        limit = options.iterations[min(step, len(options.iterations) - 1)]
        tasks = [_THRESHOLDS, _FIRST if limit else _LAST, *[_NEXT] * (limit - 1), *[_LAST] * min(limit, 1)]
        for task in tasks:
            device.launch(
                "align_sums", min(blocks_of(n, _THREADS), _MOST_BLOCKS), _THREADS, n, *arrays, image, w, h, factor,
                float(offset), state, sums,
            )  # fmt: skip
            device.launch(
                "align_judge", 1, _THREADS, task, n, free, np.float64(factor), np.float64(total), chosen, state, sums
            )
    found = download(state)
    cost = float(found[_COST]) if found[_COST] < 1e300 else np.inf
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = found[_POSE : _POSE + 9].reshape(3, 3), found[_POSE + 9 : _POSE + 12]
    upper = np.zeros((6, 6))
    upper[np.triu_indices(6)] = found[_H : _H + 21]
    hessian = upper + np.triu(upper, 1).T
    return Alignment(
        renormalise(T), cost, float(found[_SIGMA]), float(found[_SEEN]), round(found[_COUNT]), hessian,
        gain, offset,
    )  # fmt: skip
