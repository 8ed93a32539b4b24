"""The page's pictures: pixels as PNG and half floats, error maps, and charts as SVG."""

from __future__ import annotations

import base64
import io
import re
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import matplotlib
import numpy as np
from markupsafe import Markup, escape
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import (
    FuncFormatter,
    LogLocator,
    MultipleLocator,
    NullLocator,
    ScalarFormatter,
)
from PIL import Image as PillowImage
from scipy.ndimage import uniform_filter
from scipy.special import ndtri

from penumbra.compare.exact.image import ExactImage
from penumbra.compare.measure.image import Image
from penumbra.compare.measure.metrics import luminance
from penumbra.compare.measure.statistics import estimate, scatter_test
from penumbra.language import _, localised, say
from penumbra.report.words import percent

LARGEST_HALF = 65504.0
"""largest finite IEEE half float"""

# Okabe and Ito's colours, told apart with any colour vision; every series also has a marker.
STYLES = {
    "penumbra": ("#0072b2", "o"),
    "cycles": ("#d55e00", "s"),
}
OTHER_STYLES = (("#009e73", "^"), ("#cc79a7", "D"), ("#56b4e9", "v"), ("#e69f00", "P"))
INK, FAINT, GRID, PAPER = "#222222", "#6b6b6b", "#e4e4e0", "#fdfdfb"
BACKED = {"facecolor": PAPER, "edgecolor": "none", "pad": 0.5}
"""behind a label that lies on a line"""
GUIDE_ABOVE = 1.5
RATE_STEPS = (1e-4, 1e-3, 1e-2, 1e-1, 1.0)
"""A colour of rate_maps for each; white for none at all"""
ABSENT = "#d4d4d0"
DIVERGING = "PuOr_r"
"""purple below, white at zero, orange above"""

RC: Any = {
    "font.family": "sans-serif",
    "font.size": 9,
    "svg.fonttype": "none",
    "text.parse_math": False,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
}


# Pixels


def png_uri(pixels: np.ndarray) -> str:
    """(H, W, 3) uint8 as a data: address of a PNG."""
    stream = io.BytesIO()
    PillowImage.fromarray(pixels).save(stream, "PNG")
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()


