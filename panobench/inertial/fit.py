"""The visual-inertial fit: poses, velocities and biases that visual poses and preintegrated samples agree on most.

States are the body's pose, velocity and biases at every node (a frame), and for every few seconds of a map a reference:
a camera pose in the world, and the logarithm of the map's scale around it. A node's visual factor compares it with its
reference, so white noise of visual poses does not add up; factors between neighbouring references let poses and scale
drift a little. Between nodes are gtsam's combined preintegration factors (Forster et al., "On-manifold preintegration",
2017). Nodes without a visual pose, in a blackout say, are held by these alone. The world is z up.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, L, V, X
from numpy.typing import NDArray

from panobench.geometry import invert_pose, make_pose, renormalise
from panobench.inertial.factors import reference_drift_factor, visual_factor
from panobench.inertial.preintegration import preintegrate, preintegration_params
from panobench.inertial.samples import Samples

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FitOptions:
    """Deviations of what drifts between two references, which are ``reference_s`` apart.

    drift_share: of the distance, on top of drift_m. drift_rad, drift_scale: per step. iterations: of
    Levenberg-Marquardt.
    """

    reference_s: float = 5.0
    drift_share: float = 0.002
    drift_m: float = 0.002
    drift_rad: float = 5e-4
    drift_scale: float = 0.001
    iterations: int = 12
    huber: float = 2.0


@dataclass(frozen=True)
class Nodes:
    """What the fit starts from, in a world that is z up and in metres, but for the drift of the maps.

    times (N,): s, on the camera's clock. T_wb (N, 4, 4), velocity (N, 3): of the body. maps (N,): the map that a node's
    visual pose is of, -1 without one. T_visual (N, 4, 4): camera poses as the maps have them, in their own units.
    scales: metres in a unit, by map. gyro_bias, accel_bias (3,).
    """

    times: Array
    T_wb: Array
    velocity: Array
    maps: NDArray[np.int64]
    T_visual: Array
    scales: dict[int, float]
    gyro_bias: Array
    accel_bias: Array


@dataclass(frozen=True)
class Noise:
    """Standard deviations of a visual pose: metres and radians per axis."""

    position_m: float
    rotation_rad: float


@dataclass(frozen=True)
class Fit:
    """T_wb (N, 4, 4), velocity (N, 3), gyro_bias, accel_bias (N, 3) at the nodes.

    scale: metres in a unit, (N,), NaN for nodes without a visual pose. scale_sigma: the mean scale's relative standard
    deviation. position_rms_m, rotation_rms_rad: of the visual residuals, per axis. inertial_rms: of the inertial ones,
    in standard deviations.
    """

    T_wb: Array
    velocity: Array
    gyro_bias: Array
    accel_bias: Array
    scale: Array
    scale_sigma: float
    position_rms_m: float
    rotation_rms_rad: float
    inertial_rms: float


@dataclass(frozen=True)
class _Reference:
    """One node that others are compared with; members: numbers of nodes."""

    node: int
    map: int
    members: NDArray[np.int64]


def fit(nodes: Nodes, samples: Samples, T_body_cam: Array, noise: Noise, options: FitOptions | None = None) -> Fit:
    """samples: on the camera's clock. T_body_cam (4, 4)."""
    o = options or FitOptions()
    references = _references(nodes, o.reference_s)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    inertial = _add_inertial(graph, nodes, samples)
    visual = _add_visual(graph, nodes, references, T_body_cam, noise, o)
    _add_drift(graph, nodes, references, o)
    _add_gauge(graph, nodes)
    _insert(values, nodes, references, T_body_cam)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(o.iterations)
    parameters.setRelativeErrorTol(1e-4)
    parameters.setAbsoluteErrorTol(1e-3)
    result = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    return _read(result, graph, nodes, references, inertial, visual, T_body_cam)


