"""The parsers under test. A target parses bytes; only a PanobenchError may come out of it."""

from __future__ import annotations

import contextlib
import functools
import json
import re
import struct
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from mutate import Material

from panobench.errors import InputError, PanobenchError

Parse = Callable[[Path], object]


@dataclass(frozen=True)
class Target:
    """file: name that the input gets. material: made when first wanted. parse: reads the file; set up per folder."""

    name: str
    file: str
    material: Callable[[], Material]
    parse: Callable[[Path], Parse]

    def runner(self, folder: Path) -> Callable[[bytes], str]:
        """Parse inputs in ``folder``: returns "" if one is read, else the refusal; raises what a crash raises."""
        path = folder / self.file
        path.parent.mkdir(parents=True, exist_ok=True)
        parse = self.parse(folder)

        def run(data: bytes) -> str:
            path.write_bytes(data)
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")
                try:
                    parse(path)
                except PanobenchError as error:
                    return str(error) or "refused without a word"
            return ""

        return run


def _plain(parse: Parse) -> Callable[[Path], Parse]:
    return lambda folder: parse


def _text(*documents: str, words: str = "") -> Callable[[], Material]:
    return lambda: Material(tuple(d.encode() for d in documents), tuple(w.encode() for w in words.split()))


# -- calibrations --------------------------------------------------------------------------------------------------


def _calibration(format: str) -> Callable[[Path], Parse]:
    def setup(folder: Path) -> Parse:
        from panobench.cameras.calibration import inspect_calibration

        if format == "panobench":
            cv2.imwrite(str(folder / "mask.png"), np.full((48, 64), 255, np.uint8))

        def parse(path: Path) -> None:
            for form in (format, None):
                with contextlib.suppress(PanobenchError) if form is None else contextlib.nullcontext():
                    camera = inspect_calibration(path, form).camera
                    camera.project(np.array([[0.1, 0.2, 1.0], [1.0, 0.0, -1.0]]))

        return parse

    return setup


def _written(format: str, words: str, extra: tuple[str, ...] = ()) -> Callable[[], Material]:
    """Every camera the format holds, small, as the package writes it."""

    def make() -> Material:
        from panobench.cameras.calibration import write_calibration
        from panobench.cameras.double_sphere import DoubleSphereCamera
        from panobench.cameras.erp import ErpCamera
        from panobench.cameras.eucm import EucmCamera
        from panobench.cameras.kannala_brandt import KannalaBrandtCamera
        from panobench.cameras.mei import MeiCamera
        from panobench.cameras.pinhole import PinholeCamera
        from panobench.cameras.scaramuzza import ScaramuzzaCamera

        k = (-0.2, 0.03, 1e-3, 1e-3)
        poly = tuple(p * (48 / 960) ** (1 - i) for i, p in enumerate((-244.5, 0.0, 1.75e-3, -1.76e-6, 4.48e-9)))
        cameras = [
            ErpCamera(64, 32),
            PinholeCamera(64, 48, 40, 41, 31, 25, k),
            KannalaBrandtCamera(64, 48, 20, 21, 31, 25, (0.02, -0.01, 0.004, -0.0008)),
            DoubleSphereCamera(64, 48, 20, 21, 31, 25, xi=-0.2, alpha=0.59),
            EucmCamera(64, 48, 20, 21, 31, 25, alpha=0.6, beta=1.1),
            MeiCamera(64, 48, 40, 41, 31, 25, xi=1.1, distortion=k),
            ScaramuzzaCamera(64, 48, poly, 32.5, 24.1, r_min=4.0, r_max=23.0),
        ]
        documents = [e.encode() for e in extra]
        with tempfile.TemporaryDirectory() as folder:
            for camera in cameras:
                path = Path(folder) / "camera.yaml"
                with contextlib.suppress(PanobenchError):
                    write_calibration(camera, path, format)
                    documents.append(path.read_bytes())
        return Material(tuple(documents), tuple(w.encode() for w in words.split()))

    return make


