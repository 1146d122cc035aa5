"""gtsam's preintegration of samples between two instants, and dead reckoning with it."""

from __future__ import annotations

from itertools import pairwise

import gtsam
import numpy as np
from numpy.typing import NDArray

from panobench.geometry import renormalise
from panobench.inertial.samples import Samples

Array = NDArray[np.float64]

#: Variance that integration itself adds to positions, m^2/s: samples are linear only nearly.
INTEGRATION_VARIANCE = 1e-8


def preintegration_params(samples: Samples) -> gtsam.PreintegrationCombinedParams:
    """For a world that is z up."""
    parameters = gtsam.PreintegrationCombinedParams.MakeSharedU(samples.gravity)
    noise = samples.noise
    parameters.setAccelerometerCovariance(np.eye(3) * noise.accel**2)
    parameters.setGyroscopeCovariance(np.eye(3) * noise.gyro**2)
    parameters.setBiasAccCovariance(np.eye(3) * noise.accel_walk**2)
    parameters.setBiasOmegaCovariance(np.eye(3) * noise.gyro_walk**2)
    parameters.setIntegrationCovariance(np.eye(3) * INTEGRATION_VARIANCE)
    return parameters


def preintegrate(
    samples: Samples,
    begin: float,
    end: float,
    parameters: gtsam.PreintegrationCombinedParams,
    bias: gtsam.imuBias.ConstantBias,
) -> gtsam.PreintegratedCombinedMeasurements:
    """The samples from ``begin`` to ``end``, s."""
    measured = gtsam.PreintegratedCombinedMeasurements(parameters, bias)
    for accel, gyro, seconds in zip(*samples.between(begin, end)):
        measured.integrateMeasurement(accel, gyro, float(seconds))
    return measured


def dead_reckon(
    samples: Samples, times: Array, T_wb: Array, velocity: Array, gyro_bias: Array, accel_bias: Array
) -> tuple[Array, Array]:
    """Poses (M, 4, 4) and velocities (M, 3) of the body at ``times`` (M,), of which the first is where it starts.

    T_wb (4, 4) and velocity (3,): there, in a world that is z up and in metres.
    """
    parameters = preintegration_params(samples)
    bias = gtsam.imuBias.ConstantBias(accel_bias, gyro_bias)
    state = gtsam.NavState(gtsam.Rot3(T_wb[:3, :3]), T_wb[:3, 3], velocity)
    poses, velocities = [T_wb], [velocity]
    for begin, end in pairwise(times):
        state = preintegrate(samples, float(begin), float(end), parameters, bias).predict(state, bias)
        poses.append(renormalise(state.pose().matrix()))
        velocities.append(state.velocity())
    return np.stack(poses), np.stack(velocities)
