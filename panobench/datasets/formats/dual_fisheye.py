"""Raw footage of a dual-fisheye camera (two circles in one frame), presented as panoramas.

``dual_fisheye.yaml`` beside the video, or ``NAME.dual.yaml`` for one of several, describes both lenses:

    blend_deg: 6                     # width of the zone around the rim in which the lenses are mixed
    lenses:
      - x: 0                         # where the lens's picture starts in the frame, pixels
        y: 0
        camera: {model: fisheye, width: 960, height: 960, fx: ..., ...}      # or the name of a calibration file
        yaw_pitch_roll_deg: [0, 0, 0]                                        # or R_rig_lens: 3x3
        t_rig_lens: [0, 0, 0.02]                                             # its centre in the rig's axes, metres
      - {x: 960, y: 0, camera: ..., yaw_pitch_roll_deg: [180, 0, 0], t_rig_lens: [0, 0, -0.02]}

With ``t_rig_lens`` the lenses are a rig, and things two metres away are stitched without a seam. Without it they are
taken to share one centre: closer than a few metres their distance is visible at the rim.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.calibration import read_calibration
from panobench.cameras.erp import ErpCamera
from panobench.cameras.factory import camera_from_dict, parse_camera_option
from panobench.cameras.rig import Rig, RigLens
from panobench.cameras.stitching import Stitcher
from panobench.cameras.views import look_rotation
from panobench.datasets.base import Dataset, FrameSequence
from panobench.datasets.files.checksums import files_provenance
from panobench.datasets.files.images import resize_image
from panobench.datasets.formats.video import video_files, video_provenance, video_remarks
from panobench.datasets.locate import choose_sequence
from panobench.errors import CalibrationError, DatasetError, UsageError
from panobench.geometry import make_pose
from panobench.reading import inside, number_array, parse_yaml, read_text
from panobench.video.pair import open_recording

Array = NDArray[np.float64]
_KEYS = {"x", "y", "camera", "yaw_pitch_roll_deg", "R_rig_lens", "t_rig_lens"}
#: Lenses whose centres are known are stitched for things so far away, metres.
_STITCHED_AT_M = 2.0


@dataclass(frozen=True)
class Lens:
    """One lens: its camera, the corner of its picture in the frame (pixels), its rotation into the rig's axes and its
    centre in them (metres).
    """

    camera: Camera
    x: int
    y: int
    R_rig_lens: Array
    centre: Array = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True)
class DualFisheye:
    """Both lenses, and the full width of the zone in which they are blended, degrees."""

    lenses: tuple[Lens, ...]
    blend_deg: float

    @property
    def rig(self) -> Rig:
        """The lenses and their poses; with one centre where their centres are not known."""
        return Rig(tuple(RigLens(lens.camera, make_pose(lens.R_rig_lens, lens.centre)) for lens in self.lenses))

    def pictures(self, frame: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
        """Each lens's part of a frame (H, W, 3)."""
        corners = [(lens.y, lens.x, lens.camera) for lens in self.lenses]
        return [np.ascontiguousarray(frame[y : y + c.height, x : x + c.width]) for y, x, c in corners]


def read_dual_fisheye(path: Path) -> DualFisheye:
    """Parse a dual_fisheye.yaml. Raises CalibrationError, which names the file and the mistake."""
    if not path.is_file():
        raise CalibrationError("the calibration of the two lenses is missing; see `panobench list datasets`", path)
    text = read_text(path, "the calibration of the two lenses", error=CalibrationError)
    values = parse_yaml(text, path, CalibrationError)
    lenses = values.get("lenses") if isinstance(values, dict) else None
    if not isinstance(lenses, list) or len(lenses) != 2:
        raise CalibrationError("expected 'lenses', a list of two", path)
    blend = values.get("blend_deg", 6.0)
    if not isinstance(blend, (int, float)) or not 0 < blend <= 60:
        raise CalibrationError(f"'blend_deg' must lie in (0, 60], not {blend!r}", path)
    return DualFisheye(tuple(_lens(v, k, path) for k, v in enumerate(lenses)), float(blend))