_PANOBENCH = """model: pinhole
width: 64
height: 48
fx: 40.0
fy: 41.0
cx: 31.0
cy: 25.0
mask: mask.png
annulus: {centre: [32.0, 24.0], r_min: 3, r_max: 22.5}
source: me
time_offset_s: -0.008
body_T_cam: [[1, 0, 0, 0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
"""
_KALIBR = """cam0:
  T_cam_imu:
  - [1.0, 0.0, 0.0, 0.01]
  - [0.0, 1.0, 0.0, 0.02]
  - [0.0, 0.0, 1.0, -0.01]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [0.003, 0.0007, -0.002, 0.0002]
  distortion_model: equidistant
  intrinsics: [19.0, 19.1, 25.4, 25.6]
  resolution: [51, 52]
  rostopic: /cam0/image_raw
  timeshift_cam_imu: -0.002
cam1:
  camera_model: omni
  distortion_coeffs: [0.003, 0.0007, -0.002, 0.0002]
  distortion_model: radtan
  intrinsics: [0.8, 19.0, 19.1, 25.4, 25.6]
  resolution: [51, 52]
"""
_LFVIO = """%YAML:1.0
---
model_type: scaramuzza
image_width: 64
image_height: 48
poly_parameters:
   p0: -12.2
   p1: 0.0
   p2: 0.035
   p3: -0.0007
   p4: 0.000036
affine_parameters: {ac: 1.0, ad: 0.001, ae: -0.002, cx: 32.0, cy: 24.1}
center_x: 32.1
center_y: 24.0
min_r: 4
max_r: 22
td: -0.008
extrinsicRotation: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [0, 0, 1, -1, 0, 0, 0, -1, 0]
extrinsicTranslation: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [0.09, 0.0, -0.05]
"""
_OPENCV = """%YAML:1.0
---
image_width: 64
image_height: 48
fisheye_model: 0
xi: !!opencv-matrix {rows: 1, cols: 1, dt: d, data: [1.1]}
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 40., 0., 31.5, 0., 41., 23.5, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 4
   cols: 1
   dt: d
   data: [ -2.0000000000000001e-01, 0.05, 0.001, -0.0005 ]
"""
_ROS = """image_width: 64
image_height: 48
camera_matrix: {rows: 3, cols: 3, data: [40.0, 0.0, 31.5, 0.0, 41.0, 23.5, 0.0, 0.0, 1.0]}
distortion_model: equidistant
distortion_coefficients: {rows: 1, cols: 4, data: [0.01, 0.002, -0.001, 0.0001]}
binning_x: 0
roi: {x_offset: 0, y_offset: 0, height: 0, width: 0}
"""
_EUROC_SENSOR = """sensor_type: camera
T_BS: {rows: 4, cols: 4, data: [0, -1, 0, 0.1, 1, 0, 0, 0.2, 0, 0, 1, 0, 0, 0, 0, 1]}
resolution: [64, 48]
camera_model: pinhole
intrinsics: [40, 41, 31.5, 23.5]
distortion_model: radial-tangential
distortion_coefficients: [-0.2, 0.05, 0.001, -0.0005]
"""
_STEREO = "M1: [[40,0,31],[0,41,23],[0,0,1]]\nM2: [[40,0,31],[0,41,23],[0,0,1]]\nD1: [0,0,0,0,0]\nsize: [64, 48]\n"
_OPENCV_XML = """<?xml version="1.0"?>
<opencv_storage>
<image_Width>64</image_Width><image_Height>48</image_Height>
<Camera_Matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
<data>40. 0. 31.5 0. 41. 23.5 0. 0. 1.</data></Camera_Matrix>
<Distortion_Coefficients type_id="opencv-matrix"><rows>5</rows><cols>1</cols><dt>d</dt>
<data>-0.2 0.05 0.001 -0.0005 0.01</data></Distortion_Coefficients>
<size><_>64</_><_>48</_></size>
</opencv_storage>
"""
_ORBSLAM = """%YAML:1.0
Camera.type: "KannalaBrandt8"
Camera.width: 64
Camera.height: 48
""" + "".join(f"Camera{n}.{k}: {v}\n" for n in (1, 2) for k, v in zip(
    ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"), (20, 21.0, 31.5, 23.5, 0.01, 0.002, -0.001, 0.0001))) + """
IMU.T_b_c1: !!opencv-matrix {rows: 4, cols: 4, dt: f, data: [0, -1, 0, 1, 1, 0, 0, 2, 0, 0, 1, 3, 0, 0, 0, 1]}
Stereo.T_c1_c2: !!opencv-matrix {rows: 4, cols: 4, dt: f, data: [1, 0, 0, 1, 0, 1, 0, 2, 0, 0, 1, 3, 0, 0, 0, 1]}
"""  # fmt: skip
_STELLA = """Camera:
  model: "fisheye"
  cols: 64
  rows: 48
  fx: 20
  fy: 21
  cx: 31.5
  cy: 23.5
  k1: 0.01
"""
_BASALT = json.dumps({"value0": {
    "T_imu_cam": [{"px": 0, "py": 0.1, "pz": 0, "qx": 0, "qy": 0, "qz": 0, "qw": 1}] * 2, "cam_time_offset_ns": 12,
    "intrinsics": [
        {"camera_type": "ds", "intrinsics": {"fx": 20, "fy": 21, "cx": 31, "cy": 25, "xi": -0.2, "alpha": 0.59}},
        {"camera_type": "kb4", "intrinsics": {"fx": 20, "fy": 21, "cx": 31, "cy": 25, "k1": 0.1, "k2": 0, "k3": 0,
                                              "k4": 0}},
    ], "resolution": [[64, 48], [64, 48]]}}, indent=1)  # fmt: skip
_TRANSFORMS = json.dumps(
    {
        "camera_model": "OPENCV",
        "w": 64,
        "h": 48,
        "fl_x": 40,
        "fl_y": 41,
        "cx": 32,
        "cy": 24,
        "k1": -0.1,
        "p1": 0.001,
        "frames": [
            {
                "file_path": f"images/{i}.png",
                "transform_matrix": [[1, 0, 0, i], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
            }
            for i in range(3)
        ],
    },
    indent=1,
)
_NGP = json.dumps({"camera_angle_x": 1.2, "w": 64, "h": 48, "frames": []})
_COLMAP_BINARY = (
    struct.pack("<QIiQQ8d", 3, 1, 5, 64, 48, 20, 21, 32, 24, 0.01, 0.002, -0.001, 0.0001)
    + struct.pack("<IiQQ2d", 2, 17, 64, 32, 64, 32) + struct.pack("<IiQQ4d", 7, 2, 64, 48, 40, 32, 24, -0.1)
)  # fmt: skip
_COLMAP = """# Camera list
1 OPENCV 64 48 40 41 32 24 -0.2 0.03 0.001 0.001
2 EQUIRECTANGULAR 64 32 64 32
3 SIMPLE_RADIAL_FISHEYE 64 48 20 32 24 0.01
4 EUCM 64 48 20 21 31 25 0.6 1.1
5 FULL_OPENCV 64 48 40 41 32 24 -0.2 0.03 0.001 0.001 0 0 0 0
"""


# -- trajectories --------------------------------------------------------------------------------------------------

_TUM = "# time x y z qx qy qz qw\n" + "".join(f"{i / 15:.6f} {0.1 * i} 0 0.2 0 0 0 1\n" for i in range(6))
_TUM_NS = "".join(f"{i * 50_000_000} {0.1 * i} 0 0.2 0 0.6 0 0.8\n" for i in range(6))
_KITTI = "".join(f"1 0 0 {0.1 * i} 0 1 0 0 0 0 1 {i}\n" for i in range(6))
_EUROC = "#timestamp [ns],x,y,z,qw,qx,qy,qz\n" + "".join(f"{i * 50_000_000},{i},0,0,1,0,0,0,9,9\n" for i in range(6))


def _parse_tum(path: Path) -> None:
    from panobench.datasets.trajectory_io import read_tum

    assert len(read_tum(path))


def _parse_answer(folder: Path) -> Parse:
    from panobench.external.trajectory import TrajectoryFormat, read_answer

    times = np.arange(6) * 0.05
    forms = [TrajectoryFormat(kind) for kind in ("tum", "tum-ns", "kitti", "euroc")]  # type: ignore[arg-type]
    forms.append(TrajectoryFormat("tum", inverse=True, index_rate=20.0, T_body_camera=np.eye(4)))

    def parse(path: Path) -> None:
        refusals = []
        for form in forms:
            try:
                found = read_answer(path, form, times)
                assert np.isin(found.times, times).all()
                assert np.isfinite(found.T_wc).all()
            except PanobenchError as error:
                refusals.append(error)
        if len(refusals) == len(forms):
            raise refusals[0]

    return parse


def _parse_import(folder: Path) -> Parse:
    from panobench.external.imported import ImportOptions, read_imported

    return lambda path: read_imported(path, ImportOptions(), np.arange(6) * 0.05)


# -- datasets ------------------------------------------------------------------------------------------------------

_SYNPANO = "frame_id image_name x y z qx qy qz qw\n" + "".join(
    f"{i} {i:06d}.png {0.1 * i} 0 0.5 0.70710678 0 0 0.70710678\n" for i in range(3)
)


def _synpano(folder: Path) -> Parse:
    from panobench.datasets.synpano import SynPano

    (folder / "images").mkdir()
    for i in range(3):
        cv2.imwrite(str(folder / "images" / f"{i:06d}.png"), np.zeros((4, 8, 3), np.uint8))

    def parse(path: Path) -> None:
        sequence = SynPano(folder).open()
        assert sequence.groundtruth is not None
        assert np.isfinite(sequence.groundtruth.T_wc).all()

    return parse


def _folder(file: str, other: dict[str, str]) -> Callable[[Path], Parse]:
    def setup(folder: Path) -> Parse:
        from panobench.datasets.folder import Folder

        (folder / "images").mkdir()
        for i in range(3):
            cv2.imwrite(str(folder / "images" / f"{i}.png"), np.zeros((32, 64, 3), np.uint8))
        for name, text in other.items():
            (folder / name).write_text(text)
        return lambda path: Folder(folder).open().novel_views()

    return setup


_FRAMES = "time,file\n0.0,images/0.png\n0.1,images/1.png\n0.2,images/2.png\n"
_NOVEL = "file,x,y,z,qx,qy,qz,qw\nimages/1.png,0,0,0,0,0,0,1\n"
_ERP = "model: erp\nwidth: 64\nheight: 32\n"
_IMU = "time,wx,wy,wz,ax,ay,az\n" + "".join(f"{i / 200},0,0,0.1,0,9.8,0\n" for i in range(5))
_META = '{"source": "x", "body_T_cam": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]], "checksums": {"a": "b"}}'
_LOC = json.dumps({"images/0.png": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], "n": 1e5})
_DUAL = """blend_deg: 6
lenses:
  - {x: 0, y: 0, camera: {model: fisheye, width: 64, height: 64, fx: 20, fy: 20, cx: 32, cy: 32, k: [0, 0, 0, 0]}}
  - {x: 64, y: 0, camera: {model: fisheye, width: 64, height: 64, fx: 20, fy: 20, cx: 32, cy: 32, k: [0, 0, 0, 0]},
     yaw_pitch_roll_deg: [180, 0, 0]}
"""
_PALVIO = """camera: camera.yaml
image_topic: /a
time_offset_s: -0.01
body_T_cam: [[1, 0, 0, 0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
"""


def _parse_dual(path: Path) -> None:
    from panobench.datasets.dual_fisheye import read_dual_fisheye

    read_dual_fisheye(path)


def _palvio(folder: Path) -> Parse:
    from panobench.datasets.palvio_calibration import find_calibration

    (folder / "camera.yaml").write_text(_ERP)
    return lambda path: find_calibration(path.parent)


def _parse_json_poses(path: Path) -> None:
    from panobench.datasets.json_poses import read_json, rigid_matrix

    values = read_json(path)
    for name, matrix in values.items() if isinstance(values, dict) else ():
        rigid_matrix(matrix, path, name)


def _image_material() -> Material:
    image = (np.indices((16, 32)).sum(axis=0) * 5 % 256).astype(np.uint8)
    colour = np.dstack([image, image.T.reshape(16, 32), 255 - image])
    pictures = [(".png", image), (".png", colour), (".png", image.astype(np.uint16) * 257), (".jpg", colour)]
    pictures += [(".webp", colour), (".bmp", colour), (".jpg", image)]
    return Material(tuple(bytes(cv2.imencode(suffix, p)[1]) for suffix, p in pictures))


def _parse_image(path: Path) -> None:
    from panobench.datasets.images import read_image, read_size

    size = read_size(path)
    assert read_image(path).shape == (size[1], size[0], 3)


def _npy_material() -> Material:
    import io

    documents = []
    for values in (np.ones((4, 8), np.float32), np.ones((4, 8, 1), np.uint16), np.asfortranarray(np.ones((4, 8)))):
        buffer = io.BytesIO()
        np.save(buffer, values)
        documents.append(buffer.getvalue())
    buffer = io.BytesIO()
    np.savez(buffer, depth=np.ones((2, 4)))
    return Material((*documents, buffer.getvalue()), (b"<f4", b"|O", b"descr", b"fortran_order", b"shape", b"True"))


def _parse_npy(path: Path) -> None:
    from panobench.datasets.images import read_depth

    assert read_depth(path).ndim == 2


def _bag_material() -> Material:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    documents = []
    for compression in (None, Writer.CompressionFormat.BZ2, Writer.CompressionFormat.LZ4):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "a.bag"
            writer = Writer(path)
            if compression is not None:
                writer.set_compression(compression)
            with writer:
                connection = writer.add_connection("/image", "sensor_msgs/msg/Image", typestore=store)
                types = store.types
                for i in range(3):
                    header = types["std_msgs/msg/Header"](
                        seq=i, stamp=types["builtin_interfaces/msg/Time"](sec=10, nanosec=i), frame_id="c"
                    )
                    message = types["sensor_msgs/msg/Image"](
                        header=header, height=4, width=8, encoding="mono8", is_bigendian=0, step=8,
                        data=np.arange(32, dtype=np.uint8),
                    )  # fmt: skip
                    data = store.serialize_ros1(message, "sensor_msgs/msg/Image")
                    writer.write(connection, 10_000_000_000 + i, data)
            documents.append(path.read_bytes())
    return Material(tuple(documents), (b"op=", b"bz2", b"lz4", b"none", b"../../x", b"/image", b"size=", b"index_pos="))


def _parse_bag(path: Path) -> None:
    from panobench.datasets.bag import BagFile, decode_image_message

    bag = BagFile(path)
    bag.describe_topics()
    connections = bag.connections("/image", "sensor_msgs/msg/Image")
    for k, (_, stamp, data) in enumerate(bag.records(connections)):
        decode_image_message(data, path, k)
        bag.parse(data, "/image", "sensor_msgs/msg/Image", k)
        if k == 0:
            bag.at(connections, stamp, 0)


# -- maps, runs and suites -----------------------------------------------------------------------------------------


def _ply_material() -> Material:
    from panobench.splat.ply import write_ply

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.ply"
        rng = np.random.default_rng(0)
        write_ply(path, *(rng.normal(size=s) for s in ((3, 3), (3, 3), (3, 4), (3,), (3, 3))))
        binary = path.read_bytes()
    header, body = binary.split(b"end_header\n")
    rows = np.frombuffer(body, "<f4").reshape(3, -1)
    ascii_rows = "\n".join(" ".join(f"{v:.4f}" for v in row) for row in rows).encode() + b"\n"
    ascii_map = header.replace(b"binary_little_endian", b"ascii") + b"end_header\n" + ascii_rows
    big = header.replace(b"little", b"big") + b"end_header\n" + rows.astype(">f4").tobytes()
    words = "ply format ascii binary_big_endian element vertex face property list float double uchar int comment x"
    return Material((binary, ascii_map, big), tuple(w.encode() for w in (words + " end_header rot_0 1.0").split()))


def _parse_ply(path: Path) -> None:
    from panobench.splat.ply import read_ply

    assert all(np.isfinite(values).all() for values in read_ply(path)[:4])


_RUN: dict[str, object] = {
    "schema": 1, "status": "ok", "message": "", "origin": "measured", "protocol": "1.0", "metric": False,
    "spec": {"method": "panogs", "camera": "erp", "dataset": "rooms", "sequence": "room1", "seed": 0, "width": 512,
             "settings": {"a": 1}, "preset": None, "fov": None, "config": {"window": 8}},
    "method": {"name": "panogs", "licence": "GPL", "citation": "", "needs": ["rgb"]},
    "metrics": {"ate_rmse_m": 0.01, "tracked": 1.0, "psnr_db": 30.0, "ssim": 0.9, "lpips": None},
    "timing": {"fps": 4.0, "tracking_fps": 9.0, "latency_p50_s": 0.2, "wall_s": 3.0, "peak_rss_bytes": 1e9},
    "frames": {"given": 6, "planned": 6, "tracked": 6, "held_out": 0}, "keyframes": [0, 3],
    "map": {"file": "map.ply", "gaussians": 100, "bytes": 5000}, "notes": {"novel": "none"},
    "depth": {"source": "bootstrap", "oracle": False, "range": [0.8, 3.9]}, "extra": {"loops": 1},
    "provenance": {"panobench": "0.1.0", "machine": {"cpu": "x", "cores": 2}, "command": "panobench run", "seed": 0},
    "cell": {"key": "k", "identity": "i", "label": "l", "limits": {"timeout_s": 1}, "attempt": 1},
}  # fmt: skip


def _run_json(folder: Path) -> Parse:
    """Everything that reads stored runs: the reader, the report's collector and tables, the gate, scoring again."""
    from panobench.bench.compare import Rule, compare, load_runs
    from panobench.bench.rescore import Protocol, rescore
    from panobench.bench.store import Store
    from panobench.cli.suite import _row
    from panobench.report.collect import collect
    from panobench.report.exports import FORMATS
    from panobench.report.tables import build_tables

    (folder / "runs" / "a" / "trajectory.tum").write_text(_TUM)
    (folder / "runs" / "a" / "groundtruth.tum").write_text(_TUM)
    rows = "".join(f"{i},{i / 15:.6f},1,0.2\n" for i in range(6))
    (folder / "runs" / "a" / "frames.csv").write_text("index,time,tracked,latency_s\n" + rows)
    rule = Rule.parse("ate>5%")

    def parse(path: Path) -> None:
        runs = load_runs(folder)
        compare(runs, runs, [rule])
        for stored in Store(folder).runs()[0]:
            _row("x", stored, "")
            assert stored.key is not None
            assert stored.limits is not None
        rescore(path.parent, Protocol())
        tables = build_tables(collect([folder]))
        for export in FORMATS.values():
            export(tables)

    return parse


def _report(folder: Path) -> Parse:
    from panobench.report.build import write_report

    (folder / "a" / "trajectory.tum").write_text(_TUM)
    (folder / "a" / "groundtruth.tum").write_text(_TUM)
    return lambda path: write_report([folder], folder / "report.html")


_SUITE = """name: demo
methods:
  - panogs
  - {name: sparse, set: {features: 5, levels: 3}, cameras: [erp, "pinhole:front"], options: {depth: constant}}
cameras: [erp]
datasets:
  - {name: rooms, sequences: [room1, room2]}
  - {name: synpano, root: /nowhere, sequences: all, options: {width: 64}}
seeds: [0, 1]
repeats: 2
options: {width: 128, max_frames: 5, timeout_s: 9, memory_gib: 2, holdout: 4}
"""


def _parse_suite(path: Path) -> None:
    from panobench.bench.suite_file import read_suite

    for cell in read_suite(path).cells[:50]:
        assert cell.label
        assert cell.slug
        assert re.fullmatch(r"[A-Za-z0-9_-]+", cell.slug)
        assert json.dumps(cell.to_dict(), default=str)


# -- depth networks and studies ------------------------------------------------------------------------------------

_NETWORK = """width: 32
height: 16
projection: erp
centre_deg: 90
colour: bgr
range: 255
mean: [0.485, 0.456, 0.406]
std: [0.229, 0.224, 0.225]
layout: nchw
output: depth
meaning: inverse-distance
metric: false
scale: 1.0
far: 100.0
"""
_IMAGE_NETWORK = "width: 32\nheight: 24\nprojection: image\nmeaning: z\nmetric: true\noutput: 1\n"


def _parse_description(path: Path) -> None:
    from panobench.depth.network_description import read_description

    found = read_description(path.with_suffix(".onnx"))
    assert found.width * found.height <= 1 << 26


def _onnx_material() -> Material:
    """A small network with its weights inside, and one that keeps them in a file beside it."""
    from onnx import TensorProto, helper, numpy_helper

    documents = []
    for location in ("", "weights.bin"):
        weights = numpy_helper.from_array(np.ones((1, 3, 1, 1), np.float32), "w")
        if location:
            weights.ClearField("raw_data")
            weights.data_location = TensorProto.EXTERNAL
            for key, value in (("location", location), ("offset", "0"), ("length", "12")):
                weights.external_data.add(key=key, value=value)
        graph = helper.make_graph(
            [helper.make_node("Conv", ["image", "w"], ["c"]), helper.make_node("Relu", ["c"], ["depth"])],
            "tiny",
            [helper.make_tensor_value_info("image", TensorProto.FLOAT, (1, 3, 16, 32))],
            [helper.make_tensor_value_info("depth", TensorProto.FLOAT, (1, 1, 16, 32))],
            [weights],
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        documents.append(model.SerializeToString())
    words = b"Conv Relu Identity com.microsoft weights.bin ../weights.bin /etc/passwd location image depth w ai.onnx.ml"
    return Material(tuple(documents), tuple(words.split()))


def _onnx(folder: Path) -> Parse:
    """The look into the file, and the runtime behind it."""
    from panobench.depth.network_description import check_description
    from panobench.depth.network_model import load_model

    (folder / "weights.bin").write_bytes(np.ones(3, np.float32).tobytes())
    description = check_description({"width": 32, "height": 16}, folder / "net.yaml")
    return lambda path: load_model(path, description)


_STUDY = {
    "schema": 1, "name": "fov", "title": "Field of view", "notes": ["a note"], "captions": {"t": "A table. More."},
    "tables": {"t": [{"field of view": "360", "ATE [mm] \u2193": 1.5, "PSNR [dB] \u2191": "/", "source": "published"},
                     {"field of view": "90", "ATE [mm] \u2193": None, "PSNR [dB] \u2191": 30.0}]},
    "figures": {"f": {"data": [{"x": [0, 1], "y": [1, 2], "type": "scatter"}], "layout": {"title": {"text": "x"}}}},
    "provenance": {"command": "panobench study fov", "quick": True, "options": {"width": "64"}},
}  # fmt: skip


def _study(folder: Path) -> Parse:
    """The reader, and what a report makes of it: exported tables, figures."""
    from panobench.report.collect import collect
    from panobench.report.exports import FORMATS
    from panobench.report.studies import study_section
    from panobench.report.tables import build_tables

    def parse(path: Path) -> None:
        found = collect([folder])
        if found.problems:
            raise InputError(str(found.problems[0]))
        tables = build_tables(found)
        for export in FORMATS.values():
            export(tables)
        for study in found.studies:
            data: dict[str, dict[str, object]] = {"figures": {}}
            study_section(0, study, data)
            json.dumps(data, allow_nan=False)

    return parse


_YAML_WORDS = "model pinhole erp pal fisheye ds eucm omni cubemap width height fx cx k poly inv_poly r_min r_max mask "
_MODELS = "PINHOLE SIMPLE_PINHOLE RADIAL OPENCV FULL_OPENCV OPENCV_FISHEYE FISHEYE EUCM EQUIRECTANGULAR"
_TARGETS = (
    Target(
        "ocamcalib", "calib_results.txt", _written("ocamcalib", "nan inf 5 0", (
            "5 -12.2 0 0.035 -0.0007 0.000036\n\n6 18.8 12.3 0.95 1.2 0.95 0.3\n\n24.1 32.2\n\n1 0 0\n\n48 64\n",
        )), _calibration("ocamcalib"),
    ),
    Target("kalibr", "camchain.yaml", _written("kalibr", "pinhole omni eucm ds none radtan equidistant cam0 cam1 "
           "camera_model intrinsics resolution T_cam_imu", (_KALIBR,)), _calibration("kalibr")),
    Target("lfvio", "lfvio.yaml", _written("lfvio", "scaramuzza PINHOLE MEI KANNALA_BRANDT p0 p5 p63 cx min_r max_r "
           "td data body_T_cam0 !!opencv-matrix", (_LFVIO,)), _calibration("lfvio")),
    Target("panobench-camera", "camera.yaml", _written("panobench", _YAML_WORDS, (_PANOBENCH,)),
           _calibration("panobench")),
    Target("colmap", "cameras.txt", _written("colmap", _MODELS, (_COLMAP,)), _calibration("colmap")),
    Target("colmap-binary", "cameras.bin", lambda: Material((_COLMAP_BINARY,), (b"\x11", b"\x05", b"\xff" * 8)),
           _calibration("colmap")),
    Target("opencv", "camera.yml", _text(_OPENCV, _ROS, _EUROC_SENSOR, _STEREO, words="K D M1 D2 dist xi skew fisheye "
           "plumb_bob rational_polynomial omnidir !!opencv-matrix data rows T_BS size"), _calibration("opencv")),
    Target("opencv-xml", "camera.xml", _text(_OPENCV_XML, words="<_> </_> <data> </data> <!DOCTYPE <!ENTITY &a; nan "
           "<xi>1</xi> type_id"), _calibration("opencv")),
    Target("slam-settings", "settings.yaml", _text(_ORBSLAM, _STELLA, words="Camera Camera1.fx PinHole fisheye "
           "Rectified equirectangular perspective Camera.cols Tbc"), _calibration("slam-settings")),
    Target("basalt", "calibration.json", _text(_BASALT, words='"ucm" "eucm" "pinhole" "pinhole-radtan8" "xi" "beta" '
           "null [] {}"), _calibration("basalt")),
    Target("nerfstudio-camera", "transforms.json", _text(_TRANSFORMS, _NGP, words='"OPENCV_FISHEYE" "EQUIRECTANGULAR" '
           '"w" "k4" null [] {} 1e999'), _calibration("nerfstudio")),
    Target("synpano", "groundtruth.txt", _text(_SYNPANO, words="000000.png 000001.png ../x.png nan"), _synpano),
    Target("tum", "trajectory.tum", _text(_TUM, _TUM_NS, words="nan inf #"), _plain(_parse_tum)),
    Target("subprocess-trajectory", "answer.txt", _text(_TUM.replace("/15", "/20"), _TUM_NS, _KITTI, _EUROC, "", "\n",
           "0 0 0 0 0 0 0 1\n0.05 0 0 0 0 0 0 1\n0.1 1 0 0 0 0 0 1\n"), _parse_answer),
    Target("imported-trajectory", "theirs.txt", _text(_TUM, _TUM_NS, _KITTI, _EUROC), _parse_import),
    Target("ply", "map.ply", _ply_material, _plain(_parse_ply)),
    Target("run-json", "runs/a/run.json", _text(json.dumps(_RUN, indent=1), json.dumps(_RUN), words="null true "
           '"lost" "crashed" "imported" [] {} [1] {"a":1} "<script>" Infinity NaN'), _run_json),
    Target("report-html", "a/run.json", _text(json.dumps(_RUN)), _report),
    Target("suite", "suite.yaml", _text(_SUITE, words="name methods cameras datasets seeds repeats options set preset "
           "root sequences width fov all panogs sparse rooms erp"), _plain(_parse_suite)),
    Target("folder-frames", "frames.csv", _text(_FRAMES, words="images/0.png ../0.png /etc/passwd nan"),
           _folder("frames.csv", {"camera.yaml": _ERP})),
    Target("folder-novel", "novel.csv", _text(_NOVEL, words="images/0.png ../0.png nan"),
           _folder("novel.csv", {"camera.yaml": _ERP, "frames.csv": _FRAMES})),
    Target("folder-imu", "imu.csv", _text(_IMU), _folder("imu.csv", {"camera.yaml": _ERP, "frames.csv": _FRAMES})),
    Target("folder-meta", "meta.json", _text(_META, words="null true body_T_cam"),
           _folder("meta.json", {"camera.yaml": _ERP, "frames.csv": _FRAMES})),
    Target("json-poses", "camera_pose.json", _text(_LOC, words="null true [] {}"), _plain(_parse_json_poses)),
    Target("dual-fisheye", "dual_fisheye.yaml", _text(_DUAL, words="x y camera R_rig_lens lenses model"),
           _plain(_parse_dual)),
    Target("palvio-yaml", "palvio.yaml", _text(_PALVIO, words="camera ../camera.yaml imu_topic time_offset_s"),
           _palvio),
    Target("image", "image.png", _image_material, _plain(_parse_image)),
    Target("depth-npy", "depth.npy", _npy_material, _plain(_parse_npy)),
    Target("bag", "a.bag", _bag_material, _plain(_parse_bag)),
    Target("network-yaml", "net.yaml", _text(_NETWORK, _IMAGE_NETWORK, words="width height erp image rgb nhwc z "
           "distance log-distance metric true"), _plain(_parse_description)),
    Target("onnx", "net.onnx", _onnx_material, _onnx),
    Target("study-json", "fov/study.json", _text(json.dumps(_STUDY, indent=1), json.dumps(_STUDY), words='null true '
           '"/" [] {} [1] {"a":1} "<script>" Infinity NaN 1e400'), _study),
)  # fmt: skip
TARGETS = {t.name: t for t in _TARGETS}


@functools.cache
def material(name: str) -> Material:
    """The target's documents, made once."""
    return TARGETS[name].material()
