"""The visual-inertial fit: poses, velocities and biases that visual poses and preintegrated samples agree on most.

States are the body's pose, velocity and biases at every node (a frame), and for every few seconds of a map a reference:
a camera pose in the world, and the logarithm of the map's scale around it. A node's visual factor compares it with its
reference, so white noise of visual poses does not add up; factors between neighbouring references let poses and scale
drift a little. Between nodes are gtsam's combined preintegration factors (Forster et al., "On-manifold preintegration",
2017). Nodes without a visual pose, in a blackout say, are held by these alone. The world is z up.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, L, V, X
from numpy.typing import NDArray

from panobench.geometry import invert_pose, renormalise
from panobench.inertial.factors import reference_drift_factor, visual_factor
from panobench.inertial.preintegration import preintegrate, preintegration_params
from panobench.inertial.samples import Samples

Array = NDArray[np.float64]

#: Noise of visual poses is taken for at least this.
POSITION_FLOOR_M, ROTATION_FLOOR_RAD = 2e-4, 5e-5
#: The fit is repeated if a deviation was misjudged by more than this factor.
MISJUDGED = 1.6


@dataclass(frozen=True)
class FitOptions:
    """reference_s: time between two references. rounds: of fits, each with the deviations that the last one showed.

    iterations: of Levenberg-Marquardt, in each. huber: residual from which the loss is linear, in deviations.
    """

    reference_s: float = 3.0
    rounds: int = 3
    iterations: int = 12
    huber: float = 2.0


@dataclass(frozen=True)
class Noise:
    """Standard deviations of a visual pose, per axis, and of what drifts between two references.

    drift_m: on top of a two-thousandth of the distance. drift_scale: relative. The defaults of the drift are of good
    poses; rounds of the fit make them larger, never smaller.
    """

    position_m: float
    rotation_rad: float
    drift_m: float = 0.001
    drift_rad: float = 2e-4
    drift_scale: float = 5e-4

    def drift_sigmas(self, distance_m: float) -> Array:
        """(6,) rotation and position."""
        return np.repeat([self.drift_rad, self.drift_m + distance_m / 2000], 3)


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
class Fit:
    """T_wb (N, 4, 4), velocity (N, 3), gyro_bias, accel_bias (N, 3) at the nodes.

    scale: metres in a unit, (N,), NaN for nodes without a visual pose. scale_sigma: the mean scale's relative standard
    deviation. noise: what the visual residuals and the drift turned out to be. inertial_rms: of the inertial residuals,
    in standard deviations.
    """

    T_wb: Array
    velocity: Array
    gyro_bias: Array
    accel_bias: Array
    scale: Array
    scale_sigma: float
    noise: Noise
    inertial_rms: float


@dataclass(frozen=True)
class _Reference:
    """One node that others are compared with; members: numbers of nodes."""

    node: int
    map: int
    members: NDArray[np.int64]


def fit(nodes: Nodes, samples: Samples, T_body_cam: Array, noise: Noise, options: FitOptions | None = None) -> Fit:
    """samples: on the camera's clock. T_body_cam (4, 4). noise: as far as it is known before."""
    o = options or FitOptions()
    problem = _Problem(nodes, samples, T_body_cam, _references(nodes, o.reference_s))
    values = problem.start()
    for remaining in range(o.rounds - 1, -1, -1):
        graph, inertial = problem.graph(noise, o)
        values = _optimised(graph, values, o)
        found = problem.noise(values, noise)
        if not remaining or not _misjudged(noise, found):
            break
        noise = found
    return problem.read(values, graph, inertial, found)


def _optimised(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, o: FitOptions) -> gtsam.Values:
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(o.iterations)
    parameters.setRelativeErrorTol(1e-4)
    parameters.setAbsoluteErrorTol(1e-3)
    return gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()


def _misjudged(noise: Noise, found: Noise) -> bool:
    """Whether one of the deviations was wrong by so much that the fit's weights were."""
    pairs = zip(vars(noise).values(), vars(found).values())
    return any(abs(np.log(after / before)) > np.log(MISJUDGED) for before, after in pairs)


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


