"""Cycles as a renderer command: python -m penumbra.blender_ref SCENE LIGHT_SAMPLES SEED OUT."""

from __future__ import annotations

import argparse
import sys

from penumbra.blender_ref import Cycles, CyclesError, MissingBlender
from penumbra.compare.measure.image import ImageError, write_exr
from penumbra.compare.run.output import named
from penumbra.compare.scene import SceneError


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m penumbra.blender_ref",
        description="Render a scene once with Blender's Cycles. For references with their own "
        "variance use `penumbra reference`.",
    )
    parser.add_argument("scene", help="scenes/*.json")
    parser.add_argument("light_samples", type=_positive, help="per pixel")
    parser.add_argument("seed", type=int, help="0 or more")
    parser.add_argument("out", type=named(".exr"), help="image to write (.exr)")
    parser.add_argument("--width", type=_positive, help="pixels, instead of the scene's")
    parser.add_argument("--height", type=_positive, help="pixels, instead of the scene's")
    parser.add_argument(
        "--antialias", action="store_true", help="uniform positions in the pixel, not its centre"
    )
    options = parser.parse_args()
    if options.seed < 0:
        parser.error("seed is 0 or more")
    try:
        with Cycles(options.scene, options.width, options.height, options.antialias) as cycles:
            write_exr(options.out, cycles.render(options.light_samples, options.seed))
    except MissingBlender as error:
        return _say(error, 3)
    except (SceneError, ImageError, CyclesError) as error:
        return _say(error, 2)
    return 0


def _positive(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value} is not 1 or more")
    return value


def _say(error: Exception, code: int) -> int:
    print(f"blender_ref: {error}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
