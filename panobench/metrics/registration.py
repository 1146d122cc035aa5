"""Specs of the built-in metrics."""

from panobench.specs import MetricSpec

METRICS: tuple[MetricSpec, ...] = (
    MetricSpec(
        "trajectory",
        "ATE over all frames and keyframes, RPE, rotation error (evo)",
        "panobench.metrics.trajectory:trajectory_metrics",
        requires=("evo",),
        keys={
            "ate_rmse_m": "lower",
            "ate_keyframes_rmse_m": "lower",
            "ate_se3_rmse_m": "lower",
            "scale_error_percent": "lower",
            "gravity_error_deg": "lower",
            "ate_percent": "lower",
            "ate_rotation_rmse_deg": "lower",
            "rpe_trans_rmse_m": "lower",
            "rpe_rotation_rmse_deg": "lower",
            "path_length_m": "none",
            "scale": "none",
        },
    ),
    MetricSpec(
        "challenge",
        "score of the Hilti x Trimble challenge 2026, for its own sequences",
        "panobench.metrics.challenge:challenge_metrics",
        requires=("evo",),
        keys={"challenge_score": "higher"},
    ),
    MetricSpec(
        "rendering",
        "three-view, panorama, held-out and novel-view image quality",
        "panobench.metrics.rendering:rendering_metrics",
        files="panobench.metrics.lpips:weight_files",
        keys={
            "psnr_db": "higher",
            "ssim": "higher",
            "lpips": "lower",
            "pano_psnr_db": "higher",
            "ws_psnr_db": "higher",
            "holdout_psnr_db": "higher",
            "holdout_ws_psnr_db": "higher",
            "holdout_views_psnr_db": "higher",
            "direct_psnr_db": "higher",
            "novel_psnr_db": "higher",
            "novel_ssim": "higher",
        },
    ),
    MetricSpec(
        "cost",
        "size of the map and share of frames used as keyframes",
        "panobench.metrics.cost:cost_metrics",
        keys={"map_gaussians": "none", "keyframe_share": "none"},
    ),
)
