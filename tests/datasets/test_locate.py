from __future__ import annotations

from pathlib import Path

import pytest
from dataset_samples import synpano_scene

from panobench.datasets.locate import describe
from panobench.datasets.open import open_dataset, open_sequence
from panobench.errors import DatasetError, UnknownNameError
from panobench.plugins import registry
from panobench.specs import DatasetSpec


def test_the_data_variable_is_used_without_root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synpano_scene(tmp_path / "synpano/room")
    monkeypatch.setenv("PANOBENCH_DATA", str(tmp_path))
    assert open_sequence("synpano").name == "room"


def test_absent_data_are_described(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PANOBENCH_DATA", raising=False)
    with pytest.raises(DatasetError, match=r"needs --root.*published by.*expected layout: SCENE/images"):
        open_dataset("synpano")
    monkeypatch.setenv("PANOBENCH_DATA", str(tmp_path))
    with pytest.raises(DatasetError, match=r"synpano: dataset 'synpano' is not there.*published by") as caught:
        open_dataset("synpano")
    assert "\n" not in str(caught.value)
    with pytest.raises(DatasetError, match="no such file or folder"):
        open_dataset("video", tmp_path / "none.mp4")


def test_unknown_dataset_suggests() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'synpano'"):
        open_dataset("synpanno")


@pytest.mark.parametrize("name", list(registry().specs(DatasetSpec)))
def test_every_dataset_that_needs_data_says_whose_and_how(name: str) -> None:
    spec = registry().get(DatasetSpec, name)
    if not spec.needs_root:
        pytest.skip("a generator")
    text = describe(spec)
    assert "published by:" in text
    assert "expected layout:" in text
