/* Irradiance by adaptive quadrature, for what has no closed form. */
#ifndef PENUMBRA_QUADRATURE_H
#define PENUMBRA_QUADRATURE_H

#include "outline.h"

/* Projected solid angle [sr] of what is seen, to about 1e-9 of `scale`, the same without balls.
 * Across the light along edge_u everything is exact: a ball hides one interval of each line, and
 * between the shadows the integrand has an antiderivative. Along the other axis Gauss-Kronrod
 * panels are halved until they agree, or until the error bound [sr] has to say that they do not. */
double quadrature_irradiance(const LightView *view, double scale, double *error_bound);

#endif
