"""Finding plugins: a broken one is skipped with a warning that names it, and the others work on."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from panobench.errors import UnavailableError, UnknownNameError
from panobench.plugins import PluginWarning, load_registry, same_contract
from panobench.specs import CameraSpec, DepthSpec, MethodSpec


def install(site: Path, name: str, source: str) -> None:
    module = name.replace("-", "_")
    (site / f"{module}.py").write_text(source)
    info = site / f"{module}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[panobench]\n{name} = {module}\n")


GOOD = """
from panobench import CameraSpec, MethodSpec, hookimpl

@hookimpl
def register_methods():
    return [MethodSpec("good-method", "works", "good_plugin:Method")]
"""

BROKEN = {
    "raises": "raise RuntimeError('out of cheese')",
    "exits": "import sys; sys.exit(3)",
    "needs": "import no_such_package",
    "syntax": "def (:",
    "wrong-spec": (
        "from panobench import CameraSpec, hookimpl\n@hookimpl\ndef register_methods():\n"
        "    return [CameraSpec('c', '', 'x:Y')]\n"
    ),
    "wrong-hook": "from panobench import hookimpl\n@hookimpl\ndef register_metods():\n    return []\n",
    "hook-raises": "from panobench import hookimpl\n@hookimpl\ndef register_methods():\n    return 1 / 0\n",
}


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_plugin_is_skipped_by_name(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, f"broken-{kind}", BROKEN[kind])
    install(tmp_path, "good-plugin", GOOD)
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.warns(PluginWarning, match=f"plugin 'broken-{kind}'"):
        registry = load_registry()
    assert f"broken-{kind}" in registry.failures
    assert registry.get(MethodSpec, "good-method").summary == "works"
    assert "erp" in registry.specs(CameraSpec)
    sys.modules.pop("good_plugin", None)


def test_a_taken_name_is_skipped_and_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = GOOD.replace("register_methods", "register_cameras").replace(
        'MethodSpec("good-method"', 'CameraSpec("erp"'
    )
    install(tmp_path, "impostor", source)
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.warns(PluginWarning, match="camera 'erp' of plugin impostor 1.0 is skipped: built-in has that name"):
        registry = load_registry()
    assert registry.entries["camera"]["erp"].origin == "built-in"
    sys.modules.pop("impostor", None)


def test_plugins_for_a_newer_contract_are_skipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "future", GOOD.replace('"good_plugin:Method"', '"future:Method", contract="2.0"'))
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.warns(PluginWarning, match="written for contract 2.0"):
        registry = load_registry()
    assert "good-method" not in registry.specs(MethodSpec)
    sys.modules.pop("future", None)


def test_builtins_register_through_the_same_hooks() -> None:
    registry = load_registry(entry_points=False)
    assert registry.manager.has_plugin("panobench.builtins")
    assert {r.origin for r in registry.all()} == {"built-in"}
    assert {"erp", "pinhole"} <= set(registry.specs(CameraSpec))
    assert {"bootstrap", "oracle", "constant"} <= set(registry.specs(DepthSpec))


def test_every_builtin_implementation_loads() -> None:
    for registered in load_registry(entry_points=False).all():
        spec = registered.spec
        if spec.unavailable() is None:
            assert spec.load() is not None, spec


def test_unknown_names_suggest_the_nearest() -> None:
    registry = load_registry(entry_points=False)
    with pytest.raises(UnknownNameError, match="did you mean 'pinhole'"):
        registry.get(CameraSpec, "pinole")


def test_a_missing_package_is_unavailable_not_a_traceback() -> None:
    spec = MethodSpec("m", "", "no_such_package.module:Name", requires=("no_such_package",))
    assert spec.unavailable() == "needs the Python package(s) no_such_package"
    with pytest.raises(UnavailableError, match="no_such_package"):
        spec.load()


def test_a_plugin_of_contract_1_0_finds_sequences_by_their_old_name() -> None:
    import panobench

    assert panobench.Sequence is panobench.FrameSequence
    assert same_contract("1.0")
    assert not same_contract("1.2")


def test_public_names_import(tmp_path: Path) -> None:
    import panobench

    for name in panobench.__all__:
        assert getattr(panobench, name) is not None
    with pytest.raises(AttributeError, match="nonsense"):
        panobench.nonsense  # noqa: B018
    done = subprocess.run(
        [sys.executable, "-c", "import sys, panobench; print('numpy' in sys.modules)"], capture_output=True, text=True
    )
    assert done.stdout.strip() == "False"
