"""Training an ORB vocabulary, and where it comes from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from panobench.errors import InputError, UnavailableError
from panobench.external import vocabulary
from panobench.testing import TinySequence


@pytest.fixture(scope="module")
def descriptors() -> list[np.ndarray]:
    """Four images of 120 descriptors around 40 random words, six bits flipped in each."""
    rng = np.random.default_rng(0)
    words = rng.integers(0, 256, size=(40, 32), dtype=np.uint8)
    images = []
    for _ in range(4):
        bits = np.unpackbits(words[rng.integers(40, size=120)], axis=1)
        for row in bits:
            row[rng.choice(256, size=6, replace=False)] ^= 1
        images.append(np.packbits(bits, axis=1))
    return images


def tree_of(text: str) -> tuple[list[int], list[list[str]]]:
    head, *nodes = text.splitlines()
    return [int(x) for x in head.split()], [node.split() for node in nodes]


def test_the_text_is_a_dbow2_tree(descriptors: list[np.ndarray]) -> None:
    head, nodes = tree_of(vocabulary.train_vocabulary(descriptors, branches=10, levels=3).text())
    assert head == [10, 3, 0, 0]
    for number, node in enumerate(nodes, start=1):
        assert len(node) == 35
        assert 0 <= int(node[0]) < number  # parents come first
        assert all(0 <= int(byte) <= 255 for byte in node[2:34])
        assert float(node[34]) >= 0
    parents = [int(node[0]) for node in nodes]
    assert max(parents.count(p) for p in set(parents)) <= 10
    leaves = {n for n, node in enumerate(nodes, start=1) if node[1] == "1"}
    assert leaves.isdisjoint(parents)
    assert leaves | set(parents) == set(range(len(nodes) + 1))


def test_a_word_and_its_noisy_copy_meet_in_one_leaf(descriptors: list[np.ndarray]) -> None:
    tree = vocabulary.train_vocabulary(descriptors, branches=10, levels=2)
    centres = np.array([c for c, leaf in zip(tree.centre, tree.leaf) if leaf])
    distance, _ = vocabulary.nearest_descriptors(np.concatenate(descriptors), centres)
    assert np.median(distance) <= 12  # six bits from the word each; unrelated ones differ in about 128


def test_words_in_every_image_weigh_nothing(descriptors: list[np.ndarray]) -> None:
    same = [descriptors[0]] * 3
    tree = vocabulary.train_vocabulary(same, levels=2)
    assert max(w for w, leaf in zip(tree.weight, tree.leaf) if leaf) == 0


def test_the_same_seed_gives_the_same_tree(descriptors: list[np.ndarray]) -> None:
    assert (
        vocabulary.train_vocabulary(descriptors, levels=2, seed=3).text()
        == vocabulary.train_vocabulary(descriptors, levels=2, seed=3).text()
    )


def test_too_few_features_are_said() -> None:
    with pytest.raises(InputError, match="too few"):
        vocabulary.train_vocabulary([])


def test_a_named_file_is_taken_and_checked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good, bad = tmp_path / "good.txt", tmp_path / "bad.txt"
    good.write_text("10 6 0 0\n")
    bad.write_bytes(b"\x80\x04pickle\n")
    monkeypatch.setenv(vocabulary.VOCABULARY_VARIABLE, str(good))
    assert vocabulary.find_vocabulary("", TinySequence(n=1), print) == good
    with pytest.raises(InputError, match=r"bad\.txt:1: not a DBoW2 vocabulary"):
        vocabulary.named_vocabulary(str(bad))
    with pytest.raises(InputError, match="no such vocabulary"):
        vocabulary.named_vocabulary(str(tmp_path / "none.txt"))


class Rooms:
    def sequences(self) -> list[str]:
        return ["room1", "room2", "tiny"]


def test_it_never_trains_on_the_sequence_that_is_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vocabulary, "_rooms", Rooms)
    sequence = TinySequence(n=1, name="room1-seed3")
    assert vocabulary.training_rooms(sequence) == ["room1", "room2"]
    sequence.dataset = "rooms"  # type: ignore[misc]
    assert vocabulary.training_rooms(sequence) == ["room2"]
    monkeypatch.setattr(Rooms, "sequences", lambda self: ["room1"])
    with pytest.raises(UnavailableError, match=vocabulary.VOCABULARY_VARIABLE):
        vocabulary.training_rooms(sequence)


def test_a_trained_one_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, descriptors: list[np.ndarray]) -> None:
    monkeypatch.delenv(vocabulary.VOCABULARY_VARIABLE, raising=False)
    monkeypatch.setattr(vocabulary, "_rooms", Rooms)
    monkeypatch.setattr(vocabulary, "cache_folder", lambda: tmp_path / "cache")
    monkeypatch.setattr(vocabulary, "room_images", lambda rooms: iter(()))
    monkeypatch.setattr(vocabulary, "orb_descriptors", lambda images: descriptors)
    log: list[str] = []
    first = vocabulary.find_vocabulary("", TinySequence(n=1), log.append)
    assert vocabulary.named_vocabulary(str(first)) == first
    monkeypatch.setattr(vocabulary, "train_vocabulary", None)
    assert vocabulary.find_vocabulary("", TinySequence(n=1), log.append) == first
    assert sum("training one" in line for line in log) == 1
