"""Conversion of ORB vocabularies from DBoW2's text format to FBoW's binary format, which stella_vslam reads.

After a header with signature and sizes, FBoW stores blocks of fixed size, one for each inner node and the root's first:
number of children, parent's block, k descriptors, and for each child (block, 0) or (word with its highest bit set,
weight).
Format: the declarations in vocabulary.h of FBoW, https://github.com/stella-cv/FBoW (MIT).
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panobench import InputError

SIGNATURE = struct.pack("<Q", 55824124)
_DESCRIPTOR, _ALIGNMENT, _LEAF = 32, 8, 1 << 31


def is_fbow(path: Path) -> bool:
    """Whether the file starts with FBoW's signature."""
    with path.open("rb") as file:
        return file.read(len(SIGNATURE)) == SIGNATURE


def fbow_from_dbow2(source: Path, target: Path) -> None:
    """Convert a vocabulary. Raises InputError for a file that is no DBoW2 text vocabulary of ORB features."""
    branches, parents, leaves, descriptors, weights = _read_dbow2(source)
    target.write_bytes(
        _header(branches, 1 + int((~leaves).sum())) + _blocks(branches, parents, leaves, descriptors, weights)
    )


def _read_dbow2(
    path: Path,
) -> tuple[int, NDArray[np.intp], NDArray[np.bool_], NDArray[np.uint8], NDArray[np.float32]]:
    """Branches; parent (0 is the root), leaf flag, descriptor (32,) and weight of each node except the root."""
    with path.open("rb") as file:
        head = file.readline(100).split()
        problem = "not a DBoW2 vocabulary in text format"
        if len(head) != 4 or not all(word.isdigit() for word in head):
            raise InputError(f"{problem}, nor one of FBoW", path, line=1)
        try:
            table = np.loadtxt(file, dtype=np.float32, comments=None, ndmin=2) if file.peek(1) else np.zeros((0, 0))
        except ValueError as error:
            raise InputError(f"{problem}: {str(error).splitlines()[0]}", path) from None
    columns = 2 + _DESCRIPTOR + 1
    if len(table) == 0 or table.shape[1] != columns:
        raise InputError(f"{problem} with ORB features: {columns} numbers are expected in every row", path)
    parents, descriptors = table[:, 0], table[:, 2:-1]
    leaves = table[:, 1] != 0
    if not (np.isfinite(table).all() and (descriptors >= 0).all() and (descriptors <= 255).all()):
        raise InputError(f"{problem}: descriptors are bytes from 0 to 255, all numbers finite", path)
    inner = np.concatenate([[True], ~leaves])
    known = (parents >= 0) & (parents <= len(table)) & (parents == np.round(parents))
    if not known.all() or not inner[parents.astype(np.intp)].all():
        raise InputError(f"{problem}: a row names a parent that is not there or has no children", path)
    branches = int(head[0])
    if not 0 < np.bincount(parents.astype(np.intp)).max() <= branches <= 1 << 10:
        raise InputError(f"{problem}: a node has more than the {branches} children its first line says", path)
    return branches, parents.astype(np.intp), leaves, descriptors.astype(np.uint8), table[:, -1].astype(np.float32)


def _layout(branches: int) -> np.dtype[np.void]:
    return np.dtype(
        [
            ("children", "<u2"),
            ("leaf", "<u2"),
            ("parent", "<u4"),
            ("descriptor", "u1", (branches, _DESCRIPTOR)),
            ("child", [("id", "<u4"), ("weight", "<f4")], (branches,)),
        ]
    )


def _header(branches: int, blocks: int) -> bytes:
    size = _layout(branches).itemsize  # a multiple of the alignment, as all parts are
    features = 8
    sizes = (_DESCRIPTOR, size, features, features + branches * _DESCRIPTOR, size * blocks)
    # a name of 50 bytes and the padding of a C compiler; 0 is OpenCV's type of unsigned bytes
    return SIGNATURE + struct.pack("<50s2xII4x5QiiI4x", b"orb", _ALIGNMENT, blocks, *sizes, 0, _DESCRIPTOR, branches)


def _blocks(
    branches: int,
    parents: NDArray[np.intp],
    leaves: NDArray[np.bool_],
    descriptors: NDArray[np.uint8],
    weights: NDArray[np.float32],
) -> bytes:
    inner = np.concatenate([[True], ~leaves])
    block_of = np.cumsum(inner) - 1  # for each node; the root is node 0
    word_of = np.cumsum(leaves) - 1
    order = np.argsort(parents, kind="stable")
    block = block_of[parents[order]]
    slot = np.arange(len(order)) - np.searchsorted(block, block)
    blocks = np.zeros(int(inner.sum()), _layout(branches))
    np.add.at(blocks["children"], block, 1)
    blocks["parent"][block_of[1:][~leaves]] = block_of[parents[~leaves]]
    blocks["leaf"][np.unique(block)] = np.logical_and.reduceat(leaves[order], np.unique(block, return_index=True)[1])
    blocks["descriptor"][block, slot] = descriptors[order]
    blocks["child"]["id"][block, slot] = np.where(leaves, word_of | _LEAF, block_of[1:])[order]
    blocks["child"]["weight"][block, slot] = np.where(leaves, weights, 0)[order]
    return blocks.tobytes()
