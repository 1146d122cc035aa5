"""Files of datasets: tables, images, depth, bags, descriptions."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from mutate import Material
from target import Parse, Target, plain, text

_SYNPANO = "frame_id image_name x y z qx qy qz qw\n" + "".join(
    f"{i} {i:06d}.png {0.1 * i} 0 0.5 0.70710678 0 0 0.70710678\n" for i in range(3)
)


def _synpano(folder: Path) -> Parse:
    from panobench.datasets.formats.synpano import SynPano

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
        from panobench.datasets.formats.folder import Folder

        (folder / "images").mkdir()
        for i in range(3):
            cv2.imwrite(str(folder / "images" / f"{i}.png"), np.zeros((32, 64, 3), np.uint8))
        for name, content in other.items():
            (folder / name).write_text(content)
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
    from panobench.datasets.formats.dual_fisheye import read_dual_fisheye

    read_dual_fisheye(path)


def _palvio(folder: Path) -> Parse:
    from panobench.datasets.palvio.calibration import find_calibration

    (folder / "camera.yaml").write_text(_ERP)
    return lambda path: find_calibration(path.parent)


def _parse_json_poses(path: Path) -> None:
    from panobench.datasets.files.json_poses import read_json, rigid_matrix

    values = read_json(path)
    for name, matrix in values.items() if isinstance(values, dict) else ():
        rigid_matrix(matrix, path, name)


def _image_material() -> Material:
    image = (np.indices((16, 32)).sum(axis=0) * 5 % 256).astype(np.uint8)
    colour = np.dstack([image, image.T.reshape(16, 32), 255 - image])
    pictures = [(".png", image), (".png", colour), (".png", image.astype(np.uint16) * 257), (".jpg", colour)]
    pictures += [(".webp", colour), (".bmp", colour), (".jpg", image)]
    pictures += [(".tif", colour), (".tif", image.astype(np.uint16) * 257), (".pgm", image), (".ppm", colour)]
    return Material(tuple(bytes(cv2.imencode(suffix, p)[1]) for suffix, p in pictures))


def _parse_image(path: Path) -> None:
    from panobench.datasets.files.images import read_image, read_size

    size = read_size(path)
    assert read_image(path).shape == (size[1], size[0], 3)


def _mask_material() -> Material:
    seen = np.ones((16, 32), np.uint8)
    seen[10:, 4:20] = 0
    pictures = [seen * 255, seen, seen.astype(np.uint16), np.dstack([seen * 200] * 3 + [seen * 255])]
    return Material(tuple(bytes(cv2.imencode(".png", p)[1]) for p in pictures))


def _parse_mask(path: Path) -> None:
    from panobench.masks.files import read_mask_file

    assert read_mask_file(path, (64, 32)).valid.shape == (32, 64)


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
    from panobench.datasets.files.images import read_depth

    assert read_depth(path).ndim == 2


def _video_material() -> Material:
    import av

    documents = []
    for suffix, codec in ((".mp4", "libx264"), (".mkv", "libx264"), (".avi", "mpeg4"), (".ts", "mpeg2video")):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"a{suffix}"
            with av.open(str(path), "w") as container:
                stream = container.add_stream(codec, rate=25)
                stream.width, stream.height, stream.pix_fmt, stream.gop_size = 64, 32, "yuv420p", 4
                for i in range(9):
                    frame = av.VideoFrame.from_ndarray(np.full((32, 64, 3), 20 * i, np.uint8), format="rgb24")
                    container.mux(stream.encode(frame))
                container.mux(stream.encode())
            documents.append(path.read_bytes())
    words = b"moov trak stts ctts stsz elst mdat 00dc \x1f\x43\xb6\x75 \0\0\1\xb3"
    return Material(tuple(documents), tuple(words.split(b" ")))


def _parse_video(path: Path) -> None:
    from panobench.video.reader import VideoReader

    reader = VideoReader(path)
    assert reader.times[0] == 0
    assert (np.diff(reader.times) > 0).all()
    for index in (len(reader) - 1, 0, len(reader) // 2):
        assert reader.read(index, (16, 8)).shape == (8, 16, 3)


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
    from panobench.datasets.bags.files import BagFile
    from panobench.datasets.bags.images import decode_image_message

    bag = BagFile(path)
    bag.describe_topics()
    bag.need("/image", ("sensor_msgs/msg/Image",))
    for k, record in enumerate(list(bag.records({"/image"}))):
        decode_image_message(bag.parse(bag.at("/image", record.place), k), path, k)


TARGETS = (
    Target("synpano", "groundtruth.txt", text(_SYNPANO, words="000000.png 000001.png ../x.png nan"), _synpano),
    Target("folder-frames", "frames.csv", text(_FRAMES, words="images/0.png ../0.png /etc/passwd nan"),
           _folder("frames.csv", {"camera.yaml": _ERP})),
    Target("folder-novel", "novel.csv", text(_NOVEL, words="images/0.png ../0.png nan"),
           _folder("novel.csv", {"camera.yaml": _ERP, "frames.csv": _FRAMES})),
    Target("folder-imu", "imu.csv", text(_IMU), _folder("imu.csv", {"camera.yaml": _ERP, "frames.csv": _FRAMES})),
    Target("folder-meta", "meta.json", text(_META, words="null true body_T_cam"),
           _folder("meta.json", {"camera.yaml": _ERP, "frames.csv": _FRAMES})),
    Target("json-poses", "camera_pose.json", text(_LOC, words="null true [] {}"), plain(_parse_json_poses)),
    Target("dual-fisheye", "dual_fisheye.yaml", text(_DUAL, words="x y camera R_rig_lens lenses model"),
           plain(_parse_dual)),
    Target("palvio-yaml", "palvio.yaml", text(_PALVIO, words="camera ../camera.yaml imu_topic time_offset_s"),
           _palvio),
    Target("image", "image.png", _image_material, plain(_parse_image)),
    Target("mask", "mask.png", _mask_material, plain(_parse_mask)),
    Target("depth-npy", "depth.npy", _npy_material, plain(_parse_npy)),
    Target("video", "a.mp4", _video_material, plain(_parse_video)),
    Target("bag", "a.bag", _bag_material, plain(_parse_bag)),
)  # fmt: skip
