"""Datasets whose publishers offer them at an address that stays, for `panobench download`."""

from __future__ import annotations

from panobench.datasets.download import Published

_TUM_VI = {"corridor": 5, "magistrale": 6, "outdoors": 8, "room": 6, "slides": 3}
#: https://cvg.cit.tum.de/data/datasets/visual-inertial-dataset, EuRoC format, 512x512, 16 bit; MD5 beside each file.
TUM_VI = Published(
    "https://cdn3.vision.in.tum.de/tumvi/exported/euroc/512_16",
    {
        f"{kind}{number}": (f"dataset-{kind}{number}_512_16.tar",)
        for kind, count in _TUM_VI.items()
        for number in range(1, count + 1)
    },
)
