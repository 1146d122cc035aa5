"""Which of a bag's topics are the images, the inertial samples and the true poses, where nobody says it."""

from __future__ import annotations

import re

from panobench.datasets.bags.files import BagFile, Topic
from panobench.datasets.bags.messages import CAMERA_INFO, IMAGES, IMU, ODOMETRY, POSES
from panobench.errors import DatasetError

#: Images that are no pictures of the scene.
_NO_PICTURE = re.compile(r"depth|disparity|mask|label|segment|semantic|confidence|feature|track|debug|annotat|thumb")
#: Words in the names of topics that have true poses.
_TRUE = re.compile(
    r"(^|[^a-z])gt([^a-z]|$)|ground_?truth|true|truth|vicon|mocap|optitrack|qualisys|vrpn|leica|reference|rtk"
)


def image_topic(bag: BagFile, wanted: str | None) -> tuple[str, list[str]]:
    """The topic of the images and the others that have some. Raises DatasetError, listing the topics, without any.

    Of several the one with the most pictures is taken; raw before compressed, whose pictures are the same.
    """
    if wanted is not None:
        return named(bag, wanted, IMAGES), []
    found = _of_kinds(bag, IMAGES)
    if not found:
        raise DatasetError(f"the bag has no images (sensor_msgs Image or CompressedImage); {_listed(bag)}", bag.path)
    ranked = sorted(found, key=lambda name: _image_rank(name, bag.topics[name]))
    same = {_plain(ranked[0])}
    return ranked[0], [name for name in ranked[1:] if _plain(name) not in same]


def _image_rank(name: str, topic: Topic) -> tuple[bool, int, bool, str]:
    return bool(_NO_PICTURE.search(name.lower())), -topic.count, topic.kind != IMAGES[0], name


def _plain(name: str) -> str:
    return name.removesuffix("/compressed")


def imu_topic(bag: BagFile, wanted: str | None) -> tuple[str | None, list[str]]:
    """The topic of inertial samples, None without one, and the others. The one with the most samples is taken."""
    if wanted is not None:
        return named(bag, wanted, IMU), []
    found = sorted(_of_kinds(bag, IMU), key=lambda name: (-bag.topics[name].count, name))
    return (found[0], found[1:]) if found else (None, [])


def truth_topic(bag: BagFile, wanted: str | None) -> tuple[str | None, list[str]]:
    """The topic of true poses, None if there is no telling, and topics of poses that are not taken.

    Poses are the truth where their topic is called so (ground truth, gt, vicon, mocap ...), or where they are the only
    ones and no odometry, which robots and methods publish of themselves. "none": none.
    """
    if wanted == "none":
        return None, []
    if wanted is not None:
        return named(bag, wanted, POSES), []
    found = sorted(_of_kinds(bag, POSES), key=lambda name: (-bag.topics[name].count, name))
    called = [name for name in found if _TRUE.search(name.lower())]
    measured = [name for name in found if bag.topics[name].kind != ODOMETRY]
    chosen = called[0] if called else measured[0] if len(measured) == 1 else None
    return chosen, [name for name in found if name != chosen]


def camera_topics(bag: BagFile, image: str) -> tuple[str, ...]:
    """Topics of CameraInfo that may be of these images, the best first: beside them, or the only one there is."""
    infos = _of_kinds(bag, (CAMERA_INFO,))
    space = _plain(image).rpartition("/")[0]
    beside = [name for name in infos if name.rpartition("/")[0] == space]
    above = [name for name in infos if name.rpartition("/")[0] == space.rpartition("/")[0]]
    return tuple((beside or above or (infos if len(infos) == 1 else []))[:1])


def named(bag: BagFile, wanted: str, kinds: tuple[str, ...]) -> str:
    """The topic of that name, of one of ``kinds``; without its first "/", or without "/compressed", too."""
    spelt = [wanted, f"/{wanted}", f"{wanted}/compressed", f"/{wanted}/compressed"]
    topic = next((name for name in spelt if name in bag.topics), wanted)
    bag.need(topic, kinds)
    return topic


def _of_kinds(bag: BagFile, kinds: tuple[str, ...]) -> list[str]:
    return [name for name, topic in bag.topics.items() if topic.kind in kinds and topic.count > 0]


def _listed(bag: BagFile) -> str:
    return bag.describe_topics()
