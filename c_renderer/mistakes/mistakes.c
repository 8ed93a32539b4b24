#include "mistakes.h"

#include "choice.h"
#include "core/rng.h"

enum { MOST_SAMPLES = MISTAKES_MOST_LIGHT_SAMPLES + 1, MOST_GRID = 24 };

/* ---------------------------------------------------------------- samples of a light */

/* The lab's (a) to (c) for `count` places of a light, seen from a point: the way to each [m], its
 * length, and both cosines. Lights that are not quads keep to random numbers in [0, 1). */
typedef struct {
    double x[MOST_SAMPLES], y[MOST_SAMPLES], z[MOST_SAMPLES], d[MOST_SAMPLES];
    double raw[MOST_SAMPLES], cl[MOST_SAMPLES];
} Samples;

static double fraction(double x)
{
    x -= floor(x);
    return x < 1 ? x : 0;
}

static void samples_make(Samples *samples, const Light *light, Vec3 point, Vec3 normal, int count,
                         const double *s, const double *t)
{
    FlatLight flat;
    if (light->type == LIGHT_QUAD && light_is_flat(light, &flat)) {
        for (int j = 0; j < count; j++) {
            double x = flat.corner.x + flat.edge_u.x * s[j] + flat.edge_v.x * t[j] - point.x;
            double y = flat.corner.y + flat.edge_u.y * s[j] + flat.edge_v.y * t[j] - point.y;
            double z = flat.corner.z + flat.edge_u.z * s[j] + flat.edge_v.z * t[j] - point.z;
            double d = sqrt(x * x + y * y + z * z);
            samples->x[j] = x, samples->y[j] = y, samples->z[j] = z, samples->d[j] = d;
            samples->raw[j] = (normal.x * x + normal.y * y + normal.z * z) / d;
            samples->cl[j] = (flat.normal.x * x + flat.normal.y * y + flat.normal.z * z) / d;
        }
        return;
    }
    LightSampler sampler;
    light_sampler_create(&sampler, light, point, SPREAD_AREA);
    for (int j = 0; j < count; j++) {
        LightSample sample =
            light_sampler_draw(&sampler, (Uniform2){fraction(s[j]), fraction(t[j])});
        Vec3 way = vec3_scale(sample.direction, sample.distance);
        double d = sample.distance, density = sample.pdf_solid_angle * light_area(light);
        samples->x[j] = way.x, samples->y[j] = way.y, samples->z[j] = way.z, samples->d[j] = d;
        samples->raw[j] = vec3_dot(normal, sample.direction);
        samples->cl[j] = density > 0 ? d * d / density : 0;
    }
}

/* Which of the rays from a point along (x, y, z), of length d, meet nothing on the way that the
 * choice looks at. `own` is the object that the point is on. */
static void rays_see(const Scene *scene, const ShadowRay *ray, Vec3 point, Vec3 normal, int own,
                     int count, const double *x, const double *y, const double *z, const double *d,
                     double *seen)
{
    Vec3 origin = vec3_along(point, normal, ray->offset);
    double sign = ray->reversed ? -1 : 1;
    for (int j = 0; j < count; j++)
        seen[j] = 1;
    if (ray->ignored)
        return;
    const double start = ray->start, length = ray->length;
    for (int k = 0; k < scene->nb_spheres; k++) {
        Vec3 c = vec3_sub(scene->spheres[k].center, origin);
        const double starts_on_it = k == own && ray->offset == 0;
        double squared = vec3_dot(c, c);
        double outside =
            starts_on_it > 0 ? 0 : squared - scene->spheres[k].radius * scene->spheres[k].radius;
#pragma omp simd
        for (int j = 0; j < count; j++) {
            double end = length > 0 ? length : d[j];
            double b = sign * (c.x * x[j] + c.y * y[j] + c.z * z[j]) / d[j];
            double root = b * b - outside;
            double half = sqrt(root > 0 ? root : 0);
            double near = b - half, far = b + half;
            double on_near = near > start ? 1 - starts_on_it : 0, on_far = far > start ? 1 : 0;
            on_near = near < end ? on_near : 0;
            on_far = far < end ? on_far : 0;
            double meets = root > 0 ? on_near + on_far : 0;
            seen[j] = meets > 0 ? 0 : seen[j];
        }
    }
    for (int k = 0; k < scene->nb_planes; k++) {
        const Plane plane = scene->planes[k];
        if (scene->nb_spheres + k == own && ray->offset == 0)
            continue;
        double height = vec3_dot(plane.normal, vec3_sub(plane.point, origin));
#pragma omp simd
        for (int j = 0; j < count; j++) {
            double end = length > 0 ? length : d[j];
            double slope = sign *
                           (plane.normal.x * x[j] + plane.normal.y * y[j] + plane.normal.z * z[j]) /
                           d[j];
            double t = height / slope;
            double meets = t > start ? 1 : 0;
            meets = t < end ? meets : 0;
            seen[j] = meets > 0 ? 0 : seen[j];
        }
    }
    if (ray->inverted)
        for (int j = 0; j < count; j++)
            seen[j] = 1 - seen[j];
}

