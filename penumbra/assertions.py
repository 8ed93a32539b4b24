"""What an instructor's own tests assert of a student's pictures, with or without pytest.

Each raises an AssertionError that says what was found, where the picture is and which command
shows it: Refuted if the claim is wrong, CannotTell if these pictures neither show nor refute it. A
test that cannot tell has shown nothing, so it fails too. What cannot be read, or is of another
scene, raises what the rest of Penumbra raises (a ValueError that names the file).
"""

from __future__ import annotations

import functools
import itertools
import math
import shlex
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ParamSpec, TypeAlias

from penumbra.language import N_, _, of_environment, say, speaking

if TYPE_CHECKING:  # numpy and all that takes time is loaded by the first assertion
    import numpy as np

    from penumbra.compare.measure.agreement import Row
    from penumbra.compare.measure.image import Image
    from penumbra.compare.measure.slope import Slope

    Picture: TypeAlias = str | Path | np.ndarray
    """A file, or (H, W, 3) radiance [W m^-2 sr^-1], row 0 on top"""

MOST_SEEDS = 64
"""More than that would settle nothing that a wider tolerance should not"""


class NotShown(AssertionError):
    """A claim that the pictures do not show."""

    def __init__(
        self,
        text: str,
        picture: Path | None = None,
        command: str = "",
        write_page: Callable[[Path], None] | None = None,
    ) -> None:
        """text: the verdict's sentence, then what it rests on. picture: the one it speaks of.
        command: what shows it. write_page: writes the page of it to a file."""
        self.sentence = text.partition("\n")[0]
        self.picture, self.command, self.write_page = picture, command, write_page
        more = [say("picture: {picture}", picture=picture)] if picture else []
        more += [say("to see it: {command}", command=command)] if command else []
        super().__init__("\n".join([text.rstrip(), *([""] if more else []), *more]))


class Refuted(NotShown):
    """The pictures show that the claim is wrong."""


class CannotTell(NotShown):
    """The pictures neither show nor refute the claim; the text says what would settle it."""


Arguments = ParamSpec("Arguments")


def _spoken(assertion: Callable[Arguments, None]) -> Callable[Arguments, None]:
    """It speaks the environment's language: nobody gives a test a --lang."""

    @functools.wraps(assertion)
    def speaks(*arguments: Arguments.args, **options: Arguments.kwargs) -> None:
        __tracebackhide__ = True
        with speaking(of_environment()):
            assertion(*arguments, **options)

    return speaks


@_spoken
def assert_right(
    images: Picture | Sequence[Picture],
    *,
    scene: str | Path = "tp3",
    light_samples: int | None = None,
    pixel_samples: int | None = None,
    hint: int = 3,
) -> None:
    """Pictures of one scene by one renderer show its direct light right, as `penumbra check` says.

    images: files (.png, .jpg, .bmp, .exr, .pfm, .hdr, and here also .ppm and .npy) or arrays
    (H, W, 3) of radiance [W m^-2 sr^-1], row 0 on top. scene: a file, or the name of one of
    Penumbra's. light_samples, pixel_samples: of all of them; None: as the files' names say
    (n016_aa01.png). hint: how much the text gives away, from 0, the verdict, to 3, all: for tests
    that students run too.

    Raises Refuted, CannotTell; CheckError, ImageError, SceneError, ValueError for what cannot be
    checked.
    """
    __tracebackhide__ = True
    import numpy as np

    from penumbra.compare.check.checking import check
    from penumbra.compare.check.explanation import text

    several = [images] if isinstance(images, str | Path | np.ndarray) else list(images)
    kept = _Kept()
    files = [kept.readable(one, f"image{i}.npy") for i, one in enumerate(several, start=1)]
    checked = check(files, _scene_file(scene), light_samples, pixel_samples)
    found = checked.verdict
    if found.verdict == "right":
        kept.discard()
        return

    def write_page(file: Path) -> None:
        from penumbra.report.check_page import write_page

        write_page(file, checked, hint)

    raised = Refuted if found.verdict == "wrong" else CannotTell
    raise raised(
        text(found, hint),
        kept.visible(Path(checked.lead.picture.name)),
        _check_command(files, scene, light_samples, pixel_samples, hint),
        write_page,
    )


