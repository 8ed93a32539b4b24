/* The command line: the only file that prints or exits. */
#define _POSIX_C_SOURCE 200809L

#include <errno.h>
#include <getopt.h>
#include <inttypes.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

#include <omp.h>

#include "exr.h"
#include "frame/render.h"
#include "frame/trust.h"
#include "packet/adaptive.h"
#include "scene_json.h"

enum { EXIT_BAD_INPUT = 2 };

#define COUNT(array) ((int)(sizeof(array) / sizeof *(array)))

static const char HELP[] =
    "usage: penumbra-render SCENE.json -o OUT.exr [options]\n"
    "\n"
    "Renders direct lighting with soft shadows, as the lab does: for every pixel and every\n"
    "surface light, the mean of N shadow rays to random points of the light.\n"
    "\n"
    "  -o, --output OUT.exr   the image: float R, G, B and the variance of each pixel's mean\n"
    "  --light-samples N      shadow rays for each surface light (the lab's nbLightSamples),\n"
    "                         1 to 1048576 [64]\n"
    "  --pixel-samples M      anti-aliasing: 1 looks through the pixel's centre, more through M\n"
    "                         random places in it; 1 to 65536 [1]\n"
    "  --sampler NAME         how the points on a light are drawn: independent (the lab's),\n"
    "                         jittered or sobol (Owen-scrambled) [independent]\n"
    "  --estimator NAME       area: sixteen pixels at a time; textbook: the same estimate one\n"
    "                         pixel at a time, as it is taught; solid-angle: points spread\n"
    "                         evenly over the directions to the light, not its area (disks: by\n"
    "                         area); exact: no samples, no noise [area]\n"
    "  --target-error E       as many shadow rays as it takes, 16 pixels at a time, until the\n"
    "                         relative error of a pixel is below E (0.01 is 1%) at 95%; then\n"
    "                         --light-samples is the most a light may take [16384]\n"
    "  --seed S               0 to 18446744073709551615; another seed, independent noise [0]\n"
    "  --threads T            1 to 1024; changes the time, not one bit of the image [all]\n"
    "  --width W, --height H  image size, 1 to 16384 [the scene's]\n"
    "  --print-scene          print the scene in SI units as JSON and stop\n"
    "  --version, --help\n"
    "\n"
    "Exit status: 0 done, 2 usage, bad input or unwritable output, 128 + n ended by signal n.\n"
    "Example: penumbra-render scenes/tp3.json -o tp3.exr --light-samples 256\n";

typedef struct {
    const char *scene_file, *output;
    RenderSettings settings; /* width and height 0: the scene's */
    double target_error;     /* 0: none */
    bool print_scene;
} Options;

static void fail(const char *format, const char *first, const char *second)
{
    fputs("penumbra-render: ", stderr);
    fprintf(stderr, format, first, second);
    fputs("\n", stderr);
    exit(EXIT_BAD_INPUT);
}

/* What was printed may meet a full disk or a closed descriptor only now. */
static void flush_output(void)
{
    if (fflush(stdout) != 0 || ferror(stdout))
        fail("%s%s", "standard output: ", strerror(errno));
}

/* The output's unfinished file, while there is one. */
static const char *unfinished;

static void remove_unfinished(int number)
{
    unlink(unfinished);
    signal(number, SIG_DFL);
    raise(number);
}

/* Ctrl-C and `kill` end the program as ever, but leave no unfinished file. A file over the size
 * limit becomes an error of writing. */
static void guard_output(const Output *output)
{
    signal(SIGXFSZ, SIG_IGN);
    if (!output->part)
        return;
    unfinished = output->part;
    const int numbers[2] = {SIGINT, SIGTERM};
    for (int i = 0; i < 2; i++)
        if (signal(numbers[i], remove_unfinished) == SIG_IGN)
            signal(numbers[i], SIG_IGN);
}

static uint64_t parse_number(const char *option, const char *text, uint64_t low, uint64_t high)
{
    char *end;
    errno = 0;
    unsigned long long value = strtoull(text, &end, 10);
    bool digits = *text >= '0' && *text <= '9' && *end == '\0';
    if (!digits || errno || value < low || value > high) {
        char range[64];
        snprintf(range, sizeof range, "%" PRIu64 " to %" PRIu64, low, high);
        fprintf(stderr, "penumbra-render: --%s: \"%s\" is not a whole number from %s\n", option,
                text, range);
        exit(EXIT_BAD_INPUT);
    }
    return value;
}

