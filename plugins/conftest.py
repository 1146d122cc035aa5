"""Makes the packages below importable without installing them, so that one pytest run covers all."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path[:0] = [str(p) for p in sorted(Path(__file__).parent.glob("*/src"))]
