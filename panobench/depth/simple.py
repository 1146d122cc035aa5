"""Depth estimators that need one frame: the dataset's own depth, and a constant."""

from __future__ import annotations

import numpy as np

from panobench.cameras.base import Camera
from panobench.depth.base import DepthEstimator
from panobench.errors import UnavailableError, UsageError
from panobench.types import DepthEstimate, Frame


class OracleDepth(DepthEstimator):
    """The dataset's depth of the first frame that has any. It is metric, and every report flags it."""

    def start(self, camera: Camera, seed: int = 0) -> None:
        self._seen = 0

    def add(self, frame: Frame) -> DepthEstimate | None:
        """Raises UnavailableError when none of the first ten frames comes with depth."""
        self._seen += 1
        if frame.depth is not None:
            return DepthEstimate(frame.depth, frame.index, metric=True)
        if self._seen >= 10:
            raise UnavailableError(
                "--depth oracle: the dataset has no depth for the first frames; use --depth bootstrap"
            )
        return None


class ConstantDepth(DepthEstimator):
    """The same depth everywhere, with noise. MonoGS starts from 2 m with a standard deviation of 0.3 m."""

    def start(self, camera: Camera, seed: int = 0) -> None:
        try:
            self._depth = float(self.argument) if self.argument else 2.0
        except ValueError as error:
            raise UsageError(f"--depth constant:METRES takes a number, not '{self.argument}'") from error
        if not 0 < self._depth < 1e6:
            raise UsageError(f"--depth constant:{self.argument}: must be positive")
        self._rng = np.random.default_rng(seed)

    def add(self, frame: Frame) -> DepthEstimate | None:
        noise = 0.15 * self._depth * self._rng.standard_normal(frame.image.shape[:2])
        depth = np.maximum(self._depth + noise, 0.25 * self._depth)
        return DepthEstimate(depth.astype(np.float32), frame.index)
