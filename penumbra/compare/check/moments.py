"""What one light sample does on average under each mistake: computed when asked for, and kept."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from pathlib import Path

import numpy as np

from penumbra.compare.check import mistaken, quadrature
from penumbra.compare.check.quadrature import Sites
from penumbra.compare.scene import read_scene

Key = tuple[str, str, str]
"""domain, visibility, weight"""


class Moments:
    """Of some sites and one light of unit radiance: (3, n) float32 for a domain, a visibility and
    a weight: the chance that a sample sees the light, and the means of V w and V w^2, where w is
    the area times the weight [sr]. Computed when asked for, by a grid x grid of jittered points at
    each site: by the library of mistakes, or where it is not built, more slowly, by quadrature.
    """

    def __init__(self, scene_file: Path, light: int, sites: Sites, grid: int) -> None:
        self.scene_file, self.light, self.sites, self.grid = scene_file, light, sites, grid
        self._table: dict[Key, np.ndarray] = {}

    def prepare(self, keys: Iterable[Key]) -> None:
        """Compute those that are not there yet: of a domain all rays with all weights."""
        missing: dict[str, list[Key]] = {}
        for key in keys:
            if key not in self._table:
                missing.setdefault(key[0], []).append(key)
        for domain, wanted in missing.items():
            rays, weights = (sorted({key[i] for key in wanted}) for i in (1, 2))
            self._compute(domain, rays, weights)

    def __getitem__(self, key: Key) -> np.ndarray:
        self.prepare([key])
        return self._table[key]

    def places(self, s: np.ndarray, t: np.ndarray) -> np.ndarray:
        """(k, n) float32 [sr]: what each of k places of the light would bring, were all of its
        power there."""
        if mistaken.is_built():
            return mistaken.places(self.scene_file, self.light, self.sites, s, t)
        return quadrature.places(_scene(self.scene_file), self.light, self.sites, s, t)

    def _compute(self, domain: str, rays: list[str], weights: list[str]) -> None:
        asked = (self.light, self.sites, domain, rays, weights, self.grid)
        if mistaken.is_built():
            chance, first, second = mistaken.moments(self.scene_file, *asked)
        else:
            chance, first, second = quadrature.moments(_scene(self.scene_file), *asked)
        for r, ray in enumerate(rays):
            for w, weight in enumerate(weights):
                self._table[domain, ray, weight] = np.stack([chance[r], first[r, w], second[r, w]])


_scene = cache(read_scene)
