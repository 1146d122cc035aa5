"""The page of a map to walk through: what it holds, and in a real browser what it shows."""

from __future__ import annotations

import base64
import gzip
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from panobench.cameras.pinhole import PinholeCamera
from panobench.errors import UsageError
from panobench.geometry import fibonacci_sphere, make_pose, quaternion_from_matrix, so3_exp
from panobench.splat.gaussians import GaussianMap
from panobench.splat.render import Renderer
from panobench.viewer.walk.page import MOST, Walk, walk_page, write_walk

sys.path.insert(0, str(Path(__file__).parents[1] / "report"))
from chromium_pipe import Page, find_chromium

CHROMIUM = find_chromium()
browser_test = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium (name it in CHROMIUM)")


def hall(n: int = 4000) -> GaussianMap:
    """Round about the origin, flat Gaussians of many colours and opacities; far away a white shell."""
    rng = np.random.default_rng(5)
    rays, far = fibonacci_sphere(n), fibonacci_sphere(60)
    means = np.concatenate([rays * (2.0 + 0.5 * np.sin(5 * rays[:, :1])), 200.0 * far])
    half = np.concatenate([rays, far]) + [0.0, 0.0, 1.0]
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    quats = np.concatenate([rng.normal(0, 0.1, (len(half), 1)), half], axis=1)
    scales = np.log(np.concatenate([rng.uniform(0.005, 0.14, (n, 3)), np.full((60, 3), 40.0)]))
    colours = np.concatenate([0.5 + 0.6 * np.sin(7 * rays), np.ones((60, 3))])
    logits = np.concatenate([rng.uniform(-2, 4, n), np.full(60, 4.0)])
    return GaussianMap(*(np.asarray(a, np.float32) for a in (means, scales, quats, logits, colours)))


def walk() -> Walk:
    t = np.linspace(0, 1, 30)
    positions = np.stack([0.8 * np.sin(2 * t), -0.1 * t, 0.8 * np.cos(2 * t)], axis=1)
    T_wc = make_pose(so3_exp(np.stack([0.1 * np.sin(4 * t), 2 * t, 0 * t], axis=1)), positions)
    return Walk("a <b> & c", hall(), T_wc, (0, 10, 20), ("4\u202f060 Gaussians",))


def part(page: str, name: str) -> str:
    found = re.search(rf'<script type="[a-z/]+" id="{name}">(.*?)</script>', page, re.DOTALL)
    assert found
    return found[1]


def test_the_page_is_one_file_and_escapes_what_comes_from_data() -> None:
    page = walk_page(walk())
    assert "a &lt;b&gt; &amp; c" in page
    assert "<b>" not in page
    assert not re.search(r"https?://|<link|<img| src=", page)
    about = json.loads(part(page, "about"))
    assert len(about["keyframes"]) == 3
    assert len(about["path"]) == 30
    assert about["start"] == about["keyframes"][0]
    assert about["up"][1] < -0.99
    assert 2 < about["frame"]["radius"] < 20, "the far shell is not in the frame"


def test_the_columns_hold_the_map() -> None:
    page, made = walk_page(walk()), hall()
    data, n = gzip.decompress(base64.b64decode(part(page, "map"))), len(made)
    assert len(data) == 33 * n
    assert np.array_equal(np.frombuffer(data, "<f4", 3 * n).reshape(n, 3), made.means)
    rest = np.frombuffer(data, "<i2", 10 * n, 12 * n)
    about = json.loads(part(page, "about"))
    assert np.abs(rest[: 3 * n].reshape(n, 3) / about["scaleSteps"] - made.log_scales).max() < 3e-4
    assert np.abs(rest[7 * n :].reshape(n, 3) / about["colourSteps"] - made.colours).max() < 2e-4


def test_a_large_map_stays_below_15_megabytes() -> None:
    rng = np.random.default_rng(1)

    def made(n: int) -> Walk:
        return Walk("large", GaussianMap(*(rng.normal(0, 1, s).astype(np.float32) for s in shapes(n))))

    def shapes(n: int) -> list[tuple[int, ...]]:
        return [(n, 3), (n, 3), (n, 4), (n,), (n, 3)]

    assert len(walk_page(made(100_000))) < 5_000_000
    page = walk_page(made(MOST + 50_000))
    assert json.loads(part(page, "about"))["count"] == MOST
    assert len(page) < 15_000_000


def test_a_map_with_nothing_to_show_is_refused(tmp_path: Path) -> None:
    made = hall(200)
    made.opacity_logits[:] = -20.0
    with pytest.raises(UsageError, match="nothing to show"):
        write_walk(Walk("t", made), tmp_path / "a.html")
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def browser() -> Iterator[Page]:
    with Page(str(CHROMIUM), 480, 320) as page:
        yield page


@pytest.fixture
def opened(browser: Page, tmp_path: Path) -> Page:
    write_walk(walk(), tmp_path / "walk.html")
    browser.errors.clear()
    browser.requests.clear()
    browser.resize(480, 320)
    browser.open(tmp_path / "walk.html", settle=0)
    browser.wait("WALK.ready")
    return browser


def pixels(page: Page, *, path: bool = False) -> np.ndarray:
    """What the canvas shows (H, W, 3), on black; without the path unless asked for."""
    button = "document.getElementById('path')"
    page.evaluate(f"if ({button}.ariaPressed !== '{str(path).lower()}') {button}.click()")
    page.evaluate("WALK.renderer.background = [0, 0, 0]; WALK.paint()")
    data = page.evaluate("WALK.canvas.toDataURL('image/png')")
    image = cv2.imdecode(np.frombuffer(base64.b64decode(data.partition(",")[2]), np.uint8), cv2.IMREAD_COLOR)
    return image[..., ::-1].astype(np.float64)


