"""Broken recordings have the outcomes that docs/robustness.md promises, on both built-in methods."""

from __future__ import annotations

import numpy as np
import pytest
from faults import BY_NAME, FAULTS, Fault, inflict, material

from panobench.bench.run.views import FrameReader
from panobench.errors import DatasetError
from panobench.testing.sequences import GivenImages, erp_camera

#: panogs starts from a constant depth here: its first twelve frames need not be solved for.
OPTIONS = {"width": 64, "frames": 16, "depth": "constant"}


@pytest.mark.parametrize("fault", [f for f in FAULTS if f.says], ids=lambda f: f.name)
def test_input_that_cannot_be_used_is_refused_with_its_row(fault: Fault) -> None:
    found = inflict(fault, "sparse", 64, 16)
    assert found.status == "refused"
    assert fault.says in found.message
    assert any(f in found.message for f in ("frames.csv:", "groundtruth.tum:", "frame 4"))


@pytest.mark.parametrize("fault", [f for f in FAULTS if not f.says and f.name != "clean"], ids=lambda f: f.name)
def test_panogs_on_broken_recordings(fault: Fault) -> None:
    found = inflict(fault, "panogs", **OPTIONS)  # type: ignore[arg-type]
    assert found.status in fault.panogs, found


@pytest.mark.parametrize("name", ["black", "black-frame", "camera-swap", "still", "one-frame", "16-bit", "exif"])
def test_sparse_on_broken_recordings(name: str) -> None:
    found = inflict(BY_NAME[name], "sparse", 128, 21)
    assert found.status in BY_NAME[name].sparse, found


def test_a_blank_frame_gets_no_pose_and_harms_none() -> None:
    clean = inflict(BY_NAME["clean"], "panogs", **OPTIONS)  # type: ignore[arg-type]
    black = inflict(BY_NAME["black-frame"], "panogs", **OPTIONS)  # type: ignore[arg-type]
    assert clean.tracked == 1.0
    assert black.tracked == pytest.approx(15 / 16)
    assert black.ate_m is not None
    assert clean.ate_m is not None
    assert black.ate_m < 2 * clean.ate_m + 5e-3


def test_pixels_that_are_not_numbers_never_reach_a_method() -> None:
    images = [i.astype(np.float32) for i in material(64, 3).images]
    images[1][4, 5] = np.nan
    sequence = GivenImages(erp_camera(64), images)  # type: ignore[arg-type]
    with pytest.raises(DatasetError, match=r"expected .* uint8"):
        FrameReader(sequence)(1)


def test_depth_that_is_not_a_number_is_unknown(tmp_path: object) -> None:
    """Depth of a dataset may have NaN, infinite, zero and negative values; all are "unknown"."""
    from pathlib import Path

    from panobench.datasets.files.images import read_depth

    path = Path(str(tmp_path)) / "d.npy"
    np.save(path, np.array([[1.0, np.nan, np.inf, -np.inf], [0.0, -2.0, 1e-3, 7.0]]))
    assert np.isfinite(read_depth(path)).tolist() == [[True, False, False, False], [False, False, True, True]]
