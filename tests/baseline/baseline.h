/* tests/baseline/baseline.h - the methods that one would take instead of peri, small and honest, in double: what the
   tests of stability and the charts of speed against accuracy put beside it. Include it in one program, which says
   PERI_IMPLEMENTATION somewhere (peri_solver.h has the SVD); everything is static. tests/test_baseline.c shows that
   each method is right where it ought to be.

   A block of matter, size[0] x size[1] x size[2] m, one corner in the origin, is cut into cells of `spacing`. Particle
   methods have one point in the middle of each cell, tetrahedra (six a cell) their nodes at the cells' corners; points
   are numbered with x fastest, and both start at x = rest. The caller fixes particles, moves the fixed ones, sets x
   and v, steps, and reads x and v. Each method says at the head of its file what it is and where it comes from. */
#ifndef PERI_BASELINE_H
#define PERI_BASELINE_H

#include "../../peri_solver.h"

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
    double young, poisson, density;     /* Pa, 1, kg/m^3; bonds, springs and XPBD are 1/4 whatever poisson, shape 0 */
    double gravity[3];                  /* m/s^2 */
    double tolerance;                   /* largest correction that ends a step's iterations, in spacings; 1e-3 */
    int max_iterations;                 /* of a step: Newton, local/global or sweeps over constraints; 200 */
    int substeps;                       /* of a step, 1 and more; 1 */
    int plain;                          /* Newton: 1 for the textbook's (see newton.h); 0: definite, with line search */
    int neighbours;                     /* of a particle in bonds, springs, XPBD, least squares: 6, 18 or 26; 26 */
    const unsigned char *removed;       /* particles: 1 where a cell is empty, for baseline_create only; NULL: none */
} baseline_def;

typedef struct baseline {
    baseline_def def;
    int count;
    double *rest, *x, *v;               /* 3 count */
    double *mass, *volume;              /* count; the caller may change mass at any time */
    unsigned char *fixed;               /* count; 1: x is the caller's */
    int iterations;                     /* of the last step */
    void *own;                          /* the method's */
} baseline;

#if defined(__GNUC__) || defined(__clang__)
#define BASELINE_MAY static __attribute__((unused))
#else
#define BASELINE_MAY static
#endif

/* The method's table entry. create: 0 on success. step: as baseline_step, of one substep. energy: elastic energy of
   positions x and, when gradient is not NULL, its gradient (3 count); NULL where the method has none. */
typedef struct baseline__method {
    const char *name;
    int tetrahedra;
    int (*create)(baseline *b);
    int (*step)(baseline *b, double h);
    double (*energy)(baseline *b, const double *x, double *gradient);
    void (*destroy)(baseline *b);
} baseline__method;

/* Cells (particles) of the block along an axis. */
static int baseline__cells(const baseline_def *def, int axis) {
    int n = (int)floor(def->size[axis] / def->spacing + 0.5);
    return n > 1 ? n : 1;
}

#include "bonds.h"
#include "newton.h"
#include "principal.h"

#include "explicit.h"
#include "springs.h"
#include "mls.h"
#include "tets.h"
#include "shape.h"
#include "xpbd.h"

static const baseline__method baseline__table[BASELINE_METHODS] = {
    {"explicit bonds", 0, baseline__explicit_create, baseline__explicit_step, baseline__bond_energy,
     baseline__explicit_destroy},
    {"mass-spring", 0, baseline__springs_create, baseline__springs_step, baseline__bond_energy,
     baseline__springs_destroy},
    {"least-squares gradient", 0, baseline__mls_create, baseline__mls_step, baseline__mls_energy,
     baseline__mls_destroy},
    {"StVK tetrahedra", 1, baseline__tets_create, baseline__tets_step, baseline__tets_energy,
     baseline__tets_destroy},
    {"corotated tetrahedra", 1, baseline__tets_create, baseline__tets_step, baseline__tets_energy,
     baseline__tets_destroy},
    {"shape matching", 0, baseline__shape_create, baseline__shape_step, NULL, baseline__shape_destroy},
    {"XPBD", 0, baseline__xpbd_create, baseline__xpbd_step, baseline__bond_energy, baseline__xpbd_destroy},
};

BASELINE_MAY const char *baseline_name(baseline_method method) { return baseline__table[method].name; }

