"""Downloads, from a server on this machine: continued, checked, and one line when they fail."""

from __future__ import annotations

import hashlib
import io
import tarfile
import threading
from collections.abc import Iterator
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from panobench.cli.main import main
from panobench.datasets import download
from panobench.datasets.download import Published, RemoteFile, checksum, fetch, obtain
from panobench.datasets.published import TUM_VI
from panobench.errors import DatasetError, InputError, OutputError
from panobench.plugins import registry
from panobench.specs import DatasetSpec

CONTENT = bytes(range(256)) * 4000


class Publisher:
    """Files at addresses, and how the server behaves."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self.ranges = True
        self.says_length = True
        self.tag: str | None = '"first"'
        self.break_after: list[int] = []  # bytes of the answers to come, after which the connection ends
        self.asked: list[tuple[str, str | None]] = []

    def offer(self, path: str, data: bytes, kind: str = "md5") -> None:
        self.files[path] = data
        self.files[f"{path}.{kind}"] = f"{hashlib.new(kind, data).hexdigest()}  {path.rpartition('/')[2]}\n".encode()


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def __init__(self, publisher: Publisher, *args: object) -> None:
        self.publisher = publisher
        super().__init__(*args)  # type: ignore[arg-type]

    def do_GET(self) -> None:
        publisher = self.publisher
        wanted = self.headers.get("Range")
        publisher.asked.append((self.path, wanted))
        data = publisher.files.get(self.path)
        if data is None:
            self.send_error(404, "Not Found")
            return
        start = 0
        if wanted and publisher.ranges and self.headers.get("If-Range") == publisher.tag:
            start = int(wanted.removeprefix("bytes=").removesuffix("-"))
            if start >= len(data):
                self.send_error(416)
                return
        self.send_response(206 if start else 200)
        if publisher.tag:
            self.send_header("ETag", publisher.tag)
        if publisher.says_length:
            self.send_header("Content-Length", str(len(data) - start))
        else:
            self.send_header("Connection", "close")
        self.end_headers()
        body = data[start:]
        if publisher.break_after and not self.path.endswith(("md5", "sha256")):
            body = body[: publisher.break_after.pop(0)]
            self.close_connection = True
        self.wfile.write(body)
        if not publisher.says_length:
            self.close_connection = True

    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Publisher, str]]:
    monkeypatch.setattr(download, "_PAUSE_S", 0.0)
    for variable in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(variable, raising=False)
    publisher = Publisher()
    publisher.offer("/data.bin", CONTENT)
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, publisher)) as running:
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        yield publisher, f"http://127.0.0.1:{running.server_address[1]}"
        running.shutdown()
        thread.join()


def file_at(base: str, name: str = "data.bin", kind: str = "md5", unpack: bool = False) -> RemoteFile:
    return RemoteFile(f"{base}/{name}", name, f"{base}/{name}.{kind}", unpack)


def test_a_file_arrives_whole_and_once(server: tuple[Publisher, str], tmp_path: Path) -> None:
    publisher, base = server
    steps: list[tuple[int, int | None]] = []
    path = fetch(file_at(base), tmp_path / "new", lambda done, total: steps.append((done, total)))
    assert path.read_bytes() == CONTENT
    assert steps[-1] == (len(CONTENT), len(CONTENT))
    assert [p.name for p in path.parent.iterdir()] == ["data.bin"]
    asked = len(publisher.asked)
    assert fetch(file_at(base), tmp_path / "new") == path
    assert len(publisher.asked) == asked


def test_sha256_is_known_by_its_length(server: tuple[Publisher, str], tmp_path: Path) -> None:
    publisher, base = server
    publisher.offer("/a.bin", b"abc", "sha256")
    assert fetch(file_at(base, "a.bin", "sha256"), tmp_path).read_bytes() == b"abc"


@pytest.mark.parametrize("says_length", [True, False])
def test_a_broken_connection_is_taken_up_by_itself(
    server: tuple[Publisher, str], tmp_path: Path, says_length: bool
) -> None:
    publisher, base = server
    publisher.break_after = [300_000, 200_000]
    publisher.says_length = says_length
    if not says_length:  # nothing tells a cut answer from a whole one but the checksum
        with pytest.raises(InputError, match="damaged"):
            fetch(file_at(base), tmp_path)
        return
    assert fetch(file_at(base), tmp_path).read_bytes() == CONTENT
    assert [r for path, r in publisher.asked if path == "/data.bin"] == [None, "bytes=300000-", "bytes=500000-"]


def test_the_next_command_goes_on(server: tuple[Publisher, str], tmp_path: Path) -> None:
    publisher, base = server
    publisher.break_after = [400_000] + [0] * 10
    with pytest.raises(InputError, match=r"connection broke.* run the command again to go on") as caught:
        fetch(file_at(base), tmp_path)
    assert "\n" not in str(caught.value)
    assert (tmp_path / "data.bin.part").stat().st_size == 400_000
    publisher.break_after, publisher.asked = [], []
    assert fetch(file_at(base), tmp_path).read_bytes() == CONTENT
    assert publisher.asked[-1] == ("/data.bin", "bytes=400000-")


@pytest.mark.parametrize("change", ["tag", "ranges", "no tag", "other address"])
def test_what_cannot_be_continued_begins_again(server: tuple[Publisher, str], tmp_path: Path, change: str) -> None:
    publisher, base = server
    if change == "no tag":
        publisher.tag = None
    publisher.break_after = [400_000] + [0] * 10
    with pytest.raises(InputError):
        fetch(file_at(base), tmp_path)
    publisher.break_after = []
    if change == "tag":
        publisher.tag = '"second"'
        publisher.offer("/data.bin", CONTENT[::-1])
    if change == "ranges":
        publisher.ranges = False
    if change == "other address":
        publisher.offer("/there/data.bin", CONTENT[::-1])
        base = f"{base}/there"
    assert (
        fetch(file_at(base), tmp_path).read_bytes()
        == publisher.files["/there/data.bin" if change == "other address" else "/data.bin"]
    )


def test_a_part_that_is_whole_already(server: tuple[Publisher, str], tmp_path: Path) -> None:
    publisher, base = server
    publisher.break_after = [400_000] + [0] * 10
    with pytest.raises(InputError):
        fetch(file_at(base), tmp_path)
    (tmp_path / "data.bin.part").write_bytes(CONTENT)
    publisher.break_after = []
    assert fetch(file_at(base), tmp_path).read_bytes() == CONTENT


def test_a_wrong_checksum_is_not_kept(server: tuple[Publisher, str], tmp_path: Path) -> None:
    publisher, base = server
    publisher.files["/data.bin"] = CONTENT[:-1] + b"x"
    with pytest.raises(InputError, match=r"its checksum is \w{32}, the publisher's is \w{32}.* run the command again"):
        fetch(file_at(base), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_one_line_of_a_list_of_checksums(server: tuple[Publisher, str]) -> None:
    publisher, base = server
    publisher.files["/data.bin.md5"] = f"{'1' * 32}  other.bin\n{'A' * 32} *exported/data.bin\n".encode()
    assert checksum(file_at(base)) == "a" * 32
    for text in (b"", b"\n\n", b"<html>not here</html>", b"\xff\xfe", b"123  data.bin"):
        publisher.files["/data.bin.md5"] = text
        with pytest.raises(InputError, match="no checksum is there"):
            checksum(file_at(base))


def test_the_server_says_no(server: tuple[Publisher, str], tmp_path: Path) -> None:
    publisher, base = server
    del publisher.files["/data.bin"]
    with pytest.raises(InputError, match="the server answers 404 Not Found"):
        fetch(file_at(base), tmp_path)
    with pytest.raises(InputError, match="only http and https"):
        fetch(RemoteFile("file:///etc/passwd", "p", "file:///etc/passwd", False), tmp_path)
    with pytest.raises(InputError, match="cannot be reached") as caught:
        fetch(file_at("http://127.0.0.1:1"), tmp_path)
    assert "\n" not in str(caught.value)


def test_too_small_a_disk_is_said_before(
    server: tuple[Publisher, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    base = server[1]
    monkeypatch.setattr("shutil.disk_usage", lambda path: type("Usage", (), {"free": 1000})())
    with pytest.raises(OutputError, match=r"needs 0\.0 GB more, 0\.0 GB are free; choose another folder with --to"):
        fetch(file_at(base), tmp_path)


def archive_of(files: dict[str, bytes]) -> bytes:
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w") as target:
        for name, data in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            target.addfile(info, io.BytesIO(data))
    return out.getvalue()


@pytest.mark.parametrize("keep", [False, True])
def test_an_archive_is_unpacked(server: tuple[Publisher, str], tmp_path: Path, keep: bool) -> None:
    publisher, base = server
    publisher.offer("/a.tar", archive_of({"room/mav0/1.txt": b"1", "room/2.txt": b"2"}))
    file = file_at(base, "a.tar", unpack=True)
    (tmp_path / "room").mkdir()
    (tmp_path / "room" / "mine.txt").write_text("mine")
    assert obtain(file, tmp_path, keep=keep)
    inside = {p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*") if p.is_file()}
    assert inside == {"room/mav0/1.txt", "room/2.txt", "room/mine.txt", ".a.tar.unpacked.json"} | (
        {"a.tar"} if keep else set()
    )
    publisher.asked = []
    assert not obtain(file, tmp_path, keep=keep)
    assert publisher.asked == []
    (tmp_path / "room").rename(tmp_path / "elsewhere")
    assert obtain(file, tmp_path, keep=keep)
    assert (tmp_path / "room" / "2.txt").read_bytes() == b"2"


def test_an_archive_that_reaches_outside(server: tuple[Publisher, str], tmp_path: Path) -> None:
    publisher, base = server
    publisher.offer("/a.tar", archive_of({"../evil": b"1"}))
    with pytest.raises(DatasetError, match="outside of itself"):
        obtain(file_at(base, "a.tar", unpack=True), tmp_path / "to")
    assert not (tmp_path / "evil").exists()


def run(*words: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(list(words))
    return int(ended.value.code or 0)


def test_the_command_fetches_what_the_adapter_reads(
    server: tuple[Publisher, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    publisher, base = server
    publisher.offer("/dataset-room1_512_16.tar", archive_of({"dataset-room1_512_16/mav0/cam0/data.csv": b"#t,f\n"}))
    monkeypatch.setenv("PANOBENCH_DATA", str(tmp_path))
    assert run("download", "tum-vi", "--sequence", "room1", "--mirror", base) == 0
    folder = tmp_path / "tum-vi"
    assert capsys.readouterr().out.splitlines() == [
        f"room1: fetched in {folder}",
        "try: panobench run --dataset tum-vi",
    ]
    assert (folder / "dataset-room1_512_16" / "mav0" / "cam0" / "data.csv").is_file()
    assert run("download", "tum-vi", "--sequence", "room1", "--mirror", base) == 0
    assert "room1: already in" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["tum-vi"], "name what to fetch: --sequence corridor1, corridor2"),
        (["tum-vi", "--sequence", "rom1"], "did you mean 'room1'"),
        (["tumvi"], "did you mean 'tum-vi'"),
        (["palvio"], "has no stable public address to fetch from; to get it: follow the links in the README of"),
        (["rooms"], "needs no download: try panobench run --dataset rooms"),
        (["video"], "is for data of your own: panobench run --dataset video --root PATH"),
    ],
)
def test_the_command_says_where_else(words: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("download", *words) == 2
    error = capsys.readouterr().err
    assert says in error
    assert len(error.strip().splitlines()) == 1


def test_every_published_dataset_says_how_to_get_it() -> None:
    for name, spec in registry().specs(DatasetSpec).items():
        if spec.needs_root and spec.publisher != "you":
            assert spec.obtain, name


def test_sequences_of_tum_vi() -> None:
    assert len(TUM_VI.sequences) == 28
    (file,) = TUM_VI.files("room1")
    assert file.url.endswith("/tumvi/exported/euroc/512_16/dataset-room1_512_16.tar")
    assert file.checksum_url == f"{file.url}.md5"
    mirror = Published("https://a.example/x/", {"s": ("d/f.zip",)}, ".sha256").files("s", "http://b.example/y/")
    assert mirror == [RemoteFile("http://b.example/y/d/f.zip", "f.zip", "http://b.example/y/d/f.zip.sha256")]
