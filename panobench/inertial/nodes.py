"""Where the visual-inertial fit starts: which frames are its nodes, and their poses by vision and dead reckoning."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import Sim3, invert_pose, renormalise
from panobench.inertial.fit import Nodes, body_poses
from panobench.inertial.initialise import Initial
from panobench.inertial.preintegration import dead_reckon
from panobench.inertial.rotation import RotationFit
from panobench.inertial.samples import InertialError, Samples
from panobench.inertial.visual import VisualPoses

Array = NDArray[np.float64]

#: Nodes a second, where there are more frames. Strides, at two a second, want a good sampling.
NODE_RATE_HZ = 10.0
#: Longest time without a visual pose that is bridged: between two of them, and before the first or after the last, s.
BRIDGE_S, EXTRAPOLATE_S = 6.0, 2.5


@dataclass(frozen=True)
class Placed:
    """frames (N,): indices of the nodes among all frames. nodes: what the fit starts from."""

    frames: NDArray[np.int64]
    nodes: Nodes


def world_of(visual: VisualPoses, initial: Initial, of_map: int) -> Sim3:
    """From a map to a world that is z up, in metres, with the first camera at the origin and looking along x.

    A camera that looks up or down has its own up along x.
    """
    up = -initial.gravity / np.linalg.norm(initial.gravity)
    first = visual.T_wc[np.flatnonzero(visual.maps == of_map)[0]]
    ahead = first[:3, 2] if abs(first[:3, 2] @ up) < 0.95 else -first[:3, 1]
    x = ahead - (ahead @ up) * up
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(up, x), up])
    return Sim3(initial.scale, R, -initial.scale * R @ first[:3, 3])


def place(
    visual: VisualPoses, samples: Samples, T_body_cam: Array, rotation: RotationFit, initials: dict[int, Initial]
) -> Placed:
    """samples: on the camera's clock. initials: by map; frames of other maps count as without a pose.

    Raises InertialError if no frame is left.
    """
    maps = np.where(np.isin(visual.maps, list(initials)), visual.maps, -1)
    frames = chosen_frames(visual.times, maps, samples)
    if not len(frames):
        raise InertialError("no frame has both a visual pose and samples of the IMU around it")
    times, of_map = visual.times[frames], maps[frames]
    main = int(of_map[of_map >= 0][0])
    worlds = {main: world_of(VisualPoses(times, visual.T_wc[frames], of_map), initials[main], main)}
    T_wb = np.full((len(frames), 4, 4), np.nan)
    first = int(np.flatnonzero(of_map >= 0)[0])
    bias = rotation.bias, initials[main].accel_bias
    known_before = first
    for i in range(first, len(frames)):
        m = int(of_map[i])
        if m < 0:
            continue
        if i > known_before + 1 or (m not in worlds):
            gap = np.arange(known_before, i + 1)
            start = _velocity(times, T_wb, known_before, of_map)
            reckoned, _ = dead_reckon(samples, times[gap], T_wb[known_before], start, *bias)
            if m not in worlds:
                worlds[m] = _joined(visual.T_wc[frames[i]], reckoned[-1] @ T_body_cam, initials[m])
            arrived = body_poses(worlds[m].apply_poses(visual.T_wc[frames[i]])[None], T_body_cam)[0]
            share = ((times[gap] - times[gap[0]]) / (times[i] - times[gap[0]]))[1:-1, None]
            T_wb[gap[1:-1]] = reckoned[1:-1]
            T_wb[gap[1:-1], :3, 3] += share * (arrived[:3, 3] - reckoned[-1][:3, 3])
        T_wb[i] = body_poses(worlds[m].apply_poses(visual.T_wc[frames[i]])[None], T_body_cam)[0]
        known_before = i
    _extrapolate(samples, times, T_wb, of_map, first, known_before, bias)
    velocity = np.gradient(T_wb[:, :3, 3], times, axis=0) if len(times) > 1 else np.zeros((1, 3))
    scales = {m: initials[m].scale for m in worlds}
    T_visual = visual.T_wc[frames]
    return Placed(frames, Nodes(times, T_wb, velocity, of_map, T_visual, scales, *bias))


def chosen_frames(times: Array, maps: NDArray[np.int64], samples: Samples) -> NDArray[np.int64]:
    """The frames that become nodes: enough of those with a pose, and those between or near them without one."""
    known = np.flatnonzero(maps >= 0)
    inside = (times >= samples.times[0]) & (times <= samples.times[-1])
    known = known[inside[known]]
    if len(known) < 2:
        return known[:0]
    step = 1 / NODE_RATE_HZ
    keep = np.zeros(len(times), bool)
    last = -np.inf
    for n, i in enumerate(known):
        lonely = n + 1 == len(known) or known[n + 1] != i + 1 or maps[known[n + 1]] != maps[i]
        begins = n == 0 or known[n - 1] != i - 1 or maps[known[n - 1]] != maps[i]
        if lonely or begins or times[i] - last > step - 1e-6:
            keep[i], last = True, times[i]
    for i, j in pairwise(known):
        if j > i + 1 and times[j] - times[i] <= BRIDGE_S and samples.covers(times[i : i + 1], times[j : j + 1])[0]:
            keep[i + 1 : j] = True
    before, after = np.arange(known[0]), np.arange(known[-1] + 1, len(times))
    for outside, edge in ((before, known[0]), (after, known[-1])):
        near = inside[outside] & (np.abs(times[outside] - times[edge]) <= EXTRAPOLATE_S)
        ends = np.sort(np.stack([times[outside], np.full(len(outside), times[edge])]), axis=0)
        keep[outside] = near & samples.covers(ends[0], ends[1])
    return np.flatnonzero(keep)


def _velocity(times: Array, T_wb: Array, at: int, of_map: NDArray[np.int64]) -> Array:
    """Of the body at a node, by a line through the positions of the last third of a second."""
    chosen = np.arange(max(at - 8, 0), at + 1)
    chosen = chosen[(times[at] - times[chosen] < 0.35) & (of_map[chosen] == of_map[at])]
    if len(chosen) < 2:
        return np.zeros(3)
    return np.asarray(np.polyfit(times[chosen] - times[at], T_wb[chosen, :3, 3], 1)[0])


def _joined(T_visual: Array, T_wc: Array, initial: Initial) -> Sim3:
    """From a new map to the world, by the pose that a camera of it has been reckoned to have there."""
    R = T_wc[:3, :3] @ T_visual[:3, :3].T
    return Sim3(initial.scale, R, T_wc[:3, 3] - initial.scale * R @ T_visual[:3, 3])


def _extrapolate(
    samples: Samples,
    times: Array,
    T_wb: Array,
    of_map: NDArray[np.int64],
    first: int,
    last: int,
    bias: tuple[Array, Array],
) -> None:
    """Poses of the nodes before the first visual pose (at constant velocity) and after the last one."""
    if last + 1 < len(times):
        start = _velocity(times, T_wb, last, of_map)
        T_wb[last:] = dead_reckon(samples, times[last:], T_wb[last], start, *bias)[0]
    if first > 0:
        after = min(first + 3, last)
        v = (T_wb[after, :3, 3] - T_wb[first, :3, 3]) / max(times[after] - times[first], 1e-9)
        for i in range(first):
            T_wb[i] = T_wb[first]
            T_wb[i, :3, 3] -= v * (times[first] - times[i])


def at_all_frames(visual: VisualPoses, placed: Placed, T_wb: Array, scale: Array, T_body_cam: Array) -> Array:
    """Camera poses (F, 4, 4) of all frames from the nodes' body poses (N, 4, 4), NaN where there is none.

    scale (N,): metres in a unit of the node's map. A frame between two nodes stays where vision saw it from both.
    """
    out = np.full((len(visual), 4, 4), np.nan)
    frames = placed.frames
    cameras = renormalise(T_wb @ T_body_cam)
    out[frames] = cameras
    for f in np.flatnonzero(visual.known):
        if np.isfinite(out[f, 0, 0]):
            continue
        n = int(np.searchsorted(frames, f))
        near = [k for k in (n - 1, n) if 0 <= k < len(frames) and placed.nodes.maps[k] == visual.maps[f]]
        if not near:
            continue
        seen = [_from_node(visual.T_wc[f], placed.nodes.T_visual[k], cameras[k], float(scale[k])) for k in near]
        away = np.array([abs(visual.times[f] - placed.nodes.times[k]) for k in near])
        share = 1 / np.maximum(away, 1e-6)
        out[f] = seen[int(np.argmin(away))]
        out[f, :3, 3] = np.average([T[:3, 3] for T in seen], axis=0, weights=share)
    return out


def _from_node(T_visual: Array, T_node: Array, camera: Array, scale: float) -> Array:
    relative = invert_pose(T_node) @ T_visual
    relative[:3, 3] *= scale
    return renormalise(camera @ relative)
