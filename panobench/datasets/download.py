"""Fetching files of published datasets: continued where it stopped, checked against the publisher's checksum.

A file is written beside its place as ``NAME.part``, with ``NAME.part.json`` saying what it is a part of. It gets its
name when it is complete and its checksum is right.
"""

from __future__ import annotations

import contextlib
import hashlib
import http.client
import json
import re
import shutil
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from panobench.datasets.files.archive import unpack_into
from panobench.errors import InputError, OutputError
from panobench.writing import writing

_BLOCK = 1 << 20
_TIMEOUT_S = 30.0
#: Connections that break are made again, so many times without a byte in between.
_TRIES = 5
#: Checksum files are a line or a few.
_MAX_CHECKSUM_BYTES = 1 << 20

Progress = Callable[[int, "int | None"], None]


@dataclass(frozen=True)
class RemoteFile:
    """url of a file; its checksum is in the file at ``checksum_url`` (md5sum's or sha256sum's), beside others or alone.

    name: what it is called on disk. unpack: an archive, whose content is what is wanted.
    """

    url: str
    name: str
    checksum_url: str
    unpack: bool = True


@dataclass(frozen=True)
class Published:
    """What a publisher offers at an address that stays. base: where all addresses begin, for mirrors.

    sequences: name -> its files, as paths below ``base``.
    """

    base: str
    sequences: Mapping[str, tuple[str, ...]]
    checksum_suffix: str = ".md5"

    def files(self, sequence: str, base: str | None = None) -> list[RemoteFile]:
        """The files of a sequence, from a mirror at ``base`` or from the publisher."""
        root = (base or self.base).rstrip("/")
        paths = self.sequences[sequence]
        return [RemoteFile(f"{root}/{p}", p.rpartition("/")[2], f"{root}/{p}{self.checksum_suffix}") for p in paths]


def obtain(
    file: RemoteFile, folder: Path, *, keep: bool = False, progress: Progress = lambda done, total: None
) -> bool:
    """What is in ``file``, below ``folder``; False if it was there already. keep: the archive stays beside it.

    Raises as ``fetch`` does, and DatasetError for an archive that cannot be unpacked.
    """
    note = folder / f".{file.name}.unpacked.json"
    if _unpacked_before(note, folder):
        return False
    there = (folder / file.name).is_file()
    path = fetch(file, folder, progress)
    if not file.unpack:
        return not there
    names = unpack_into(path, folder)
    with writing(note):
        note.write_text(json.dumps(names), encoding="utf-8")
        if not keep:
            path.unlink()
    return True


def _unpacked_before(note: Path, folder: Path) -> bool:
    """Whether what was in the archive is still there, by its top names."""
    with contextlib.suppress(OSError, ValueError, TypeError):
        names = json.loads(note.read_text(encoding="utf-8"))
        return bool(names) and all((folder / str(name)).exists() for name in names)
    return False


def fetch(file: RemoteFile, folder: Path, progress: Progress = lambda done, total: None) -> Path:
    """Download ``file`` into ``folder``, going on with what an earlier attempt left. Nothing is done if it is there.

    ``progress`` gets the bytes so far and those in all, if known. Raises InputError when the address does not answer or
    the checksum is wrong, OutputError when it does not fit.
    """
    target = folder / file.name
    if target.is_file():
        return target
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    expected = checksum(file)
    part = folder / f"{file.name}.part"
    _receive(file.url, part, progress)
    found = _digest(part, expected)
    if found != expected:
        _forget(part)
        raise InputError(
            f"its checksum is {found}, the publisher's is {expected}: it was damaged on its way; run the command again",
            file.url,
        )
    with writing(target):
        part.replace(target)
        part.with_name(f"{part.name}.json").unlink(missing_ok=True)
    return target


def checksum(file: RemoteFile) -> str:
    """The publisher's checksum of the file, in hexadecimal digits: 32 of MD5 or 64 of SHA-256. Raises InputError."""
    with _open(file.checksum_url, {}) as answer:
        text = answer.read(_MAX_CHECKSUM_BYTES).decode("utf-8", "replace")
    lines = [line.split() for line in text.splitlines() if line.strip()]
    named = [words for words in lines if len(words) > 1 and words[-1].lstrip("*").rpartition("/")[2] == file.name]
    words = (named or lines or [[""]])[0]
    digits = next((w.lower() for w in words if re.fullmatch(r"[0-9a-fA-F]{32}|[0-9a-fA-F]{64}", w)), None)
    if digits is None:
        raise InputError("no checksum is there", file.checksum_url)
    return digits


