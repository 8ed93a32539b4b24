"""Computes the image without noise."""

from __future__ import annotations

import argparse

from penumbra.cli.arguments import (
    Subcommands,
    add_out,
    add_scene,
    add_size,
    add_subcommand,
    positive,
)
from penumbra.cli.exit import PASS
from penumbra.compare.run.output import named
from penumbra.compare.run.provenance import VERSION


def add(subcommands: Subcommands) -> None:
    parser = add_subcommand(
        subcommands,
        "exact",
        run,
        "Compute the image without noise, penumbra included.",
        "penumbra exact scenes/tp3.json -o build/exact/tp3.exr",
    )
    add_scene(parser)
    add_out(parser, "OUT.exr", named(".exr"))
    add_size(parser, "the scene's")
    parser.add_argument(
        "--pixel-grid",
        type=positive,
        default=1,
        metavar="K",
        help="mean over K x K positions in each pixel; 1 is the pixel's centre [1]",
    )


def run(options: argparse.Namespace) -> int:
    import numpy as np

    from penumbra.compare.exact.image import exact_image
    from penumbra.compare.measure.image import Image, write_exr
    from penumbra.compare.scene import read_scene

    scene = read_scene(options.scene)
    exact = exact_image(scene, options.width, options.height, options.pixel_grid)
    attributes: dict[str, str | int | float] = {
        "sceneName": scene.name,
        "sceneHash": scene.hash,
        "sampler": "exact",
        "pixelGrid": options.pixel_grid,
        "errorBound": float(exact.error_bound.max()),
        "software": f"penumbra {VERSION}",
    }
    write_exr(options.out, Image(exact.radiance, np.zeros_like(exact.radiance), attributes))
    return PASS
