/* The catalogue of mistakes, compiled: catalogue.def's expressions as functions. */
#ifndef PENUMBRA_CHOICE_H
#define PENUMBRA_CHOICE_H

#include "mistakes.h"

/* Kinds: who shares random numbers; where a clamp is; what a SPLIT counts. */
enum { NONE, ALL, ROW, NOWHERE, PIXEL, LIGHT, COUNT, RUN, APART, FIRST };

/* An entry of catalogue.def: which fields mean something depends on its module. */
typedef struct {
    Module module;
    const char *name;
    void (*places)(int count, const double *a, const double *b, double *s, double *t);
    void (*factors)(int count, const double *raw, const double *cl, const double *d, double *w);
    ShadowRay ray;
    Output output;
    double (*scale)(double n, double area, double norms);
    double (*of_light)(double l, double nl, double n);
    double (*colour)(double c);
    double (*drawn)(double n); /* an average: samples, and the weight of each; or, where 0, */
    double (*weight)(double n, double i);
    double (*value)(double n, double k); /* of k visible ones */
    double (*shaded)(double n, double k);
    int kind; /* of value; where a clamp is; who shares random numbers */
} Choice;

/* In the file's order; mistakes_choice says where each is. */
extern const Choice CHOICES[];

#endif
