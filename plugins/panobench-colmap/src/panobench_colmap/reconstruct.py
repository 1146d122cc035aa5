"""Runs in the environment that has pycolmap 4: ``python reconstruct.py WORK``; WORK/job.json has the options."""

from __future__ import annotations

import json
import sys
from pathlib import Path


def main(work: Path) -> None:
    import numpy as np
    import pycolmap

    job = json.loads((work / "job.json").read_text())
    database = work / "database.db"
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = job["model"]
    reader.camera_params = ",".join(repr(p) for p in job["parameters"])
    if job["mask"]:
        reader.camera_mask_path = work / "mask.png"
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.num_threads = job["threads"]
    extraction.sift.max_num_features = job["features"]
    extraction.use_gpu = False
    pycolmap.extract_features(
        database,
        work / "images",
        image_names=job["images"],
        camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=reader,
        extraction_options=extraction,
        device=pycolmap.Device.cpu,
    )
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = job["threads"]
    matching.use_gpu = False
    if job["matcher"] == "exhaustive":
        pycolmap.match_exhaustive(database, matching_options=matching, device=pycolmap.Device.cpu)
    else:
        pairing = pycolmap.SequentialPairingOptions()
        pairing.overlap = job["overlap"]
        pairing.quadratic_overlap = True
        pycolmap.match_sequential(
            database, matching_options=matching, pairing_options=pairing, device=pycolmap.Device.cpu
        )
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = job["threads"]
    options.random_seed = job["seed"]
    options.extract_colors = False
    options.ba_refine_focal_length = options.ba_refine_principal_point = options.ba_refine_extra_params = False
    (work / "models").mkdir()
    models = pycolmap.incremental_mapping(database, work / "images", work / "models", options)
    if not models:
        print("no two images could be registered", flush=True)
        return
    best = max(models.values(), key=lambda model: model.num_reg_images())
    times = dict(zip(job["images"], job["times"]))
    rows = []
    for image in best.images.values():
        if image.has_pose:
            pose = image.cam_from_world().inverse()
            x, y, z, w = pose.rotation.quat  # pycolmap stores (x, y, z, w)
            rows.append((times[image.name], *pose.translation, x, y, z, w))
    lines = [" ".join(repr(float(v)) for v in row) for row in sorted(rows)]
    (work / "trajectory.tum").write_text("\n".join(lines) + "\n")
    summary = {
        "models": len(models),
        "registered": len(rows),
        "points": best.num_points3D(),
        "reprojection_error_px": float(np.round(best.compute_mean_reprojection_error(), 4)),
    }
    (work / "summary.json").write_text(json.dumps(summary))
    print(summary, flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