def _references(nodes: Nodes, every_s: float) -> list[_Reference]:
    """Of each map the node in the middle of every ``every_s`` seconds."""
    found = []
    for m in sorted(set(nodes.maps[nodes.maps >= 0].tolist())):
        members = np.flatnonzero(nodes.maps == m)
        t = nodes.times[members]
        parts = max(round((t[-1] - t[0]) / every_s), 1)
        cut = np.minimum(((t - t[0]) / max(t[-1] - t[0], 1e-9) * parts).astype(np.int64), parts - 1)
        for part in range(parts):
            chosen = members[cut == part]
            if len(chosen):
                found.append(_Reference(int(chosen[len(chosen) // 2]), m, chosen))
    return found


def _add_inertial(graph: gtsam.NonlinearFactorGraph, nodes: Nodes, samples: Samples) -> list[int]:
    """Combined factors between neighbouring nodes; across gaps of the samples only the biases go on."""
    parameters = preintegration_params(samples)
    bias = gtsam.imuBias.ConstantBias(nodes.accel_bias, nodes.gyro_bias)
    covered = samples.covers(nodes.times[:-1], nodes.times[1:])
    numbers = []
    for i in range(len(nodes.times) - 1):
        begin, end = float(nodes.times[i]), float(nodes.times[i + 1])
        if covered[i]:
            numbers.append(graph.size())
            measured = preintegrate(samples, begin, end, parameters, bias)
            graph.add(gtsam.CombinedImuFactor(X(i), V(i), X(i + 1), V(i + 1), B(i), B(i + 1), measured))
            continue
        walk = np.repeat([samples.noise.accel_walk, samples.noise.gyro_walk], 3) * np.sqrt(end - begin)
        between = gtsam.noiseModel.Diagonal.Sigmas(walk)
        graph.add(gtsam.BetweenFactorConstantBias(B(i), B(i + 1), gtsam.imuBias.ConstantBias(), between))
        graph.add(gtsam.PriorFactorVector(V(i + 1), nodes.velocity[i + 1], gtsam.noiseModel.Isotropic.Sigma(3, 1.0)))
    return numbers


def _add_visual(
    graph: gtsam.NonlinearFactorGraph,
    nodes: Nodes,
    references: list[_Reference],
    T_body_cam: Array,
    noise: Noise,
    o: FitOptions,
) -> list[int]:
    sigmas = np.repeat([noise.rotation_rad, noise.position_m], 3)
    model = gtsam.noiseModel.Robust.Create(
        gtsam.noiseModel.mEstimator.Huber.Create(o.huber), gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    )
    numbers = []
    for r, reference in enumerate(references):
        T = invert_pose(nodes.T_visual[reference.node]) @ nodes.T_visual[reference.members]
        unit = nodes.scales[reference.map]
        for i, relative in zip(reference.members, T):
            numbers.append(graph.size())
            graph.add(visual_factor(A(r), X(int(i)), L(r), relative, T_body_cam, unit, model))
    return numbers


def _add_drift(graph: gtsam.NonlinearFactorGraph, nodes: Nodes, references: list[_Reference], o: FitOptions) -> None:
    for r, (one, other) in enumerate(pairwise(references)):
        if one.map != other.map:
            continue
        relative = invert_pose(nodes.T_visual[one.node]) @ nodes.T_visual[other.node]
        unit = nodes.scales[one.map]
        far = unit * float(np.linalg.norm(relative[:3, 3]))
        sigmas = np.repeat([o.drift_rad, o.drift_m + o.drift_share * far], 3)
        model = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
        graph.add(reference_drift_factor(A(r), A(r + 1), L(r), relative, unit, model))
        scale = gtsam.noiseModel.Isotropic.Sigma(1, o.drift_scale)
        graph.add(gtsam.BetweenFactorDouble(L(r), L(r + 1), 0.0, scale))


def _add_gauge(graph: gtsam.NonlinearFactorGraph, nodes: Nodes) -> None:
    """Where the world begins and its heading; gravity fixes roll and pitch a thousand times more firmly."""
    sigmas = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([0.5, 1e-3], 3))
    graph.add(gtsam.PriorFactorPose3(X(0), _pose(nodes.T_wb[0]), sigmas))
    biases = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([0.3, 0.05], 3))
    graph.add(gtsam.PriorFactorConstantBias(B(0), gtsam.imuBias.ConstantBias(), biases))


def _insert(values: gtsam.Values, nodes: Nodes, references: list[_Reference], T_body_cam: Array) -> None:
    bias = gtsam.imuBias.ConstantBias(nodes.accel_bias, nodes.gyro_bias)
    for i, (T, v) in enumerate(zip(nodes.T_wb, nodes.velocity)):
        values.insert(X(i), _pose(T))
        values.insert(V(i), v)
        values.insert(B(i), bias)
    for r, reference in enumerate(references):
        values.insert(A(r), _pose(nodes.T_wb[reference.node] @ T_body_cam))
        values.insert(L(r), float(np.log(nodes.scales[reference.map])))


def _read(
    result: gtsam.Values,
    graph: gtsam.NonlinearFactorGraph,
    nodes: Nodes,
    references: list[_Reference],
    inertial: list[int],
    visual: list[int],
    T_body_cam: Array,
) -> Fit:
    n = range(len(nodes.times))
    T_wb = np.stack([renormalise(result.atPose3(X(i)).matrix()) for i in n])
    biases = np.stack([result.atConstantBias(B(i)).vector() for i in n])
    scale = np.full(len(nodes.times), np.nan)
    turned, moved = [], []
    for r, reference in enumerate(references):
        scale[reference.members] = np.exp(result.atDouble(L(r)))
        T = invert_pose(result.atPose3(A(r)).matrix()) @ T_wb[reference.members] @ T_body_cam
        seen = invert_pose(nodes.T_visual[reference.node]) @ nodes.T_visual[reference.members]
        moved.append(T[:, :3, 3] - scale[reference.members][:, None] * seen[:, :3, 3])
        turned.append((np.swapaxes(seen[:, :3, :3], 1, 2) @ T[:, :3, :3] - np.eye(3))[:, [2, 0, 1], [1, 2, 0]])
    errors = [2 * graph.at(k).error(result) / 15 for k in inertial]
    return Fit(
        T_wb,
        np.stack([result.atVector(V(i)) for i in n]),
        biases[:, 3:],
        biases[:, :3],
        scale,
        _scale_sigma(graph, result, references),
        _robust_rms(np.concatenate(moved)),
        _robust_rms(np.concatenate(turned)),
        float(np.sqrt(np.median(errors))) if errors else 0.0,
    )


def _scale_sigma(graph: gtsam.NonlinearFactorGraph, result: gtsam.Values, references: list[_Reference]) -> float:
    """Of the reference in the middle; the scales of neighbours hardly differ."""
    try:
        marginals = gtsam.Marginals(graph, result)
        return float(np.sqrt(marginals.marginalCovariance(L(len(references) // 2))[0, 0]))
    except RuntimeError:  # an indeterminate system: nothing holds the scale
        return float("inf")


def _robust_rms(values: Array) -> float:
    return float(np.median(np.abs(values))) / 0.6745


def _pose(T: Array) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3(T[:3, :3]), T[:3, 3])


def body_poses(T_wc: Array, T_body_cam: Array) -> Array:
    """Body poses (N, 4, 4) of camera poses (N, 4, 4)."""
    return renormalise(T_wc @ make_pose(T_body_cam[:3, :3].T, -T_body_cam[:3, :3].T @ T_body_cam[:3, 3]))
