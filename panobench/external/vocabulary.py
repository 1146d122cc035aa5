"""The ORB vocabulary that the ORB-SLAM family needs: the user's file, or one that is trained on other images.

Galvez-Lopez and Tardos, "Bags of binary words for fast place recognition in image sequences" (2012): a tree of binary
descriptors by hierarchical k-medians under the Hamming distance, leaves weighted by log(images / images with the word).
Text format of DBoW2: "k L scoring weighting", then per node "parent leaf byte0 ... byte31 weight", parents first.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.base import Dataset, FrameSequence
from panobench.errors import InputError, UnavailableError

#: Environment variable with the vocabulary for all adapters that need one.
VOCABULARY_VARIABLE = "PANOBENCH_ORB_VOCABULARY"
BRANCHES, LEVELS = 10, 5
ROOMS = ("room1", "room2", "room3", "room4", "room5")
TRAINING_FRAMES, TRAINING_STEP, TRAINING_WIDTH, FEATURES = 20, 2, 1024, 2000
Descriptors = NDArray[np.uint8]


def named_vocabulary(option: str) -> Path | None:
    """The file that the option or the environment variable names, or None. Raises InputError if it is no vocabulary."""
    name = option or os.environ.get(VOCABULARY_VARIABLE, "")
    if not name:
        return None
    path = Path(name).expanduser().resolve()
    if not path.is_file():
        raise InputError("no such vocabulary file (DBoW2 text format, usually called ORBvoc.txt)", path)
    with path.open("rb") as file:
        head = file.readline(100).split()
    if len(head) != 4 or not all(word.isdigit() for word in head):
        raise InputError(
            "not a DBoW2 vocabulary in text format: it does not start with four whole numbers", path, line=1
        )
    return path


def _silent(_: str) -> None:
    return None


def find_vocabulary(option: str, sequence: FrameSequence, log: Callable[[str], None] = _silent) -> Path:
    """The named vocabulary, or one that is trained on built-in rooms other than ``sequence`` and kept in the cache.

    Raises InputError for a named file that is no vocabulary, UnavailableError if none is named and there are no rooms.
    """
    named = named_vocabulary(option)
    if named is not None:
        return named
    rooms = training_rooms(sequence)
    settings = f"{rooms} {TRAINING_FRAMES} {TRAINING_STEP} {TRAINING_WIDTH} {FEATURES} {BRANCHES} {LEVELS}"
    path = cache_folder() / f"orb-{hashlib.sha256(settings.encode()).hexdigest()[:16]}.txt"
    if not path.exists():
        log(f"no ORB vocabulary is named: training one on {', '.join(rooms)}; this takes a minute, once")
        vocabulary = train_vocabulary(orb_descriptors(room_images(rooms)))
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(f".{os.getpid()}.part")
        part.write_text(vocabulary.text())
        part.replace(path)
    log(f"ORB vocabulary: {path.name}, trained on {', '.join(rooms)} (name the original in {VOCABULARY_VARIABLE})")
    return path


def cache_folder() -> Path:
    """The folder in which trained vocabularies are kept."""
    from panobench.rooms.cache import cache_root

    return cache_root() / "orb-vocabulary"


def training_rooms(sequence: FrameSequence) -> list[str]:
    """The built-in rooms without the one that ``sequence`` shows. Raises UnavailableError if there is none."""
    names = _rooms().sequences()
    own = sequence.name if sequence.dataset == "rooms" else ""
    rooms = [name for name in ROOMS if name in names and not own.startswith(name)]
    if not rooms:
        raise UnavailableError(
            f"no ORB vocabulary: name one in {VOCABULARY_VARIABLE} (no other room is there to train one on)"
        )
    return rooms


def _rooms() -> Dataset:
    from panobench.plugins import registry
    from panobench.specs import DatasetSpec

    dataset: Dataset = registry().get(DatasetSpec, "rooms").load()(None)
    return dataset


def room_images(rooms: list[str]) -> Iterator[NDArray[np.uint8]]:
    """Panoramas of built-in rooms without the stretched rows near the poles."""
    for room in rooms:
        sequence = _rooms().open(room, width=TRAINING_WIDTH)
        for i in range(0, min(TRAINING_FRAMES, len(sequence)), TRAINING_STEP):
            image = sequence.image(i)
            yield image[image.shape[0] // 6 : image.shape[0] * 5 // 6]


def orb_descriptors(images: Iterable[NDArray[np.uint8]]) -> list[Descriptors]:
    """ORB descriptors (N, 32) of each image."""
    import cv2

    orb = cv2.ORB_create(FEATURES, fastThreshold=7)  # type: ignore[attr-defined]
    found = []
    for image in images:
        _, descriptors = orb.detectAndCompute(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), None)
        if descriptors is not None:
            found.append(np.asarray(descriptors, dtype=np.uint8))
    return found


@dataclass
class Vocabulary:
    """A vocabulary tree: parent, descriptor (32,), leaf flag and weight of each node but the root, parents first."""

    branches: int
    levels: int
    parent: list[int] = field(default_factory=list)
    centre: list[Descriptors] = field(default_factory=list)
    leaf: list[bool] = field(default_factory=list)
    weight: list[float] = field(default_factory=list)

    @property
    def words(self) -> int:
        """How many leaves the tree has."""
        return sum(self.leaf)

    def text(self) -> str:
        """The tree in DBoW2's text format, with L1 scoring (0) and tf-idf weighting (0)."""
        lines = [f"{self.branches} {self.levels} 0 0"]
        for parent, centre, leaf, weight in zip(self.parent, self.centre, self.leaf, self.weight):
            lines.append(f"{parent} {int(leaf)} {' '.join(map(str, centre.tolist()))} {weight:.6g}")
        return "\n".join(lines) + "\n"