@_spoken
def assert_agrees(
    image: Picture,
    reference: Picture,
    delta: float | None = None,
    *,
    scene: str | Path = "tp3",
) -> None:
    """An image shows the reference's radiance, in every region, as `penumbra compare` says.

    image, reference: files that `penumbra compare` reads, or arrays; reference may be "exact".
    delta: the bias, relative to a region's mean, that still agrees; 0.0005 unless it is given
    (0.001 where one of the two is Cycles'). The image's noise must be small enough to tell.

    Raises Refuted, CannotTell; ComparisonError, ImageError, SceneError, ValueError for what cannot
    be compared.
    """
    __tracebackhide__ = True
    from penumbra.compare.measure.agreement import EXACT, compare_files, format_rows, passes

    kept = _Kept()
    file = kept.readable(image, "image.exr")
    other: str | Path = EXACT
    if not isinstance(reference, str) or reference != EXACT:
        other = kept.readable(reference, "reference.exr")
    scene_file = _scene_file(scene)
    rows = compare_files(file, other, scene_file, delta=delta).rows
    failing = [row for row in rows if not passes(row)]
    if not failing:
        kept.discard()
        return
    contradicted = [row for row in failing if _contradicts(row)]
    row = contradicted[0] if contradicted else max(failing, key=_width)
    if contradicted:
        sentence = _difference(row)
    else:
        is_coarse = any(_read(one).is_eight_bit for one in (file, other) if isinstance(one, Path))
        sentence = _doubt(row, is_coarse)
    command = ["penumbra", "compare", str(file), str(other), "--scene", str(scene_file)]
    command += [] if delta is None else ["--delta", f"{delta:g}"]
    raise (Refuted if contradicted else CannotTell)(
        f"{sentence}\n\n{format_rows(rows)}", kept.visible(file), shlex.join(command)
    )


@_spoken
def assert_noise_falls(
    render: Callable[[int, int], Picture] | Mapping[int, Sequence[Picture]],
    slope: float = -0.5,
    *,
    light_samples: Sequence[int] = (4, 8, 16, 32, 64),
    seeds: int = 4,
    tolerance: float = 0.1,
    scene: str | Path = "tp3",
    hint: int = 3,
) -> None:
    """The noise falls with the number N of light samples at least as fast as N^slope.

    render: render(light_samples, seed), which gives a file that `penumbra compare` reads or an
    array, and is called `seeds` times for each N, each time with another seed; or the pictures
    themselves, N -> four or more of different seeds. Noise is what differs between two pictures of
    one N, so that neither a bias nor another pixel grid counts: compare.measure.noise. The slope is
    that of a straight line through the logarithms, with its 95% interval (compare.measure.slope):
    the noise falls if all of it is below slope + tolerance, and does not if all of it is above.
    slope: -0.5 for independent samples; well-spread ones fall faster, and pass. scene, hint: of the
    command that is said to show it, and of its page.

    Raises Refuted; CannotTell, which says how many seeds to give; ImageError, NoiseError,
    ValueError for pictures that cannot be used.
    """
    __tracebackhide__ = True
    import numpy as np

    from penumbra.compare.measure.noise import STEPS, noise_of_pairs
    from penumbra.compare.measure.slope import fit_slope

    kept = _Kept()
    images, last = _rendered(render, light_samples, seeds)
    counts = sorted(images)
    squares, rounding = noise_of_pairs([images[n] for n in counts])
    fit = fit_slope(np.array(counts), squares, floor=STEPS * rounding)
    limit = slope + tolerance
    if fit is not None and fit.high is not None and fit.high <= limit:
        return
    refuted = fit is not None and fit.low is not None and fit.low > limit
    if fit is None or fit.low is None or fit.high is None:
        sentence = say(
            "cannot tell how the noise falls: {reason}",
            reason=_without_slope(squares, STEPS * rounding),
        )
    else:
        sentence = say(
            N_(
                "the noise does not fall as N^{slope:g} with the number N of light samples: it "
                "falls as N^{found:.2f} (95%: {low:.2f} to {high:.2f}, and {limit:g} would do)"
            )
            if refuted
            else N_(
                "cannot tell whether the noise falls as N^{slope:g} with the number N of light "
                "samples: it falls as N^{found:.2f} (95%: {low:.2f} to {high:.2f}, and {limit:g} "
                "would do): {advice}"
            ),
            slope=slope,
            found=fit.slope,
            low=fit.low,
            high=fit.high,
            limit=limit,
            advice="" if refuted else _narrower(fit, limit, len(images[counts[0]])),
        )
    table = "".join(
        "\n" + say("  N = {n:<6d} noise {noise:.3g}", n=n, noise=mean**0.5)
        for n, mean in zip(counts, squares.mean(axis=1), strict=True)
    )
    most = counts[-1]
    file = kept.readable(last, f"n{most:03d}.npy")

    def write_page(page: Path) -> None:
        from penumbra.compare.check.checking import check
        from penumbra.report.check_page import write_page

        write_page(page, check([file], _scene_file(scene), most), hint)

    raise (Refuted if refuted else CannotTell)(
        f"{sentence}\n{table}",
        kept.visible(file),
        _check_command([file], scene, most, None, hint),
        write_page,
    )


