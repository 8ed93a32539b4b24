#define _POSIX_C_SOURCE 200809L

#include "exr.h"

#include <errno.h>
#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#include <openexr.h>

/* Alphabetical, as the format wants them: channel i is plane 2 - i % 3 of its buffer below. */
static const char *const CHANNELS[6] = {"B", "G", "R", "variance.B", "variance.G", "variance.R"};

static exr_result_t write_header(exr_context_t exr, const ExrImage *image)
{
    const Scene *scene = image->scene;
    const RenderSettings *settings = image->settings;
    const int nb_channels = image->variance ? 6 : 3;
    char seed[24];
    snprintf(seed, sizeof seed, "%" PRIu64, settings->seed);
    int part;
    exr_result_t result = exr_add_part(exr, "image", EXR_STORAGE_SCANLINE, &part);
    /* Not compressed: that would take many times as long as rendering. */
    if (!result)
        result = exr_initialize_required_attr_simple(exr, part, settings->width, settings->height,
                                                     EXR_COMPRESSION_NONE);
    for (int c = 0; c < nb_channels && !result; c++)
        result =
            exr_add_channel(exr, part, CHANNELS[c], EXR_PIXEL_FLOAT, EXR_PERCEPTUALLY_LINEAR, 1, 1);
    if (!result)
        result = exr_attr_set_string(exr, part, "sceneName", scene->name);
    if (!result)
        result = exr_attr_set_string(exr, part, "sceneHash", scene->hash);
    if (!result)
        result = exr_attr_set_int(exr, part, "lightSamples", settings->nb_light_samples);
    if (!result)
        result = exr_attr_set_int(exr, part, "pixelSamples", settings->samples_per_pixel);
    if (!result)
        result = exr_attr_set_string(exr, part, "seed", seed);
    if (!result)
        result = exr_attr_set_string(exr, part, "sampler", RENDER_SAMPLER_NAMES[settings->sampler]);
    if (!result)
        result = exr_attr_set_string(exr, part, "estimator",
                                     RENDER_ESTIMATOR_NAMES[settings->estimator]);
    if (!result)
        result = exr_attr_set_int(exr, part, "threads", settings->threads);
    if (!result)
        result = exr_attr_set_float(exr, part, "renderSeconds", (float)image->seconds);
    if (!result && image->spent) {
        double pixels = (double)settings->width * settings->height;
        result = exr_attr_set_float(exr, part, "targetError", (float)image->target_error);
        if (!result)
            result = exr_attr_set_float(exr, part, "meanLightSamples",
                                        (float)(image->spent->light_samples / pixels));
        if (!result)
            result = exr_attr_set_float(exr, part, "pixelsAboveTarget",
                                        (float)image->spent->pixels_above);
    }
    if (!result)
        result = exr_attr_set_int(exr, part, "untrustedPixels", image->untrusted_pixels);
    if (!result)
        result = exr_attr_set_string(exr, part, "precision", REAL_NAME);
    if (!result)
        result = exr_attr_set_string(exr, part, "software", "penumbra-render " PENUMBRA_VERSION);
    return result ? result : exr_write_header(exr);
}

/* One chunk of rows: OpenEXR takes the pixels from our planes as they lie there. */
static exr_result_t write_rows(exr_context_t exr, int y, const ExrImage *image)
{
    const RenderSettings *settings = image->settings;
    const size_t width = (size_t)settings->width, plane = width * (size_t)settings->height;
    exr_chunk_info_t chunk;
    exr_encode_pipeline_t encoder = EXR_ENCODE_PIPELINE_INITIALIZER;
    exr_result_t result = exr_write_scanline_chunk_info(exr, 0, y, &chunk);
    if (!result)
        result = exr_encoding_initialize(exr, 0, &chunk, &encoder);
    if (result)
        return result;
    for (int c = 0; c < encoder.channel_count; c++) {
        const float *planes = c < 3 ? image->radiance : image->variance;
        const float *first = planes + (size_t)(2 - c % 3) * plane + (size_t)y * width;
        encoder.channels[c].encode_from_ptr = (const uint8_t *)first;
        encoder.channels[c].user_pixel_stride = sizeof(float);
        encoder.channels[c].user_line_stride = settings->width * (int32_t)sizeof(float);
    }
    result = exr_encoding_choose_default_routines(exr, 0, &encoder);
    if (!result)
        result = exr_encoding_run(exr, 0, &encoder);
    exr_encoding_destroy(exr, &encoder);
    return result;
}

static void be_silent(exr_const_context_t exr, exr_result_t code, const char *message)
{
    (void)exr;
    (void)code;
    (void)message;
}

/* The file through one large buffer: OpenEXR's own writer asks the system for every row. */
typedef struct {
    FILE *file;
    uint64_t position;
} Stream;

static int64_t write_bytes(exr_const_context_t exr, void *user, const void *bytes, uint64_t size,
                           uint64_t offset, exr_stream_error_func_ptr_t report)
{
    Stream *stream = user;
    (void)exr;
    (void)report;
    if (offset != stream->position && fseeko(stream->file, (off_t)offset, SEEK_SET) != 0)
        return -1;
    size_t written = fwrite(bytes, 1, size, stream->file);
    stream->position = offset + written;
    return written == size ? (int64_t)size : -1;
}

static exr_result_t write_image(Output *output, const ExrImage *image)
{
    Stream stream = {output->stream, 0};
    exr_context_t exr;
    exr_context_initializer_t options = EXR_DEFAULT_CONTEXT_INITIALIZER;
    options.error_handler_fn = be_silent;
    options.write_fn = write_bytes;
    options.user_data = &stream;
    exr_result_t result = exr_start_write(&exr, output->name, EXR_WRITE_FILE_DIRECTLY, &options);
    if (result)
        return result;
    result = write_header(exr, image);
    int rows = 1;
    if (!result)
        result = exr_get_scanlines_per_chunk(exr, 0, &rows);
    for (int y = 0; y < image->settings->height && !result; y += rows)
        result = write_rows(exr, y, image);
    exr_result_t closed = exr_finish(&exr);
    return result ? result : closed;
}

bool exr_write(Output *output, const ExrImage *image, char *message, size_t message_size)
{
    errno = 0;
    exr_result_t result = EXR_ERR_SUCCESS;
    bool written = output_begin(output);
    if (written) {
        result = write_image(output, image);
        int reason = errno;
        written = output_end(output, !result) && !result;
        errno = result ? reason : errno;
    }
    if (!written)
        snprintf(message, message_size, "%s: cannot be written: %s",
                 output->target ? output->target : output->name,
                 errno ? strerror(errno) : exr_get_default_error_message(result));
    return written;
}
