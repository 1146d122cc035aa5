"""The ring of valid pixels of a panoramic annular lens, and the agreement of its two polynomials inside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.scaramuzza import ScaramuzzaCamera
from panobench.errors import CalibrationError

#: Largest tolerated difference between direct and inverse polynomial, pixels.
TOLERANCE_PX = 1.0


def annulus_mask(width: int, height: int, centre: tuple[float, float], r_min: float, r_max: float) -> NDArray[np.bool_]:
    """(H, W): pixels whose centre is r_min..r_max pixels from ``centre`` (u, v; first pixel's centre at 0.5)."""
    u = np.arange(width) + 0.5 - centre[0]
    v = np.arange(height) + 0.5 - centre[1]
    mask = np.empty((height, width), dtype=bool)
    for top in range(0, height, 256):  # in strips: the radii of a large image would take eight times the mask
        r = np.hypot(u[None, :], v[top : top + 256, None])
        mask[top : top + 256] = (r >= r_min) & (r <= r_max)
    return mask


def check_annulus(camera: ScaramuzzaCamera, annulus: tuple[float, float] | None = None) -> tuple[float, float]:
    """The radii (r_min, r_max) between which the annulus is taken to lie.

    Unknown (None): the outer two thirds of the largest circle in the image; an annular lens is blind in the middle,
    and there the inverse polynomial is often not fitted.
    """
    if annulus is not None:
        return annulus
    if camera.r_max is not None:
        return camera.r_min, camera.r_max
    outer = min(camera.cx, camera.width - camera.cx, camera.cy, camera.height - camera.cy)
    return max(camera.r_min, outer / 3), max(outer, camera.r_min + 1)


def worst_disagreement(camera: ScaramuzzaCamera, low: float, high: float) -> tuple[float, float, float]:
    """Largest difference of the polynomials in low..high, its radius, and the first radius above tolerance or NaN."""
    r = np.linspace(low, high, 2001)
    error = np.abs(camera.inverse_error(r))
    error = np.where(np.isfinite(error), error, np.inf)
    worst = int(np.argmax(error))
    beyond = np.flatnonzero(error > TOLERANCE_PX)
    return float(error[worst]), float(r[worst]), float(r[beyond[0]]) if len(beyond) else float("nan")


def require_agreement(
    camera: ScaramuzzaCamera,
    path: Path | None,
    line: int | None = None,
    annulus: tuple[float, float] | None = None,
) -> list[str]:
    """Notes on how far the polynomials agree. Raises CalibrationError naming the radius where they do not."""
    if not camera.inv_poly:
        return ["no inverse polynomial: the direct one is inverted numerically"]
    low, high = check_annulus(camera, annulus)
    error, radius, first = worst_disagreement(camera, low, high)
    if error > TOLERANCE_PX:
        raise CalibrationError(
            f"direct and inverse polynomial disagree by more than {TOLERANCE_PX:g} px from r = {first:.0f} px "
            f"(worst {error:.1f} px at r = {radius:.0f} px) inside the valid annulus {low:.0f}..{high:.0f} px; "
            "check the signs and the order of both",
            path,
            line=line,
        )
    notes = [f"polynomials agree to {error:.3f} px for r in {low:.0f}..{high:.0f} px"]
    r = np.linspace(0, low, 501)
    apart = np.flatnonzero(~(np.abs(camera.inverse_error(r)) <= TOLERANCE_PX))
    if len(apart):
        notes.append(f"they disagree by more than {TOLERANCE_PX:g} px for r < {r[apart[-1]]:.0f} px (blind centre)")
    return notes


def fit_inverse(camera: ScaramuzzaCamera, tolerance: float = 0.01, max_terms: int = 20) -> tuple[float, ...]:
    """The camera's inverse polynomial, or one fitted to ``tolerance`` pixels if it has none.

    It covers all radii of the model if it can, else those inside the valid annulus.
    Raises CalibrationError if no polynomial of ``max_terms`` terms is that close.
    """
    if camera.inv_poly:
        return camera.inv_poly
    for low, high in ((camera.r_min, camera.reach), check_annulus(camera)):
        rho = np.linspace(low, min(high, camera.reach), 1000)
        theta = camera.polar_angle(rho) - np.pi / 2
        for terms in range(6, max_terms + 1):
            inverse = np.polynomial.Polynomial.fit(theta, rho, terms - 1).convert().coef
            if np.abs(np.polynomial.polynomial.polyval(theta, inverse) - rho).max() < tolerance:
                return tuple(float(q) for q in inverse)
    raise CalibrationError(f"no inverse polynomial of {max_terms} terms fits this camera to {tolerance} px")
