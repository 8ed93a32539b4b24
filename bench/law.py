"""Medians of the rounds, and the laws of a system's error and time against the light samples."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

Row = dict[str, Any]
"""One measurement, as bench.rounds.COLUMNS say, or the median of several"""


ROUNDING = 1e-5
"""Relative errors below are partly float32's, which more samples do not reduce."""


def medians(frames: Iterable[Row]) -> list[Row]:
    """One row for each thing measured: its rounds' median, smallest and largest seconds, and the
    root of the mean of its squared errors."""
    groups: dict[tuple[Any, ...], list[Row]] = {}
    keys = ("experiment", "system", "width", "height", "light_samples", "threads")
    for row in frames:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    result = []
    for key, rows in groups.items():
        seconds = [row["seconds"] for row in rows]
        entry: Row = dict(zip(keys, key, strict=True))
        entry |= {
            "rounds": len(rows),
            "seconds": float(np.median(seconds)),
            "low": min(seconds),
            "high": max(seconds),
        }
        for name in ("relative_rmse_all", "relative_rmse_lit"):
            errors = [row[name] for row in rows if name in row]
            entry[name] = float(np.sqrt(np.mean(np.square(errors)))) if errors else None
        result.append(entry)
    return sorted(result, key=lambda r: [str(r["experiment"]), str(r["system"]), r["threads"],
                                         r["width"], r["light_samples"]])  # fmt: skip


def seconds_of(rows: Iterable[Row], system: str, **wanted: Any) -> float | None:
    """The median seconds of the only row that is so; None where there is none."""
    wanted = {"experiment": "samples", "system": system, **wanted}
    found = [r["seconds"] for r in rows if all(r[k] == v for k, v in wanted.items())]
    return found[0] if found else None


@dataclass(frozen=True)
class Law:
    """A system's error and time against the number of light samples N."""

    counts: np.ndarray
    """ascending"""
    seconds: np.ndarray
    rmse: dict[str, np.ndarray]
    """relative, by region"""

    @staticmethod
    def of(frames: Iterable[Row], system: str, threads: int) -> Law:
        rows = [
            row
            for row in medians(frames)
            if (row["experiment"], row["system"], row["threads"]) == ("samples", system, threads)
        ]
        rmse = {
            region: np.array([row[f"relative_rmse_{region}"] for row in rows], float)
            for region in ("all", "lit")
        }
        counts = np.array([row["light_samples"] for row in rows], float)
        return Law(counts, np.array([row["seconds"] for row in rows]), rmse)

    def slope(self, region: str) -> float | None:
        """Of log RMSE against log N, by least squares; None if there is no error to speak of."""
        fit = self._fit(region)
        return fit[0] if fit else None

    def samples_for(self, target: float) -> float | None:
        """N that meets the target [relative RMSE, all]; None if none does.

        Between two N measured, on the power law through both; beyond the largest, on the power
        law fitted to all. At least the smallest measured, and rounded up to three binary digits:
        no point set with an odd number of points is well stratified.
        """
        rmse = self.rmse["all"]
        if rmse[0] <= target:
            return float(self.counts[0])
        log_counts, log_rmse, wanted = np.log(self.counts), np.log(rmse), math.log(target)
        for i in range(1, len(rmse)):
            if rmse[i] <= target:
                # rising, as np.interp wants it
                between = np.interp(wanted, log_rmse[[i, i - 1]], log_counts[[i, i - 1]])
                return round_up(math.exp(float(between)))
        fit = self._fit("all")
        if not fit or fit[0] > -0.1:
            return None
        slope, offset = fit
        return round_up(max(float(self.counts[-1]), math.exp((wanted - offset) / slope)))

    def seconds_at(self, count: float) -> float:
        """Linear between the measured N, in proportion to N beyond the largest."""
        if count > self.counts[-1]:
            return float(self.seconds[-1] * count / self.counts[-1])
        return float(np.interp(count, self.counts, self.seconds))

    def _fit(self, region: str) -> tuple[float, float] | None:
        rmse = self.rmse[region]
        above = rmse > ROUNDING
        if above.sum() < 2:
            return None
        slope, offset = np.polyfit(np.log(self.counts[above]), np.log(rmse[above]), 1)
        return float(slope), float(offset)


def round_up(count: float) -> float:
    """To three significant binary digits.

    >>> [round_up(x) for x in (3.2, 16, 17, 100, 113)]
    [4.0, 16.0, 20.0, 112.0, 128.0]
    """
    step = 2.0 ** max(0, math.floor(math.log2(count)) - 2)
    return math.ceil(count / step) * step