def own(T_wc: np.ndarray, width: int = 480, height: int = 320) -> np.ndarray:
    """Our own render of the same view: 90 degrees along the longer side."""
    focal = max(width, height) / 2
    camera = PinholeCamera(width, height, focal, focal, width / 2, height / 2)
    return 255 * np.clip(Renderer(camera).forward(hall(), T_wc).colour, 0, 1)


def place(page: Page, T: np.ndarray) -> None:
    w, x, y, z = quaternion_from_matrix(T[:3, :3]).tolist()
    page.evaluate(f"WALK.place({{eye: {T[:3, 3].tolist()}, q: {[x, y, z, w]}}})")


@pytest.mark.browser
@browser_test
def test_it_shows_what_our_own_renderer_shows(opened: Page) -> None:
    poses = walk().T_wc
    apart = np.abs(pixels(opened) - own(poses[0]))
    assert apart.mean() < 1.0, "it opens at the first pose"
    assert np.quantile(apart, 0.99) < 4.0
    for T in (poses[17], make_pose(so3_exp([0.9, -1.2, 0.4]), [1.2, 0.9, -0.3])):
        place(opened, T)
        assert np.abs(pixels(opened) - own(T)).mean() < 1.0
    assert np.abs(own(poses[0]) - own(poses[17])).mean() > 20, "other poses look different"
    assert opened.errors == []
    assert len(opened.requests) == 1


@pytest.mark.browser
@browser_test
def test_the_path_is_drawn_and_flown_along(opened: Page) -> None:
    place(opened, make_pose(so3_exp([-np.pi / 2, 0, 0]), [0.4, -1.2, 0.5]))  # from above, straight down
    bare, drawn = pixels(opened), pixels(opened, path=True)
    changed = np.abs(bare - drawn).max(axis=2) > 20
    assert 100 < changed.sum() < 0.2 * changed.size
    opened.evaluate("WALK.seek(239)")
    T = walk().T_wc[-1]
    assert np.abs(np.array(opened.evaluate("WALK.camera.eye")) - T[:3, 3]).max() < 0.05
    opened.evaluate("WALK.seek(0); document.getElementById('fly').click()")
    opened.wait("Number(document.getElementById('along').value) > 1")
    moved = opened.evaluate("WALK.camera.eye")
    assert np.linalg.norm(np.array(moved) - walk().T_wc[0, :3, 3]) > 1e-3
    opened.evaluate("document.getElementById('fly').click()")
    assert opened.evaluate("document.getElementById('fly').ariaPressed") == "false"


@pytest.mark.browser
@browser_test
def test_from_above_one_sees_into_the_hall_without_the_far_shell(opened: Page) -> None:
    opened.evaluate("WALK.show(true)")
    opened.wait("Math.abs(WALK.camera.eye[1]) > 2")
    opened.evaluate("new Promise(done => setTimeout(done, 700))")
    image = pixels(opened)
    assert image[:10].max() < 30, "nothing at the border, where the white shell would be"
    assert image[120:200, 200:280].mean() > 30


@pytest.mark.browser
@browser_test
def test_dragging_turns_and_keys_move(opened: Page) -> None:
    R, eye = (np.array(opened.evaluate(f"WALK.camera.{name}")) for name in ("R", "eye"))
    opened.drag((240, 160), (300, 160))
    turned = np.array(opened.evaluate("WALK.camera.R"))
    forward, left = turned.reshape(3, 3)[:, 2], -R.reshape(3, 3)[:, 0]
    assert forward @ left > 0.1, "the scene follows the pointer to the right, the camera turns to the left"
    opened.evaluate("document.getElementById('view').focus()")
    opened.call("Input.dispatchKeyEvent", type="keyDown", key="w", code="KeyW", windowsVirtualKeyCode=87)
    opened.wait(f"Math.hypot(...WALK.camera.eye.map((v, k) => v - {eye.tolist()}[k])) > 0.05")
    opened.call("Input.dispatchKeyEvent", type="keyUp", key="w", code="KeyW", windowsVirtualKeyCode=87)
    step = np.array(opened.evaluate("WALK.camera.eye")) - eye
    assert step @ forward > 0.99 * np.linalg.norm(step)
    opened.evaluate("document.getElementById('start').click()")
    opened.wait(f"Math.hypot(...WALK.camera.eye.map((v, k) => v - {eye.tolist()}[k])) < 1e-6")


@pytest.mark.browser
@browser_test
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_fits_a_telephone_and_can_be_read(opened: Page, scheme: str) -> None:
    from test_browser import axe_source

    opened.prefer(scheme)
    opened.resize(390, 844, mobile=True)
    outside = opened.evaluate(
        "[...document.querySelectorAll('.bar, button, input')].filter(e => { const b = e.getBoundingClientRect();"
        " return b.left < 0 || b.right > innerWidth || b.bottom > innerHeight; }).length"
    )
    assert outside == 0
    source = axe_source()
    if source is None:
        pytest.skip("needs axe-core")
    opened.evaluate(source + "; 0")
    found = opened.evaluate("axe.run().then(r => r.violations.map(v => [v.id, v.impact]))")
    assert [name for name, impact in found if impact in ("serious", "critical")] == []
