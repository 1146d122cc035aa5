"""A person made of solids: joints from a stride, an optional reach of the right hand, and how the head is held.

Axes: x right, y forward, z up, metres, origin on the floor between the feet; 1.75 m tall.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panobench.capture.solids import CHECK, CLOTH, HAIR, PLAIN, SKIN, STRIPES, Builder, Material, Solids

Array = NDArray[np.float64]

UPPER_ARM, FOREARM, THIGH, SHIN = 0.29, 0.26, 0.43, 0.42
HIP, SHOULDER = 0.93, 1.42
#: Share of the forearm up to the wrist, and from there to the middle of the palm.
WRIST, PALM = 0.86, 0.055
#: Where the fingers of a hand point that holds something above it.
_HELD_OUT = np.array([-0.15, 0.985, 0.08])

_SKINS = ((0.55, 0.33, 0.24), (0.42, 0.24, 0.16), (0.22, 0.12, 0.08), (0.62, 0.40, 0.31))
_HAIRS = ((0.05, 0.03, 0.02), (0.16, 0.09, 0.04), (0.02, 0.02, 0.02), (0.32, 0.30, 0.28), (0.35, 0.22, 0.08))
_TOPS = ((0.03, 0.22, 0.26), (0.05, 0.08, 0.22), (0.35, 0.05, 0.05), (0.45, 0.43, 0.40), (0.05, 0.15, 0.06))
_TROUSERS = ((0.03, 0.05, 0.12), (0.04, 0.04, 0.04), (0.22, 0.17, 0.11), (0.12, 0.12, 0.13))


@dataclass(frozen=True)
class Looks:
    """What a person wears: materials of skin, hair, top, trousers, shoes, and whether the hair is long."""

    skin: Material
    hair: Material
    top: Material
    trousers: Material
    shoes: Material
    long_hair: bool

    @classmethod
    def random(cls, rng: np.random.Generator) -> Looks:
        def pick(colours: tuple[tuple[float, float, float], ...]) -> tuple[float, float, float]:
            return colours[int(rng.integers(len(colours)))]

        skin, hair, top, legs = pick(_SKINS), pick(_HAIRS), pick(_TOPS), pick(_TROUSERS)
        second = pick(_TOPS)
        kind = int(rng.choice([CLOTH, STRIPES, CHECK]))
        return cls(
            skin=Material(SKIN, skin, (min(1.3 * skin[0], 0.9), 0.75 * skin[1], 0.7 * skin[2])),
            hair=Material(HAIR, hair, tuple(min(3.0 * c + 0.02, 0.8) for c in hair)),  # type: ignore[arg-type]
            top=Material(kind, top, second, scale=float(rng.uniform(0.04, 0.09)), folds=1.0),
            trousers=Material(CLOTH, legs, tuple(1.8 * c for c in legs), folds=0.9),  # type: ignore[arg-type]
            shoes=Material(PLAIN, pick(((0.02, 0.02, 0.02), (0.5, 0.5, 0.5), (0.15, 0.08, 0.04)))),
            long_hair=bool(rng.uniform() < 0.5),
        )


@dataclass(frozen=True)
class Posture:
    """How a person stands at one moment.

    stride:   phase of the walk in radians, one full turn for two steps. swing: amplitude of the legs, radians.
    lean:     of the trunk (forward, to the right), radians. head: turn (to the left), nod (down), radians.
    hand:     where the right hand reaches, in the person's axes; None: it swings. grip: direction of the thumb side.
    """

    stride: float = 0.0
    swing: float = 0.4
    lean: tuple[float, float] = (0.0, 0.0)
    head: tuple[float, float] = (0.0, 0.0)
    hand: tuple[float, float, float] | None = None
    fingers: float = 1.0


@dataclass
class _Figure:
    looks: Looks
    posture: Posture
    solids: Builder = field(default_factory=Builder)


def person(looks: Looks, posture: Posture) -> Solids:
    """The solids of a person in a posture."""
    figure = _Figure(looks, posture)
    trunk = _tilt(*posture.lean)
    _trunk(figure, trunk)
    _head(figure, trunk)
    for side in (-1.0, 1.0):
        _leg(figure, side)
        _arm(figure, trunk, side)
    return figure.solids.build()


def _rot(axis: int, angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    R = np.eye(3)
    R[i, i], R[i, j], R[j, i], R[j, j] = c, -s, s, c
    return R


def _tilt(forward: float, right: float) -> Array:
    """Rotation of the trunk about the hips."""
    return _rot(0, -forward) @ _rot(1, right)


def _at(trunk: Array, point: ArrayLike) -> Array:
    """A point of the upright trunk, leaned about the hips."""
    hips = np.array([0.0, 0.0, HIP])
    return np.asarray(hips + trunk @ (np.asarray(point, dtype=np.float64) - hips))


def _trunk(figure: _Figure, trunk: Array) -> None:
    add, top, legs = figure.solids, figure.looks.top, figure.looks.trousers
    add.ellipsoid((0, -0.01, HIP - 0.03), (0.175, 0.125, 0.13), np.eye(3), legs)
    for x in (-0.05, 0.05):
        add.cone(_at(trunk, (x, 0.0, HIP + 0.03)), _at(trunk, (x, 0.0, 1.12)), 0.115, 0.11, top)
    add.ellipsoid(_at(trunk, (0, 0.005, 1.24)), (0.175, 0.118, 0.225), trunk, top)
    add.ellipsoid(_at(trunk, (0, -0.015, 1.36)), (0.185, 0.105, 0.115), trunk, top)
    add.cone(
        _at(trunk, (-0.155, -0.01, SHOULDER - 0.015)), _at(trunk, (0.155, -0.01, SHOULDER - 0.015)), 0.066, 0.066, top
    )
    add.cone(_at(trunk, (0, -0.01, SHOULDER)), _at(trunk, (0, 0.005, 1.50)), 0.062, 0.056, figure.looks.skin)
    add.cone(_at(trunk, (0, -0.012, 1.40)), _at(trunk, (0, -0.01, 1.455)), 0.085, 0.072, top)  # collar
    add.cone(
        _at(trunk, (-0.05, 0.115, 1.36)),
        _at(trunk, (-0.01, 0.13, 1.16)),
        0.006,
        0.006,
        Material(PLAIN, (0.6, 0.12, 0.02)),
    )
    add.cone(
        _at(trunk, (0.05, 0.115, 1.36)), _at(trunk, (0.0, 0.13, 1.16)), 0.006, 0.006, Material(PLAIN, (0.6, 0.12, 0.02))
    )


def _head(figure: _Figure, trunk: Array) -> None:
    add, looks = figure.solids, figure.looks
    turn, nod = figure.posture.head
    R = trunk @ _rot(2, turn) @ _rot(0, -nod)
    neck = _at(trunk, (0, 0.0, 1.52))

    def place(x: float, y: float, z: float) -> Array:
        """A point of the head, about the top of the neck."""
        return np.asarray(neck + R @ np.array([x, y, z]))

    add.ellipsoid(place(0, 0.012, 0.115), (0.074, 0.094, 0.112), R, looks.skin)
    add.ellipsoid(place(0, 0.045, 0.05), (0.056, 0.062, 0.07), R, looks.skin)  # jaw
    add.cone(place(0, 0.10, 0.125), place(0, 0.122, 0.092), 0.009, 0.016, looks.skin)  # nose
    white, dark, lips = (Material(PLAIN, c) for c in ((0.7, 0.7, 0.68), (0.02, 0.015, 0.01), (0.35, 0.12, 0.10)))
    for x in (-0.031, 0.031):
        add.ellipsoid(place(x, 0.088, 0.125), (0.015, 0.012, 0.010), R, white)
        add.ellipsoid(place(x, 0.098, 0.125), (0.007, 0.004, 0.007), R, dark)
        add.cone(place(x - 0.013, 0.092, 0.146), place(x + 0.013, 0.092, 0.146), 0.0035, 0.0035, looks.hair)
    add.cone(place(-0.02, 0.101, 0.055), place(0.02, 0.101, 0.055), 0.006, 0.006, lips)
    for x in (-0.076, 0.076):
        add.ellipsoid(place(x, 0.0, 0.115), (0.010, 0.020, 0.030), R, looks.skin)
    add.ellipsoid(place(0, -0.012, 0.137), (0.083, 0.096, 0.103), R, looks.hair)
    add.ellipsoid(place(0, -0.045, 0.095), (0.078, 0.07, 0.10), R, looks.hair)
    if looks.long_hair:
        for x in (-0.05, 0.0, 0.05):
            add.cone(place(x, -0.07, 0.1), _at(trunk, (1.3 * x, -0.12, 1.36)), 0.045, 0.03, looks.hair)


def _leg(figure: _Figure, side: float) -> None:
    add, looks, posture = figure.solids, figure.looks, figure.posture
    phase = posture.stride + (0.0 if side < 0 else np.pi)
    hip_angle = posture.swing * np.sin(phase)
    bend = 0.12 + 1.3 * posture.swing * max(0.0, np.cos(phase)) ** 2
    hip = np.array([0.095 * side, 0.0, HIP - 0.04])
    knee = hip + THIGH * np.array([0, np.sin(hip_angle), -np.cos(hip_angle)])
    lower = hip_angle - bend
    ankle = knee + SHIN * np.array([0, np.sin(lower), -np.cos(lower)])
    add.cone(hip, knee, 0.092, 0.06, looks.trousers)
    add.cone(knee, ankle, 0.06, 0.048, looks.trousers)
    toe = ankle + np.array([0.01 * side, 0.16 * np.cos(lower), -0.035 + 0.16 * np.sin(min(lower, 0.0))])
    add.cone(ankle + [0, -0.03, -0.03], toe, 0.042, 0.03, looks.shoes)


def _arm(figure: _Figure, trunk: Array, side: float) -> None:
    add, looks, posture = figure.solids, figure.looks, figure.posture
    shoulder = _at(trunk, (0.185 * side, -0.01, SHOULDER - 0.01))
    if side > 0 and posture.hand is not None:
        wrist = np.array(posture.hand) - PALM * _HELD_OUT
        elbow, wrist = _reach(shoulder, wrist, np.array([0.5 * side, -0.3, -1.0]))
        hand = wrist + PALM * _HELD_OUT
    else:
        swing = -0.8 * posture.swing * np.sin(posture.stride + (0.0 if side < 0 else np.pi))
        down = np.array([0.12 * side, np.sin(swing), -np.cos(swing)])
        elbow = shoulder + UPPER_ARM * down / np.linalg.norm(down)
        fore = swing + 0.35
        hand = elbow + FOREARM * np.array([0.02 * side, np.sin(fore), -np.cos(fore)])
        wrist = elbow + (hand - elbow) * WRIST
    add.cone(shoulder, elbow, 0.06, 0.047, looks.top)
    cuff = elbow + (wrist - elbow) * 0.8
    add.cone(elbow, cuff, 0.048, 0.038, looks.top)
    add.cone(elbow, wrist, 0.034, 0.026, looks.skin)
    _hand(figure, wrist, hand, side)


def _reach(shoulder: Array, wrist: Array, pole: Array) -> tuple[Array, Array]:
    """Elbow and wrist of an arm that reaches for ``wrist``; the elbow points towards ``pole``."""
    to, forearm = wrist - shoulder, WRIST * FOREARM
    length = float(np.linalg.norm(to))
    reach = min(length, 0.99 * (UPPER_ARM + forearm))
    to = to / length
    along = (UPPER_ARM**2 - forearm**2 + reach**2) / (2 * reach)
    out = pole - (pole @ to) * to
    elbow = shoulder + along * to + np.sqrt(max(UPPER_ARM**2 - along**2, 0.0)) * out / np.linalg.norm(out)
    return elbow, shoulder + reach * to


def _hand(figure: _Figure, wrist: Array, hand: Array, side: float) -> None:
    """Palm, four fingers of two phalanges and a thumb; a hand that reaches closes round what is above it."""
    add, skin, posture = figure.solids, figure.looks.skin, figure.posture
    holds = side > 0 and posture.hand is not None
    along = hand - wrist
    along = along / np.linalg.norm(along)
    across = np.cross(along, [0.0, 0.0, 1.0] if holds else [0.0, 1.0, 0.0])
    norm = float(np.linalg.norm(across))
    across = np.array([side, 0.0, 0.0]) if norm < 0.1 else across / norm
    palm = np.cross(across, along)  # out of the palm: up when the hand holds something
    centre = wrist + PALM * along
    add.ellipsoid(centre, (0.042, 0.054, 0.019), np.column_stack([across, along, palm]), skin)
    curl = posture.fingers * (1.25 if holds else 0.5)
    for k in range(4):
        base = centre + 0.045 * along + (k - 1.5) * 0.02 * across
        bend = curl * (0.8 + 0.08 * k)
        first = base + 0.042 * (np.cos(bend) * along + np.sin(bend) * palm)
        tip = first + 0.036 * (np.cos(1.8 * bend) * along + np.sin(1.8 * bend) * palm)
        add.cone(base, first, 0.0105, 0.0095, skin)
        add.cone(first, tip, 0.0095, 0.008, skin)
    base = centre - 0.02 * along - side * 0.036 * across
    knuckle = base - side * 0.03 * across + 0.03 * along + 0.012 * palm
    add.cone(base, knuckle, 0.014, 0.012, skin)
    add.cone(knuckle, knuckle + 0.02 * along + 0.03 * np.sin(curl) * palm, 0.012, 0.010, skin)