/* s, t of a fixed target: ShadowRay. */
static void target_place(int target, double *s, double *t)
{
    static const double places[5][2] = {{0, 0}, {1, 0}, {0, 1}, {1, 1}, {0.5, 0.5}};
    *s = places[target - 1][0];
    *t = places[target - 1][1];
}

/* ---------------------------------------------------------------- what a mistake does on average */

static Vec3 row(const double *values, int i)
{
    return (Vec3){values[3 * i], values[3 * i + 1], values[3 * i + 2]};
}

/* The share of a pixel that sees one place of the light. */
static double share_seen(const Scene *scene, const Light *light, const Receivers *at, int i,
                         const ShadowRay *ray, double s, double t)
{
    double sum = 0, seen;
    Samples one;
    for (int v = -1; v <= 1; v++)
        for (int u = -1; u <= 1; u++) {
            Vec3 point = vec3_along(row(at->point, i), row(at->right, i), u * (2.0 / 3));
            point = vec3_along(point, row(at->down, i), v * (2.0 / 3));
            samples_make(&one, light, point, row(at->normal, i), 1, &s, &t);
            rays_see(scene, ray, point, row(at->normal, i), at->object[i], 1, one.x, one.y, one.z,
                     one.d, &seen);
            sum += seen / 9;
        }
    return sum;
}

/* Whether a domain is one place: then a pixel's edge is where it sees it in part. */
static bool is_one_place(const Choice *domain, double *s, double *t)
{
    const double a[3] = {0.1, 0.7, 0.4}, b[3] = {0.2, 0.5, 0.9};
    double places[2][3];
    domain->places(3, a, b, places[0], places[1]);
    *s = places[0][0], *t = places[1][0];
    return places[0][1] == *s && places[0][2] == *s && places[1][1] == *t && places[1][2] == *t;
}