def displayed(radiance: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8, as the lab shows radiance: clamped to [0, 1], times 255, truncated."""
    return (np.clip(radiance, 0, 1) * 255).astype(np.uint8)


def packed_halves(radiance: np.ndarray) -> str:
    """(H, W, 3) as base64 of deflated half floats; compare.js unpacks it.

    Channel after channel, and in each all high bytes before all low bytes: the high bytes
    (sign, exponent) are nearly constant, which halves the size. Above 65504 is clipped.
    """
    halves = np.clip(radiance, -LARGEST_HALF, LARGEST_HALF).astype("<f2")
    planes = np.ascontiguousarray(halves.transpose(2, 0, 1)).view(np.uint8)
    low_high = planes.reshape(3, -1, 2)
    ordered = low_high[:, :, ::-1].transpose(0, 2, 1)
    deflate = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)
    data = deflate.compress(np.ascontiguousarray(ordered).tobytes()) + deflate.flush()
    return base64.b64encode(data).decode()


@dataclass(frozen=True)
class Crop:
    """A window of an image [pixels]."""

    left: int
    top: int
    width: int
    height: int

    def of(self, values: np.ndarray) -> np.ndarray:
        return values[self.top : self.top + self.height, self.left : self.left + self.width]


def crop_around(interest: np.ndarray, width: int, height: int) -> Crop:
    """The window of that size where interest (H, W) sums highest; the middle if it is zero."""
    rows, columns = interest.shape
    width, height = min(width, columns), min(height, rows)
    centres = (
        slice(height // 2, rows - (height - 1) // 2),
        slice(width // 2, columns - (width - 1) // 2),
    )
    sums = uniform_filter(interest.astype(np.float64), (height, width), mode="constant")[centres]
    if sums.max() <= 0:
        return Crop((columns - width) // 2, (rows - height) // 2, width, height)
    # Among equals (a wide flat top) the middle one.
    best = np.argwhere(sums >= sums.max() * (1 - 1e-9))
    top, left = best[len(best) // 2]
    return Crop(int(left), int(top), width, height)


def relative_difference(image: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """(y - y_ref) / y_ref, y the mean of the channels. (H, W, 3) each -> (H, W).

    Where the reference is 0: 0 if the image is 0 too, else infinite, so that light leaking
    into the umbra shows.
    """
    y, y_ref = luminance(image), luminance(reference)
    difference = y - y_ref
    dark = y_ref == 0
    ratio = difference / np.where(dark, 1, y_ref)
    return np.where(dark & (difference != 0), np.copysign(np.inf, difference), ratio)


def standardised_difference(image: Image, exact: ExactImage) -> np.ndarray:
    """z of each pixel, (H, W): the normal quantile of compare's two-sided p-value, signed.

    Raises StatisticsError if the image has no variance.
    """
    truth = estimate(Image(exact.radiance, np.zeros_like(exact.radiance)), exact.error_bound)
    shown = estimate(image)
    classes = 4 * exact.object_id + exact.shadow
    p = scatter_test(shown, truth, classes)
    return np.copysign(-ndtri(p / 2), shown.mean - truth.mean)


def diverging_map(values: np.ndarray, limit: float, background: np.ndarray) -> np.ndarray:
    """(H, W) values in [-limit, limit] as colours, background (bool) in grey. (H, W, 3) uint8."""
    position = np.clip(values / limit, -1, 1) / 2 + 0.5
    colours = (colormaps[DIVERGING](position)[..., :3] * 255).round().astype(np.uint8)
    colours[background] = (225, 225, 225)
    return colours


def diverging_stops(count: int = 9) -> list[str]:
    """The colours of diverging_map from -limit to limit, for a colour bar in CSS."""
    return [
        "#" + "".join(f"{round(c * 255):02x}" for c in colormaps[DIVERGING](i / (count - 1))[:3])
        for i in range(count)
    ]


# Charts


@dataclass(frozen=True)
class Series:
    """One line of a chart, with its band where low and high are known."""

    label: str
    renderer: str
    """chooses colour and marker"""
    x: Sequence[float]
    y: Sequence[float]
    low: Sequence[float] | None = None
    high: Sequence[float] | None = None


def styles(renderers: Iterable[str]) -> dict[str, tuple[str, str]]:
    """Colour and marker of each renderer, the known ones always in their own."""
    others = iter(OTHER_STYLES * 8)
    return {r: STYLES.get(r) or next(others) for r in sorted(set(renderers))}


def convergence_chart(
    name: str,
    description: str,
    series: Sequence[Series],
    style: dict[str, tuple[str, str]],
    x_label: str,
    x_base: int,
) -> Markup:
    """Relative RMSE against light samples or seconds, both axes logarithmic, as inline SVG.

    x_base: ratio of one tick of the x axis to the one before.

    The dashed guide has slope -1/2 and lies GUIDE_ABOVE times above the first series' start.
    """
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=(3.7, 3.0), layout="constrained")
        axes = figure.add_subplot()
        axes.set(xscale="log", yscale="log", xlabel=x_label, ylabel=_("relative RMSE [1]"))
        for s in series:
            colour, marker = style[s.renderer]
            _band(axes, s, colour)
            axes.plot(s.x, s.y, color=colour, marker=marker, markersize=3.6, linewidth=1.3,
                      label=s.label)  # fmt: skip
        _guide(axes, series)
        axes.legend(loc="lower left", handlelength=1.6, borderaxespad=0.2)
        for axis, base in ((axes.xaxis, x_base), (axes.yaxis, 10)):
            axis.set_major_locator(LogLocator(base, numticks=8))
            axis.set_minor_locator(NullLocator())
            axis.set_major_formatter(FuncFormatter(lambda value, place: localised(f"{value:g}")))
        return _svg(figure, name, description)


def speedup_chart(name: str, description: str, speedup: Series, cores: int | None) -> Markup:
    """Speed-up against threads, with the ideal line and the machine's cores, inline SVG."""
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=(4.6, 3.0), layout="constrained")
        axes = figure.add_subplot()
        top = max(speedup.x)
        axes.plot([1, top], [1, top], color=FAINT, linestyle=(0, (4, 3)), linewidth=1)
        axes.text((1 + 3 * top) / 4, (1 + 3 * top) / 4, " " + _("ideal") + " ", color=FAINT,
                  ha="center", va="center", bbox=BACKED)  # fmt: skip
        if cores and cores < top:
            axes.axvline(cores, color=FAINT, linewidth=0.8, linestyle=":")
            axes.annotate(say("{count} cores", count=cores), (cores, top), (4, 0),
                          textcoords="offset points", va="top", color=FAINT)  # fmt: skip
        colour, marker = STYLES["penumbra"]
        _band(axes, speedup, colour)
        axes.plot(speedup.x, speedup.y, color=colour, marker=marker, markersize=4, linewidth=1.3)
        axes.set(
            xlabel=_("OpenMP threads"), ylabel=_("speed-up over one thread [1]"), ylim=(0, None)
        )
        axes.xaxis.set_major_locator(MultipleLocator(1))
        axes.yaxis.set_major_formatter(_Scalar())
        return _svg(figure, name, description)