def _rendered(
    render: Callable[[int, int], Picture] | Mapping[int, Sequence[Picture]],
    light_samples: Sequence[int],
    seeds: int,
) -> tuple[dict[int, list[Image]], Picture]:
    """N -> images, and the last picture of the largest N. Each is read before the next is rendered,
    which may go to the same file. Raises ImageError; ValueError for too few to give a slope with
    its interval."""
    if isinstance(render, Mapping):
        several: list[tuple[int, Iterator[Picture]]]
        several = [(n, iter(pictures)) for n, pictures in sorted(render.items())]
        fewest = min(map(len, render.values()), default=0)
    else:
        seed = itertools.count(1)  # no two pictures have one: they are to be independent
        several = [
            (n, map(render, itertools.repeat(n, seeds), seed)) for n in sorted(set(light_samples))
        ]
        fewest = seeds
    if len(several) < 3 or fewest < 4:
        raise ValueError(
            _(
                "a slope and its interval need three or more numbers of light samples, and four or "
                "more seeds of each"
            )
        )
    images: dict[int, list[Image]] = {n: [] for n, _ in several}
    for n, pictures in several:
        for picture in pictures:
            images[n].append(_read(picture))
    return images, picture


def _without_slope(squares: np.ndarray, floor: float) -> str:
    """Why there is no slope with an interval, and what would give one."""
    if not squares.any():
        return _(
            "all pictures of one N are the same: let the random numbers depend on the seed, or "
            "give pictures of several seeds"
        )
    if floor > 0 and (squares.mean(axis=1) <= floor).any():
        return _(
            "the files' 8 bits (or other rounding) hide the noise of the larger N: give smaller "
            "numbers of light_samples, or images of floats (.exr, .pfm, .npy)"
        )
    return _("some pictures of one N are the same: let the random numbers depend on the seed")


def _narrower(fit: Slope, limit: float, seeds: int) -> str:
    """What would settle on which side of the limit the slope is: an interval half as wide needs
    four times the seeds."""
    assert fit.low is not None and fit.high is not None
    distance = max(abs(fit.slope - limit), 1e-9)
    needed = math.ceil(seeds * ((fit.high - fit.low) / 2 / distance) ** 2 / 2) * 2
    needed = max(needed, seeds + 2)
    if needed > MOST_SEEDS:
        return _(
            "too near to tell by more seeds: give a wider range of light_samples, or a tolerance"
        )
    return say("give seeds={needed}, or a wider range of light_samples", needed=needed)


def _difference(row: Row) -> str:
    said = say(
        "{image} and {reference} differ in “{region}”",
        image=row["image"],
        reference=row["reference"],
        region=row["region"],
    )
    low, high, bias = row["relative_low"], row["relative_high"], row["relative_bias"]
    if row["verdict"] != "differs" or low is None or high is None or bias is None:
        share = 1 - (row["consistent_fraction"] or 0)
        return say(
            "{said}: {share:.2%} of its pixels contradict a bias of {delta:.2%} or less",
            said=said,
            share=share,
            delta=row["delta"],
        )
    return say(
        "{said}: a bias of {bias:+.2%} ({confidence:.0%}: {low:+.2%} to {high:+.2%}), and "
        "{delta:.2%} would do",
        said=said,
        bias=bias,
        confidence=row["confidence"],
        low=low,
        high=high,
        delta=row["delta"],
    )