def _digest(path: Path, expected: str) -> str:
    digest = hashlib.sha256() if len(expected) == 64 else hashlib.md5(usedforsecurity=False)
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


def _forget(part: Path) -> None:
    part.unlink(missing_ok=True)
    part.with_name(f"{part.name}.json").unlink(missing_ok=True)


def _receive(url: str, part: Path, progress: Progress) -> None:
    """All of ``url`` in ``part``, continued with a range where the server has the same file still."""
    failures = 0
    while True:
        have = part.stat().st_size if part.is_file() else 0
        tag = _tag(part, url) if have else None
        if have and tag is None:  # of another file, or of a server that cannot say
            _forget(part)
            have = 0
        headers = {"Range": f"bytes={have}-", "If-Range": tag} if have and tag else {}
        try:
            with _open(url, headers) as answer:
                if have and answer.status != 206:
                    have = 0
                total = _total(answer, have)
                _check_room(part, total, have, url)
                _note(part, url, answer.headers.get("ETag") or answer.headers.get("Last-Modified"))
                if _copy(answer, part, have, total, progress):
                    failures = 0
                if total is None or part.stat().st_size >= total:
                    return
        except (http.client.HTTPException, ConnectionError, TimeoutError) as error:
            if part.is_file() and part.stat().st_size > have:
                failures = 0
            if failures + 1 >= _TRIES:
                raise InputError(
                    f"the connection broke ({_reason(error)}); run the command again to go on", url
                ) from None
        except _Complete:
            return
        failures += 1
        if failures >= _TRIES:
            raise InputError("the connection broke again and again; run the command again to go on", url)
        time.sleep(min(2.0**failures, 30.0) * _PAUSE_S)


#: Seconds that the pauses between attempts are multiples of.
_PAUSE_S = 0.5


class _Complete(Exception):
    """The server has no more of the file than is there."""


def _open(url: str, headers: Mapping[str, str]) -> Any:
    """The answer to a request. Raises InputError that says what the server said."""
    if urllib.parse.urlsplit(url).scheme not in ("http", "https"):
        raise InputError("only http and https are read", url)
    request = urllib.request.Request(url, headers={"User-Agent": "panobench", **headers})
    try:
        return urllib.request.urlopen(request, timeout=_TIMEOUT_S)
    except urllib.error.HTTPError as error:
        error.close()
        if error.code == 416 and "Range" in headers:
            raise _Complete from None
        raise InputError(f"the server answers {error.code} {error.reason}", url) from None
    except urllib.error.URLError as error:
        if isinstance(error.reason, (ConnectionResetError, TimeoutError)):
            raise error.reason from None
        raise InputError(f"it cannot be reached ({_reason(error.reason)})", url) from None


def _reason(error: object) -> str:
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return " ".join(str(text).split())


def _total(answer: Any, have: int) -> int | None:
    length = answer.headers.get("Content-Length")
    return have + int(length) if length is not None and length.isdecimal() else None


def _check_room(part: Path, total: int | None, have: int, url: str) -> None:
    free = shutil.disk_usage(part.parent).free
    if total is not None and total - have > free:
        raise OutputError(
            f"{part.parent}: {url} needs {(total - have) / 1e9:.1f} GB more, {free / 1e9:.1f} GB are free; "
            "choose another folder with --to"
        )


def _copy(answer: Any, part: Path, have: int, total: int | None, progress: Progress) -> bool:
    """Append the answer's body from byte ``have`` on; whether any came."""
    done = have
    with writing(part):
        out = part.open("r+b" if have else "wb")
    with out:
        out.seek(have)
        out.truncate()
        progress(done, total)
        while block := answer.read(_BLOCK):
            with writing(part):
                out.write(block)
            done += len(block)
            progress(done, total)
    return done > have


def _note(part: Path, url: str, tag: str | None) -> None:
    with writing(part):
        part.with_name(f"{part.name}.json").write_text(json.dumps({"url": url, "tag": tag}), encoding="utf-8")


def _tag(part: Path, url: str) -> str | None:
    """What identified the file that ``part`` is the beginning of; None if that is not known."""
    with contextlib.suppress(OSError, ValueError):
        noted = json.loads(part.with_name(f"{part.name}.json").read_text(encoding="utf-8"))
        if isinstance(noted, dict) and noted.get("url") == url and isinstance(noted.get("tag"), str):
            return str(noted["tag"])
    return None