def train_vocabulary(
    images: list[Descriptors], branches: int = BRANCHES, levels: int = LEVELS, seed: int = 0
) -> Vocabulary:
    """Train a vocabulary tree on the images' descriptors. Raises InputError if there are too few of them."""
    data = np.concatenate(images) if images else np.zeros((0, 32), np.uint8)
    if len(data) < 2 * branches:
        raise InputError(f"{len(data)} ORB features are too few to train a vocabulary")
    owner = np.repeat(np.arange(len(images)), [len(d) for d in images])
    tree = Vocabulary(branches, levels)
    rng = np.random.default_rng(seed)
    queue = [(0, 0, np.arange(len(data)))]
    while queue:
        parent, level, members = queue.pop(0)
        groups, centres = k_medians(data[members], branches, rng)
        for k, centre in enumerate(centres):
            inside = members[groups == k]
            tree.parent.append(parent)
            tree.centre.append(centre)
            node = len(tree.parent)
            leaf = level + 1 == levels or len(inside) <= 1
            tree.leaf.append(leaf)
            tree.weight.append(float(np.log(len(images) / len(np.unique(owner[inside])))) if leaf else 0.0)
            if not leaf:
                queue.append((node, level + 1, inside))
    return tree


def nearest_descriptors(a: Descriptors, b: Descriptors) -> tuple[NDArray[np.int32], NDArray[np.intp]]:
    """For each of a (N, 32), the Hamming distance to the nearest of b (M, 32), and its index."""
    import cv2

    distance, index = cv2.batchDistance(a, b, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=1)
    return np.asarray(distance[:, 0], dtype=np.int32), np.asarray(index[:, 0], dtype=np.intp)


def k_medians(data: Descriptors, k: int, rng: np.random.Generator) -> tuple[NDArray[np.intp], Descriptors]:
    """k-medians of descriptors (N, 32): the cluster of each row, and centres (k', 32) with k' <= k, none empty.

    Initialised as in k-means++, at most ten iterations.
    """
    if len(data) <= k:  # each distinct descriptor is a cluster
        centres, groups = np.unique(data, axis=0, return_inverse=True)
        return groups.reshape(-1), centres
    chosen = [int(rng.integers(len(data)))]
    distance = nearest_descriptors(data, data[chosen])[0]
    while len(chosen) < k and distance.max() > 0:
        edges = np.cumsum(distance, dtype=np.int64)
        chosen.append(int(np.searchsorted(edges, rng.integers(edges[-1]), side="right")))
        distance = np.minimum(distance, nearest_descriptors(data, data[chosen[-1:]])[0])
    centres = data[chosen]
    groups = nearest_descriptors(data, centres)[1]
    bits = np.unpackbits(data, axis=1)
    for _ in range(10):
        members = [groups == g for g in range(len(centres))]
        sums = [(bits[m].sum(axis=0, dtype=np.int32), int(m.sum())) for m in members if m.any()]
        centres = np.packbits([2 * ones >= n for ones, n in sums], axis=1)
        again = nearest_descriptors(data, centres)[1]
        if len(centres) == len(members) and np.array_equal(again, groups):
            break
        groups = again
    used, groups = np.unique(groups, return_inverse=True)
    return groups, centres[used]