def _lens(values: Any, k: int, path: Path) -> Lens:
    if not isinstance(values, dict) or "camera" not in values:
        raise CalibrationError(f"lens {k} has no 'camera'", path)
    unknown = sorted(set(map(str, values)) - _KEYS)
    if unknown:
        raise CalibrationError(f"lens {k}: unknown key '{unknown[0]}'; known: {', '.join(sorted(_KEYS))}", path)
    camera = values["camera"]
    try:
        model = _camera_beside(path, camera) if isinstance(camera, str) else camera_from_dict(camera)
    except CalibrationError as error:
        raise CalibrationError(f"lens {k}: {error}", path) from None
    try:
        if "R_rig_lens" in values:
            R = number_array(values["R_rig_lens"])
        else:
            yaw, pitch, roll = (float(v) for v in values.get("yaw_pitch_roll_deg", (180.0 * k, 0, 0)))
            R = look_rotation(yaw, pitch, roll).T
        x, y = int(values.get("x", 0)), int(values.get("y", 0))
        centre = number_array(values.get("t_rig_lens", [0.0, 0.0, 0.0]))
    except (TypeError, ValueError, OverflowError) as error:
        raise CalibrationError(f"lens {k}: {error}", path) from None
    if R.shape != (3, 3) or not np.allclose(R @ R.T, np.eye(3), atol=1e-3) or np.linalg.det(R) < 0:
        raise CalibrationError(f"lens {k}: 'R_rig_lens' is not a rotation", path)
    if centre.shape != (3,) or not (np.abs(centre) < 10).all():
        raise CalibrationError(f"lens {k}: 't_rig_lens' must be three numbers, in metres", path)
    return Lens(model, x, y, R, centre)


def _camera_beside(path: Path, name: str) -> Camera:
    file = inside(path.parent, name)
    if file is None:
        raise CalibrationError(f"'{name}' does not lie beside it", path)
    return read_calibration(file)


class DualFisheyeSequence(FrameSequence):
    """A video of two circles as panoramas of ``width`` (None: that of the lenses' resolution)."""

    def __init__(self, path: Path, rig: DualFisheye, calibration: Path, name: str, width: int | None) -> None:
        self.reader = open_recording(path)
        for k, lens in enumerate(rig.lenses):
            right, bottom = lens.x + lens.camera.width, lens.y + lens.camera.height
            if lens.x < 0 or lens.y < 0 or right > self.reader.width or bottom > self.reader.height:
                raise CalibrationError(
                    f"lens {k} reaches to ({right}, {bottom}), the frame is {self.reader.width}x{self.reader.height}",
                    calibration,
                )
        if width is not None and width % 2:
            raise UsageError(f"--width {width}: a panorama's width must be even")
        native = parse_camera_option("erp", rig.lenses[0].camera, width).camera
        camera = ErpCamera(native.width, native.height)
        apart = rig.rig.baseline_m > 0
        self._lenses = rig
        self._stitcher = Stitcher(rig.rig, camera, rig.blend_deg, _STITCHED_AT_M if apart else None)
        self._full = parse_camera_option("erp", rig.lenses[0].camera, None).camera.width
        self._rig = rig.rig.scaled(min(1.0, camera.width / self._full)) if apart else None
        self.camera = camera if self._stitcher.valid.all() else camera.with_mask(self._stitcher.valid)
        self.name, self.dataset = name, "insta360-dual-fisheye"
        self.times = self.reader.times
        self._files = [*self.reader.files(), calibration]

    @property
    def rig(self) -> Rig | None:
        return self._rig

    def lens_images(self, index: int) -> tuple[NDArray[np.uint8], ...]:
        if self._rig is None:
            return ()
        pictures = self._lenses.pictures(self.reader.read(range(len(self))[index]))
        sizes = [(lens.camera.width, lens.camera.height) for lens in self._rig.lenses]
        return tuple(resize_image(picture, *size) for picture, size in zip(pictures, sizes, strict=True))

    def image(self, index: int) -> NDArray[np.uint8]:
        return self._stitcher.image(self._lenses.pictures(self.reader.read(range(len(self))[index])))

    @property
    def enlargement(self) -> float:
        return max(1.0, self.camera.width / self._full)

    def remarks(self) -> list[str]:
        return video_remarks(self.reader)

    def provenance(self) -> dict[str, Any]:
        return {
            "dataset": self.dataset,
            "sequence": self.name,
            "root": str(self._files[0]),
            **video_provenance(self.reader),
            "blend_deg": self._lenses.blend_deg,
            **({} if self._rig is None else {"baseline_m": self._rig.baseline_m}),
            **files_provenance(self._files),
        }


class Insta360DualFisheye(Dataset):
    """``root`` is a video, or a folder of videos, with the calibration beside it."""

    name = "insta360-dual-fisheye"

    def sequences(self) -> list[str]:
        if self.root is None:
            raise DatasetError(f"dataset '{self.name}' needs --root FILE or FOLDER")
        return list(video_files(self.root))

    def open(self, sequence: str | None = None, *, width: int | None = None) -> FrameSequence:
        name = choose_sequence(self.name, sequence, self.sequences())
        assert self.root is not None
        path = video_files(self.root)[name]
        own = path.with_name(f"{path.stem}.dual.yaml")
        calibration = own if own.is_file() else path.with_name("dual_fisheye.yaml")
        return DualFisheyeSequence(path, read_dual_fisheye(calibration), calibration, name, width)