@dataclass(frozen=True)
class _Problem:
    """The factor graph for some noise, and what its solution says."""

    nodes: Nodes
    samples: Samples
    T_body_cam: Array
    references: list[_Reference]

    def start(self) -> gtsam.Values:
        n, values = self.nodes, gtsam.Values()
        bias = gtsam.imuBias.ConstantBias(n.accel_bias, n.gyro_bias)
        for i, (T, v) in enumerate(zip(n.T_wb, n.velocity)):
            values.insert(X(i), _pose(T))
            values.insert(V(i), v)
            values.insert(B(i), bias)
        for r, reference in enumerate(self.references):
            values.insert(A(r), _pose(n.T_wb[reference.node] @ self.T_body_cam))
            values.insert(L(r), float(np.log(n.scales[reference.map])))
        return values

    def graph(self, noise: Noise, o: FitOptions) -> tuple[gtsam.NonlinearFactorGraph, list[int]]:
        """All factors, and the numbers of those that are preintegrated samples."""
        graph = gtsam.NonlinearFactorGraph()
        self._add_gauge(graph)
        inertial = self._add_inertial(graph)
        self._add_visual(graph, noise, o)
        self._add_drift(graph, noise)
        return graph, inertial

    def _add_gauge(self, graph: gtsam.NonlinearFactorGraph) -> None:
        """Where the world begins and its heading; what is known of roll and pitch is left to gravity."""
        T = self.nodes.T_wb[0]
        covariance = np.diag(np.repeat([0.0, 1e-6], 3))
        covariance[:3, :3] = T[:3, :3].T @ np.diag([0.25, 0.25, 1e-6]) @ T[:3, :3]  # in the body's axes
        graph.add(gtsam.PriorFactorPose3(X(0), _pose(T), gtsam.noiseModel.Gaussian.Covariance(covariance)))
        biases = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([0.3, 0.05], 3))
        graph.add(gtsam.PriorFactorConstantBias(B(0), gtsam.imuBias.ConstantBias(), biases))

    @cached_property
    def _preintegrated(self) -> list[gtsam.PreintegratedCombinedMeasurements | None]:
        """Between neighbouring nodes; None across gaps of the samples."""
        n = self.nodes
        parameters = preintegration_params(self.samples)
        bias = gtsam.imuBias.ConstantBias(n.accel_bias, n.gyro_bias)
        covered = self.samples.covers(n.times[:-1], n.times[1:])
        return [
            preintegrate(self.samples, float(begin), float(end), parameters, bias) if whole else None
            for begin, end, whole in zip(n.times[:-1], n.times[1:], covered)
        ]

    def _add_inertial(self, graph: gtsam.NonlinearFactorGraph) -> list[int]:
        """Combined factors between neighbouring nodes; across gaps of the samples only the biases go on."""
        n, numbers = self.nodes, []
        for i, measured in enumerate(self._preintegrated):
            if measured is not None:
                numbers.append(graph.size())
                graph.add(gtsam.CombinedImuFactor(X(i), V(i), X(i + 1), V(i + 1), B(i), B(i + 1), measured))
                continue
            noise = self.samples.noise
            walk = np.repeat([noise.accel_walk, noise.gyro_walk], 3) * np.sqrt(n.times[i + 1] - n.times[i])
            between = gtsam.noiseModel.Diagonal.Sigmas(walk)
            graph.add(gtsam.BetweenFactorConstantBias(B(i), B(i + 1), gtsam.imuBias.ConstantBias(), between))
            graph.add(gtsam.PriorFactorVector(V(i + 1), n.velocity[i + 1], gtsam.noiseModel.Isotropic.Sigma(3, 1.0)))
        return numbers

    def _add_visual(self, graph: gtsam.NonlinearFactorGraph, noise: Noise, o: FitOptions) -> None:
        n = self.nodes
        sigmas = np.repeat([noise.rotation_rad, noise.position_m], 3)
        model = gtsam.noiseModel.Robust.Create(
            gtsam.noiseModel.mEstimator.Huber.Create(o.huber), gtsam.noiseModel.Diagonal.Sigmas(sigmas)
        )
        for r, reference in enumerate(self.references):
            unit = n.scales[reference.map]
            for i, relative in zip(reference.members, self._seen(reference, reference.members)):
                graph.add(visual_factor(A(r), X(int(i)), L(r), relative, self.T_body_cam, unit, model))

    def _add_drift(self, graph: gtsam.NonlinearFactorGraph, noise: Noise) -> None:
        for r, reference, relative in self._steps():
            unit = self.nodes.scales[reference.map]
            sigmas = noise.drift_sigmas(unit * float(np.linalg.norm(relative[:3, 3])))
            model = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
            graph.add(reference_drift_factor(A(r), A(r + 1), L(r), relative, unit, model))
            scale = gtsam.noiseModel.Isotropic.Sigma(1, noise.drift_scale)
            graph.add(gtsam.BetweenFactorDouble(L(r), L(r + 1), 0.0, scale))

    def _seen(self, reference: _Reference, members: NDArray[np.int64]) -> Array:
        """(M, 4, 4) members' visual poses in the reference's axes and the map's unit."""
        T = self.nodes.T_visual
        return np.asarray(invert_pose(T[reference.node]) @ T[members])

    def _steps(self) -> list[tuple[int, _Reference, Array]]:
        """References that another one of their map follows, and that one's visual pose in their axes."""
        following = enumerate(pairwise(self.references))
        return [
            (r, one, self._seen(one, np.array([other.node]))[0])
            for r, (one, other) in following
            if one.map == other.map
        ]

    def _cameras(self, values: gtsam.Values) -> Array:
        bodies = np.stack([values.atPose3(X(i)).matrix() for i in range(len(self.nodes.times))])
        return np.asarray(bodies @ self.T_body_cam)

    def noise(self, values: gtsam.Values, before: Noise) -> Noise:
        """By the residuals; the drift's are those of few steps, and pulled towards zero by what was assumed."""
        cameras, turned, moved, drifts = self._cameras(values), [], [], []
        for r, reference in enumerate(self.references):
            unit, scale = self.nodes.scales[reference.map], np.exp(values.atDouble(L(r)))
            T = invert_pose(values.atPose3(A(r)).matrix()) @ cameras[reference.members]
            seen = self._seen(reference, reference.members)
            moved.append(unit / scale * T[:, :3, 3] - unit * seen[:, :3, 3])
            turned.append(_turns(seen, T))
        for r, reference, seen_next in self._steps():
            unit, scale = self.nodes.scales[reference.map], np.exp(values.atDouble(L(r)))
            T = invert_pose(values.atPose3(A(r)).matrix()) @ values.atPose3(A(r + 1)).matrix()
            sigmas = before.drift_sigmas(unit * float(np.linalg.norm(seen_next[:3, 3])))
            off = np.concatenate([_turns(seen_next, T), unit / scale * T[:3, 3] - unit * seen_next[:3, 3]]) / sigmas
            grown = (values.atDouble(L(r + 1)) - values.atDouble(L(r))) / before.drift_scale
            drifts.append([np.mean(off[:3] ** 2), np.mean(off[3:] ** 2), grown**2])
        rad, m, scale = (
            np.maximum(1.5 * np.sqrt(np.mean(np.array(drifts, np.float64), axis=0)), 1.0) if drifts else np.ones(3)
        )
        return Noise(
            max(_robust_rms(np.concatenate(moved)), POSITION_FLOOR_M),
            max(_robust_rms(np.concatenate(turned)), ROTATION_FLOOR_RAD),
            before.drift_m * m,
            before.drift_rad * rad,
            before.drift_scale * scale,
        )

    def read(self, values: gtsam.Values, graph: gtsam.NonlinearFactorGraph, inertial: list[int], noise: Noise) -> Fit:
        n = range(len(self.nodes.times))
        biases = np.stack([values.atConstantBias(B(i)).vector() for i in n])
        scale = np.full(len(self.nodes.times), np.nan)
        for r, reference in enumerate(self.references):
            scale[reference.members] = np.exp(values.atDouble(L(r)))
        errors = [2 * graph.at(k).error(values) / 15 for k in inertial]
        return Fit(
            renormalise(np.stack([values.atPose3(X(i)).matrix() for i in n])),
            np.stack([values.atVector(V(i)) for i in n]),
            biases[:, 3:],
            biases[:, :3],
            scale,
            self._scale_sigma(graph, values),
            noise,
            float(np.sqrt(np.median(errors))) if errors else 0.0,
        )

    def _scale_sigma(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> float:
        """Of the reference in the middle; the scales of neighbours hardly differ."""
        try:
            marginals = gtsam.Marginals(graph, values)
            return float(np.sqrt(marginals.marginalCovariance(L(len(self.references) // 2))[0, 0]))
        except RuntimeError:  # an indeterminate system: nothing holds the scale
            return float("inf")


def _turns(T: Array, other: Array) -> Array:
    """Small rotations (..., 3) from poses (..., 4, 4) to others, in the axes of the first."""
    R = np.swapaxes(T[..., :3, :3], -1, -2) @ other[..., :3, :3]
    return (R - np.swapaxes(R, -1, -2))[..., [2, 0, 1], [1, 2, 0]] / 2


def _robust_rms(values: Array) -> float:
    return float(np.median(np.abs(values))) / 0.6745


def _pose(T: Array) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3(T[:3, :3]), T[:3, 3])


def body_poses(T_wc: Array, T_body_cam: Array) -> Array:
    """Body poses (N, 4, 4) of camera poses (N, 4, 4)."""
    return renormalise(T_wc @ invert_pose(T_body_cam))
