"""Evidence in what a method says beside its trajectory: its first depth, its map, its own doubts."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from panobench.types import Estimate
from panobench.verdict.base import Evidence, falling

#: Trust in a map that started from a depth that had failed its own check; the same where a second method has confirmed
#: the path, which is what such a start could have spoilt.
FAILED_START, FAILED_START_CONFIRMED = 0.4, 0.8
#: PSNR of the map at its own frames, in dB, that a right run of a recording reaches, and that no right run has.
PSNR_GOOD, PSNR_BAD = 19.0, 13.0
#: By so much less where the method has left out what moves, which is in the frames all the same.
PSNR_MOVING = 4.0
#: Trust does not fall lower for pictures where the map explains the frames but for their brightness.
PSNR_LEAST_AGREEING = 0.6
#: Trust in a path that the IMU contradicts: a wrong mounting is as likely as a wrong path.
CONTRADICTED = 0.4
#: Trust in a path whose parts were put together by looks alone; the same where a second method that agrees has followed
#: the camera all the way.
BY_LOOKS, BY_LOOKS_FOLLOWED = 0.4, 0.9
#: Trust in a path where most of the view does not move as a rigid scene: all methods may follow the rest, or that.
NOT_RIGID = 0.4
#: Median share of textured blocks in which frame and render agree.
AGREEMENT_GOOD, AGREEMENT_BAD = 0.65, 0.35
#: Median over the frames of their reprojection error, in pixels, that right runs stay below, and that no right run has;
#: of images with at most so many pixels per radian (a panorama 512 wide). In finer ones, motion is more pixels.
REPROJECTION_GOOD, REPROJECTION_BAD, REPROJECTION_FINE = 0.8, 1.4, 512 / (2 * np.pi)


def first_depth(estimate: Estimate, *, confirmed: bool = False) -> Evidence | None:
    """Whether the depth that the map started from had passed its check. confirmed: a second method's path agrees."""
    if estimate.depth is None:
        return None
    if estimate.depth.ok:
        return Evidence("first depth", 1.0, "the first depth passed its check")
    return Evidence(
        "first depth",
        FAILED_START_CONFIRMED if confirmed else FAILED_START,
        f"the map started from a depth that failed its check ({estimate.depth.message})",
        "start where the camera moves sideways past things at different distances, or mask what moves with it (--mask)",
    )


def map_pictures(metrics: Mapping[str, float | None], *, moving: bool = False, agrees: bool = False) -> Evidence | None:
    """How well the map shows the frames: held-out ones if there are any. moving: what moves is not in the map.

    agrees: blocks of frames and map correlate, so that what is left is brightness: the exposure changes.
    """
    less = PSNR_MOVING if moving else 0.0
    for key, what in (("holdout_psnr_db", "held-out frames"), ("pano_psnr_db", "its own frames")):
        value = metrics.get(key)
        if value is not None:
            trust = falling(value, PSNR_GOOD - less, PSNR_BAD - less)
            trust = max(trust, PSNR_LEAST_AGREEING) if agrees else trust
            return Evidence("pictures", trust, f"the map shows {what} with {value:.1f} dB")
    return None


def inertial(estimate: Estimate) -> Evidence | None:
    """Whether the IMU and the camera could both be right, if the method had one."""
    said = estimate.extra.get("inertial")
    if not isinstance(said, Mapping) or not said:
        return None
    if said.get("contradicted"):
        return Evidence(
            "inertial", CONTRADICTED, str(said.get("reason", "the IMU contradicts the camera")),
            "give the IMU's mounting, axes and units as they are, and no levelled or stabilised video; or --imu off",
        )  # fmt: skip
    if said.get("initialised"):
        return Evidence("inertial", 1.0, "camera and IMU agree on turns, scale and gravity")
    return Evidence("inertial", 1.0, f"the IMU was no help: {said.get('reason', '')}")


def joined_maps(estimate: Estimate, *, followed: bool = False) -> Evidence | None:
    """Whether parts of the path hang together by looks alone (``extra`` "joined_by_looks"): places may look alike.

    followed: a second method has followed the camera without a break, and its path agrees.
    """
    joined = estimate.extra.get("joined_by_looks")
    if not isinstance(joined, int) or not joined:
        return None
    return Evidence(
        "joined maps", BY_LOOKS_FOLLOWED if followed else BY_LOOKS,
        f"after {'a cut' if joined == 1 else f'{joined} cuts'} the path goes on where the place looked the same, "
        "and places may look alike",
        "run the parts before and after the cut apart",
    )  # fmt: skip


def agreement(estimate: Estimate) -> Evidence | None:
    """The share of each frame that the method's map explains, if the method says so per frame ("agreement")."""
    shares = [row["agreement"] for row in estimate.frames.values() if "agreement" in row]
    if len(shares) < 5:
        return None
    low = float(np.quantile(shares, 0.25))
    return Evidence(
        "agreement", falling(low, AGREEMENT_GOOD, AGREEMENT_BAD),
        f"in a quarter of the frames the map explains less than {100 * low:.0f}% of the picture",
        "mask what moves with the camera (--mask), or record with less motion in view",
    )  # fmt: skip


def reprojection(estimate: Estimate, enlargement: float = 1.0) -> Evidence | None:
    """How well one rigid scene explains the features, if the method says so per frame ("error_px").

    ``extra`` "pixels_per_radian" is the resolution of what the features were found in, if the method says it.
    enlargement: see ``FrameSequence.enlargement``; what counts are the pixels that were recorded.
    """
    errors = [row["error_px"] for row in estimate.frames.values() if "error_px" in row]
    if len(errors) < 5:
        return None
    usual, resolution = float(np.median(errors)) / enlargement, estimate.extra.get("pixels_per_radian")
    finer = max(resolution / enlargement / REPROJECTION_FINE, 1.0) if isinstance(resolution, (int, float)) else 1.0
    pixels = "pixels of the recording" if enlargement > 1 else "pixels"
    return Evidence(
        "reprojection", falling(usual / finer, REPROJECTION_GOOD, REPROJECTION_BAD),
        f"in half of the frames features are more than {usual:.1f} {pixels} from where the map has them",
        "mask what moves with the camera (--mask), or record with less motion in view",
    )  # fmt: skip


def rigid_scene(not_rigid: float) -> Evidence | None:
    """Whether most of the view moves as a rigid scene does. not_rigid: the share that does not, if it is too much."""
    if not not_rigid:
        return None
    return Evidence(
        "rigid scene", NOT_RIGID,
        f"{100 * not_rigid:.0f}% of the view does not move as a rigid scene: too much to hide",
        "mask what moves with the camera by hand (--mask FILE)",
    )  # fmt: skip