void mistakes_moments(const Scene *scene, int light, const Receivers *receivers, int domain,
                      const int *rays, int nb_rays, const int *weights, int nb_weights, int grid,
                      float *chance, float *first, float *second)
{
    const Light *it = &scene->lights[light];
    const double area = light_area(it);
    const int n = receivers->n;
    double fixed_s, fixed_t;
    const bool fixed = is_one_place(&CHOICES[domain], &fixed_s, &fixed_t);
    grid = fixed ? 1 : grid < MOST_GRID ? grid : MOST_GRID;
    const int count = grid * grid;

#pragma omp parallel for schedule(dynamic, 64)
    for (int i = 0; i < n; i++) {
        Samples samples;
        double a[MOST_GRID * MOST_GRID], b[MOST_GRID * MOST_GRID];
        double s[MOST_GRID * MOST_GRID], t[MOST_GRID * MOST_GRID];
        double seen[MOST_GRID * MOST_GRID], w[nb_weights][MOST_GRID * MOST_GRID];
        /* in each cell of the grid one point, at the places of a lattice (Roberts's R2) that is
         * shifted for every site */
        const double step_a = 0.7548776662466927, step_b = 0.5698402909980532;
        const int site = receivers->first + i;
        for (int j = 0; j < count; j++) {
            a[j] = (j % grid + fraction((site + 1) * step_b + j * step_a)) / grid;
            b[j] = (j / grid + fraction((site + 1) * step_a + j * step_b)) / grid;
        }
        CHOICES[domain].places(count, a, b, s, t);
        Vec3 point = row(receivers->point, i), normal = row(receivers->normal, i);
        samples_make(&samples, it, point, normal, count, s, t);
        for (int k = 0; k < nb_weights; k++)
            CHOICES[weights[k]].factors(count, samples.raw, samples.cl, samples.d, w[k]);
        for (int r = 0; r < nb_rays; r++) {
            const ShadowRay *ray = &CHOICES[rays[r]].ray;
            const bool apart = ray->apart;
            if (ray->target || fixed) {
                double to_s = fixed_s, to_t = fixed_t;
                if (ray->target)
                    target_place(ray->target, &to_s, &to_t);
                double share = share_seen(scene, it, receivers, i, ray, to_s, to_t);
                for (int j = 0; j < count; j++)
                    seen[j] = share;
            } else {
                rays_see(scene, ray, point, normal, receivers->object[i], count, samples.x,
                         samples.y, samples.z, samples.d, seen);
            }
            double sum = 0;
            for (int j = 0; j < count; j++)
                sum += seen[j];
            chance[r * (long)n + i] = (float)(sum / count);
            for (int k = 0; k < nb_weights; k++) {
                double one = 0, two = 0;
#pragma omp simd reduction(+ : one, two)
                for (int j = 0; j < count; j++) {
                    double value = area * w[k][j];
                    double visible = apart ? 1 : seen[j];
                    one += visible * value;
                    two += visible * value * value;
                }
                first[((long)r * nb_weights + k) * n + i] = (float)(one / count);
                second[((long)r * nb_weights + k) * n + i] = (float)(two / count);
            }
        }
    }
}

void mistakes_places(const Scene *scene, int light, const Receivers *receivers, const double *s,
                     const double *t, int nb_places, float *first)
{
    const Light *it = &scene->lights[light];
    const ShadowRay *ray = &CHOICES[mistakes_choice(MODULE_VISIBILITY, "std")].ray;
    const Choice *weight = &CHOICES[mistakes_choice(MODULE_WEIGHT, "std")];
    const long n = receivers->n;
#pragma omp parallel for schedule(dynamic, 64)
    for (int i = 0; i < n; i++) {
        Samples samples;
        double seen, w;
        Vec3 point = row(receivers->point, i), normal = row(receivers->normal, i);
        for (int j = 0; j < nb_places; j++) {
            samples_make(&samples, it, point, normal, 1, &s[j], &t[j]);
            rays_see(scene, ray, point, normal, receivers->object[i], 1, samples.x, samples.y,
                     samples.z, samples.d, &seen);
            weight->factors(1, samples.raw, samples.cl, samples.d, &w);
            first[j * n + i] = (float)(light_area(it) * w * seen);
        }
    }
}

/* ---------------------------------------------------------------- what a mistake does */

typedef struct {
    const Scene *scene;
    const MistakenSettings *settings;
    const Choice *choice[NB_MODULES];
    RngStream stream;
    bool black; /* acne */
} Renderer;

