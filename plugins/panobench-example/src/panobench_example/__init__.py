"""Example plugin: what it registers. Nothing heavy is imported here."""

from __future__ import annotations

from panobench import MethodSpec, hookimpl

ROTATION = MethodSpec(
    "rotation",
    "frame-to-frame rotation by phase correlation; no translation (example plugin)",
    "panobench_example.rotation:Rotation",
    cameras=("erp",),
    colour=False,
    licence="GPL-3.0-or-later",
    citation="Kuglin, Hines: The phase correlation image alignment method (1975)",
    install="pip install panobench-example",
    config="panobench_example.rotation:RotationConfig",
    presets={"fast": {"window_px": 16, "iterations": 2}},
)


@hookimpl
def register_methods() -> list[MethodSpec]:
    return [ROTATION]