static double parse_fraction(const char *option, const char *text)
{
    char *end;
    double value = strtod(text, &end);
    if (end == text || *end || !(value >= 1e-4 && value <= 1)) {
        fprintf(stderr, "penumbra-render: --%s: \"%s\" is not a number from 0.0001 to 1\n", option,
                text);
        exit(EXIT_BAD_INPUT);
    }
    return value;
}

static int parse_name(const char *option, const char *text, const char *const *names, int count)
{
    for (int i = 0; i < count; i++)
        if (strcmp(text, names[i]) == 0)
            return i;
    fprintf(stderr, "penumbra-render: --%s: \"%s\" is none of", option, text);
    for (int i = 0; i < count; i++)
        fprintf(stderr, "%s %s", i ? "," : "", names[i]);
    fputs("\n", stderr);
    exit(EXIT_BAD_INPUT);
}

/* A name that says that a file is something else, a picture above all, is a mistake. */
static void check_name(const char *name)
{
    static const char *const OTHERS[] = {
        ".png",  ".jpg",   ".jpeg", ".bmp",  ".gif",  ".hdr", ".pfm", ".ppm", ".tif", ".tiff",
        ".webp", ".blend", ".csv",  ".html", ".json", ".npy", ".npz", ".pdf", ".svg", ".txt"};
    const char *ending = strrchr(name, '.');
    for (int i = 0; ending && i < COUNT(OTHERS); i++)
        if (strcasecmp(ending, OTHERS[i]) == 0) {
            fprintf(stderr,
                    "penumbra-render: --output: \"%s\" does not end in .exr; for a picture of it: "
                    "penumbra png OUT.exr -o OUT.png\n",
                    name);
            exit(EXIT_BAD_INPUT);
        }
}

static Options parse_options(int argc, char **argv)
{
    enum {
        LIGHT = 1,
        PIXEL,
        SAMPLER,
        ESTIMATOR,
        TARGET,
        SEED,
        THREADS,
        WIDTH,
        HEIGHT,
        PRINT,
        VERSION,
        HELP_OPTION
    };
    static const struct option LONG[] = {{"output", required_argument, NULL, 'o'},
                                         {"light-samples", required_argument, NULL, LIGHT},
                                         {"pixel-samples", required_argument, NULL, PIXEL},
                                         {"sampler", required_argument, NULL, SAMPLER},
                                         {"estimator", required_argument, NULL, ESTIMATOR},
                                         {"target-error", required_argument, NULL, TARGET},
                                         {"seed", required_argument, NULL, SEED},
                                         {"threads", required_argument, NULL, THREADS},
                                         {"width", required_argument, NULL, WIDTH},
                                         {"height", required_argument, NULL, HEIGHT},
                                         {"print-scene", no_argument, NULL, PRINT},
                                         {"version", no_argument, NULL, VERSION},
                                         {"help", no_argument, NULL, HELP_OPTION},
                                         {NULL, 0, NULL, 0}};
    Options options = {.settings = {.nb_light_samples = 0,
                                    .samples_per_pixel = 1,
                                    .threads = omp_get_max_threads()}};
    RenderSettings *settings = &options.settings;
    int option;
    while ((option = getopt_long(argc, argv, "o:", LONG, NULL)) != -1) {
        switch (option) {
        case 'o':
            check_name(optarg);
            options.output = optarg;
            break;
        case LIGHT:
            settings->nb_light_samples = (int)parse_number("light-samples", optarg, 1, 1 << 20);
            break;
        case PIXEL:
            settings->samples_per_pixel = (int)parse_number("pixel-samples", optarg, 1, 1 << 16);
            break;
        case SAMPLER:
            settings->sampler = (Sampler)parse_name("sampler", optarg, RENDER_SAMPLER_NAMES,
                                                    COUNT(RENDER_SAMPLER_NAMES));
            break;
        case ESTIMATOR:
            settings->estimator = (Estimator)parse_name("estimator", optarg, RENDER_ESTIMATOR_NAMES,
                                                        COUNT(RENDER_ESTIMATOR_NAMES));
            break;
        case TARGET:
            options.target_error = parse_fraction("target-error", optarg);
            break;
        case SEED:
            settings->seed = parse_number("seed", optarg, 0, UINT64_MAX);
            break;
        case THREADS:
            settings->threads = (int)parse_number("threads", optarg, 1, 1024);
            break;
        case WIDTH:
            settings->width = (int)parse_number("width", optarg, 1, 16384);
            break;
        case HEIGHT:
            settings->height = (int)parse_number("height", optarg, 1, 16384);
            break;
        case PRINT:
            options.print_scene = true;
            break;
        case VERSION:
            puts("penumbra-render " PENUMBRA_VERSION " " REAL_NAME);
            flush_output();
            exit(0);
        case HELP_OPTION:
            fputs(HELP, stdout);
            flush_output();
            exit(0);
        default: /* getopt has said what is wrong */
            fputs("Try: penumbra-render --help\n", stderr);
            exit(EXIT_BAD_INPUT);
        }
    }
    if (optind != argc - 1)
        fail("%s%s; try --help", optind < argc ? "more than one scene file: " : "no scene file",
             optind < argc ? argv[optind + 1] : "");
    options.scene_file = argv[optind];
    if (options.target_error > 0 &&
        (settings->sampler != SAMPLER_INDEPENDENT || settings->estimator != ESTIMATOR_AREA ||
         settings->samples_per_pixel != 1))
        fail("%s%s", "--target-error chooses sampler, estimator and pixel samples itself", "");
    if (!settings->nb_light_samples)
        settings->nb_light_samples = options.target_error > 0 ? 16384 : 64;
    if (!options.output && !options.print_scene)
        fail("%s%s", "no output file: add -o OUT.exr", "");
    return options;
}

