"""Specs of the built-in datasets."""

from panobench.specs import DatasetSpec

DATASETS: tuple[DatasetSpec, ...] = (
    DatasetSpec(
        "synpano",
        "synthetic indoor panoramas with exact ground truth",
        "panobench.datasets.formats.synpano:SynPano",
        publisher="the SynPano authors (the synthetic benchmark of the PanoGS-SLAM paper)",
        obtain="ask the authors of the PanoGS-SLAM paper; no public address is known",
        layout="SCENE/images/*.{png,jpg} (2:1), SCENE/groundtruth.txt with rows 'frame_id image_name x y z qx qy qz "
        "qw' in Blender camera axes, optional SCENE/depth/<stem>.{npy,png} and SCENE/novel/",
        camera="erp",
        recorded=False,
    ),
    DatasetSpec(
        "folder",
        "panobench's own sequence format, as `panobench convert` writes it",
        "panobench.datasets.formats.folder:Folder",
        publisher="you",
        layout="SEQUENCE/camera.yaml, SEQUENCE/images/, SEQUENCE/frames.csv (time,file), optional groundtruth.tum, "
        "imu.csv, depth/, mask.png, meta.json",
    ),
    DatasetSpec(
        "video",
        "any equirectangular 360 video; no ground truth",
        "panobench.datasets.formats.video:Video",
        publisher="you",
        layout="FILE.mp4, or FOLDER/NAME.mp4 with --sequence NAME; optional NAME.mask.png (white = valid)",
        camera="erp",
    ),
    DatasetSpec(
        "images",
        "a folder of panoramas, or of images with a calibration",
        "panobench.datasets.formats.image_folder:ImageFolder",
        publisher="you",
        layout="FOLDER/*.jpg, FOLDER/images/*.jpg or FOLDER/NAME/*.jpg; times from times.txt, names, EXIF or --rate; "
        "2:1 panoramas, or --calibration FILE; optional mask.png",
    ),
    DatasetSpec(
        "colmap",
        "a COLMAP project: images, camera and poses (without scale)",
        "panobench.datasets.formats.reconstructions:ColmapProject",
        publisher="you",
        layout="PROJECT/images/ and PROJECT/sparse/0/{cameras,images}.{bin,txt}",
    ),
    DatasetSpec(
        "nerfstudio",
        "a project of nerfstudio or instant-ngp: images, camera and poses (without scale)",
        "panobench.datasets.formats.reconstructions:NerfstudioProject",
        publisher="you",
        layout="PROJECT/transforms.json and the images it names",
    ),
    DatasetSpec(
        "bag",
        "any bag of ROS 1 or ROS 2: images, with IMU, true poses and camera if it has them",
        "panobench.datasets.bags.dataset:Bag",
        requires=("rosbags",),
        publisher="you",
        layout="FILE.bag, FILE.db3 or FILE.mcap, a folder of ROS 2 (metadata.yaml), or a folder of such; --topic, "
        "--imu-topic, --groundtruth-topic; 2:1 panoramas, CameraInfo or --calibration FILE",
    ),
    DatasetSpec(
        "palvio",
        "panoramic annular camera, IMU and motion capture on a drone (LF-VIO)",
        "panobench.datasets.palvio.dataset:Palvio",
        requires=("rosbags",),
        publisher="Wang et al., LF-VIO (IROS 2022): the PALVIO dataset, linked from the LF-VIO repository on GitHub",
        obtain="follow the links in the README of https://github.com/flysoaryun/LF-VIO (Google Drive: ID01, ID06 and "
        "ID10; Baidu: all ten) and put the bags into one folder",
        layout="ID01.bag ... ID10.bag (ROS 1: /mindvision/mindvision/left/image_mono, /mavros/imu/data, "
        "/vicon/pal/pal), or extracted ID01/images/<nanoseconds>.png with optional groundtruth.tum "
        "(body poses) and imu.csv",
        camera="pal",
    ),
    DatasetSpec(
        "hilti-360",
        "two fisheye lenses, IMU and laser-scanned poses on construction sites (Hilti x Trimble challenge 2026)",
        "panobench.datasets.hilti.dataset:Hilti360",
        requires=("rosbags",),
        publisher="Centanni, Zhang et al., Hilti-Trimble-Oxford Dataset (2026)",
        obtain="follow the links in the README of https://github.com/Hilti-Research/hilti-trimble-slam-challenge-2026 "
        "(Google Drive), and copy its groundtruth/ into the same folder; or make one: `panobench synth hilti-360`",
        layout="floor_X/YYYY-MM-DD/run_Z/rosbag/{rosbag.db3,metadata.yaml} (ROS 2: /cam0/image_raw/compressed, "
        "/cam1/image_raw/compressed, /imu/data_raw), optional groundtruth/floor_X_YYYY-MM-DD_run_Z.txt (cam0 to map); "
        "optional --calibration FILE (Kalibr, cam0 and cam1)",
        camera="erp",
    ),
    DatasetSpec(
        "rooms",
        "built-in furnished rooms, ray cast with exact poses and depth",
        "panobench.datasets.synthetic.rooms:RoomsDataset",
        needs_root=False,
        camera="erp",
        recorded=False,
    ),
    DatasetSpec(
        "disturbed",
        "another dataset's sequence with noise, blur, an occluder and so on, or as a simulated recording of it",
        "panobench.datasets.synthetic.disturbed:DisturbedDataset",
        layout="--sequence DATASET/SEQUENCE+PART-NUMBER:NAME=NUMBER, for example rooms/room1+operator-15:noise=0.03",
        needs_root=False,
        recorded=False,
    ),
    DatasetSpec(
        "tum-vi",
        "fisheye camera, IMU and motion capture, handheld",
        "panobench.datasets.formats.tum_vi:TumVi",
        publisher="Schubert et al., TUM-VI (IROS 2018), Technical University of Munich",
        obtain="`panobench download tum-vi --sequence room1`, or the 512x512 EuRoC archives of "
        "https://cvg.cit.tum.de/data/datasets/visual-inertial-dataset",
        download="panobench.datasets.published:TUM_VI",
        layout="SEQUENCE/mav0/cam0/{data.csv,data/*.png}, SEQUENCE/dso/camchain.yaml, optional mav0/imu0/data.csv, "
        "mav0/mocap0/data.csv",
    ),
    DatasetSpec(
        "360vo",
        "synthetic panoramas of streets with ground truth (left-handed)",
        "panobench.datasets.formats.vo360:Vo360",
        publisher="Huang and Yeung, 360VO (ICRA 2022), HKUST",
        obtain="ask the authors of the 360VO paper; no public address is known",
        layout="SEQUENCE/images/*.{png,jpg} (2:1), SEQUENCE/groundtruth.txt with rows 'frame_id image_name x y z qx qy "
        "qz qw', x right, y up, z forward",
        camera="erp",
        recorded=False,
    ),
    DatasetSpec(
        "360loc",
        "panoramas of four places with poses, for localisation",
        "panobench.datasets.formats.loc360:Loc360",
        publisher="Huang et al., 360Loc (CVPR 2024), HKUST",
        obtain="follow the link in the README of https://github.com/HuajianUP/360Loc (OneDrive) and unpack a place",
        layout="PLACE/{mapping,query_360}/SEQUENCE/image/*.jpg with camera_pose.json beside image/",
        camera="erp",
    ),
    DatasetSpec(
        "omniblender",
        "synthetic 360 scenes: OmniBlender and OB3D",
        "panobench.datasets.formats.omniblender:OmniBlender",
        publisher="Choi et al., EgoNeRF (CVPR 2023); Ito et al., OB3D (2025)",
        obtain="OmniBlender: follow the link in the README of https://github.com/changwoonchoi/EgoNeRF (Google Drive); "
        "OB3D: https://www.kaggle.com/datasets/shintacs/ob3d-dataset",
        layout="SCENE/images/*.png and SCENE/transform.json (OmniBlender), or SCENE/Egocentric/images/NNNNN_rgb.png "
        "and cameras/NNNNN_cam.json (OB3D)",
        camera="erp",
        recorded=False,
    ),
    DatasetSpec(
        "insta360-dual-fisheye",
        "raw footage of two fisheye lenses, stitched with a given calibration",
        "panobench.datasets.formats.dual_fisheye:Insta360DualFisheye",
        publisher="you",
        layout="FILE.mp4 or FILE.insv with both circles in one frame, and dual_fisheye.yaml (or FILE.dual.yaml) beside "
        "it: lenses: two of {x, y, camera, yaw_pitch_roll_deg}, blend_deg",
        camera="erp",
    ),
)
