"""The 3DGS PLY writer and the reader's distrust of headers."""

from __future__ import annotations

import resource
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from panobench.errors import InputError
from panobench.splat.ply import SH_C0, read_ply, write_ply

NAMES = [*"xyz", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
NAMES += ["rot_0", "rot_1", "rot_2", "rot_3"]
QUICK = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def random_map(n: int, seed: int = 0) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    return (
        rng.normal(size=(n, 3)).astype(np.float32),
        rng.normal(-3, 1, size=(n, 3)).astype(np.float32),
        rng.normal(size=(n, 4)).astype(np.float32),
        rng.normal(size=n).astype(np.float32),
        rng.uniform(size=(n, 3)).astype(np.float32),
    )


def header(count: object = 1, fmt: str = "binary_little_endian", names: list[str] = NAMES, kind: str = "float") -> str:
    lines = ["ply", f"format {fmt} 1.0", f"element vertex {count}"]
    return "\n".join([*lines, *(f"property {kind} {n}" for n in names), "end_header", ""])


def row(dtype: str = "<f4", names: list[str] = NAMES) -> bytes:
    return (np.arange(len(names)) + 1.0).astype(dtype).tobytes()


def write(path: Path, *parts: str | bytes) -> Path:
    path.write_bytes(b"".join(p.encode("latin-1") if isinstance(p, str) else p for p in parts))
    return path


@pytest.mark.parametrize("n", [0, 1, 257])
def test_round_trip(tmp_path: Path, n: int) -> None:
    values = random_map(n)
    write_ply(tmp_path / "map.ply", *values)
    back = read_ply(tmp_path / "map.ply")
    for name, wrote, read in zip(back._fields[:4], values, back):
        np.testing.assert_array_equal(read, wrote, err_msg=name)
        assert read.dtype == np.float32
    np.testing.assert_allclose(back.colours, values[4], atol=2e-7)
    assert [p.name for p in tmp_path.iterdir()] == ["map.ply"]


def test_layout_is_the_one_splat_viewers_read(tmp_path: Path) -> None:
    means, log_scales, quats, logits, colours = random_map(3)
    write_ply(tmp_path / "map.ply", means, log_scales, quats, logits, colours)
    data = (tmp_path / "map.ply").read_bytes()
    text, body = data.split(b"end_header\n")
    assert text.decode().splitlines() == header(3).splitlines()[:-1]
    rows = np.frombuffer(body, "<f4").reshape(3, 17)
    np.testing.assert_array_equal(rows[:, :3], means)
    np.testing.assert_array_equal(rows[:, 3:6], 0)
    np.testing.assert_allclose(rows[:, 6:9], (colours - 0.5) / SH_C0, rtol=1e-6)
    np.testing.assert_array_equal(rows[:, 9], logits)
    np.testing.assert_array_equal(rows[:, 10:13], log_scales)
    np.testing.assert_array_equal(rows[:, 13:], quats)


def test_gaussian_map_writes_it(tmp_path: Path) -> None:
    gaussians = pytest.importorskip("panobench.splat.gaussians")
    g = gaussians.GaussianMap(*random_map(5))
    g.write_ply(tmp_path / "map.ply")
    again = gaussians.GaussianMap(*read_ply(tmp_path / "map.ply"))
    for a, b in zip(g.arrays(), again.arrays()):
        np.testing.assert_allclose(a, b, atol=2e-7)


def test_write_refuses_wrong_shapes(tmp_path: Path) -> None:
    means, log_scales, quats, logits, colours = random_map(4)
    with pytest.raises(ValueError, match="rot_0"):
        write_ply(tmp_path / "map.ply", means, log_scales, quats[:, :3], logits, colours)
    with pytest.raises(ValueError, match="scale_0"):
        write_ply(tmp_path / "map.ply", means, log_scales[:3], quats, logits, colours)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("fmt", "kind", "dtype"),
    [
        ("binary_little_endian", "float", "<f4"),
        ("binary_little_endian", "double", "<f8"),
        ("binary_big_endian", "float32", ">f4"),
        ("binary_big_endian", "short", ">i2"),
        ("ascii", "float", ""),
    ],
)
def test_reads_every_format(tmp_path: Path, fmt: str, kind: str, dtype: str) -> None:
    body = row(dtype) if dtype else " ".join(str(k + 1) for k in range(17)).encode() + b"\r\n"
    g = read_ply(write(tmp_path / "m.ply", header(1, fmt, kind=kind), body))
    np.testing.assert_array_equal(g.means, [[1, 2, 3]])
    np.testing.assert_allclose(g.colours, 0.5 + SH_C0 * np.array([[7, 8, 9]]), rtol=1e-6)
    np.testing.assert_array_equal(g.opacity_logits, [10])
    np.testing.assert_array_equal(g.log_scales, [[11, 12, 13]])
    np.testing.assert_array_equal(g.quats, [[14, 15, 16, 17]])


