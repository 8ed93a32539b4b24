"""The image files that the C program writes."""

from __future__ import annotations

from pathlib import Path

import cffi
import numpy as np

from penumbra.compare.measure.image import read_image
from tests.conftest import built

WIDTH = 3000

ffi = cffi.FFI()
ffi.cdef("""
typedef struct {
    int width, height, nb_light_samples, samples_per_pixel;
    uint64_t seed;
    int threads, sampler, estimator;
} RenderSettings;
typedef struct {
    const void *scene; const RenderSettings *settings; double seconds, target_error;
    const void *spent; int untrusted_pixels; const float *radiance; const float *variance;
} ExrImage;
typedef struct {
    const char *name; char *target, *part; int descriptor; void *stream; char *buffer;
} Output;
bool output_find(const char *name, Output *output);
void output_free(Output *output);
bool exr_write(Output *output, const ExrImage *image, char *message, size_t message_size);
""")


def test_every_float_is_read_back(tmp_path: Path) -> None:
    """A row of random bits, all finite: what is written is what is read."""
    library = ffi.dlopen(str(built("lib/libpenumbra.so")))
    random = np.random.default_rng(0)
    scene = ffi.new("char[4096]")  # its name and hash, empty, and no more is read
    settings = ffi.new("RenderSettings *", [WIDTH, 1, 1, 1, 0, 1, 0, 0])
    message = ffi.new("char[200]")
    file = tmp_path / "row.exr"
    bits = random.integers(0, 2**32, 3 * WIDTH, dtype=np.uint32)
    values = (bits & np.uint32(0xBFFFFFFF)).view(np.float32)  # below 2, so finite
    image = ffi.new("ExrImage *", [scene, settings, 0, 0, ffi.NULL, 0, ffi.NULL, ffi.NULL])
    radiance = ffi.from_buffer("float[]", values)
    image.radiance = radiance
    name, output = ffi.new("char[]", str(file).encode()), ffi.new("Output *")
    assert library.output_find(name, output)
    assert library.exr_write(output, image, message, 200), ffi.string(message)
    library.output_free(output)
    assert np.array_equal(read_image(file).radiance[0].T.ravel(), values.astype(np.float64))
