"""Specs of the built-in studies."""

from panobench.specs import StudySpec

STUDIES: tuple[StudySpec, ...] = (
    StudySpec(
        "fov",
        "accuracy against field of view: 120, 200, 280 and 360 degrees (the paper's FoV table)",
        "panobench.studies.fov:run",
    ),
    StudySpec(
        "ablation",
        "PanoGS-SLAM with one part taken out at a time (the paper's ablation table)",
        "panobench.studies.ablation:run",
    ),
    StudySpec(
        "iterations",
        "front-end/back-end iterations against accuracy and speed (the paper's iteration table)",
        "panobench.studies.iterations:run",
    ),
    StudySpec(
        "basin",
        "the loss around a true pose, starts that converge, conditioning of the pose (the paper's basin figure)",
        "panobench.studies.basin:run",
    ),
    StudySpec(
        "robustness",
        "tracking under noise, blur, swinging exposure, an occluder, black and skipped frames, and fast yaw",
        "panobench.studies.robustness:run",
    ),
    StudySpec(
        "length",
        "drift, scale, memory and time per frame of long runs against the path behind the camera",
        "panobench.studies.length:run",
    ),
    StudySpec(
        "verdict",
        "how often the verdict on a run is right: wrong and right runs under an operator, walkers, blur and so on",
        "panobench.studies.verdict:run",
    ),
)
