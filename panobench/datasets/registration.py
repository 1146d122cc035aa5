"""Specs of the built-in datasets."""

from panobench.specs import DatasetSpec

DATASETS: tuple[DatasetSpec, ...] = (
    DatasetSpec(
        "synpano",
        "synthetic indoor panoramas with exact ground truth",
        "panobench.datasets.synpano:SynPano",
        publisher="the SynPano authors (the synthetic benchmark of the PanoGS-SLAM paper)",
        layout="SCENE/images/*.{png,jpg} (2:1), SCENE/groundtruth.txt with rows 'frame_id image_name x y z qx qy qz "
        "qw' in Blender camera axes, optional SCENE/depth/<stem>.{npy,png} and SCENE/novel/",
    ),
    DatasetSpec(
        "folder",
        "panobench's own sequence format, as `panobench convert` writes it",
        "panobench.datasets.folder:Folder",
        publisher="you",
        layout="SEQUENCE/camera.yaml, SEQUENCE/images/, SEQUENCE/frames.csv (time,file), optional groundtruth.tum, "
        "imu.csv, depth/, mask.png, meta.json",
    ),
    DatasetSpec(
        "video",
        "any equirectangular 360 video; no ground truth",
        "panobench.datasets.video:Video",
        publisher="you",
        layout="FILE.mp4, or FOLDER/NAME.mp4 with --sequence NAME; optional NAME.mask.png (white = valid)",
    ),
    DatasetSpec(
        "palvio",
        "panoramic annular camera, IMU and motion capture on a drone (LF-VIO)",
        "panobench.datasets.palvio:Palvio",
        requires=("rosbags",),
        publisher="Wang et al., LF-VIO (IROS 2022): the PALVIO dataset, linked from the LF-VIO repository on GitHub",
        layout="ID01.bag ... ID10.bag (ROS 1: /mindvision/mindvision/left/image_mono, /mavros/imu/data, "
        "/vicon/pal/pal), or extracted ID01/images/<nanoseconds>.png with optional groundtruth.tum "
        "(body poses) and imu.csv",
    ),
    DatasetSpec(
        "rooms",
        "built-in furnished rooms, ray cast with exact poses and depth",
        "panobench.datasets.rooms.dataset:RoomsDataset",
        needs_root=False,
    ),
)
