"""Short table of metrics for a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from glucoloop.parts.metrics import RESULTS


def short_table(metrics: Mapping[str, Any]) -> str:
    """The most used metrics with units: of one person, or their distribution over people."""
    people = np.shape(metrics["minimum_mg_dl"])
    lines = [f"{'':31}{'5 %':>9}{'median':>9}{'95 %':>9}   of {np.prod(people, dtype=int)} people"] if people else []
    for result in filter(lambda of: of.everyday, RESULTS):
        values = np.asarray(metrics[result.name], float) / result.divisor
        finite = values[np.isfinite(values)]
        told = np.percentile(finite, [5, 50, 95]) if people and finite.size else values.reshape(-1)[:1]
        at_least = "+" if not people and result.settled and not bool(metrics[result.settled]) else ""
        numbers = "".join(f"{value:9.{result.digits}f}" for value in told)
        lines.append(f"{result.title:31}{numbers}{at_least} {result.unit}".rstrip())
    return "\n".join(lines)
