"""The shadow along a line: known values, symmetry, and a line that is nowhere."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from penumbra.compare.studies.profile import ProfileError, profile


def test_profile_under_the_labs_light(scenes: Path, tmp_path: Path) -> None:
    """At (3, -2, 3) brute force with 4 million points found the irradiance 0.97721693 / 40 of the
    light's radiance 40; the floor's BRDF is (1, 0, 0). Scene and line are mirrored in x = 0, the
    umbra lies in the middle, a penumbra on each side."""
    out = tmp_path / "profile.json"
    result = profile([scenes / "tp3.json"], out)
    assert json.loads(out.read_text())["rows"] == result["rows"]
    row = result["rows"][0]
    radiance = np.array(row["radiance"])
    assert radiance[-1] == pytest.approx(0.97721693 / 3, rel=1e-7)
    assert np.allclose(radiance, radiance[::-1], rtol=1e-12)
    steps = np.diff(radiance[: len(radiance) // 2 + 1])
    dark = np.flatnonzero(radiance == 0)
    assert len(dark) * 0.01 == pytest.approx(row["umbra"], abs=0.02)
    assert np.array_equal(dark, np.arange(dark[0], dark[-1] + 1)) and 300 in dark
    falls = np.flatnonzero(steps < 0)
    assert len(falls) * 0.01 >= row["penumbra"] / 2 - 0.02 and falls[-1] < dark[0]


def test_a_point_light_has_no_penumbra(scenes: Path, tmp_path: Path) -> None:
    rows = profile([scenes / f"{n}.json" for n in ("tp3_point", "tp3_disk")], tmp_path / "p.json")[
        "rows"
    ]
    assert rows[0]["penumbra"] == 0 < rows[0]["umbra"]
    assert rows[1]["penumbra"] > 0.5


def test_a_line_that_lies_in_no_plane_is_refused(scenes: Path, tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match=r"tp3\.json: the line from"):
        profile([scenes / "tp3.json"], tmp_path / "p.json", start=(-3, -1.9, 3))
    assert not (tmp_path / "p.json").exists()
