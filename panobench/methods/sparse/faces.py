"""Any central camera as a set of perspective images, the "faces". Only this module of ``sparse`` uses the camera model.

A wide camera (panorama, annular lens, fisheye) becomes the sides of a cube. Each has a margin, so that patches at its
edge are complete; the poles and the seam of a panorama are then nothing special. A camera with a moderate field of
view is one face, which is resampled only if the camera has distortion.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.methods.sparse.lenses import Lenses
from panobench.methods.sparse.patches import cut_templates

Array = NDArray[np.float64]

#: Border around the 90 degrees of a cube side, in face pixels: half of a coarse patch and its search range.
MARGIN = 28
#: A camera whose rays all lie within 68 degrees of its axis (this cosine) becomes a single face. For wider cameras a
#: plane spends so many pixels on its rim that a cube with as many pixels has more detail in the middle.
SINGLE_FACE_COSINE = 0.37
#: Fine faces are so many times as fine as the image, as far as ``max_pixels`` allow. A patch then spans half as many
#: degrees. One that holds surfaces at several distances keeps to one of them over a long track, while a small motion is
#: that of all of them, and comes out too small.
FINER = 2.0
#: Rows that are added beyond each pole of a panorama for interpolation.
POLE_ROWS = 2


@dataclass
class FaceSet:
    """F faces of H x W pixels.

    R_fc (F, 3, 3) takes rays from the camera's axes to a face's. intrinsics (4,): fx, fy, cx, cy with pixel centres at
    k + 0.5. valid (F, H, W): the pixel shows something. core (F, H, W): valid, away from edges, and nearest to this
    face; corners are detected there. focal: pixels per radian, the unit of residuals. map_u, map_v (F * H, W): where
    each face pixel lies in the image; None if the image itself is the face. wraps: the image is a closed panorama.
    source_scale: face pixels per image pixel. lenses: where bearings begin.
    """

    R_fc: Array
    intrinsics: Array
    size: tuple[int, int]
    valid: NDArray[np.bool_]
    core: NDArray[np.bool_]
    focal: float
    map_u: NDArray[np.float32] | None
    map_v: NDArray[np.float32] | None
    wraps: bool = False
    source_scale: float = 1.0
    lenses: Lenses = field(default_factory=Lenses)

    @property
    def count(self) -> int:
        return len(self.R_fc)

    def pyramid(self, image: NDArray[np.uint8], levels: int) -> list[NDArray[np.uint8]]:
        """RGB or grey image (H, W[, 3]) -> per level the grey faces (F, H / 2^l, W / 2^l)."""
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
        if self.source_scale < 0.7:  # the faces are much coarser than the image: avoid aliasing
            grey = cv2.GaussianBlur(grey, (0, 0), 0.4 / self.source_scale)
        h, w = self.size
        if self.map_u is not None and self.map_v is not None:
            if self.wraps:  # beyond a pole the panorama continues on the opposite meridian
                half = grey.shape[1] // 2
                over = [np.roll(rows[::-1], half, axis=1) for rows in (grey[:POLE_ROWS], grey[-POLE_ROWS:])]
                grey = np.concatenate([over[0], grey, over[1]])
            border = cv2.BORDER_WRAP if self.wraps else cv2.BORDER_REPLICATE
            tall = cv2.remap(grey, self.map_u, self.map_v, cv2.INTER_CUBIC, borderMode=border)
        else:
            tall = cv2.copyMakeBorder(grey, 0, h - grey.shape[0], 0, w - grey.shape[1], cv2.BORDER_REPLICATE)
        out: list[NDArray[np.uint8]] = [np.ascontiguousarray(tall, dtype=np.uint8).reshape(self.count, h, w)]
        for level in range(1, levels):
            # Heights are multiples of 2^levels, so a mean of 2x2 pixels never mixes two faces.
            half = (w >> level, self.count * (h >> level))
            tall = cv2.resize(tall, half, interpolation=cv2.INTER_AREA)
            out.append(np.asarray(tall, dtype=np.uint8).reshape(self.count, h >> level, w >> level))
        return out

    def templates(self, pyramid: list[NDArray[np.uint8]], bearings: Array) -> NDArray[np.float32]:
        """Templates (N, levels, 16, 16) around bearings (N, 3); see ``cut_templates``."""
        return cut_templates(pyramid, self.R_fc, self.intrinsics, bearings, self.focal)

    def rays(self, face: int, pixels: Array) -> Array:
        """Pixels (N, 2) of one face -> unit rays (N, 3) in the camera frame."""
        fx, fy, cx, cy = self.intrinsics
        d = np.column_stack([(pixels[:, 0] - cx) / fx, (pixels[:, 1] - cy) / fy, np.ones(len(pixels))])
        d = d @ self.R_fc[face]
        return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True))


def levels_for(focal: float) -> int:
    """Pyramid levels so that the coarsest has about 25 pixels per radian; at least three."""
    return int(np.clip(1 + round(np.log2(focal / 25.0)), 3, 5))


def build_faces(camera: Camera, max_pixels: int, levels: int, *, fine: bool = False) -> FaceSet:
    """Choose faces for a camera, at the camera's mean angular resolution over the sphere; fine: see ``FINER``."""
    valid = camera.valid_mask()
    rays = camera.rays()
    omega = camera.solid_angle()
    usable = valid & (omega > 0)
    total = float(omega[usable].sum())
    pixel_angle = float((omega[usable] ** 1.5).sum()) / total if total > 0 else 2 * np.pi / camera.width
    multiple = 1 << (levels - 1)
    times = FINER if fine else 1.0
    if usable.any() and float(rays[usable][:, 2].min()) > SINGLE_FACE_COSINE:
        return _single_face(camera, rays, usable, pixel_angle, max_pixels, multiple, times)
    return _cube(camera, usable, pixel_angle, max_pixels, multiple, times)