@dataclass(frozen=True)
class Line:
    """One line of a log_chart or profile_chart."""

    label: str
    x: Sequence[float]
    """in a log_chart: positions among its ticks"""
    y: Sequence[float]
    colour: str
    marker: str
    dashes: Any
    """matplotlib's linestyle"""
    hollow: Sequence[bool] = ()
    """marks drawn as rings"""


def log_chart(
    name: str,
    description: str,
    lines: Sequence[Line],
    x_label: str,
    ticks: Sequence[str],
    limits: Sequence[float],
    size: tuple[float, float] = (3.7, 2.7),
) -> Markup:
    """Relative errors on a logarithmic axis over named places, dotted lines at the limits, as
    inline SVG."""
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=size, layout="constrained")
        axes = figure.add_subplot()
        axes.set(yscale="log", xlabel=x_label, ylabel=_("relative error [1]"))
        low = min(min(line.y) for line in lines)
        top = max([*limits, *(max(line.y) for line in lines)])
        axes.set_ylim(low / 4, top * 4)
        for limit in limits:
            axes.axhline(limit, color=INK, linewidth=0.8, linestyle=(0, (2, 2)))
        for line in lines:
            axes.plot(line.x, line.y, color=line.colour, linestyle=line.dashes, linewidth=1.2,
                      label=line.label)  # fmt: skip
            hollow = list(line.hollow) or [False] * len(line.y)
            for x, y, ring in zip(line.x, line.y, hollow, strict=True):
                axes.plot(x, y, color=line.colour, marker=line.marker, markersize=3.6,
                          markerfacecolor=PAPER if ring else line.colour)  # fmt: skip
        step = max(1, -(-len(ticks) // 6))
        places = range(0, len(ticks), step)
        axes.set_xticks(places, [ticks[i] for i in places])
        axes.yaxis.set_major_locator(LogLocator(10, numticks=7))
        axes.yaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, place: f"{value:.0e}"))
        axes.legend(loc="best", handlelength=1.8, borderaxespad=0.2, fontsize=7.5, frameon=True,
                    facecolor=PAPER, edgecolor="none")  # fmt: skip
        return _svg(figure, name, description)


def profile_chart(
    name: str, description: str, lines: Sequence[Line], x_label: str, y_label: str
) -> Markup:
    """Values along a line, on plain axes from 0, as inline SVG."""
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=(6.4, 3.4), layout="constrained")
        axes = figure.add_subplot()
        for line in lines:
            axes.plot(line.x, line.y, color=line.colour, linestyle=line.dashes, linewidth=1.3,
                      label=line.label)  # fmt: skip
        axes.set(xlabel=x_label, ylabel=y_label, ylim=(0, None))
        axes.margins(x=0)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(_Scalar())
        axes.legend(loc="upper center", handlelength=2.6, borderaxespad=0.2)
        return _svg(figure, name, description)


def places_chart(name: str, description: str, places: np.ndarray, weights: np.ndarray) -> Markup:
    """Where a light seems to be: places (k, 2) along its edges, of areas as their weights (k,),
    beside the quad that it should be, as inline SVG."""
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=(3.7, 3.5), layout="constrained")
        axes = figure.add_subplot()
        axes.fill([0, 1, 1, 0], [0, 0, 1, 1], facecolor="#fff3c9", edgecolor="#b58900",
                  linewidth=1.3, label=_("the quad"))  # fmt: skip
        shown = weights > 0.002 * weights.max(initial=0)
        share = weights[shown] / max(float(weights.max(initial=0)), 1e-30)
        axes.scatter(places[shown, 0], places[shown, 1], s=120 * share, color=STYLES["cycles"][0],
                     alpha=0.75, linewidth=0, label=_("light"))  # fmt: skip
        axes.set(xlabel=_("s along u [1]"), ylabel=_("t along v [1]"), aspect="equal",
                 xlim=(-1.7, 2.7), ylim=(-1.7, 2.7))  # fmt: skip
        axes.legend(loc="upper right", fontsize=7.5, handlelength=1.2)
        return _svg(figure, name, description)