def _doubt(row: Row, is_coarse: bool) -> str:
    """is_coarse: one of the images is of 8 bits, through which place of a pixel is not known."""
    said = say(
        "cannot tell whether {image} and {reference} agree in “{region}”",
        image=row["image"],
        reference=row["reference"],
        region=row["region"],
    )
    low, high = row["relative_low"], row["relative_high"]
    if low is None or high is None:
        return say("{said}: {note}", said=said, note=row["note"])
    said += say(
        ": the bias is within {low:+.2%} and {high:+.2%}, and {delta:.2%} would do",
        low=low,
        high=high,
        delta=row["delta"],
    )
    if is_coarse:
        return say(
            "{said}: give images of floats (.exr, .pfm, .npy), or ask assert_right", said=said
        )
    wide = _width(row) / row["delta"]
    if wide <= 1:
        return say("{said}: give a larger delta, or more light samples", said=said)
    return say(
        "{said}: give about {times} times as many light samples",
        said=said,
        times=math.ceil(wide**2),
    )


def _width(row: Row) -> float:
    """Half of the interval that the relative bias is known to be in; -1: it is not"""
    low, high = row["relative_low"], row["relative_high"]
    return -1.0 if low is None or high is None else (high - low) / 2


def _contradicts(row: Row) -> bool:
    """Whether the row shows that the images differ: by its bias, or by its pixels."""
    from penumbra.compare.measure.agreement import CONSISTENT_FRACTION

    fraction = row["consistent_fraction"]
    return row["verdict"] == "differs" or (fraction is not None and fraction < CONSISTENT_FRACTION)


def _check_command(
    files: Sequence[Path],
    scene: str | Path,
    light_samples: int | None,
    pixel_samples: int | None,
    hint: int,
) -> str:
    words = ["penumbra", "check", *map(str, files), "--scene", str(scene)]
    words += ["--light-samples", str(light_samples)] if light_samples else []
    words += ["--pixel-samples", str(pixel_samples)] if pixel_samples else []
    words += ["--hint", str(hint)] if hint < 3 else []
    return shlex.join([*words, "--html", "check.html"])


def _scene_file(scene: str | Path) -> Path:
    from penumbra.cli.check import scene_named
    from penumbra.cli.exit import UsageError

    try:
        return scene_named(str(scene))
    except UsageError as error:
        raise ValueError(str(error).removeprefix("--")) from None


class _Kept:
    """Where arrays become files, which are kept if an assertion fails, so that they can be seen."""

    def __init__(self) -> None:
        self._folder: Path | None = None

    def readable(self, picture: Picture, name: str) -> Path:
        """Its file: its own, or one of that name, .npy or .exr. Raises ImageError, OSError."""
        if isinstance(picture, str | Path):
            return Path(picture)
        import numpy as np

        from penumbra.compare.measure.image import Image, write_display, write_exr

        radiance = _radiance(picture)
        self._folder = self._folder or Path(tempfile.mkdtemp(prefix="penumbra-"))
        file = self._folder / name
        if file.suffix == ".exr":
            write_exr(file, Image(radiance))
        else:
            np.save(file, radiance)
        write_display(file.with_suffix(".png"), radiance)
        return file

    def visible(self, file: Path) -> Path:
        """What people can open: of an array the .png beside it."""
        return file.with_suffix(".png") if file.parent == self._folder else file

    def discard(self) -> None:
        if self._folder:
            shutil.rmtree(self._folder, ignore_errors=True)


def _read(picture: Picture) -> Image:
    """Raises ImageError."""
    from penumbra.compare.measure.image import Image, read_image

    if isinstance(picture, str | Path):
        return read_image(picture)
    return Image(_radiance(picture))


def _radiance(picture: np.ndarray) -> np.ndarray:
    """(H, W, 3) float64. Raises ImageError."""
    import numpy as np

    from penumbra.compare.measure.image import ImageError

    radiance = np.asarray(picture)
    if radiance.ndim != 3 or radiance.shape[2] != 3 or radiance.dtype.kind not in "fiu":
        raise ImageError(
            say(
                "an array of {dtype} and shape {shape}, not (H, W, 3) of numbers",
                dtype=radiance.dtype,
                shape=radiance.shape,
            )
        )
    if radiance.dtype == np.uint8:
        raise ImageError(_("an array of bytes: divide by 255 first, or give the picture's file"))
    return radiance.astype(np.float64)
