"""A rig's frames as panogs sees them: the lenses' pictures side by side in one panorama of many centres."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.rig import Rig
from panobench.cameras.rig_panorama import LensCentres, LensPictures, RigPanorama
from panobench.inertial.fusion import Unit
from panobench.methods.base import MethodContext
from panobench.methods.lens_scale import is_metric, scale_numbers
from panobench.methods.panogs.config import PanogsConfig, RollingShutterOptions
from panobench.methods.panogs.rigs.scale import RigScale
from panobench.types import Frame


class RigFrames:
    """camera: what the frames are of. scale: what its lenses' distance tells. numbers: for run.json, at the end.

    overlap: as for ``RigScale``.
    """

    def __init__(self, rig: Rig, camera: ErpCamera, overlap: float, context: MethodContext) -> None:
        lenses = LensCentres.of(rig)
        self.camera, self.context = RigPanorama.of(rig, camera, lenses), context
        self.scale = RigScale(lenses, overlap, context.log)
        self.numbers: dict[str, Any] = {}
        self._pictures = LensPictures(rig, self.camera)

    def frame(self, frame: Frame) -> Frame:
        """The frame with the lenses' pictures in place of the stitched one."""
        return replace(frame, image=self._pictures.image(frame.lenses))

    def rolling_shutter(self, options: RollingShutterOptions) -> RollingShutterOptions:
        """With the readout that the rig's calibration states, where none is given."""
        stated = self.camera.rig.readout_s if self.camera.rig else None
        return options if options.readout_ms != 0 or not stated else replace(options, readout_ms=1e3 * stated)

    def unit(self, pixel_angle: float, scene_depth: float) -> Unit | None:
        """The map's unit in metres, if the lenses' distance tells it; arguments as for ``RigScale.sigma``."""
        sigma = self.scale.sigma(pixel_angle, scene_depth)
        self.numbers = scale_numbers(len(self.scale.lenses.centres_m), sigma)
        if not is_metric(sigma, self.context.warn):
            return None
        metres = 1 / self.scale.lenses.units_per_metre
        self.context.log(f"a unit of the map is {metres:.4g} m by the lenses' distance (+- {sigma:.2%})")
        return Unit(metres, sigma)


def rig_frames(camera: Camera, context: MethodContext, config: PanogsConfig) -> RigFrames | None:
    """What there is to a rig whose lenses are seen through; None where frames are taken as they come."""
    if context.rig is None or not config.rig.enabled or not isinstance(camera, ErpCamera):
        return None
    if context.saved_map is not None:
        context.log("rig: a saved map is gone on with through the stitched panorama")
        return None
    return RigFrames(context.rig, camera, 2 * config.factors.reach / config.factors.every, context)
