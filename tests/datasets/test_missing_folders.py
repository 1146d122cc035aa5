from __future__ import annotations

from pathlib import Path

import pytest

from panobench.errors import DatasetError
from panobench.plugins import registry
from panobench.specs import DatasetSpec

NEED_DATA = [n for n, s in registry().specs(DatasetSpec).items() if s.needs_root]


@pytest.mark.parametrize("name", NEED_DATA)
def test_a_folder_that_vanished_is_a_clear_error(tmp_path: Path, name: str) -> None:
    dataset = registry().get(DatasetSpec, name).load()(tmp_path / "gone")
    with pytest.raises(DatasetError) as caught:
        dataset.sequences()
    assert "gone" in str(caught.value)


@pytest.mark.parametrize("name", NEED_DATA)
def test_without_a_root_it_asks_for_one(name: str) -> None:
    with pytest.raises(DatasetError, match="--root"):
        registry().get(DatasetSpec, name).load()(None).sequences()