def round_up(value: float, multiple: int) -> int:
    """The least multiple that is not smaller."""
    return int(np.ceil(value / multiple)) * multiple


def _single_face(
    camera: Camera,
    rays: Array,
    usable: NDArray[np.bool_],
    pixel_angle: float,
    max_pixels: int,
    multiple: int,
    times: float,
) -> FaceSet:
    x, y = rays[..., 0] / rays[..., 2], rays[..., 1] / rays[..., 2]
    grid = camera.pixel_grid()
    # Without distortion u is affine in x / z, and the image itself is the face.
    fx, cx = np.polyfit(x[usable], grid[..., 0][usable], 1)
    fy, cy = np.polyfit(y[usable], grid[..., 1][usable], 1)
    straight = max(
        float(np.abs(fx * x + cx - grid[..., 0])[usable].max()), float(np.abs(fy * y + cy - grid[..., 1])[usable].max())
    )
    if times == 1.0 and straight < 0.02 and camera.width * camera.height <= max_pixels:
        h, w = round_up(camera.height, multiple), round_up(camera.width, multiple)
        mask = np.zeros((1, h, w), bool)
        mask[0, : camera.height, : camera.width] = camera.valid_mask()
        intrinsics = np.array([fx, fy, cx, cy])
        return FaceSet(np.eye(3)[None], intrinsics, (h, w), mask, _erode(mask), float(np.sqrt(fx * fy)), None, None)
    if times > 1.0 and straight < 0.02:  # its middle, where an image without distortion has the fewest pixels a radian
        pixel_angle = float(1.0 / np.sqrt(fx * fy))
    x0, x1, y0, y1 = (float(f(a[usable])) for a in (x, y) for f in (np.min, np.max))
    focal = min(times / pixel_angle, float(np.sqrt(max_pixels / ((x1 - x0) * (y1 - y0)))))
    w, h = round_up(focal * (x1 - x0), multiple), round_up(focal * (y1 - y0), multiple)
    intrinsics = np.array([focal, focal, -focal * x0, -focal * y0])
    return resampled(camera, np.eye(3)[None], intrinsics, (h, w), focal, pixel_angle, wide=False)


def _cube(
    camera: Camera, usable: NDArray[np.bool_], pixel_angle: float, max_pixels: int, multiple: int, times: float
) -> FaceSet:
    sides = np.array(
        [
            [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
            [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
            [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
            [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
            [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
            [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
        ],
        dtype=np.float64,
    )
    looks = camera.rays()[usable]
    if len(looks):
        nearest = np.argmax(looks @ sides[:, 2].T, axis=1)
        share = np.bincount(nearest, weights=camera.solid_angle()[usable], minlength=6)
        sides = sides[share > 0.05]
    widest = np.sqrt(max_pixels / max(1, len(sides))) / 2 - MARGIN
    focal = float(min(times / pixel_angle, widest))
    half = round_up(2 * (focal + MARGIN), 2 * multiple) // 2
    intrinsics = np.array([focal, focal, float(half), float(half)])
    return resampled(camera, sides, intrinsics, (2 * half, 2 * half), focal, pixel_angle, wide=True)


def resampled(
    camera: Camera,
    R_fc: Array,
    intrinsics: Array,
    size: tuple[int, int],
    focal: float,
    pixel_angle: float,
    wide: bool,
) -> FaceSet:
    """Faces that look along ``R_fc`` (F, 3, 3), cut out of the camera's image. ``wide``: they are sides of a cube."""
    h, w = size
    fx, fy, cx, cy = intrinsics
    u, v = np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5)
    d = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones((h, w))], axis=-1)
    rays = np.einsum("hwi,fij->fhwj", d, R_fc)
    pixels, ok = camera.project(rays)
    finite = np.isfinite(pixels[..., 0]) & np.isfinite(pixels[..., 1])
    pixels = np.where(finite[..., None], pixels, -1.0)
    mask = camera.valid_mask()
    col = np.clip(np.floor(pixels[..., 0]).astype(int), 0, camera.width - 1)
    row = np.clip(np.floor(pixels[..., 1]).astype(int), 0, camera.height - 1)
    valid = ok & finite & mask[row, col]
    map_u = (pixels[..., 0] - 0.5).astype(np.float32)
    map_v = (pixels[..., 1] - 0.5).astype(np.float32)
    # A panorama continues across its seam, and so must the interpolation of its outermost columns.
    left, right = camera.unproject(np.array([[0.5, camera.height / 2], [camera.width - 0.5, camera.height / 2]]))
    wraps = wide and float(np.dot(left, right)) > np.cos(3 * pixel_angle)
    if wraps:
        map_v += POLE_ROWS
    core = _erode(valid)
    if wide and len(R_fc) > 1:
        own = np.argmax(np.einsum("fhwj,kj->fhwk", rays, R_fc[:, 2]), axis=-1) == np.arange(len(R_fc))[:, None, None]
        core &= own
    return FaceSet(
        R_fc,
        intrinsics,
        size,
        valid,
        core,
        focal,
        map_u.reshape(-1, w),
        map_v.reshape(-1, w),
        wraps,
        focal * pixel_angle,
    )


def _erode(valid: NDArray[np.bool_], radius: int = 8) -> NDArray[np.bool_]:
    """The pixels whose neighbourhood is valid and inside the face, so that a patch there is complete."""
    kernel = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    return np.stack(
        [
            cv2.erode(v.astype(np.uint8), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=(0,)).astype(bool)
            for v in valid
        ]
    )
