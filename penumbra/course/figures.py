"""The handout's figures 1 to 4, at the brightness that its text defines: pictures, and the commands
that make them."""

from __future__ import annotations

import shlex
import subprocess
from dataclasses import dataclass
from pathlib import Path

from penumbra.compare.measure.image import Image, read_image, write_display
from penumbra.compare.run.library import PROGRAM
from penumbra.compare.run.output import write_whole
from penumbra.compare.run.provenance import HOW_TO_BUILD, ROOT
from penumbra.compare.run.renderers import MissingProgramError, RendererError

LIGHT_SAMPLES = (4, 16, 64, 256)
"""N of figure 4"""
QUAD = Path(__file__).resolve().parent / "handout" / "quad.typ"
PPI = 300
"""Of the drawing as a picture"""


@dataclass(frozen=True)
class Picture:
    """One that the renderer makes."""

    name: str
    scene: str
    """its name in scenes/"""
    options: str
    """of penumbra-render"""

    @property
    def commands(self) -> tuple[str, str]:
        """To be typed in the repository: the image, and what shows it."""
        return (
            f"build/bin/penumbra-render scenes/{self.scene}.json -o {self.name}.exr {self.options}",
            f"penumbra png {self.name}.exr -o {self.name}.png",
        )

    def render(self, folder: Path) -> Image:
        """NAME.exr in `folder`, by the first command. Raises MissingProgramError, RendererError."""
        if not PROGRAM.exists():
            raise MissingProgramError(f"{PROGRAM} is missing: {HOW_TO_BUILD}")
        out = folder.resolve() / f"{self.name}.exr"
        words = shlex.split(self.commands[0])
        words[0], words[words.index("-o") + 1] = str(PROGRAM), str(out)
        done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
        if done.returncode:
            raise RendererError(f"{self.name}: {done.stderr.strip()}")
        return read_image(out)


HARD = Picture("figure-1a", "tp3_point_statement", "--estimator exact")
SOFT = Picture("figure-1b", "tp3_statement", "--estimator exact")
ONE = Picture("figure-3", "tp3_statement", "--light-samples 1 --seed 1")
SEVERAL = tuple(
    Picture(f"figure-4-n{n}", "tp3_statement", f"--light-samples {n} --seed 1")
    for n in LIGHT_SAMPLES
)
PICTURES = (HARD, SOFT, ONE, *SEVERAL)


def commands() -> dict[str, list[str]]:
    """Figure's number -> lines for a shell in the repository."""
    counts = " ".join(map(str, LIGHT_SAMPLES))
    loop = [line.replace(f"n{LIGHT_SAMPLES[0]}", "n$n") for line in SEVERAL[0].commands]
    loop[0] = loop[0].replace(f"--light-samples {LIGHT_SAMPLES[0]}", "--light-samples $n")
    drawn = (
        "import typst; typst.compile('penumbra/course/handout/quad.typ', "
        f"output='figure-2.png', ppi={PPI}, ignore_system_fonts=True)"
    )
    return {
        "1": [*HARD.commands, *SOFT.commands],
        "2": [f'.venv/bin/python -c "{drawn}"'],
        "3": list(ONE.commands),
        "4": [f"for n in {counts}; do", *(f"  {line};" for line in loop), "done"],
    }


def write_figures(folder: Path, images: Path) -> dict[str, Image]:
    """Figures 1 to 4 as PNG into `folder`; their names and images, which `images` holds as .exr.

    Raises MissingProgramError, RendererError, ImageError, OSError; ImportError without Typst.
    """
    import typst

    rendered = {picture.name: picture.render(images) for picture in PICTURES}
    for name, image in rendered.items():
        write_display(folder / f"{name}.png", image.radiance)
    drawing = typst.compile(str(QUAD), format="png", ppi=PPI, ignore_system_fonts=True)
    assert isinstance(drawing, bytes)  # of several pages it would be a list
    write_whole(folder / "figure-2.png", lambda part: part.write_bytes(drawing))
    return rendered
