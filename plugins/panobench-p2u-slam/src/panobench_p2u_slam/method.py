"""P2U-SLAM by the interface that its paper implies: ORB-SLAM3's command line, with a polynomial as the camera.

No code is public at the time of writing. What is not ORB-SLAM3's is a guess, and is kept in one place:
``PAL_TYPE`` and ``pal_settings``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from panobench import Camera, UnsupportedError, option
from panobench.external import ExternalConfig, MonoEurocMethod, OrbSlamConfig, write_mask

PAL_TYPE = "Taylor"


@dataclass(frozen=True)
class P2uSlamConfig(OrbSlamConfig):
    """Features."""

    features: int = option(1500, "ORB features per image", above=0)


def pal_settings(camera: Camera) -> dict[str, Any]:
    """The camera's keys: Taylor (OCamCalib) polynomial, inverse polynomial, affine part; first pixel's centre at 0."""
    v = camera.to_dict()
    values: dict[str, Any] = {"Camera.type": PAL_TYPE}
    values |= {f"Camera1.poly{i}": float(x) for i, x in enumerate(v["poly"])}
    values |= {f"Camera1.invpoly{i}": float(x) for i, x in enumerate(v["inv_poly"])}
    values |= {"Camera1.c": float(v["c"]), "Camera1.d": float(v["d"]), "Camera1.e": float(v["e"])}
    return values | {"Camera1.cx": float(v["cx"]) - 0.5, "Camera1.cy": float(v["cy"]) - 0.5}


class P2uSlam(MonoEurocMethod):
    """Monocular, with a mask for the lens's blind parts."""

    title: ClassVar[str] = "P2U-SLAM"
    program: ClassVar[str] = "p2u_slam_mono"
    variable: ClassVar[str] = "PANOBENCH_P2U_SLAM"
    config_class: ClassVar[type[ExternalConfig]] = P2uSlamConfig

    @classmethod
    def missing(cls, config: ExternalConfig | None = None) -> str | None:
        reason = super().missing(config)
        return None if reason is None else f"no public code at present; {reason}"

    def camera_settings(self, camera: Camera) -> dict[str, Any]:
        if camera.kind == "pal":
            return pal_settings(camera)
        try:
            return super().camera_settings(camera)
        except UnsupportedError as error:
            raise UnsupportedError(f"{error}, or --camera pal") from error

    def visible_pixels(self, camera: Camera) -> None:
        return None  # the mask says it

    def file_settings(self, camera: Camera, work: Path) -> dict[str, Any]:
        mask = work / "mask.png"
        return {"Camera.mask": str(mask)} if write_mask(camera, mask) else {}
