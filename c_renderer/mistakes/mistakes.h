/* Renderers with mistakes: the estimator's page with each of its choices made right or, in the ways
 * that catalogue.def names, wrongly. A library of its own, in double precision; the renderer knows
 * nothing of it.
 *
 * mistakes_moments foretells what a mistake does, mistakes_render does it: one checks the other. */
#ifndef PENUMBRA_MISTAKES_H
#define PENUMBRA_MISTAKES_H

#include "core/scene.h"

/* The modules of a renderer, in each of which one choice of catalogue.def is made. */
typedef enum {
    MODULE_DOMAIN,
    MODULE_VISIBILITY,
    MODULE_WEIGHT,
    MODULE_SCALE,
    MODULE_LIGHTS,
    MODULE_AVERAGE,
    MODULE_CLAMP,
    MODULE_OUTPUT,
    MODULE_COLOUR,
    MODULE_GENERATOR,
    NB_MODULES
} Module;

/* How a shadow ray is cast from a point of a surface. */
typedef struct {
    double
        offset; /* it starts so far along the normal [m]; 0: on the surface, which it does not meet */
    double start;  /* t_min [m] */
    double length; /* t_max [m]; 0: the light's distance */
    double lost;   /* chance that a visible sample is lost */
    int target;    /* 0: the sample; 1 to 4: corner, + u, + v, + u + v; 5: the centre */
    bool ignored, inverted, reversed;
    bool apart; /* it goes to another sample than the shading's */
} ShadowRay;

typedef struct {
    double ambient; /* times the flat colour */
    double fog;     /* [m^-1] */
    double acne;    /* share of the pixels that come out black */
    bool wrap;      /* 8 bits without a clamp: the writer's business */
} Output;

/* The position in catalogue.def of a choice among those of its module: 0 is the right one. -1: none. */
int mistakes_choice(Module module, const char *name);

/* n points that receive light [m], their unit normals, the objects they are on, and how far each
 * moves in half a pixel to the right and down [m]: arrays of 3 n values, n for object. */
typedef struct {
    int n;
    const double *point, *normal, *right, *down;
    const int *object;
    int first; /* how many others come before these, where many are worked through in parts */
} Receivers;

/* Of one light of unit radiance, for the samples that a domain draws, by a grid x grid (24 x 24 at
 * most) of jittered points at each receiver: per shadow ray (a visibility choice) and weight,
 *   chance[ray][receiver]                 that a sample sees the light,
 *   first, second[ray][weight][receiver]  the means of V w and V w^2, w area times the weight.
 * A ray to a fixed target is seen by a share of the pixel. */
void mistakes_moments(const Scene *scene, int light, const Receivers *receivers, int domain,
                      const int *rays, int nb_rays, const int *weights, int nb_weights, int grid,
                      float *chance, float *first, float *second);

/* What one place (s, t) of a light brings, of the light's whole power: into first[place][receiver],
 * as in mistakes_moments, of the right ray and weight. */
void mistakes_places(const Scene *scene, int light, const Receivers *receivers, const double *s,
                     const double *t, int nb_places, float *first);

enum { MISTAKES_MOST_LIGHT_SAMPLES = 4095 };

typedef struct {
    int choice[NB_MODULES];
    double factor;         /* on every sample */
    int width, height;     /* [pixels] */
    int nb_light_samples;  /* 1 to MISTAKES_MOST_LIGHT_SAMPLES */
    int samples_per_pixel; /* >= 1; more than 1 are at random places of the pixel */
    unsigned long long seed;
    double position_x, position_y; /* of one ray in its pixel; below 0: random */
    int divisor;                   /* pixels are divided by width - divisor, height - divisor */
} MistakenSettings;

/* Fills width * height * 3 floats, RGB, rows from the top, unclamped unless a choice clamps. */
void mistakes_render(const Scene *scene, const MistakenSettings *settings, float *radiance);

/* The same for the rows first, first + step, ... alone. */
void mistakes_render_rows(const Scene *scene, const MistakenSettings *settings, int first, int step,
                          float *radiance);

#endif
