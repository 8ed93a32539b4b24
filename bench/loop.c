/* Renders the same scene as often as it is asked to, in one warm process, and says how long each
 * frame took: a frame of a millisecond cannot be timed from outside.
 *
 * usage: penumbra-loop SCENE.json
 *
 * First it prints the names that it knows, as JSON: {"version", "samplers", "estimators"}. Then each line
 *     ESTIMATOR SAMPLER WIDTH HEIGHT LIGHT_SAMPLES SEED THREADS FRAMES OUT
 * of standard input is answered by a line {"seconds": [...]}, one number a frame. OUT is a file
 * for the last frame's radiance, three planes of floats, or - for none. Exit status: 0 at the end
 * of input, 2 bad input or unwritable output. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <omp.h>

#include "frame/render.h"
#include "io/scene_json.h"

/* What is timed. */
#ifdef OTHER
#include "other.h"
#define RENDER other_render
#define RENDERER OTHER_VERSION
#else
#define RENDER render
#define RENDERER PENUMBRA_VERSION
#endif

#define COUNT(ARRAY) ((int)(sizeof(ARRAY) / sizeof *(ARRAY)))

typedef struct {
    RenderSettings settings;
    int frames;
    char out[1024];
} Request;

static void fail(const char *what)
{
    fprintf(stderr, "penumbra-loop: %s\n", what);
    exit(2);
}

static int find_name(const char *name, const char *const *names, int count)
{
    for (int i = 0; i < count; i++)
        if (strcmp(name, names[i]) == 0)
            return i;
    fail("unknown estimator or sampler");
    return 0;
}

static void print_names(const char *key, const char *const *names, int count, const char *end)
{
    printf("\"%s\": [", key);
    for (int i = 0; i < count; i++)
        printf("%s\"%s\"", i ? ", " : "", names[i]);
    printf("]%s", end);
}

static bool read_request(Request *request)
{
    char line[2048], estimator[32], sampler[32];
    if (!fgets(line, sizeof line, stdin))
        return false;
    RenderSettings s = {.samples_per_pixel = 1};
    int read = sscanf(line, "%31s %31s %d %d %d %" SCNu64 " %d %d %1023[^\n]", estimator, sampler,
                      &s.width, &s.height, &s.nb_light_samples, &s.seed, &s.threads,
                      &request->frames, request->out);
    if (read != 9 || s.width < 1 || s.height < 1 || s.width > 16384 || s.height > 16384 ||
        s.nb_light_samples < 1 || s.threads < 1 || request->frames < 1)
        fail("a request that is none");
    s.estimator =
        (Estimator)find_name(estimator, RENDER_ESTIMATOR_NAMES, COUNT(RENDER_ESTIMATOR_NAMES));
    s.sampler = (Sampler)find_name(sampler, RENDER_SAMPLER_NAMES, COUNT(RENDER_SAMPLER_NAMES));
    request->settings = s;
    return true;
}

static void write_radiance(const char *file, const float *radiance, size_t floats)
{
    FILE *stream = fopen(file, "wb");
    if (!stream)
        fail("the output file cannot be written");
    bool written = fwrite(radiance, sizeof *radiance, floats, stream) == floats;
    if (fclose(stream) != 0 || !written)
        fail("the output file cannot be written");
}

static void answer(const Scene *scene, const Request *request)
{
    size_t floats = 3 * (size_t)request->settings.width * (size_t)request->settings.height;
    float *radiance = malloc(floats * sizeof *radiance);
    /* as the program does */
    const bool states_variance = render_knows_variance(scene, &request->settings);
    float *variance = states_variance ? malloc(floats * sizeof *variance) : NULL;
    if (!radiance || (states_variance && !variance))
        fail("not enough memory");
    /* The system hands out memory when it is first touched: before the clock runs. */
    memset(radiance, 0, floats * sizeof *radiance);
    if (variance)
        memset(variance, 0, floats * sizeof *variance);
    printf("{\"seconds\": [");
    for (int frame = 0; frame < request->frames; frame++) {
        double start = omp_get_wtime();
        if (!RENDER(scene, &request->settings, radiance, variance, NULL, NULL))
            fail("not enough memory");
        printf("%s%.9f", frame ? ", " : "", omp_get_wtime() - start);
    }
    if (strcmp(request->out, "-") != 0)
        write_radiance(request->out, radiance, floats);
    printf("]}\n");
    fflush(stdout);
    free(radiance);
    free(variance);
}

int main(int argc, char **argv)
{
    Scene scene;
    char message[1024];
    if (argc != 2)
        fail("usage: penumbra-loop SCENE.json");
    if (!scene_read(argv[1], &scene, NULL, message, sizeof message))
        fail(message);
    printf("{\"version\": \"%s\", ", RENDERER);
    print_names("samplers", RENDER_SAMPLER_NAMES, COUNT(RENDER_SAMPLER_NAMES), ", ");
    print_names("estimators", RENDER_ESTIMATOR_NAMES, COUNT(RENDER_ESTIMATOR_NAMES), "}\n");
    fflush(stdout);
    Request request;
    while (read_request(&request))
        answer(&scene, &request);
    scene_free(&scene);
    return 0;
}