/* One light's samples at a hit: how each is seen, and its weight without it. */
static void draw(const Renderer *renderer, int light, const Hit *hit, int count, double *seen,
                 double *w)
{
    const Light *it = &renderer->scene->lights[light];
    const ShadowRay *ray = &renderer->choice[MODULE_VISIBILITY]->ray;
    double a[MOST_SAMPLES], b[MOST_SAMPLES], s[MOST_SAMPLES], t[MOST_SAMPLES];
    Samples samples, apart;
    const Samples *shadow = &samples;
    const uint32_t dimension = 3 * ((uint32_t)light + 1);
    for (int j = 0; j < count; j++) {
        Uniform2 random = rng_uniform2(renderer->stream, (uint32_t)j, dimension);
        a[j] = random.x, b[j] = random.y;
    }
    renderer->choice[MODULE_DOMAIN]->places(count, a, b, s, t);
    samples_make(&samples, it, hit->point, hit->normal, count, s, t);
    renderer->choice[MODULE_WEIGHT]->factors(count, samples.raw, samples.cl, samples.d, w);
    const double area = light_area(it);
    for (int j = 0; j < count; j++)
        w[j] *= area;
    if (ray->apart || ray->target) {
        for (int j = 0; j < count; j++) {
            Uniform2 random = rng_uniform2(renderer->stream, (uint32_t)j, dimension + 1);
            a[j] = random.x, b[j] = random.y;
        }
        renderer->choice[MODULE_DOMAIN]->places(count, a, b, s, t);
        for (int j = 0; j < count && ray->target; j++)
            target_place(ray->target, &s[j], &t[j]);
        samples_make(&apart, it, hit->point, hit->normal, count, s, t);
        shadow = &apart;
    }
    rays_see(renderer->scene, ray, hit->point, hit->normal, hit->object, count, shadow->x,
             shadow->y, shadow->z, shadow->d, seen);
    for (int j = 0; j < count && ray->lost > 0; j++)
        if (rng_uniform2(renderer->stream, (uint32_t)j, dimension + 2).x < ray->lost)
            seen[j] = 0;
}

/* The share of unit radiance that a light brings, and what each sample may be clamped at. */
static double light_mean(const Renderer *renderer, int light, const Hit *hit, double clamp_scale)
{
    const Choice *average = renderer->choice[MODULE_AVERAGE];
    const bool clamps = renderer->choice[MODULE_CLAMP]->kind == LIGHT;
    const double n = renderer->settings->nb_light_samples;
    double seen[MOST_SAMPLES], w[MOST_SAMPLES], sum = 0;
    const int count = (int)(average->drawn ? average->drawn(n) : n);
    draw(renderer, light, hit, count, seen, w);
    for (int j = 0; j < count && clamps; j++)
        w[j] = clamped(w[j] * clamp_scale, 0, 1) / clamp_scale;
    if (average->drawn) {
        for (int j = 0; j < count; j++)
            sum += average->weight(n, j) * seen[j] * w[j];
        return sum;
    }
    double k = 0, of = 0;
    int visible_first = 0;
    while (visible_first < count && seen[visible_first] > 0)
        visible_first++;
    for (int j = 0; j < count; j++)
        k += seen[j];
    k = average->kind == RUN ? visible_first : average->kind == FIRST ? seen[0] : k;
    const double shaded = average->shaded(n, k);
    const bool any = average->kind == APART || average->kind == FIRST;
    for (int j = 0; j < count && of < shaded; j++)
        if (any || seen[j] > 0)
            sum += w[j], of++;
    return of > 0 ? average->value(n, k) * sum / of : 0;
}

static Rgb hit_radiance(const Renderer *renderer, const Hit *hit)
{
    const Scene *scene = renderer->scene;
    const Output *output = &renderer->choice[MODULE_OUTPUT]->output;
    double (*colour)(double) = renderer->choice[MODULE_COLOUR]->colour;
    const double flat[3] = {colour(hit->brdf.r), colour(hit->brdf.g), colour(hit->brdf.b)};
    double sum[3] = {0, 0, 0};
    const double n = renderer->settings->nb_light_samples;
    int surfaces = 0, index = 0;
    for (int l = 0; l < scene->nb_lights; l++)
        surfaces += light_is_surface(&scene->lights[l]);
    for (int l = 0; l < scene->nb_lights; l++) {
        const Light *light = &scene->lights[l];
        if (!light_is_surface(light))
            continue;
        FlatLight quad;
        const double area = light_area(light);
        double norms = area;
        if (light->type == LIGHT_QUAD && light_is_flat(light, &quad))
            norms = sqrt(vec3_dot(quad.edge_u, quad.edge_u) * vec3_dot(quad.edge_v, quad.edge_v));
        double scale = renderer->settings->factor *
                       renderer->choice[MODULE_SCALE]->scale(n, area, norms) *
                       renderer->choice[MODULE_LIGHTS]->of_light(index++, surfaces, n);
        const Rgb radiance = light_radiance(light);
        double brightest =
            fmax(flat[0] * radiance.r, fmax(flat[1] * radiance.g, flat[2] * radiance.b));
        double mean = scale * light_mean(renderer, l, hit, brightest > 0 ? brightest : 1);
        sum[0] += flat[0] * radiance.r * mean;
        sum[1] += flat[1] * radiance.g * mean;
        sum[2] += flat[2] * radiance.b * mean;
    }
    for (int c = 0; c < 3; c++)
        sum[c] += output->ambient * flat[c];
    return (Rgb){sum[0], sum[1], sum[2]};
}

