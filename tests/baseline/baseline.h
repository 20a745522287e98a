/* tests/baseline/baseline.h - the methods that one would take instead of peri, small and honest, in double: what the
   tests of stability and the charts of speed against accuracy put beside it. Include it in one program; everything is
   static.

   A block of matter, size[0] x size[1] x size[2] m, is cut into cells of `spacing`. Particle methods have one point in
   the middle of each cell, tetrahedra (six a cell) their nodes at the cells' corners; both start at x = rest. The
   caller fixes particles, moves the fixed ones, sets x and v, steps, and reads x and v. */
#ifndef PERI_BASELINE_H
#define PERI_BASELINE_H

#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef enum baseline_method {
    BASELINE_EXPLICIT,      /* peridynamic bonds (bond-based, Poisson's ratio 1/4), symplectic Euler */
    BASELINE_SPRINGS,       /* mass-spring lattice, implicit Euler by Newton */
    BASELINE_MLS,           /* deformation gradient by moving least squares, neo-Hookean, inversion by SVD, implicit */
    BASELINE_STVK,          /* St. Venant-Kirchhoff tetrahedra, implicit Euler by Newton */
    BASELINE_COROTATED,     /* corotated tetrahedra, implicit Euler */
    BASELINE_SHAPE,         /* shape matching in overlapping clusters */
    BASELINE_XPBD,          /* extended position-based dynamics: distance constraints */
    BASELINE_METHODS
} baseline_method;

typedef struct baseline_def {
    baseline_method method;
    double size[3], spacing;            /* m */
    double young, poisson, density;     /* Pa, 1, kg/m^3 */
    double gravity[3];                  /* m/s^2 */
    double tolerance;                   /* largest correction that ends a step's iterations, in spacings; 1e-3 */
    int max_iterations;                 /* of a step: Newton, local/global or sweeps over constraints; 200 */
    int substeps;                       /* of a step, 1 and more; 1 */
} baseline_def;

typedef struct baseline {
    baseline_def def;
    int count;
    double *rest, *x, *v;               /* 3 count */
    double *mass, *volume;              /* count */
    unsigned char *fixed;               /* count; 1: x is the caller's */
    int iterations;                     /* of the last step */
    void *own;                          /* the method's */
} baseline;

#endif
