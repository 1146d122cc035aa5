"""The map of ``sparse``: templates in the places of those of dead points."""

from __future__ import annotations

import numpy as np

from panobench.methods.sparse.pointmap import ACTIVE, DEAD, PointMap


def test_new_templates_take_the_places_of_dead_points() -> None:
    m, rng = PointMap(2), np.random.default_rng(0)
    kept: dict[int, np.ndarray] = {}
    for _ in range(40):
        templates = rng.uniform(size=(200, 2, 16, 16)).astype(np.float32)
        ids = m.add(200, templates, state=ACTIVE)
        kept |= dict(zip(ids.tolist(), templates))
        for dead in rng.permutation(list(kept))[:195].tolist():
            m.state[dead] = DEAD
            del kept[dead]
        alive = np.array(sorted(kept))
        for level in (0, 1):
            assert np.array_equal(m.templates_on(alive, level), [kept[k][level] for k in alive.tolist()])
    renewed = alive[::3]
    m.renew_templates(renewed, np.ones((len(renewed), 2, 16, 16), np.float32))
    assert (m.templates_on(renewed, 1) == 1).all()
    others = np.setdiff1d(alive, renewed)
    assert np.array_equal(m.templates_on(others, 0), [kept[k][0] for k in others.tolist()])
    assert m.size == 8000
    assert len(m._templates) < 1500, "and not one for each point there ever was"