/* NULL may be passed. */
BASELINE_MAY void baseline_destroy(baseline *b) {
    if (!b) return;
    if (b->own) baseline__table[b->def.method].destroy(b);
    free(b->own);
    free(b->rest);
    free(b->x);
    free(b->v);
    free(b->mass);
    free(b->volume);
    free(b->fixed);
    free(b);
}

/* Points of the block, the first `shift` cells from the corner; particles have the mass of their cell. */
static void baseline__place(baseline *b, const int n[3], double shift) {
    double d = b->def.spacing, cell = d * d * d;
    int i, j, k, c = 0;
    for (k = 0; k < n[2]; k++)
        for (j = 0; j < n[1]; j++)
            for (i = 0; i < n[0]; i++, c++) {
                b->rest[3 * c] = (i + shift) * d;
                b->rest[3 * c + 1] = (j + shift) * d;
                b->rest[3 * c + 2] = (k + shift) * d;
                b->volume[c] = cell;
                b->mass[c] = b->def.density * cell;
            }
    memcpy(b->x, b->rest, 3 * (size_t)b->count * sizeof(double));
}

/* An empty cell keeps its number, but nothing pulls at it and it has no volume; it is fixed. */
static void baseline__empty(baseline *b) {
    int i;
    for (i = 0; i < b->count; i++)
        if (b->def.removed[i]) {
            b->fixed[i] = 1;
            b->volume[i] = 0;
        }
}

/* A block at rest, nothing fixed but empty cells. NULL: bad definition, unknown method or no memory. */
BASELINE_MAY baseline *baseline_create(const baseline_def *def) {
    const baseline__method *m = baseline__table + def->method;
    baseline *b;
    size_t count;
    int n[3], a;
    if (!m->create || !(def->spacing > 0) || !(def->young > 0) || !(def->density > 0)) return NULL;
    if (m->tetrahedra && (def->removed || def->neighbours)) return NULL;
    for (a = 0; a < 3; a++) n[a] = baseline__cells(def, a) + m->tetrahedra;
    count = (size_t)n[0] * (size_t)n[1] * (size_t)n[2];
    b = (baseline *)calloc(1, sizeof *b);
    if (!b) return NULL;
    b->def = *def;
    if (b->def.substeps < 1) b->def.substeps = 1;
    if (b->def.max_iterations < 1) b->def.max_iterations = 200;
    if (!(b->def.tolerance > 0)) b->def.tolerance = 1e-3;
    b->count = (int)count;
    b->rest = (double *)calloc(3 * count, sizeof(double));
    b->x = (double *)calloc(3 * count, sizeof(double));
    b->v = (double *)calloc(3 * count, sizeof(double));
    b->mass = (double *)calloc(count, sizeof(double));
    b->volume = (double *)calloc(count, sizeof(double));
    b->fixed = (unsigned char *)calloc(count, 1);
    if (b->rest && b->x && b->v && b->mass && b->volume && b->fixed) {
        int failed;
        baseline__place(b, n, m->tetrahedra ? 0 : 0.5);
        if (b->def.removed) baseline__empty(b);
        failed = m->create(b);
        b->def.removed = NULL;
        if (!failed) return b;
    }
    baseline_destroy(b);
    return NULL;
}

/* Advances by dt, in def.substeps equal parts. 0: converged (methods without iterations always are); 1: iterations used
   up or no way down; -1: non-finite, or the linear solve failed, and x and v are worth nothing. */
BASELINE_MAY int baseline_step(baseline *b, double dt) {
    int s, k, result = 0, iterations = 0;
    for (s = 0; s < b->def.substeps && result >= 0; s++) {
        int r = baseline__table[b->def.method].step(b, dt / b->def.substeps);
        iterations += b->iterations;
        result = r ? r : result;
    }
    b->iterations = iterations;
    for (k = 0; k < 3 * b->count; k++)
        if (!(fabs(b->x[k]) < 1e100 && fabs(b->v[k]) < 1e100)) return -1;
    return result;
}

/* Elastic energy at positions x, J, and its gradient when not NULL; NAN for methods without one. */
BASELINE_MAY double baseline_energy(baseline *b, const double *x, double *gradient) {
    const baseline__method *m = baseline__table + b->def.method;
    return m->energy ? m->energy(b, x, gradient) : (double)NAN;
}

#endif
