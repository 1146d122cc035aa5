"""Hypothesis strategies: plausible cameras of every model."""

from __future__ import annotations

from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st

from panobench.cameras.base import Camera
from panobench.cameras.cubemap import CubemapCamera
from panobench.cameras.double_sphere import DoubleSphereCamera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.eucm import EucmCamera
from panobench.cameras.kannala_brandt import KannalaBrandtCamera
from panobench.cameras.mei import MeiCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.cameras.scaramuzza import ScaramuzzaCamera

#: The same examples on every machine, and no minutes spent on shrinking a failure.
QUICK = settings(
    max_examples=10,
    deadline=None,
    derandomize=True,
    database=None,
    phases=(Phase.explicit, Phase.generate),
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.differing_executors],
)

#: The direct polynomial of PALVIO's upward camera at its native 1280x960.
PALVIO_POLY = (-244.5239, 0.0, 1.748610e-3, -1.757770e-6, 4.475965e-9)
#: Its inverse polynomial, as the calibration file prints it.
PALVIO_INVERSE = [376.845565, 246.746504, 19.035187, 23.840497, 18.991943, 6.066253, 1.560387, 5.854280]
PALVIO_INVERSE += [3.458320, -1.995166, -1.509264, 1.089614, 1.340245, 0.255323]


def between(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False)


size = st.fixed_dictionaries({"width": st.integers(24, 64), "height": st.integers(24, 64)})
centre = st.fixed_dictionaries({"cx": between(6, 24), "cy": between(6, 24)})
radtan = st.one_of(
    st.just(()),
    st.tuples(between(-0.3, 0.1), between(-0.05, 0.05), between(-0.01, 0.01), between(-0.01, 0.01)),
    st.tuples(
        between(-0.3, 0.1), between(-0.05, 0.05), between(-0.01, 0.01), between(-0.01, 0.01), between(-0.02, 0.02)
    ),
    st.tuples(*[between(-0.1, 0.1)] * 2, *[between(-0.01, 0.01)] * 2, *[between(-0.05, 0.05)] * 4),
)


def merged(*parts: st.SearchStrategy[dict[str, float]]) -> st.SearchStrategy[dict[str, float]]:
    return st.tuples(*parts).map(lambda ds: {k: v for d in ds for k, v in d.items()})


def focal(low: float, high: float) -> st.SearchStrategy[dict[str, float]]:
    return st.fixed_dictionaries({"fx": between(low, high), "fy": between(low, high)})


erp = st.builds(
    lambda n, h, a, b: ErpCamera(2 * n, n, h, a, b),
    st.integers(8, 40),
    between(30, 360),
    between(-90, -1),
    between(1, 90),
)
pinhole = st.builds(lambda d, k: PinholeCamera(**d, distortion=k), merged(size, centre, focal(20, 80)), radtan)
fisheye = st.builds(
    lambda d, k, fov: KannalaBrandtCamera(**d, k=k, fov_deg=fov),
    merged(size, centre, focal(8, 40)),
    st.tuples(between(-0.05, 0.1), between(-0.02, 0.02), between(-0.005, 0.005), between(-0.001, 0.001)),
    between(100, 340),
)
ds = st.builds(
    lambda d: DoubleSphereCamera(**d),
    merged(size, centre, focal(8, 60), st.fixed_dictionaries({"xi": between(-0.4, 0.6), "alpha": between(0, 0.9)})),
)
eucm = st.builds(
    lambda d: EucmCamera(**d),
    merged(size, centre, focal(8, 60), st.fixed_dictionaries({"alpha": between(0, 0.9), "beta": between(0.4, 2)})),
)
omni = st.builds(
    lambda d, k: MeiCamera(**d, distortion=k),
    merged(size, centre, focal(20, 80), st.fixed_dictionaries({"xi": between(0, 2)})),
    radtan,
)
cubemap = st.builds(lambda n: CubemapCamera(6 * n, n), st.integers(2, 12))


EXAMPLES: dict[str, Camera] = {
    "erp": ErpCamera(64, 32),
    "pinhole": PinholeCamera(64, 48, 40, 41, 31, 25, (-0.2, 0.03, 1e-3, 1e-3)),
    "pal": ScaramuzzaCamera(1280, 960, PALVIO_POLY, 645.6, 486.5),
    "fisheye": KannalaBrandtCamera(64, 48, 20, 21, 31, 25, (0.02, -0.01, 0.004, -0.0008)),
    "ds": DoubleSphereCamera(64, 48, 20, 21, 31, 25, xi=-0.2, alpha=0.59),
    "eucm": EucmCamera(64, 48, 20, 21, 31, 25, alpha=0.6, beta=1.1),
    "omni": MeiCamera(64, 48, 40, 41, 31, 25, xi=1.1, distortion=(-0.1, 0.01, 1e-3, 1e-3)),
    "cubemap": CubemapCamera(48, 8),
}


@st.composite
def pal(draw: st.DrawFn) -> ScaramuzzaCamera:
    width = draw(st.integers(24, 64))
    height = draw(st.integers(24, 64))
    s = draw(between(0.9, 1.1)) * min(width, height) / 960
    bend = draw(between(0.8, 1.2))
    poly = tuple(p * s ** (1 - i) * (bend if i > 1 else 1.0) for i, p in enumerate(PALVIO_POLY))
    return ScaramuzzaCamera(
        width,
        height,
        poly,
        draw(between(0.4, 0.6)) * width,
        draw(between(0.4, 0.6)) * height,
        c=draw(between(0.9, 1.1)),
        d=draw(between(-0.05, 0.05)),
        e=draw(between(-0.05, 0.05)),
        r_min=draw(between(0, 150)) * s,
        r_max=draw(st.none() | between(300, 560).map(lambda r: r * s)),
    )


STRATEGIES: dict[str, st.SearchStrategy[Camera]] = {
    "erp": erp,
    "pinhole": pinhole,
    "pal": pal(),
    "fisheye": fisheye,
    "ds": ds,
    "eucm": eucm,
    "omni": omni,
    "cubemap": cubemap,
}
