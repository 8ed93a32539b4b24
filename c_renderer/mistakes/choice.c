#include "choice.h"

#include <math.h>
#include <string.h>

#define where(condition, yes, no) ((condition) ? (yes) : (no))
#define MISTAKE(...)
#define NOTHING(...)

/* first its expressions, as functions */
#define DOMAIN(name, s_, t_)                                                                       \
    static void domain_##name(int count, const double *a_, const double *b_, double *s, double *t) \
    {                                                                                              \
        for (int j = 0; j < count; j++) {                                                          \
            double a = a_[j], b = b_[j];                                                           \
            (void)a, (void)b;                                                                      \
            s[j] = s_;                                                                             \
            t[j] = t_;                                                                             \
        }                                                                                          \
    }
#define WEIGHT(name, factor)                                                                       \
    static void weight_##name(int count, const double *raw_, const double *cl_, const double *d_,  \
                              double *w)                                                           \
    {                                                                                              \
        for (int j = 0; j < count; j++) {                                                          \
            double raw = raw_[j], cl = cl_[j], d = d_[j], cs = raw > 0 ? raw : 0;                  \
            (void)raw, (void)cs, (void)d;                                                          \
            w[j] = cl > 0 ? (factor) : 0;                                                          \
        }                                                                                          \
    }
#define OF(result, prefix, name, a, b, c)                                                          \
    static double prefix##_##name(double a, double b, double c)                                    \
    {                                                                                              \
        (void)a, (void)b, (void)c;                                                                 \
        return result;                                                                             \
    }
#define OF2(result, prefix, name, a, b)                                                            \
    static double prefix##_##name(double a, double b)                                              \
    {                                                                                              \
        (void)a, (void)b;                                                                          \
        return result;                                                                             \
    }
#define OF1(result, prefix, name, a)                                                               \
    static double prefix##_##name(double a)                                                        \
    {                                                                                              \
        (void)a;                                                                                   \
        return result;                                                                             \
    }
#define SCALE(name, factor) OF(factor, scale, name, n, area, norms)
#define LIGHTS(name, factor) OF(factor, of_light, name, l, nl, n)
#define COLOUR(name, factor) OF1(factor, colour, name, c)
#define AVERAGE(name, drawn_, weight_) OF1(drawn_, drawn, name, n) OF2(weight_, each, name, n, i)
#define SPLIT(name, kind, value_, shaded_)                                                         \
    OF2(value_, value, name, n, k) OF2(shaded_, shaded, name, n, k)
#define VISIBILITY NOTHING
#define CLAMP NOTHING
#define OUTPUT NOTHING
#define GENERATOR NOTHING
#include "catalogue.def"
#undef DOMAIN
#undef VISIBILITY
#undef WEIGHT
#undef SCALE
#undef LIGHTS
#undef AVERAGE
#undef SPLIT
#undef CLAMP
#undef OUTPUT
#undef COLOUR
#undef GENERATOR

/* then the table */
#define DOMAIN(name_, s, t) {.module = MODULE_DOMAIN, .name = #name_, .places = domain_##name_},
#define VISIBILITY(name_, ...) {.module = MODULE_VISIBILITY, .name = #name_, .ray = {__VA_ARGS__}},
#define WEIGHT(name_, f) {.module = MODULE_WEIGHT, .name = #name_, .factors = weight_##name_},
#define SCALE(name_, f) {.module = MODULE_SCALE, .name = #name_, .scale = scale_##name_},
#define LIGHTS(name_, f) {.module = MODULE_LIGHTS, .name = #name_, .of_light = of_light_##name_},
#define AVERAGE(name_, d, w)                                                                       \
    {.module = MODULE_AVERAGE, .name = #name_, .drawn = drawn_##name_, .weight = each_##name_},
#define SPLIT(name_, kind_, v, s)                                                                  \
    {.module = MODULE_AVERAGE,                                                                     \
     .name = #name_,                                                                               \
     .kind = kind_,                                                                                \
     .value = value_##name_,                                                                       \
     .shaded = shaded_##name_},
#define CLAMP(name_, kind_) {.module = MODULE_CLAMP, .name = #name_, .kind = kind_},
#define OUTPUT(name_, ...) {.module = MODULE_OUTPUT, .name = #name_, .output = {__VA_ARGS__}},
#define COLOUR(name_, f) {.module = MODULE_COLOUR, .name = #name_, .colour = colour_##name_},
#define GENERATOR(name_, kind_) {.module = MODULE_GENERATOR, .name = #name_, .kind = kind_},
const Choice CHOICES[] = {
#include "catalogue.def"
};

int mistakes_choice(Module module, const char *name)
{
    for (size_t i = 0; i < sizeof CHOICES / sizeof *CHOICES; i++)
        if (CHOICES[i].module == module && strcmp(CHOICES[i].name, name) == 0)
            return (int)i;
    return -1;
}
