"""The conformance suite checks whether a plugin keeps the contract. A check passes, fails or is skipped with a reason.

Use ``check_spec(spec)`` for one spec, and ``assert_conforms(spec)`` in a plugin's own tests.
"""

from __future__ import annotations

import importlib.metadata
import re
import sysconfig
import traceback
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from panobench.errors import PanobenchError
from panobench.plugins import ENTRY_POINT_GROUP
from panobench.specs import CameraSpec, DatasetSpec, DepthSpec, MaskSpec, MethodSpec, MetricSpec, Spec

Outcome = Literal["pass", "fail", "skip"]
NAME = re.compile(r"[a-z0-9][a-z0-9_-]*")
_PACKAGE = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class Check:
    """One finding about one spec. message: what was seen; for a failure, what to change."""

    spec: str
    name: str
    outcome: Outcome
    message: str = ""


@dataclass(frozen=True)
class Options:
    """How to check. root: data folder, for a dataset that needs one. seed: given to methods and estimators.

    preset: of a method's options ("": its defaults), for methods that are too slow with their defaults.
    """

    root: Path | None = None
    seed: int = 7
    preset: str = ""


class Failed(Exception):
    """Raised inside a check when the contract is broken; the message is for the author."""


class Skipped(Exception):
    """Raised inside a check that does not apply or cannot run here."""


def require(condition: object, message: str) -> None:
    """Fail the current check unless ``condition`` holds."""
    if not condition:
        raise Failed(message)


Checks = Iterable[tuple[str, Callable[[], "str | None"]]]


def run_checks(label: str, checks: Checks) -> list[Check]:
    """Run named functions one after the other; an exception they do not expect is a failure with its place."""
    found = []
    for name, function in checks:
        try:
            found.append(Check(label, name, "pass", function() or ""))
        except Skipped as skipped:
            found.append(Check(label, name, "skip", str(skipped)))
        except Failed as failed:
            found.append(Check(label, name, "fail", str(failed)))
        except Exception as error:
            found.append(Check(label, name, "fail", f"{type(error).__name__} at {blamed_place(error)}: {error}"))
    return found


def blamed_place(error: BaseException) -> str:
    """ "file.py:12": the innermost place that is neither an installed library's nor this package's.

    A plugin that hands numpy the wrong shape is to be mended in the plugin. The innermost place of all stands where the
    error passed through no other code; a plugin that is installed as a library is recognised by its entry point.
    """
    calls = traceback.extract_tb(error.__traceback__)
    own = [call for call in calls if not _is_library(Path(call.filename))]
    last = (own or calls)[-1]
    return f"{Path(last.filename).name}:{last.lineno}"


def _is_library(path: Path) -> bool:
    """Whether the file belongs to Python, to this package, or to a distribution that registers no plugin."""
    if path.is_relative_to(_PACKAGE) or path.name.startswith("<"):
        return True
    folders = [Path(sysconfig.get_path(name)) for name in ("stdlib", "purelib", "platlib")]
    within = [folder for folder in folders if path.is_relative_to(folder)]
    if not within:
        return False
    top = path.relative_to(max(within, key=lambda folder: len(folder.parts))).parts[0].removesuffix(".py")
    plugins = importlib.metadata.entry_points(group=ENTRY_POINT_GROUP)
    return top not in {entry.value.split(":")[0].split(".")[0] for entry in plugins}


def check_spec(spec: Spec, options: Options | None = None) -> list[Check]:
    """All checks for one spec. Never raises; a spec of a kind without a suite gets the general checks only."""
    options = options or Options()
    label = f"{spec.kind} '{spec.name}'"
    found = run_checks(label, [("spec", lambda: _general(spec))])
    reason: str | None = None
    try:
        reason = spec.unavailable()
    except Exception as error:
        return [*found, Check(label, "probe", "fail", f"{type(error).__name__}: {error}; a probe returns a reason")]
    if reason is not None:
        found.append(Check(label, "probe", "pass", f"cannot run here: {reason}"))
    return found + run_checks(label, _suite(spec, options, reason))


def assert_conforms(spec: Spec, options: Options | None = None) -> None:
    """Raise AssertionError with every failed check, for use in a plugin's tests."""
    failed = [c for c in check_spec(spec, options) if c.outcome == "fail"]
    if failed:
        raise AssertionError("\n".join(f"{c.spec}, {c.name}: {c.message}" for c in failed))


def _general(spec: Spec) -> str | None:
    require(NAME.fullmatch(spec.name), f"the name '{spec.name}' is not lower-case letters, digits, '-' and '_'")
    require(spec.summary.strip(), "the summary is empty; `panobench list` shows it")
    require("\n" not in spec.summary and len(spec.summary) <= 120, "the summary is one line of up to 120 characters")
    module, colon, attribute = spec.implementation.partition(":")
    require(colon and module and attribute, f"implementation '{spec.implementation}' is not 'package.module:Name'")
    return None


def _suite(spec: Spec, options: Options, unavailable: str | None) -> Checks:
    if isinstance(spec, MethodSpec):
        from panobench.testing.check_methods import method_checks

        return method_checks(spec, options, unavailable)
    if unavailable is not None:
        return [("runs", lambda: _skip(unavailable))]
    if isinstance(spec, CameraSpec):
        from panobench.testing.check_cameras import camera_checks

        return camera_checks(spec)
    if isinstance(spec, DatasetSpec):
        from panobench.testing.check_datasets import dataset_checks

        return dataset_checks(spec, options)
    if isinstance(spec, MetricSpec):
        from panobench.testing.check_metrics import metric_checks

        return metric_checks(spec)
    if isinstance(spec, DepthSpec):
        from panobench.testing.check_depth import depth_checks

        return depth_checks(spec, options)
    if isinstance(spec, MaskSpec):
        from panobench.testing.check_masks import mask_checks

        return mask_checks(spec, options)
    return [("loads", lambda: _loads(spec))]


def _skip(reason: str) -> None:
    raise Skipped(reason)


def _loads(spec: Spec) -> None:
    require(callable(spec.load()), f"{spec.implementation} is not callable")


def same_clean_error(function: Callable[[], object], kinds: type[PanobenchError], what: str) -> None:
    """Fail unless ``function`` raises one of ``kinds`` with a message on one line."""
    try:
        function()
    except kinds as error:
        require("\n" not in str(error), f"{what}: the message has more than one line")
    except Exception as error:
        raise Failed(f"{what}: raises {type(error).__name__}, must be {kinds.__name__}: {error}") from error
    else:
        raise Failed(f"{what}: nothing is raised, must be {kinds.__name__}")
