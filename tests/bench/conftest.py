"""What several tests of exports look at."""

from __future__ import annotations

import pytest
from panoramas_of_a_box import posed_views, with_bulges

from panobench.bench.export.posed_panoramas import PosedPanoramas


@pytest.fixture(scope="session")
def truth() -> PosedPanoramas:
    """A box with a ball in it, with exact depth."""
    return posed_views()


@pytest.fixture(scope="session")
def bulging(truth: PosedPanoramas) -> PosedPanoramas:
    """The same with wrong depth."""
    return with_bulges(truth)
