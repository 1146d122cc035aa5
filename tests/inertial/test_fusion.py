"""Metres, gravity, clocks and blackouts from visual poses with noise and drift and samples with published noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from inertial_walks import Recording, drone, gravity_error_deg, record, seen, walk, without

from panobench.datasets.palvio.synth import BodyMotion
from panobench.geometry import umeyama
from panobench.inertial.initialise import initialise
from panobench.inertial.rotation import fit_rotation
from panobench.inertial.samples import InertialError, usable_samples
from panobench.inertial.visual import VisualPoses

MOTIONS = {"walk": walk(seed=2), "from rest": walk(still_s=5.0, seed=1), "drone": drone(seed=3)}


def recorded(name: str, offset_s: float) -> Recording:
    fps, rate = (15.0, 200.0) if name == "drone" else (30.0, 500.0)
    return record(MOTIONS[name], fps=fps, rate_hz=rate, offset_s=offset_s)


@pytest.mark.parametrize("offset_s", [-0.0066, 0.12])
@pytest.mark.parametrize("name", MOTIONS)
def test_rotation_gives_the_clocks_offset_and_the_poses_scale_and_gravity(name: str, offset_s: float) -> None:
    recording = recorded(name, offset_s)
    visual = seen(recording)
    samples = usable_samples(recording.imu, recording.times)
    rotation = fit_rotation(visual, samples)
    assert rotation.offset_s == pytest.approx(offset_s, abs=1e-3)
    assert rotation.remarks == ()
    initial = initialise(visual, samples, rotation)
    assert initial.scale * 0.37 == pytest.approx(1, abs=0.02)
    assert abs(np.log(initial.scale * 0.37)) < 4 * initial.scale_sigma
    assert gravity_error_deg(initial.gravity, recording, visual) < 0.1


def errors_m(T_wc: np.ndarray, recording: Recording) -> np.ndarray:
    """Of positions, after an alignment without scale."""
    p, q = T_wc[:, :3, 3], recording.truth[:, :3, 3]
    return np.asarray(np.linalg.norm(umeyama(p, q, with_scale=False).apply_points(p) - q, axis=1))


@pytest.mark.parametrize("name", MOTIONS)
def test_the_fit_is_metric_upright_and_bridges_a_blackout(name: str) -> None:
    pytest.importorskip("gtsam")
    from panobench.inertial.fusion import fuse

    recording = recorded(name, 0.0066)
    visual = without(seen(recording, noise_m=0.001), 30.0, 32.0)
    found = fuse(visual, recording.imu)
    assert np.isfinite(found.T_wc).all()
    assert list(np.flatnonzero(found.bridged)) == list(np.flatnonzero(~visual.known))
    p, q = found.T_wc[:, :3, 3], recording.truth[:, :3, 3]
    assert umeyama(p, q).scale == pytest.approx(1, abs=0.005)
    up = np.einsum("nij,nkj->ik", recording.truth[:, :3, :3], found.T_wc[:, :3, :3])[2]
    assert np.degrees(np.arccos(up[2] / np.linalg.norm(up))) < 0.3
    errors = errors_m(found.T_wc, recording)
    assert np.sqrt(np.mean(errors**2)) < 0.02
    assert errors[found.bridged].max() < 0.03


def test_two_maps_with_their_own_scales_become_one_trajectory() -> None:
    pytest.importorskip("gtsam")
    from panobench.inertial.fusion import fuse

    recording = record(walk(40.0, seed=5), 40.0, rate_hz=200.0)
    one, two = seen(recording, scale=0.37), seen(recording, scale=1.9, seed=3)
    later = recording.times >= 20.0
    T_wc = np.where(later[:, None, None], two.T_wc, one.T_wc)
    T_wc[later, :3, 3] += 7.0
    visual = without(VisualPoses(recording.times, T_wc, later.astype(np.int64)), 19.5, 20.5)
    found = fuse(visual, recording.imu)
    assert np.isfinite(found.T_wc).all()
    assert (
        np.sqrt(np.mean(errors_m(found.T_wc, recording) ** 2)) < 0.1
    )  # each map's scale is known to half a percent of 20 m


def test_a_few_seconds_know_their_uncertainty() -> None:
    """The scale of four seconds is uncertain, and the fit can tell by how much."""
    pytest.importorskip("gtsam")
    from panobench.inertial.fusion import fuse

    recording = record(walk(4.0, seed=6), 4.0, fps=15.0, rate_hz=200.0)
    found = fuse(seen(recording, noise_m=0.001), recording.imu)
    assert 0.001 < found.scale_sigma < 0.05
    assert abs(np.log(found.scale * 0.37)) < 3 * found.scale_sigma


def test_wrong_accelerations_do_not_become_a_scale() -> None:
    """The gyroscope is right, the accelerometer is another recording's."""
    recording, other = record(walk(20.0), 20.0, rate_hz=200.0), record(walk(20.0, seed=9), 20.0, rate_hz=200.0)
    samples = usable_samples(replace(recording.imu, accel=other.imu.accel), recording.times)
    visual = seen(recording)
    with pytest.raises(InertialError):
        initialise(visual, samples, fit_rotation(visual, samples))


def test_exact_input_gives_exact_output() -> None:
    recording = record(walk(20.0), 20.0, rate_hz=1000.0, noise=None, gyro_bias=(0, 0, 0), accel_bias=(0, 0, 0))
    visual = seen(recording, noise_m=0.0, noise_deg=0.0, drift_m=0.0, drift_deg=0.0)
    samples = usable_samples(recording.imu, recording.times)
    rotation = fit_rotation(visual, samples)
    initial = initialise(visual, samples, rotation)
    assert rotation.offset_s == pytest.approx(0, abs=2e-5)
    assert initial.scale * 0.37 == pytest.approx(1, abs=2e-4)


def test_the_motion_of_the_tests_has_no_seam() -> None:
    """A spline's second derivative is what the accelerometer measures; a jump would be a force nobody felt."""
    motion: BodyMotion = MOTIONS["walk"]
    _, accel = motion.imu(np.arange(0.0, 60.0, 0.01), np.array([0.0, 0.0, 1.0]))
    assert np.abs(np.diff(accel, axis=0)).max() < 3.0