def test_other_elements_properties_comments_and_line_ends(tmp_path: Path) -> None:
    names = [*NAMES[:9], "f_rest_0", *NAMES[9:]]
    text = header(1, names=names).replace("element vertex", "element camera 2\nproperty uchar id\nelement vertex")
    text = text.replace("ply\n", "ply\ncomment caf\xe9\n", 1).replace("\n", "\r\n")
    g = read_ply(write(tmp_path / "m.ply", text, b"\x00\x01", row(names=names)))
    np.testing.assert_array_equal(g.opacity_logits, [11])
    ascii_text = header(1, "ascii").replace("element vertex", "element x 1\nproperty list uchar int i\nelement vertex")
    g = read_ply(write(tmp_path / "m.ply", ascii_text, "3 1 2 3\n\n", " ".join(["2"] * 17)))
    np.testing.assert_array_equal(g.opacity_logits, [2])


def bad(old: str, new: str, fmt: str = "binary_little_endian") -> bytes:
    text = header(1, fmt)
    assert old in text
    return text.replace(old, new, 1).encode("latin-1") + (row() if fmt != "ascii" else b" ".join([b"1"] * 17) + b"\n")


NAN_ROW = np.array([1.0] * 16 + [np.nan], "<f4").tobytes()
HOSTILE = {
    "empty": (b"", "not a PLY"),
    "another format": (b"\x89PNG\r\n\x1a\n" * 10, "not a PLY"),
    "no end": (b"ply\nformat ascii 1.0\n", "end_header"),
    "endless line": (b"ply\ncomment " + b"a" * 10**6, "end_header"),
    "endless header": (b"ply\n" + b"comment\n" * 5000, "more than"),
    "no format": (bad("format binary_little_endian 1.0\n", ""), "no 'format'"),
    "unknown format": (bad("binary_little_endian", "binary_middle_endian"), "unknown PLY format"),
    "unknown version": (bad("1.0", "2.0"), "unknown PLY format"),
    "two formats": (bad("element", "format ascii 1.0\nelement"), "unexpected PLY header line"),
    "terabytes": (bad("vertex 1", "vertex 1000000000000"), "claims 1000000000000 vertices"),
    "terabytes of ascii": (bad("vertex 1", "vertex 1000000000000", "ascii"), "claims 1000000000000 vertices"),
    "terabytes before": (bad("element", "element a 999999999999999999\nproperty double b\nelement"), "claims 1 vert"),
    "one too many": (bad("vertex 1", "vertex 2"), "claims 2 vertices"),
    "one too many in ascii": (bad("vertex 1", "vertex 2", "ascii"), "claims 2 vertices"),
    "many digits": (bad("vertex 1", "vertex " + "9" * 5000), "end_header"),
    "some digits": (bad("vertex 1", "vertex " + "9" * 400), "bad element"),
    "negative": (bad("vertex 1", "vertex -1"), "bad element"),
    "fractional": (bad("vertex 1", "vertex 1.5"), "bad element"),
    "no count": (bad("vertex 1", "vertex"), "bad element"),
    "unknown type": (bad("float x", "float128 x"), "unknown PLY type 'float128'"),
    "missing property": (bad("property float opacity\n", ""), "lacks opacity"),
    "twice": (bad("float y", "float x"), "appears twice"),
    "list": (bad("float nx", "list uchar int nx"), "list property"),
    "list before": (bad("element", "element a 1\nproperty list uchar int i\nelement"), "has lists"),
    "nothing but vertices": (b"ply\nformat ascii 1.0\nelement vertex 1000000000000\nend_header\n", "lacks x, y"),
    "no vertices": (b"ply\nformat ascii 1.0\nend_header\n", "0 'vertex' elements"),
    "two vertex elements": (bad("end_header", "element vertex 1\nend_header"), "2 'vertex' elements"),
    "property first": (bad("element vertex 1\n", ""), "unexpected PLY header line"),
    "not a number": (header(1, "ascii").encode() + b" ".join([b"1"] * 16 + [b"one"]), "not a number"),
    "short row": (header(1, "ascii").encode() + b"  ".join([b"1"] * 16) + b"\n" * 9, "has 16 values"),
    "nan": (header().encode() + NAN_ROW, "rot_0... is not finite"),
    "overflow": (header(1, "ascii").encode() + b" ".join([b"1e99"] * 17), "not finite in float32"),
    "zero quaternion": (header().encode() + b"\0" * 68, "quaternion"),
    "binary header": (bad("element", "element \xff"), "not ascii"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files(tmp_path: Path, name: str) -> None:
    data, message = HOSTILE[name]
    path = write(tmp_path / "m.ply", data)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match=message) as caught:
        read_ply(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # KiB


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nothing\.ply"):
        read_ply(tmp_path / "nothing.ply")
    with pytest.raises(InputError, match="cannot be read"):
        read_ply(tmp_path)


def test_every_truncation_is_refused(tmp_path: Path) -> None:
    write_ply(tmp_path / "m.ply", *random_map(2))
    data = (tmp_path / "m.ply").read_bytes()
    for n in range(len(data)):
        with pytest.raises(InputError):
            read_ply(write(tmp_path / "short.ply", data[:n]))


@QUICK
@given(
    st.lists(
        st.one_of(
            st.sampled_from(["comment x", "end_header", "format ascii 1.0", "format binary_big_endian 1.0", "element"]),
            st.builds("element {} {}".format, st.sampled_from(["vertex", "face"]), st.integers(-2, 10**20)),
            st.builds(
                "property {} {}".format, st.sampled_from(["float", "list uchar int", "x"]), st.sampled_from(NAMES)
            ),
            st.just(header(2)[4:].rstrip("\n")),
            st.text(max_size=20),
        ),
        max_size=12,
    ),
    st.binary(max_size=200),
)
def test_any_header_reads_or_raises_input_error(tmp_path: Path, lines: list[str], body: bytes) -> None:
    text = "\n".join(["ply", *lines, "end_header", ""])
    path = write(tmp_path / "fuzz.ply", text.encode("utf-8"), body)
    try:
        g = read_ply(path)
    except InputError:
        return
    assert all(np.isfinite(a).all() and len(a) == len(g.means) for a in g)


@QUICK
@given(st.integers(0, 600), st.binary(min_size=1, max_size=4))
def test_flipped_bytes_read_or_raise_input_error(tmp_path: Path, at: int, junk: bytes) -> None:
    write_ply(tmp_path / "m.ply", *random_map(2))
    data = bytearray((tmp_path / "m.ply").read_bytes())
    at = min(at, len(data) - len(junk))
    data[at : at + len(junk)] = junk
    try:
        g = read_ply(write(tmp_path / "flip.ply", bytes(data)))
    except InputError:
        return
    assert all(np.isfinite(a).all() and len(a) == len(g.means) for a in g)
