"""A view's steps leave out Gaussians that contribute nothing to it, and nothing else."""

from __future__ import annotations

import numpy as np
from gaussian_shells import shell

from panobench.cameras.erp import ErpCamera
from panobench.methods.panogs.config import MappingOptions, PanogsConfig
from panobench.methods.panogs.mapping.mapper import Mapper
from panobench.methods.panogs.trajectory import AnchoredTrajectory
from panobench.methods.splatting.culling import STEPS, VisibilityCulling
from panobench.methods.splatting.views import View
from panobench.splat.render import Renderer

CAMERA = ErpCamera(128, 64)


def mapper(culling_px: float = 0.01) -> Mapper:
    config = PanogsConfig(mapping=MappingOptions(culling_px=culling_px))
    m = Mapper(CAMERA, Renderer(CAMERA, "sphere", config.rendering.low_pass), config, AnchoredTrajectory(), seed=0)
    for g in (shell(2.0, 0.5), shell(4.0, 0.9)):
        m.map.append(g, 0)
    return m


def view() -> View:
    return View(0, np.full((64, 128, 3), 200, np.uint8), np.eye(4))


def test_weights_are_the_pixels_each_gaussian_makes_up() -> None:
    m = mapper()
    out = m.renderer.forward(m.map.gaussians, np.eye(4), sum_weights=True)
    assert out.weights is not None
    np.testing.assert_allclose(out.weights.sum(), out.opacity.sum(), rtol=1e-4)
    ones = np.ones((3, 64, 128), np.float32)
    np.testing.assert_allclose(out.weights, out.weighted_sums(ones)[:, 0], atol=1e-3)
    assert out.weights[1500:].sum() < 0.01 * out.weights[:1500].sum()
    assert m.renderer.forward(m.map.gaussians, np.eye(4)).weights is None


def test_steps_after_the_first_leave_out_what_is_behind_and_see_the_same() -> None:
    m, v = mapper(), view()
    m.optimiser.step(v, refine_pose=False)
    hidden = v.culling.hidden(m.map.ids)
    assert hidden is not None
    assert not hidden[:1500].any()
    assert hidden[1500:].mean() > 0.9
    whole = m.renderer.forward(m.map.gaussians, v.T_wc)
    part = m.renderer.forward(m.map.gaussians, v.T_wc, culled=hidden)
    assert len(part.order) == len(whole.order) - np.count_nonzero(hidden)
    np.testing.assert_allclose(part.colour, whole.colour, atol=2e-3)
    before = m.map.gaussians.colours[hidden].copy()
    m.optimiser.step(v, refine_pose=False)
    np.testing.assert_array_equal(m.map.gaussians.colours[hidden], before)


def test_after_some_steps_everything_is_drawn_again() -> None:
    m, v = mapper(), view()
    for _ in range(STEPS + 1):
        m.optimiser.step(v, refine_pose=False)
    assert v.culling.hidden(m.map.ids) is None


def test_numbers_stay_with_their_gaussians() -> None:
    """Whatever is dropped or added between: a number is never given twice, and what is new is drawn."""
    m, v = mapper(), view()
    m.optimiser.step(v, refine_pose=False)
    unused = set(m.map.ids[v.culling.hidden(m.map.ids)])
    gone = np.zeros(len(m.map), bool)
    gone[::3] = True
    gone[-5:] = True
    m.map.drop(gone)
    m.map.append(shell(3.0, 0.2, 40), 0)
    assert len(m.map.ids) == len(m.map) == len(set(m.map.ids))
    hidden = v.culling.hidden(m.map.ids)
    assert hidden is not None
    assert not hidden[-40:].any()
    assert {k for k, h in zip(m.map.ids, hidden) if h} == unused & set(m.map.ids[:-40])


def test_it_can_be_turned_off() -> None:
    m, v = mapper(culling_px=0.0), view()
    m.optimiser.step(v, refine_pose=False)
    assert v.culling.hidden(m.map.ids) is None


def test_nothing_to_note_hides_nothing() -> None:
    culling = VisibilityCulling()
    none = np.zeros(0, np.int32)
    culling.update(none, np.zeros(0, np.float32), 0.01)
    hidden = culling.hidden(np.arange(9, dtype=np.int32))
    assert hidden is not None
    assert not hidden.any()