static Rgb pixel_sample(const Renderer *renderer, double x, double y)
{
    const Scene *scene = renderer->scene;
    const Output *output = &renderer->choice[MODULE_OUTPUT]->output;
    Ray ray =
        camera_ray(&scene->camera, x, y, renderer->settings->width, renderer->settings->height);
    Hit hit = scene_hit(scene, ray);
    if (hit.object == SCENE_NOTHING)
        return scene->background;
    Rgb colour = renderer->black ? (Rgb){0, 0, 0} : hit_radiance(renderer, &hit);
    if (output->fog > 0) {
        Vec3 way = vec3_sub(hit.point, ray.origin);
        double left = exp(-output->fog * sqrt(vec3_dot(way, way)));
        colour = rgb_add(rgb_scale(colour, left), rgb_scale(scene->background, 1 - left));
    }
    if (renderer->choice[MODULE_CLAMP]->kind == PIXEL)
        colour = (Rgb){clamped(colour.r, 0, 1), clamped(colour.g, 0, 1), clamped(colour.b, 0, 1)};
    return colour;
}

void mistakes_render(const Scene *scene, const MistakenSettings *settings, float *radiance)
{
    mistakes_render_rows(scene, settings, 0, 1, radiance);
}

void mistakes_render_rows(const Scene *scene, const MistakenSettings *settings, int first, int step,
                          float *radiance)
{
    const int width = settings->width, height = settings->height, m = settings->samples_per_pixel;
    const double across = (double)width / (width - settings->divisor);
    const double down = (double)height / (height - settings->divisor);
#pragma omp parallel for schedule(dynamic, 4)
    for (int y = first; y < height; y += step) {
        Renderer renderer = {.scene = scene, .settings = settings};
        for (int k = 0; k < NB_MODULES; k++)
            renderer.choice[k] = &CHOICES[settings->choice[k]];
        const int shared = renderer.choice[MODULE_GENERATOR]->kind;
        const double acne = renderer.choice[MODULE_OUTPUT]->output.acne;
        for (int x = 0; x < width; x++) {
            const uint32_t pixel = (uint32_t)(y * width + x);
            double sum[3] = {0, 0, 0};
            renderer.black =
                acne > 0 && rng_uniform2((RngStream){settings->seed, pixel, 0}, 0, 1).x < acne;
            for (int k = 0; k < m; k++) {
                RngStream own = {settings->seed, pixel, (uint32_t)k};
                renderer.stream = own;
                renderer.stream.pixel = shared == ALL ? 0 : shared == ROW ? (uint32_t)y : pixel;
                Uniform2 place = rng_uniform2(own, 0, 0);
                bool random = m > 1 || settings->position_x < 0;
                double dx = random ? place.x : settings->position_x;
                double dy = random ? place.y : settings->position_y;
                Rgb sample = pixel_sample(&renderer, (x + dx) * across, (y + dy) * down);
                sum[0] += sample.r, sum[1] += sample.g, sum[2] += sample.b;
            }
            for (int c = 0; c < 3; c++)
                radiance[3 * (long)pixel + c] = (float)(sum[c] / m);
        }
    }
}
