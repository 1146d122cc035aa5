"""When a cached kernel is stale: once its module has changed, or any that it takes kernels or constants from.

Numba stamps a cached kernel with the file it stands in alone, although what it calls is compiled into it: after an
update it would load code that still has the callee of before. Here the stamp of a module of this package is over its
text and that of all modules of the package that it imports, directly or not.
"""

from __future__ import annotations

import functools
import hashlib
import re
from pathlib import Path
from typing import Any

_ROOT = Path(__file__).parents[1]
#: "from panobench.a import b, c" at the top of a module, also over several lines in parentheses; "import panobench.a".
_IMPORT = re.compile(r"^(?:from\s+(panobench[\w.]*)\s+import\s+(\([^)]*\)|[^\n#]*)|import\s+(panobench[\w.]*))", re.M)


def stamp_by_imports() -> None:
    """Let Numba stamp this package's kernels by ``stamp``. Does nothing to a Numba it does not know."""
    try:
        from numba.core.caching import _SourceFileBackedLocatorMixin as Locator

        of_one_file = Locator.get_source_stamp
    except (ImportError, AttributeError):
        return
    if hasattr(of_one_file, "__wrapped__"):
        return

    @functools.wraps(of_one_file)
    def get_source_stamp(self: Any) -> Any:
        path = Path(self._py_file)
        return stamp(path) if path.is_relative_to(_ROOT) and path.is_file() else of_one_file(self)

    Locator.get_source_stamp = get_source_stamp  # type: ignore[method-assign]


@functools.cache
def stamp(path: Path) -> str:
    """A digest of a module and of what it imports of this package. path: of its file, which must exist."""
    digest = hashlib.sha256()
    for module in sorted(with_imports(path)):
        digest.update(str(module.relative_to(_ROOT)).encode() + b"\0" + module.read_bytes())
    return digest.hexdigest()


def with_imports(path: Path) -> set[Path]:
    """The file of a module and those of all modules of this package that it imports, directly or not."""
    found, waiting = {path}, [path]
    while waiting:
        new = _imported(waiting.pop()) - found
        found |= new
        waiting += new
    return found


@functools.cache
def _imported(path: Path) -> frozenset[Path]:
    """The files of the modules that a file imports, but for ``__init__`` of packages, which have no kernels."""
    files = set()
    for package, names, module in _IMPORT.findall(path.read_text(encoding="utf-8")):
        parent = package or module
        children = [f"{parent}.{name.split()[0]}" for name in names.strip("()").split(",") if name.split()]
        for name in (parent, *children):
            files.add(_ROOT.joinpath(*name.split(".")[1:]).with_suffix(".py"))
    return frozenset(file for file in files if file.is_file())
