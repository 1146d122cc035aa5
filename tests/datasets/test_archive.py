"""Archives as folders: unpacked once, and never outside of themselves."""

from __future__ import annotations

import io
import tarfile
import zipfile
from pathlib import Path

import pytest

from panobench.datasets.files import archive
from panobench.datasets.files.archive import is_archive, unpacked
from panobench.errors import DatasetError

FILES = {"room/images/1.png": b"one", "room/images/2.png": b"two", "room/times.txt": b"0\n1\n"}


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PANOBENCH_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "archives"


def zipped(path: Path, files: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as target:
        for name, data in files.items():
            target.writestr(name, data)
    return path


def tarred(path: Path, files: dict[str, bytes], mode: str) -> Path:
    with tarfile.open(path, mode) as target:  # type: ignore[call-overload]
        for name, data in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            target.addfile(info, io.BytesIO(data))
    return path


@pytest.mark.parametrize(("name", "mode"), [("a.zip", ""), ("a.tar", "w:"), ("a.tar.gz", "w:gz"), ("a.TGZ", "w:gz"),
                                            ("a.tar.xz", "w:xz"), ("a.tbz2", "w:bz2")])  # fmt: skip
def test_every_kind_is_unpacked_once(tmp_path: Path, cache: Path, name: str, mode: str) -> None:
    files = {**FILES, "__MACOSX/room/._1.png": b"x", "room/._times.txt": b"y"}
    path = zipped(tmp_path / name, files) if not mode else tarred(tmp_path / name, files, mode)
    assert is_archive(path)
    folder = unpacked(path)
    assert {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()} == {
        k.removeprefix("room/"): v for k, v in FILES.items()
    }
    (folder / "images" / "1.png").write_bytes(b"changed")
    assert (unpacked(path) / "images" / "1.png").read_bytes() == b"changed"  # it was there already
    assert len(list(cache.iterdir())) == 1


def test_without_a_top_folder(tmp_path: Path) -> None:
    folder = unpacked(zipped(tmp_path / "a.zip", {"1.png": b"", "2.png": b""}))
    assert sorted(p.name for p in folder.iterdir()) == ["1.png", "2.png"]


@pytest.mark.parametrize("name", ["../evil.txt", "/etc/evil.txt", "a/../../evil.txt", "..\\evil.txt", "C:/evil.txt"])
def test_a_file_outside_is_refused(tmp_path: Path, cache: Path, name: str) -> None:
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as target:
        target.writestr(zipfile.ZipInfo(name), b"x")
    with pytest.raises(DatasetError, match="a file outside of itself"):
        unpacked(path)
    assert list(cache.iterdir()) == []
    assert not (tmp_path / "evil.txt").exists()


def test_links_and_devices_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "a.tar"
    with tarfile.open(path, "w") as target:
        for name, kind in (("r/link", tarfile.SYMTYPE), ("r/hard", tarfile.LNKTYPE), ("r/pipe", tarfile.FIFOTYPE)):
            info = tarfile.TarInfo(name)
            info.type, info.linkname = kind, "/etc/passwd"
            target.addfile(info)
        info = tarfile.TarInfo("r/1.txt")
        info.size = 1
        target.addfile(info, io.BytesIO(b"x"))
    assert [p.name for p in unpacked(path).iterdir()] == ["1.txt"]


def test_what_unpacks_to_too_much_is_refused(tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bomb = zipped(tmp_path / "bomb.zip", {f"{k}": bytes(8 << 20) for k in range(4)})
    monkeypatch.setattr(archive, "MAX_RATIO", 100)
    with pytest.raises(DatasetError, match="unpacks to more than a recording would"):
        unpacked(bomb)
    monkeypatch.setattr(archive, "MAX_RATIO", 10**6)
    monkeypatch.setattr("shutil.disk_usage", lambda path: type("Usage", (), {"free": 1 << 20})())
    with pytest.raises(DatasetError, match=r"needs over \d+ MiB .* which has 1 MiB; unpack it elsewhere"):
        unpacked(bomb)
    assert list(cache.iterdir()) == []


@pytest.mark.parametrize("cut", [10, 100, 140])
@pytest.mark.parametrize("mode", ["", "w:gz"])
def test_damage_is_one_line(tmp_path: Path, cache: Path, cut: int, mode: str) -> None:
    path = zipped(tmp_path / "a.zip", FILES) if not mode else tarred(tmp_path / "a.tgz", FILES, mode)
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(DatasetError, match=r"cannot be unpacked|cut short") as caught:
        unpacked(path)
    assert "\n" not in str(caught.value)
    assert not cache.is_dir() or list(cache.iterdir()) == []
