"""Vocabularies rewritten for FBoW are read here as FBoW reads them: block by block from the root."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from panobench_stella_vslam.fbow import fbow_from_dbow2, is_fbow

from panobench import InputError
from panobench.external import Vocabulary, train_vocabulary

HEAD = "<Q50s2xII4xQQQQQiiI4x"


def some_vocabulary(branches: int = 5, levels: int = 3) -> Vocabulary:
    rng = np.random.default_rng(1)
    return train_vocabulary([rng.integers(0, 256, (80, 32), dtype=np.uint8) for _ in range(4)], branches, levels)


def differing_bits(a: bytes, b: bytes) -> int:
    return (int.from_bytes(a, "little") ^ int.from_bytes(b, "little")).bit_count()


def word_by_blocks(data: bytes, descriptor: bytes) -> tuple[int, float]:
    """Word and weight of a descriptor: in each block the nearest child, until it is a leaf."""
    _, _, _, _, padded, size, features, children, _, _, _, _ = struct.unpack_from(HEAD, data)
    start, block = struct.calcsize(HEAD), 0
    while True:
        at = start + block * size
        (count,) = struct.unpack_from("<H", data, at)
        places = [at + features + i * padded for i in range(count)]
        best = min(range(count), key=lambda i: differing_bits(data[places[i] : places[i] + 32], descriptor))
        number, weight = struct.unpack_from("<If", data, at + children + 8 * best)
        if number >> 31:
            return number & 0x7FFFFFFF, weight
        (parent,) = struct.unpack_from("<I", data, start + number * size + 4)
        assert parent == block
        block = number


def word_by_rows(vocabulary: Vocabulary, descriptor: bytes) -> tuple[int, float]:
    """The same from the tree that was written as text. Words are numbered as its leaves."""
    node = 0
    while node == 0 or not vocabulary.leaf[node - 1]:
        children = [i + 1 for i, parent in enumerate(vocabulary.parent) if parent == node]
        node = min(children, key=lambda i: differing_bits(vocabulary.centre[i - 1].tobytes(), descriptor))
    return sum(vocabulary.leaf[: node - 1]), vocabulary.weight[node - 1]


def test_every_descriptor_falls_into_the_same_word(tmp_path: Path) -> None:
    vocabulary = some_vocabulary()
    (tmp_path / "voc.txt").write_text(vocabulary.text())
    fbow_from_dbow2(tmp_path / "voc.txt", tmp_path / "voc.fbow")
    data = (tmp_path / "voc.fbow").read_bytes()
    rng = np.random.default_rng(2)
    found = set()
    for row in rng.integers(0, 256, (200, 32), dtype=np.uint8):
        word, weight = word_by_blocks(data, row.tobytes())
        expected, expected_weight = word_by_rows(vocabulary, row.tobytes())
        assert word == expected
        assert weight == pytest.approx(expected_weight, rel=1e-5)
        found.add(word)
    assert len(found) > 30  # of 125 at most: they do not all fall into one


def test_the_header_says_how_long_the_file_is(tmp_path: Path) -> None:
    vocabulary = some_vocabulary()
    (tmp_path / "voc.txt").write_text(vocabulary.text())
    fbow_from_dbow2(tmp_path / "voc.txt", tmp_path / "voc.fbow")
    data = (tmp_path / "voc.fbow").read_bytes()
    _, name, alignment, blocks, padded, size, features, children, total, kind, length, k = struct.unpack_from(
        HEAD, data
    )
    assert struct.calcsize(HEAD) == 128  # the signature and a struct of 120 bytes on 64-bit machines
    assert (name.rstrip(b"\0"), kind, length, k) == (b"orb", 0, 32, 5)
    assert blocks == 1 + vocabulary.leaf.count(False)
    assert total == blocks * size == len(data) - 128
    assert padded % alignment == size % alignment == features % alignment == 0
    assert children == features + k * padded
    assert is_fbow(tmp_path / "voc.fbow")
    assert not is_fbow(tmp_path / "voc.txt")


ROW = "0 1 " + "7 " * 32 + "0.5\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hello\n", "nor one of FBoW"),
        ("10 5 0 0\n", "35 numbers are expected"),
        ("10 5 0 0\n0 1 2 3\n", "35 numbers are expected"),
        ("10 5 0 0\n" + ROW + "0 1\n", "not a DBoW2 vocabulary"),
        ("10 5 0 0\n" + ROW.replace("0.5", "half"), "not a DBoW2 vocabulary"),
        ("10 5 0 0\n" + ROW.replace("7", "256", 1), "bytes from 0 to 255"),
        ("10 5 0 0\n" + ROW.replace("0.5", "nan"), "finite"),
        ("10 5 0 0\n" + ROW + "1" + ROW[1:], "has no children"),
        ("10 5 0 0\n" + "9" + ROW[1:], "not there"),
        ("2 5 0 0\n" + ROW * 3, "more than the 2 children"),
    ],
)
def test_what_is_no_vocabulary_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "voc.txt").write_text(text)
    with pytest.raises(InputError, match=message):
        fbow_from_dbow2(tmp_path / "voc.txt", tmp_path / "voc.fbow")
    assert not (tmp_path / "voc.fbow").exists()
