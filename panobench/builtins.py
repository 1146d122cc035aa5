"""The built-in cameras, datasets, methods, estimators, metrics and studies, registered like a plugin's."""

from __future__ import annotations

from collections.abc import Sequence

from panobench.cameras.registration import CAMERAS
from panobench.datasets.registration import DATASETS
from panobench.depth.registration import DEPTH_ESTIMATORS
from panobench.hookspecs import hookimpl
from panobench.masks.registration import MASK_ESTIMATORS
from panobench.methods.registration import METHODS
from panobench.metrics.registration import METRICS
from panobench.specs import CameraSpec, DatasetSpec, DepthSpec, MaskSpec, MethodSpec, MetricSpec, StudySpec
from panobench.studies.registration import STUDIES


@hookimpl
def register_cameras() -> Sequence[CameraSpec]:
    return CAMERAS


@hookimpl
def register_datasets() -> Sequence[DatasetSpec]:
    return DATASETS


@hookimpl
def register_methods() -> Sequence[MethodSpec]:
    return METHODS


@hookimpl
def register_depth_estimators() -> Sequence[DepthSpec]:
    return DEPTH_ESTIMATORS


@hookimpl
def register_mask_estimators() -> Sequence[MaskSpec]:
    return MASK_ESTIMATORS


@hookimpl
def register_metrics() -> Sequence[MetricSpec]:
    return METRICS


@hookimpl
def register_studies() -> Sequence[StudySpec]:
    return STUDIES
