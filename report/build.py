"""From the pipeline's files to one offline HTML page."""

from __future__ import annotations

from pathlib import Path

import jinja2
from markupsafe import Markup

from compare.run.output import write_whole
from compare.run.provenance import VERSION
from report import figures, pictures, results, self_shadow, speed, stability, trade
from report.inputs import PIXEL_SAMPLES, Data, ReportError, read_inputs

TEMPLATES = Path(__file__).resolve().parent / "template"

CONTENTS = (
    ("shadows", "Hard and soft shadows"),
    ("light", "The quad light"),
    ("ray", "One shadow ray"),
    ("samples", "More shadow rays"),
    ("compare", "Compare any two images"),
    ("agreement", "Is it right?"),
    ("convergence", "How fast does it converge?"),
    ("antialiasing", "Why is there less noise in the shadow?"),
    ("threads", "Threads"),
    ("trade", "What does a millisecond buy?"),
    ("speed", "How fast is that?"),
    ("self_shadow", "Where should a shadow ray start?"),
    ("stability", "Where do floats break?"),
    ("remake", "What was rendered, and how to remake it"),
    ("glossary", "Glossary"),
)

STYLES = ("page", "trade", "stability")
OPTIONAL = ("trade", "speed", "self_shadow", "stability")
"""Left out where they were not measured"""


def build(build_dir: Path, out: Path, scenes_dir: Path) -> None:
    """Write the page `out` from the files of `report.inputs.INPUTS` in build_dir.

    Raises ReportError for an input that is missing or unusable (naming it and the command
    that makes it), SceneError, and OSError if `out` cannot be written.
    """
    html = page(read_inputs(build_dir, scenes_dir), build_dir)
    write_whole(out, lambda part: part.write_text(html, encoding="utf-8"))


def page(data: Data, build_dir: Path) -> str:
    """The whole page as HTML, with the OPTIONAL sections that build_dir has.

    Raises ReportError for an input that lacks something.
    """
    environment = jinja2.Environment(
        autoescape=True,
        loader=jinja2.FileSystemLoader(TEMPLATES),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    try:
        sections = {
            **pictures.shadows(data),
            **results.agreement(data),
            **pictures.maps(data),
            **results.convergence(data),
            **results.antialiasing(data),
            **results.speedup(data),
            **results.provenance(data),
            **pictures.comparer(data),
            **trade.trade(data, build_dir),
            **speed.speed(build_dir),
            **self_shadow.self_shadow(build_dir),
            **stability.stability(build_dir),
        }
        sections["glance"] = results.glance(data)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise ReportError(
            f"an input lacks what the page needs ({error!r}); `make clean` and `make report` "
            "make all of them anew"
        ) from error
    return environment.get_template("page.html.j2").render(
        **sections,
        version=VERSION,
        contents=[c for c in CONTENTS if c[0] not in OPTIONAL or sections[c[0]]],
        enlarged=pictures.ENLARGED,
        pixel_samples=PIXEL_SAMPLES,
        summary=results.summary(data),
        scene=data.scenes["tp3"],
        light=figures.light_drawing(data.scenes["tp3"].quad_lights[0]),
        css=Markup("".join((TEMPLATES / f"{name}.css").read_text() for name in STYLES)),
        viewer=Markup((TEMPLATES / "viewer.js").read_text()),
        trade_script=Markup((TEMPLATES / "trade.js").read_text()),
        stability_script=Markup((TEMPLATES / "stability.js").read_text()),
    )
