"""Specs of the built-in datasets."""

from panobench.specs import DatasetSpec

DATASETS: tuple[DatasetSpec, ...] = ()
