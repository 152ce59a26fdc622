"""Latencies: percentiles of times."""

from collections.abc import Collection

import numpy as np


def percentiles_ms(times_s: Collection[float]) -> dict[str, float]:
    """Return p50, p99 and the greatest of times, in ms; nothing of none."""
    if not times_s:
        return {}
    p50, p99, most = np.percentile(list(times_s), [50, 99, 100]) * 1e3
    return {"p50": round(float(p50), 2), "p99": round(float(p99), 2), "max": round(float(most), 2)}