def rate_colours() -> tuple[Colormap, BoundaryNorm]:
    """White for a rate of 0, then a colour for each of RATE_STEPS, that rate included."""
    colours = colormaps["inferno_r"](np.linspace(0.12, 0.92, len(RATE_STEPS)))
    scheme = ListedColormap([(1, 1, 1, 1), *colours], name="rates").with_extremes(bad=ABSENT)
    edges = [np.nextafter(edge, 2) for edge in (-1.0, 0.0, *RATE_STEPS)]
    return scheme, BoundaryNorm(edges, scheme.N)


def rate_maps(
    name: str,
    description: str,
    rates: np.ndarray,
    columns: Sequence[str],
    lines: Sequence[str],
    x: tuple[str, Sequence[str]],
    y: tuple[str, Sequence[str]],
) -> Markup:
    """Panels of heat maps of rates, one scale of colours for all, as inline SVG.

    rates: (lines, columns, y, x) in [0, 1], NaN where there is none (grey). columns, lines: the
    panels' titles. x, y: an axis's label, and its values' names.
    """
    scheme, norm = rate_colours()
    with matplotlib.rc_context(RC | {"axes.grid": False, "font.size": 8}):
        figure = Figure(figsize=(9.6, 4.9), layout="constrained")
        panels = figure.subplots(len(lines), len(columns), sharex=True, sharey=True, squeeze=False)
        for place, axes in np.ndenumerate(panels):
            axes.imshow(rates[place], cmap=scheme, norm=norm, origin="lower", aspect="auto",
                        interpolation="none")  # fmt: skip
            axes.tick_params(length=0, labelsize=6.5)
            axes.set_xticks(range(len(x[1])), x[1])
            axes.set_yticks(range(len(y[1])), y[1])
        for axes, title in zip(panels[0], columns, strict=True):
            axes.set_title(title, fontsize=8.5, color=INK)
        for axes, title in zip(panels[:, 0], lines, strict=True):
            axes.set_ylabel(f"{title}\n{y[0]}", fontsize=8.5)
        for axes in panels[-1]:
            axes.set_xlabel(x[0])
        middles = [(a + b) / 2 for a, b in pairwise(norm.boundaries)]
        bar = figure.colorbar(ScalarMappable(norm, scheme), ax=panels, ticks=middles,
                              spacing="uniform", aspect=30, pad=0.01)  # fmt: skip
        bar.ax.set_yticklabels([_("none"), *(f"≤ {percent(step)}" for step in RATE_STEPS)])
        bar.ax.tick_params(length=0)
        return _svg(figure, name, description)


class _Scalar(ScalarFormatter):
    """matplotlib's own numbers, as the language that is spoken writes them."""

    def __call__(self, value: float, place: int | None = None) -> str:
        return localised(super().__call__(value, place))


def _band(axes: Axes, series: Series, colour: str) -> None:
    if series.low is not None and series.high is not None:
        axes.fill_between(series.x, series.low, series.high, color=colour, alpha=0.22, linewidth=0)


def _guide(axes: Axes, series: Sequence[Series]) -> None:
    if not series or not len(series[0].x):
        return
    first = series[0]
    x = np.array([min(min(s.x) for s in series), max(max(s.x) for s in series)])
    y = GUIDE_ABOVE * first.y[0] * (x / first.x[0]) ** -0.5
    limits = axes.get_ylim()
    axes.plot(x, y, color=FAINT, linestyle=(0, (4, 3)), linewidth=1, zorder=1)
    axes.set_ylim(limits)
    middle_x, middle_y = np.exp(np.log([x, y]).mean(axis=1))
    axes.text(middle_x, middle_y, " " + _("slope −1/2") + " ", color=FAINT, ha="center",
              va="center", bbox=BACKED)  # fmt: skip


def _svg(figure: Figure, name: str, description: str) -> Markup:
    """The figure as an <svg> element without prolog or metadata, its ids private to it."""
    stream = io.StringIO()
    keys = ("Creator", "Date", "Format", "Type")
    with matplotlib.rc_context({"svg.hashsalt": name}):
        figure.savefig(stream, format="svg", transparent=True, metadata=dict.fromkeys(keys))
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    prefix = re.sub(r"[^a-z0-9]+", "-", name.lower())
    text = re.sub(r'(\bid="|"#|url\(#)', rf"\g<1>{prefix}-", text)
    return Markup(f'<svg role="img" aria-label="{escape(description)}"' + text.removeprefix("<svg"))