/* A bar on a terminal, once the work has lasted a second. */
static void show_progress(int rows_done, int rows, void *start)
{
    if (omp_get_wtime() - *(const double *)start < 1)
        return;
    fprintf(stderr, "\rrendering %3d%%", (int)(100LL * rows_done / rows));
}

static void report_spent(const RenderSettings *settings, double target_error,
                         const RenderSpent *spent)
{
    double pixels = (double)settings->width * settings->height;
    printf(
        "%.1f light samples a pixel; the stated error is below %g%% in %.2f%% of the pixels, above "
        "it in %.0f that took up to %d\n",
        spent->light_samples / pixels, 100 * target_error, 100 * (1 - spent->pixels_above / pixels),
        spent->pixels_above, settings->nb_light_samples);
}

static void warn_untrusted(int pixels)
{
    fprintf(stderr,
            "penumbra-render: %d pixel%s too near a light for so few samples, and may be wrong by "
            "more than the stated variance says: try --estimator solid-angle\n",
            pixels, pixels == 1 ? " is" : "s are");
}

int main(int argc, char **argv)
{
    Options options = parse_options(argc, argv);
    RenderSettings *settings = &options.settings;

    Scene scene;
    char message[1024], *dump = NULL;
    if (!scene_read(options.scene_file, &scene, options.print_scene ? &dump : NULL, message,
                    sizeof message))
        fail("%s%s", message, "");
    if (options.print_scene) {
        fputs(dump, stdout);
        free(dump);
        scene_free(&scene);
        flush_output();
        return 0;
    }
    Output output;
    if (!output_find(options.output, &output))
        fail("%s: cannot be written: %s", options.output, strerror(errno));
    if (!settings->width)
        settings->width = scene.width;
    if (!settings->height)
        settings->height = scene.height;

    size_t floats = 3 * (size_t)settings->width * (size_t)settings->height;
    float *radiance = malloc(floats * sizeof *radiance);
    bool targeted = options.target_error > 0;
    bool states_variance = targeted || render_knows_variance(&scene, settings);
    float *variance = states_variance ? malloc(floats * sizeof *variance) : NULL;
    if (!radiance || (states_variance && !variance))
        fail("%s%s", "not enough memory for an image of this size", "");

    RenderProgress *progress = isatty(STDERR_FILENO) ? show_progress : NULL;
    RenderSpent spent;
    double start = omp_get_wtime();
    if (targeted)
        spent = render_to_target(&scene, settings, options.target_error, radiance, variance,
                                 progress, &start);
    else if (!render(&scene, settings, radiance, variance, progress, &start))
        fail("%s%s", "not enough memory for so many light samples", "");
    double seconds = omp_get_wtime() - start;
    if (progress && seconds > 1)
        fprintf(stderr, "\rrendered in %.1f s\n", seconds);

    ExrImage image = {.scene = &scene,
                      .settings = settings,
                      .seconds = seconds,
                      .target_error = options.target_error,
                      .spent = targeted ? &spent : NULL,
                      .radiance = radiance,
                      .variance = variance};
    image.untrusted_pixels = trust_untrusted_pixels(
        &scene, settings, targeted ? ADAPTIVE_PILOT : settings->nb_light_samples);
    guard_output(&output);
    bool written = exr_write(&output, &image, message, sizeof message);
    if (written && targeted)
        report_spent(settings, options.target_error, &spent);
    if (written && image.untrusted_pixels)
        warn_untrusted(image.untrusted_pixels);
    free(radiance);
    free(variance);
    scene_free(&scene);
    output_free(&output);
    if (!written)
        fail("%s%s", message, "");
    flush_output();
    return 0;
}
