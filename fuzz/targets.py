"""Every parser under test, by name."""

from __future__ import annotations

import functools

import bag_targets
import calibration_targets
import dataset_targets
import layout_targets
import network_targets
import run_targets
import trajectory_targets
from mutate import Material

_GROUPS = (
    calibration_targets,
    trajectory_targets,
    dataset_targets,
    layout_targets,
    bag_targets,
    run_targets,
    network_targets,
)
TARGETS = {target.name: target for group in _GROUPS for target in group.TARGETS}


@functools.cache
def material(name: str) -> Material:
    """The target's documents, made once."""
    return TARGETS[name].material()
