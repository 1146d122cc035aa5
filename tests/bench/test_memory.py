"""The meter counts this process and its children."""

from __future__ import annotations

import subprocess
import sys

import numpy as np

from panobench.bench.run.memory import Meter

MIB = 1 << 20


def test_a_short_peak_of_this_process_is_seen() -> None:
    with Meter() as empty:
        pass
    with Meter() as meter:
        block = np.ones(200 * MIB, np.uint8)
        del block
    assert meter.peak_rss_bytes - empty.peak_rss_bytes > 150 * MIB


def test_children_count() -> None:
    code = "import time; b = bytearray(b'x') * (150 << 20)\nwhile time.process_time() < 0.6: pass"
    with Meter() as empty:
        pass
    with Meter() as meter:
        subprocess.run([sys.executable, "-c", code], check=True)
        cpu_s = meter.cpu_s
    assert meter.peak_rss_bytes - empty.peak_rss_bytes > 120 * MIB
    assert cpu_s > 0.3
