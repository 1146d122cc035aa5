"""The person who carries the camera: below and behind it, one arm holding it, swaying in step."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.erp import ErpCamera
from panobench.capture.casting import Light, cast
from panobench.capture.person import Looks, Posture, person
from panobench.capture.solids import PLAIN, Builder, Material, Solids, joined

Array = NDArray[np.float64]

#: Full strides per second.
STRIDES = 0.9
#: Where the camera is in the person's axes and how far below it the hand is: from nearest to on a stick.
_NEAR, _FAR = np.array([0.10, 0.22, 1.58]), np.array([0.16, 0.55, 2.30])
_GRIP_NEAR, _GRIP_FAR = 0.06, 0.75
_STICK = Material(PLAIN, (0.03, 0.03, 0.03))


class Operator:
    """``solids(t)``: what is seen of the operator at a time, in the axes of an upright camera (x right, y down, z
    forward), so that ``share`` of the sphere is hidden on average.
    """

    def __init__(self, share: float, seed: int = 0) -> None:
        self.share = share
        rng = np.random.default_rng([seed, 77])
        self._looks = Looks.random(rng)
        self._phase = rng.uniform(0, 2 * np.pi, 8)

    def solids(self, t: float) -> Solids:
        """At ``t`` seconds."""
        return self._at(t, self._nearness)

    def _at(self, t: float, near: float) -> Solids:
        p, stride = self._phase, 2 * np.pi * STRIDES * t
        # Steps shake the camera against the body, a tiring arm moves it slowly, the trunk turns.
        camera = _FAR + near * (_NEAR - _FAR)
        slow = np.array([np.sin(0.9 * t + p[0]), np.sin(1.1 * t + p[1]), np.sin(0.7 * t + p[2])])
        step = np.array([np.sin(stride + p[3]), 0.6 * np.sin(2 * stride + p[4]), np.sin(2 * stride + p[5])])
        # An arm close to the body holds the camera more steadily.
        camera = camera + (1 - 0.6 * near) * (0.03 * slow + 0.012 * step)
        grip = _GRIP_FAR + near * (_GRIP_NEAR - _GRIP_FAR)
        shake = 0.006 * np.array([np.sin(2.3 * t + p[6]), np.sin(1.7 * t + p[7]), 0.0])
        hand = camera - [0.0, 0.02, grip] + shake
        posture = Posture(
            stride=stride,
            lean=(0.05 + 0.02 * np.sin(2 * stride), 0.03 * np.sin(stride)),
            head=(0.55 * np.sin(0.8 * t + p[2]) + 0.15 * np.sin(2.1 * t + p[0]), 0.12 + 0.12 * np.sin(1.3 * t + p[3])),
            hand=(float(hand[0]), float(hand[1]), float(hand[2])),
            fingers=0.9 + 0.12 * np.sin(0.6 * t + p[5]),
        )
        stick = Builder()
        stick.cone(hand - [0, -0.01, 0.06], camera - [0.0, 0.0, 0.045], 0.013, 0.011, _STICK)
        turn = 0.07 * np.sin(0.5 * t + p[4]) + 0.05 * np.sin(stride)
        return joined([person(self._looks, posture), stick.build()]).moved(camera_axes(camera, turn))

    @cached_property
    def _nearness(self) -> float:
        """0 on a long stick, 1 right before the chest: so that the share is right."""
        low, high = 0.0, 1.0
        for _ in range(9):
            middle = 0.5 * (low + high)
            if share_hidden([self._at(t, middle) for t in (0.3, 2.1, 4.0)]) > self.share:
                high = middle
            else:
                low = middle
        return 0.5 * (low + high)


def camera_axes(camera: Array, turn: float = 0.0) -> Array:
    """(4, 4) from a carrier's axes (x right, y forward, z up) to those of a camera at ``camera`` that looks along y."""
    c, s = np.cos(turn), np.sin(turn)
    T = np.eye(4)
    T[:3, :3] = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    T[:3, 3] = -T[:3, :3] @ camera
    return T


def share_hidden(moments: list[Solids]) -> float:
    """Mean share of the sphere that the solids hide from the origin."""
    camera = ErpCamera(160, 80)
    area = camera.solid_angle() / (4 * np.pi)
    rays = camera.rays().astype(np.float32)
    dark = Light(np.zeros((9, 3)), np.zeros((1, 1, 3), np.float32))
    return float(np.mean([(cast(s, rays, np.eye(4), dark, sub=1).share * area).sum() for s in moments]))
