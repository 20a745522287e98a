/* tests/stability.h - the cells of the stability atlas: one small scene each, run by one of our models and solvers or
   by one of the methods of tests/baseline, and judged against finite elements (tests/fem.h) or an exact solution.
   Shared by tests/bench/atlas.c, which draws the maps, and tests/test_stability.c.

   Include it after peri.h (with PERI_IMPLEMENTATION). Everything is static.

   MAPS (x, y), d the spacing, 25 mm, 1000 kg/m^3, Poisson's ratio 1/4, 9.81 m/s^2, unless said
   modulus   Young's modulus, time step: a cantilever 16 x 4 x 4 d let go at rest, for a period of its slowest
             vibration, but at least 6 and at most 30 steps; gravity E/4e4, so that all bend alike, the tip by a
             quarter of the length. Poisson's ratio 0: bending hardly depends on it, and the next map is about it
   poisson   Poisson's ratio, time step: a bar 12 x 4 x 4 d gripped at both ends at stretch 1.1, let go, E 2e4, as long
   stretch   ratio along x, ratio along y: a cube of 6^3 whose outer layer is pulled or pressed to them, in steps of
             1/30 s of at most a quarter of a spacing, then held for 12 steps; E 1e5, no gravity
   mass      density of the last quarter over the rest's, time step: as modulus, E 4e5; the denser has 1000 kg/m^3
   contact   density of the upper cube over the lower's (1000 at the upper), time step: two cubes of 5^3 on each other
             in a shaft, all without friction, d 50 mm, E 2e4, 1 s and at least 20 steps, the mean of the second half.
             Ours only: no baseline has contact
   collapse  1 plane, 2 line, 3 point, 4 mirror image, 5 shuffle; time step: a cube of 5^3, E 1e6, no gravity, 100 steps
   section   rows, layers of a bar 12 long (one layer: coplanar families; one row of one layer: collinear ones), gripped
             at stretch 1.25, E 1e5, no gravity, free particles shaken by d/10, 30 steps of 1/30 s
   removed   share of particles removed at random, horizon in spacings: the cube of stretch, begun at 1.25 along x,
             shaken, without that share of its inner particles, the others the larger for it, otherwise as section.
             Bonds, springs, XPBD and least squares have 6, 18 or 26 neighbours by the horizon and no more; shape
             matching has its clusters of eight, less what is removed. Not tetrahedra: without elements there are holes,
             and the solution is another; with other elements over the points left it is the mesh maker that is judged

   RIGHT     "modulus", "poisson", "mass": every step's state weighted by 1 - cos(2 pi t/T), which takes vibrations out;
             others: the mean of the last five steps. References:
             finite elements (modulus, poisson, mass, section), which go through the same backward Euler steps (the
             explicit method is measured against them too: where it is stable they differ little from the motion) or,
             in section, to rest. They follow the method's own law where it is St. Venant-Kirchhoff and has a solution,
             neo-Hookean else. Error: rms distance of the free points over the rms displacement of the reference, which
             counts as a tenth of a spacing at least; between two grips, which move most points themselves, of each axis
             by itself, and the worst of them; in poisson also the contraction across in the middle half, over an
             incompressible bar's: Poisson's ratio is to be within 0.05.
             the affine map (stretch, removed), the exact solution: rms distance of the free points in spacings; in
             stretch also, of ours, the mean Cauchy stress over the law's (E/20 at least).
             uniaxial strain (contact), exact, by the same laws: shortening of the lower cube between its second and
             fourth layer over it (the outermost layers are stiffer by themselves), and the floor's force over the
             weight.
             the rest shape (collapse): rms distance to its best rigid fit, in spacings.
   CELL      red: a step failed, was not finite or went further than ten lengths; the error is 100 % (collapse: half a
             spacing) or more; more than half of the steps used up their iterations and the error is above 10 %.
             yellow: the error is above 10 % (0.1 spacings), or more than half of the steps used up their iterations.
             green: else.
   FAIR      every method has a tolerance of 1e-3 d and 200 iterations a step. XPBD has them as 200 substeps of one
             sweep, which serves it better, and is judged by its error alone. The explicit method has as many substeps
             as it needs to be stable, at most 100, but in modulus, poisson and mass, where the time step is the
             subject. */
#ifndef PERI_TESTS_STABILITY_H
#define PERI_TESTS_STABILITY_H

#include "baseline/baseline.h"
#include "fem.h"
#include <stdio.h>
#include <time.h>

#if defined(__GNUC__) || defined(__clang__)
#define STABILITY_MAY static __attribute__((unused))
#else
#define STABILITY_MAY static
#endif

enum { GRIP = 2 };      /* layers held beyond the plane of a grip, which is a face of the finite elements */

typedef enum map { MAP_MODULUS, MAP_POISSON, MAP_STRETCH, MAP_MASS, MAP_CONTACT, MAP_COLLAPSE, MAP_SECTION, MAP_REMOVED,
                   MAPS } map;
static const char *const map_name[MAPS] = {"modulus", "poisson", "stretch", "mass",
                                           "contact", "collapse", "section", "removed"};

/* Ours by model, then the baselines. */
enum { NEO_HOOKEAN, STVK, LINEAR, PAPERS, PROJECTIVE, MODELS, METHODS = MODELS + BASELINE_METHODS };
static const char *const model_name[MODELS] = {"correspondence neo-Hookean", "correspondence StVK", "stretch linear",
                                               "stretch A1/A1", "projective"};
static const char *const solver_name[6] = {"auto", "cholesky", "two levels", "jacobi", "chebyshev", "position"};

STABILITY_MAY const char *method_name(int method) {
    return method < MODELS ? model_name[method] : baseline_name((baseline_method)(method - MODELS));
}

typedef struct cell {
    char colour;            /* g, y, r */
    double error, iterations, ms;
} cell;

/* What happens in a cell. */
typedef struct plan {
    map m;
    int cells[3], grips;    /* grips: of the near end, of both, of none */
    int shell;              /* 1: the outer layer is held and driven affinely */
    double spacing, young, poisson, density, tip_density, gravity[3];
    double horizon, removed, shake;
    double along, across;   /* ratios that the grips are driven to */
    double dt;
    int drive, steps;       /* grips move during the first `drive` steps; 0: all begins as driven, affinely */
    int swing;              /* 1: dynamic, weighted over all steps; 0: to rest, mean of the last five */
} plan;

static const double stability_step = 1.0 / 30;

/* The cells that the atlas shows: quick and tests, full. */
enum { AXIS_MOST = 12 };
typedef struct axis {
    int count;
    double at[AXIS_MOST];
} axis;
typedef struct grid {
    axis x, y;
} grid;

static const grid quick_grid[MAPS] = {
    {{5, {1e4, 1e5, 1e6, 1e7, 1e8}}, {4, {1. / 240, 1. / 30, 0.1, 1}}},
    {{5, {0, 0.25, 0.4, 0.49, 0.499}}, {2, {1. / 240, 1. / 30}}},
    {{5, {0.5, 0.7, 1, 1.5, 2.2}}, {3, {0.5, 0.7, 1}}},
    {{4, {1e-2, 1, 100, 1e4}}, {2, {1. / 240, 1. / 30}}},
    {{4, {1, 10, 100, 1e3}}, {2, {1. / 60, 0.1}}},
    {{5, {1, 2, 3, 4, 5}}, {2, {1. / 240, 1. / 30}}},
    {{4, {1, 2, 3, 4}}, {4, {1, 2, 3, 4}}},
    {{5, {0, 0.2, 0.4, 0.6, 0.8}}, {4, {1.01, 1.45, 1.75, 3.01}}}};
STABILITY_MAY const grid full_grid[MAPS] = {
    {{7, {1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9}}, {7, {1. / 1000, 1. / 240, 1. / 60, 1. / 30, 0.1, 1, 10}}},
    {{7, {-0.5, 0, 0.25, 0.4, 0.45, 0.49, 0.499}}, {4, {1. / 240, 1. / 60, 1. / 30, 0.1}}},
    {{9, {0.35, 0.5, 0.6, 0.7, 0.85, 1, 1.5, 2, 2.4}}, {5, {0.35, 0.5, 0.6, 0.7, 1}}},
    {{7, {1e-4, 1e-2, 1, 10, 100, 1e3, 1e4}}, {4, {1. / 240, 1. / 60, 1. / 30, 0.1}}},
    {{5, {1, 10, 100, 1e3, 1e4}}, {3, {1. / 60, 1. / 30, 0.1}}},
    {{5, {1, 2, 3, 4, 5}}, {7, {1. / 1000, 1. / 240, 1. / 60, 1. / 30, 0.1, 1, 10}}},
    {{4, {1, 2, 3, 4}}, {4, {1, 2, 3, 4}}},
    {{5, {0, 0.2, 0.4, 0.6, 0.8}}, {5, {1.01, 1.45, 1.75, 2.1, 3.01}}}};

STABILITY_MAY plan plan_of(map m, double x, double y) {
    plan p;
    double move;
    memset(&p, 0, sizeof p);
    p.m = m;
    p.cells[0] = m == MAP_MODULUS || m == MAP_MASS ? 16 : 12;
    p.cells[1] = p.cells[2] = 4;
    p.spacing = 0.025;
    p.poisson = 0.25;
    p.young = 1e5;
    p.density = p.tip_density = 1000;
    p.along = p.across = 1;
    p.dt = m == MAP_STRETCH || m == MAP_SECTION || m == MAP_REMOVED ? stability_step : y;
    p.grips = 1;
    p.swing = m == MAP_MODULUS || m == MAP_POISSON || m == MAP_MASS;
    if (p.swing) {
        p.poisson = 0;
        p.young = m == MAP_MODULUS ? x : m == MAP_MASS ? 4e5 : 2e4;
        p.gravity[2] = m == MAP_MODULUS ? -x / 4e4 : -9.81;
        p.steps = (int)(sqrt(1e5 / p.young) / p.dt + 0.5);
        p.steps = p.steps < 6 ? 6 : p.steps > 30 ? 30 : p.steps;
    } else p.steps = 30;
    switch (m) {
    case MAP_POISSON:
        p.poisson = x;
        p.along = 1.1;
        p.grips = 2;
        break;
    case MAP_STRETCH:
        p.cells[0] = p.cells[1] = p.cells[2] = 6;
        p.grips = 0;
        p.shell = 1;
        p.along = x;
        p.across = y;
        move = fabs(x - 1) > fabs(y - 1) ? fabs(x - 1) : fabs(y - 1);
        p.drive = (int)ceil(move * p.cells[0] / 2 * 4) + 1;
        p.steps = p.drive + 12;
        break;
    case MAP_MASS:
        if (x > 1) p.density /= x; else p.tip_density *= x;
        break;
    case MAP_SECTION:
        p.cells[1] = (int)x;
        p.cells[2] = (int)y;
        p.grips = 2;
        p.along = 1.25;
        p.shake = 0.1;
        break;
    case MAP_REMOVED:
        p.cells[0] = p.cells[1] = p.cells[2] = 6;
        p.grips = 0;
        p.shell = 1;
        p.along = 1.25;
        p.shake = 0.2; /* rms of the shaken start: who does nothing is not right */
        p.removed = x;
        p.horizon = y;
        break;
    case MAP_CONTACT:
    case MAP_COLLAPSE:
        p.cells[0] = p.cells[1] = p.cells[2] = 5;
        p.grips = 0;
        p.spacing = 0.05;
        if (m == MAP_CONTACT) {
            p.young = 2e4;
            p.gravity[2] = -9.81;
            p.density /= x; /* of the lower cube */
            p.tip_density = p.density;
            p.steps = 1 / p.dt > 20 ? (int)(1 / p.dt + 0.5) : 20;
        } else {
            p.young = 1e6;
            p.steps = 100;
        }
        break;
    default: break;
    }
    return p;
}

/* Where a held point goes, t (0 to 1) of the way; the affine map in between. */
STABILITY_MAY void plan_place(const plan *p, double t, const double X[3], double out[3]) {
    double length = p->cells[0] * p->spacing, middle = p->cells[1] * p->spacing / 2, inside = X[0];
    if (p->shell) inside -= length / 2;
    else if (inside < 0) inside = 0;
    if (inside > length) inside = length;
    out[0] = X[0] + t * (p->along - 1) * inside;
    out[1] = middle + (X[1] - middle) * (1 + t * (p->across - 1));
    out[2] = X[2];
}

/* Weight of the state after step k (from 0). */
STABILITY_MAY double plan_weight(const plan *p, int k) {
    if (p->swing) return 1 - cos(6.283185307179586 * (k + 0.5) / p->steps);
    return k >= p->steps - 5;
}

/* ---- the reference ----------------------------------------------------------------------------------------------- */

typedef struct guide {
    plan p;
    fem f;
    double *mean;   /* of the nodes */
    int bad;        /* no solution: the law has none, or Newton's method did not find it */
} guide;

/* The finite elements' run of a plan. finer: twice the elements along each axis. */
STABILITY_MAY void guide_begin(guide *g, const plan *p, fem_law law, int finer) {
    int elements[3], i, k, c, steps;
    double size[3], total = 0;
    memset(g, 0, sizeof *g);
    g->p = *p;
    for (c = 0; c < 3; c++) size[c] = p->cells[c] * p->spacing;
    elements[0] = p->grips == 2 ? 8 : 4;
    elements[1] = p->m == MAP_SECTION ? 2 : 1;
    elements[2] = p->grips == 2 ? 2 : 1;
    for (c = 0; finer && c < 3; c++) elements[c] *= 2;
    fem_begin(&g->f, elements, size, law, p->young, p->poisson);
    fem_mass(&g->f, p->density, p->tip_density, p->gravity);
    g->mean = fem_room(3 * (size_t)g->f.nodes);
    for (i = 0; i < g->f.nodes; i++) {
        double X = g->f.rest[3 * i];
        g->f.held[i] = X < 1e-9 || (p->grips == 2 && X > size[0] - 1e-9);
        plan_place(p, 1, g->f.rest + 3 * i, g->f.x + 3 * i);
    }
    steps = p->swing ? p->steps : 1;
    for (k = 0; k < steps && !g->bad; k++) {
        double w = p->swing ? plan_weight(p, k) : 1;
        g->bad = fem_step(&g->f, p->swing ? p->dt : 0);
        for (i = 0; i < 3 * g->f.nodes; i++) g->mean[i] += w * g->f.x[i];
        total += w;
    }
    for (i = 0; i < 3 * g->f.nodes; i++) g->mean[i] /= total;
}

STABILITY_MAY void guide_end(guide *g) {
    if (g->mean) fem_end(&g->f);
    free(g->mean);
    memset(g, 0, sizeof *g);
}

/* Whether a map has finite elements as its reference. */
STABILITY_MAY int map_guided(map m) {
    return m == MAP_MODULUS || m == MAP_POISSON || m == MAP_MASS || m == MAP_SECTION;
}

/* ---- who is judged ----------------------------------------------------------------------------------------------- */

typedef struct subject {
    plan p;
    int method, count, steps, capped, lost;
    double *rest, *x, *mean, weight; /* 3 count, in the coordinates of the plan */
    unsigned char *grip, *tip;
    double iterations, ms;
    double origin[3];   /* of a baseline's block */
    peri_world *world;
    peri_body_id body;
    baseline *b;
} subject;

/* The same random numbers on every machine. */
STABILITY_MAY double stability_random(uint32_t *seed) {
    *seed = *seed * 1664525u + 1013904223u;
    return (double)(*seed >> 8) / 16777216.0;
}

STABILITY_MAY peri_material stability_material(int method, const plan *p, double density) {
    peri_real e = (peri_real)p->young, nu = (peri_real)p->poisson, rho = (peri_real)density;
    switch (method) {
    case STVK: return peri_material_stvk_exact(e, nu, rho);
    case LINEAR: return peri_material_linear(e, nu, rho);
    case PAPERS: return peri_material_neo_hookean_papers(e, nu, rho);
    case PROJECTIVE: return peri_material_projective(e, (peri_real)0.5, rho);
    default: return peri_material_neo_hookean(e, nu, rho);
    }
}

STABILITY_MAY void subject_room(subject *s, int count) {
    s->count = count;
    s->rest = fem_room(3 * (size_t)count);
    s->x = fem_room(3 * (size_t)count);
    s->mean = fem_room(3 * (size_t)count);
    s->grip = (unsigned char *)calloc(2 * (size_t)count, 1);
    if (!s->grip) exit(2);
    s->tip = s->grip + count;
}

/* Which of s->rest are held or belong to the tip. */
STABILITY_MAY void subject_marks(subject *s) {
    double length = s->p.cells[0] * s->p.spacing, slack = 1e-6 * s->p.spacing;
    int i, c;
    for (i = 0; i < s->count; i++) {
        double X = s->rest[3 * i];
        s->grip[i] = (unsigned char)((s->p.grips && X < slack) || (s->p.grips == 2 && X > length - slack));
        for (c = 0; c < 3 && s->p.shell; c++) {
            double at = s->rest[3 * i + c];
            if (at < 0.6 * s->p.spacing || s->p.cells[c] * s->p.spacing - at < 0.6 * s->p.spacing) s->grip[i] = 1;
        }
        s->tip[i] = X > length * 0.75;
    }
    memcpy(s->x, s->rest, 3 * (size_t)s->count * sizeof *s->x);
}

/* Whether the particle of this cell is removed, asked for all in their order: inner ones only. */
STABILITY_MAY int plan_removes(const plan *p, int i, int j, int k, uint32_t *seed) {
    int inner = i > 0 && j > 0 && k > 0 && i < p->cells[0] - 1 && j < p->cells[1] - 1 && k < p->cells[2] - 1;
    return stability_random(seed) < p->removed && inner;
}

/* Our particles: cell centres, x running fastest, but the removed ones. */
STABILITY_MAY void subject_points(subject *s) {
    const plan *p = &s->p;
    int from = p->grips ? -GRIP : 0, to = p->cells[0] + (p->grips == 2 ? GRIP : 0), i, j, k, c = 0;
    uint32_t seed = 5;
    subject_room(s, (to - from) * p->cells[1] * p->cells[2]);
    for (k = 0; k < p->cells[2]; k++)
        for (j = 0; j < p->cells[1]; j++)
            for (i = from; i < to; i++) {
                if (plan_removes(p, i, j, k, &seed)) continue;
                s->rest[3 * c] = (i + 0.5) * p->spacing;
                s->rest[3 * c + 1] = (j + 0.5) * p->spacing;
                s->rest[3 * c++ + 2] = (k + 0.5) * p->spacing;
            }
    s->count = c;
    subject_marks(s);
}

STABILITY_MAY peri_world *stability_world(const plan *p, peri_solver solver) {
    peri_world_def wd = peri_default_world_def();
    wd.gravity.x = (peri_real)p->gravity[0];
    wd.gravity.y = (peri_real)p->gravity[1];
    wd.gravity.z = (peri_real)p->gravity[2];
    wd.solver = solver;
    wd.sleep_speed = 0;
    return peri_world_create(&wd, NULL);
}

STABILITY_MAY void subject_ours(subject *s, peri_solver solver) {
    const plan *p = &s->p;
    peri_body_def bd = peri_default_body_def();
    peri_material m = stability_material(s->method, p, p->density);
    peri_material_id tip;
    peri_real *points, *volumes;
    int i;
    subject_points(s);
    s->world = stability_world(p, solver);
    points = (peri_real *)malloc(4 * (size_t)s->count * sizeof *points);
    volumes = points + 3 * s->count;
    for (i = 0; i < 3 * s->count; i++) points[i] = (peri_real)s->rest[i];
    for (i = 0; i < s->count; i++)
        volumes[i] = (peri_real)(pow(p->spacing, 3) / (s->grip[i] ? 1 : 1 - p->removed));
    bd.points = points;
    if (p->removed > 0) bd.volumes = volumes;
    bd.count = s->count;
    bd.fixed = s->grip;
    bd.spacing = (peri_real)p->spacing;
    if (p->horizon > 0) bd.horizon = (peri_real)p->horizon;
    if (p->horizon > 2.5) bd.kernel_power = 1; /* as the header says */
    bd.material = peri_material_create(s->world, &m);
    if (p->tip_density != p->density) {
        m = stability_material(s->method, p, p->tip_density);
        tip = peri_material_create(s->world, &m);
        bd.materials = &tip;
        bd.material_count = 1;
        bd.material_of = s->tip;
    }
    s->body = peri_body_create(s->world, &bd);
    if (!s->body.index1) s->lost = 1;
    free(points);
}

/* Substeps that keep the explicit method stable, three tenths of the time of a pressure wave over a spacing; but
   at most a hundred. */
STABILITY_MAY int stability_substeps(const plan *p) {
    double n = ceil(p->dt / (0.3 * p->spacing / sqrt(1.2 * p->young / p->density)));
    return n < 100 ? (int)n : 100;
}

/* How many neighbours a baseline's particle has within a horizon in spacings; 0: more than it can have. */
STABILITY_MAY int stability_neighbours(double horizon) {
    return horizon < 1.1 ? 6 : horizon < 1.5 ? 18 : horizon < 1.8 ? 26 : 0;
}

/* A block, without the particles that are removed. NULL: as baseline_create. */
STABILITY_MAY baseline *plan_block(const plan *p, baseline_def *d) {
    unsigned char *removed = NULL, *at;
    uint32_t seed = 5;
    baseline *b;
    int i, j, k;
    if (p->removed > 0) {
        d->removed = at = removed = (unsigned char *)malloc((size_t)(p->cells[0] * p->cells[1] * p->cells[2]));
        if (!removed) exit(2);
        for (k = 0; k < p->cells[2]; k++)
            for (j = 0; j < p->cells[1]; j++)
                for (i = 0; i < p->cells[0]; i++) *at++ = (unsigned char)plan_removes(p, i, j, k, &seed);
    }
    b = baseline_create(d);
    free(removed);
    return b;
}

STABILITY_MAY void subject_baseline(subject *s) {
    const plan *p = &s->p;
    baseline_def d;
    int i, c;
    memset(&d, 0, sizeof d);
    if (p->m == MAP_REMOVED && (int)BASELINE_SHAPE != s->method - MODELS)
        d.neighbours = stability_neighbours(p->horizon);
    d.method = (baseline_method)(s->method - MODELS);
    for (c = 0; c < 3; c++) {
        d.size[c] = p->cells[c] * p->spacing;
        d.gravity[c] = p->gravity[c];
    }
    d.size[0] += p->grips * GRIP * p->spacing;
    d.spacing = p->spacing;
    d.young = p->young;
    d.poisson = p->poisson;
    d.density = p->density;
    d.tolerance = 1e-3;
    d.max_iterations = 200;
    d.substeps = d.method == BASELINE_EXPLICIT && !p->swing ? stability_substeps(p) : 1;
    if (d.method == BASELINE_XPBD) { /* small steps (Macklin et al. 2019): better than sweeps over one step */
        d.substeps = 200;
        d.max_iterations = 1;
    }
    s->b = plan_block(p, &d);
    if (!s->b) {
        s->lost = 1;
        return;
    }
    subject_room(s, s->b->count);
    for (c = 0; c < 3; c++) { /* the block's middle is the plan's, the near grip apart */
        double low = HUGE_VAL, high = -HUGE_VAL;
        for (i = 0; i < s->count; i++) {
            if (s->b->rest[3 * i + c] < low) low = s->b->rest[3 * i + c];
            if (s->b->rest[3 * i + c] > high) high = s->b->rest[3 * i + c];
        }
        s->origin[c] = (low + high) / 2 - d.size[c] / 2 + (c == 0 && p->grips ? GRIP * p->spacing : 0);
        for (i = 0; i < s->count; i++) s->rest[3 * i + c] = s->b->rest[3 * i + c] - s->origin[c];
    }
    subject_marks(s);
    for (i = 0; i < s->count; i++) {
        if (s->b->fixed[i]) s->grip[i] = 1; /* removed */
        s->b->fixed[i] = s->grip[i];
        if (!s->grip[i]) {
            s->b->mass[i] /= 1 - p->removed;
            s->b->volume[i] /= 1 - p->removed;
        }
        if (s->tip[i]) s->b->mass[i] *= p->tip_density / p->density;
    }
}

STABILITY_MAY void subject_begin(subject *s, const plan *p, int method, peri_solver solver) {
    memset(s, 0, sizeof *s);
    s->p = *p;
    s->method = method;
    if (method < MODELS) subject_ours(s, solver); else subject_baseline(s);
}

STABILITY_MAY void subject_end(subject *s) {
    peri_world_destroy(s->world);
    if (s->b) baseline_destroy(s->b);
    free(s->rest);
    free(s->x);
    free(s->mean);
    free(s->grip);
    memset(s, 0, sizeof *s);
}

/* Puts every point at s->x, at rest. */
STABILITY_MAY void subject_put(subject *s) {
    int i, n = 3 * s->count;
    if (s->lost) return;
    if (s->b) {
        for (i = 0; i < n; i++) {
            s->b->x[i] = s->x[i] + s->origin[i % 3];
            s->b->v[i] = 0;
        }
    } else {
        peri_real *x = (peri_real *)malloc((size_t)n * sizeof *x);
        for (i = 0; i < n; i++) x[i] = (peri_real)s->x[i];
        if (peri_body_set_positions(s->world, s->body, 0, s->count, x)) s->lost = 1;
        free(x);
    }
}

/* Moves the grips t of their way. */
STABILITY_MAY void subject_grip(subject *s, double t) {
    int i, c;
    for (i = 0; i < s->count && !s->lost; i++) {
        double to[3];
        if (!s->grip[i]) continue;
        plan_place(&s->p, t, s->rest + 3 * i, to);
        if (s->b) {
            for (c = 0; c < 3; c++) s->b->x[3 * i + c] = to[c] + s->origin[c];
        } else {
            peri_vec3 q;
            q.x = (peri_real)to[0];
            q.y = (peri_real)to[1];
            q.z = (peri_real)to[2];
            peri_body_move(s->world, s->body, i, q);
        }
    }
}

/* One step; the state goes to s->x and, by its weight, into the mean. */
STABILITY_MAY void subject_step(subject *s, double weight) {
    double far = 10 * s->p.cells[0] * s->p.spacing, begin = (double)clock();
    int i, result = 0, n = 3 * s->count;
    if (s->lost) return;
    if (s->b) {
        result = baseline_step(s->b, s->p.dt);
        s->lost = result < 0;
        s->capped += result == 1 && s->b->def.method != BASELINE_XPBD;
        s->iterations += s->b->iterations;
    } else {
        s->lost = peri_world_step(s->world, (peri_real)s->p.dt) != PERI_OK;
        s->capped += !peri_world_stats(s->world).converged;
        s->iterations += peri_world_stats(s->world).iterations;
    }
    s->ms += 1e3 * ((double)clock() - begin) / CLOCKS_PER_SEC;
    s->steps++;
    if (s->b) for (i = 0; i < n; i++) s->x[i] = s->b->x[i] - s->origin[i % 3];
    else {
        const peri_real *x = peri_body_positions(s->world, s->body);
        for (i = 0; i < n; i++) s->x[i] = (double)x[i];
    }
    for (i = 0; i < n; i++) {
        if (!(fabs(s->x[i]) < far)) s->lost = 1;
        s->mean[i] += weight * s->x[i];
    }
    s->weight += weight;
}

/* The colour by error and by what the steps said; bad: where red begins. */
STABILITY_MAY cell subject_cell(const subject *s, double error, double bad) {
    cell c;
    int capped = 2 * s->capped > s->steps;
    memset(&c, 0, sizeof c);
    c.error = s->lost || !(error < HUGE_VAL) ? HUGE_VAL : error;
    c.iterations = s->steps ? s->iterations / s->steps : 0;
    c.ms = s->ms;
    c.colour = c.error <= 0.1 ? (capped ? 'y' : 'g') : c.error < bad && !capped ? 'y' : 'r';
    return c;
}

/* ---- maps with finite elements ----------------------------------------------------------------------------------- */

/* Rms distance of the free points to the reference over its rms displacement, at least d/10; between two grips of the
   worst axis. */
STABILITY_MAY double field_error(const subject *s, const guide *g) {
    double away[3] = {0}, moved[3] = {0}, worst = 0, least = 0.1 * s->p.spacing;
    int i, c, n = 0;
    for (i = 0; i < s->count; i++) {
        double at[3];
        if (s->grip[i]) continue;
        fem_at(g->mean, &g->f, s->rest + 3 * i, at);
        for (c = 0; c < 3; c++) {
            away[c] += pow(s->mean[3 * i + c] / s->weight - at[c], 2);
            moved[c] += pow(at[c] - s->rest[3 * i + c], 2);
        }
        n++;
    }
    if (s->p.grips == 1) {
        away[0] += away[1] + away[2];
        moved[0] += moved[1] + moved[2];
        away[1] = away[2] = 0;
    }
    for (c = 0; c < 3; c++) {
        double scale = sqrt(moved[c] / n) > least ? sqrt(moved[c] / n) : least, e = sqrt(away[c] / n) / scale;
        if (!(e <= worst)) worst = e;
    }
    return worst;
}

/* Contraction along y in the middle half: of the subject, or of the reference at the same points. */
STABILITY_MAY double contraction(const subject *s, const guide *g) {
    double length = s->p.cells[0] * s->p.spacing, middle = s->p.cells[1] * s->p.spacing / 2, yy = 0, yY = 0;
    int i;
    for (i = 0; i < s->count; i++) {
        const double *X = s->rest + 3 * i;
        double at[3];
        if (fabs(X[0] - length / 2) > length / 4) continue;
        if (g) fem_at(g->mean, &g->f, X, at); else at[1] = s->mean[3 * i + 1] / s->weight;
        yy += (X[1] - middle) * (X[1] - middle);
        yY += (X[1] - middle) * (at[1] - middle);
    }
    return 1 - yY / yy;
}

STABILITY_MAY double guided_error(const subject *s, const guide *g) {
    double error = field_error(s, g), e;
    if (s->p.m != MAP_POISSON) return error;
    e = fabs(contraction(s, NULL) - contraction(s, g)) / (0.5 * (s->p.along - 1));
    return e <= error ? error : e;
}

/* ---- maps with an affine solution -------------------------------------------------------------------------------- */

/* Cauchy stress of the method's law under diag(along, across, 1): its diagonal. */
STABILITY_MAY void exact_stress(const subject *s, double stress[3]) {
    double mu = s->p.young / (2 * (1 + s->p.poisson)), f[3] = {1, 1, 1}, trace = 0, j;
    double lambda = s->p.young * s->p.poisson / ((1 + s->p.poisson) * (1 - 2 * s->p.poisson));
    int c;
    f[0] = s->p.along;
    f[1] = s->p.across;
    j = f[0] * f[1];
    for (c = 0; c < 3; c++) trace += (f[c] * f[c] - 1) / 2;
    for (c = 0; c < 3; c++)
        stress[c] = s->method == STVK ? f[c] * f[c] * (mu * (f[c] * f[c] - 1) + lambda * trace) / j
                                      : (mu * (f[c] * f[c] - 1) + lambda * log(j)) / j;
}

/* Mean stress of our free particles over the exact one. */
STABILITY_MAY double stress_error(const subject *s) {
    peri_real *all = (peri_real *)malloc(6 * (size_t)s->count * sizeof *all);
    double mean[3] = {0}, exact[3], away = 0, size = 0, least = s->p.young / 20;
    int i, c, n = 0;
    if (peri_body_stress(s->world, s->body, all)) return HUGE_VAL;
    for (i = 0; i < s->count; i++) {
        if (s->grip[i]) continue;
        for (c = 0; c < 3; c++) mean[c] += (double)all[6 * i + c];
        n++;
    }
    free(all);
    exact_stress(s, exact);
    for (c = 0; c < 3; c++) {
        away += (mean[c] / n - exact[c]) * (mean[c] / n - exact[c]);
        size += exact[c] * exact[c];
    }
    return sqrt(away) / (sqrt(size) > least ? sqrt(size) : least);
}

STABILITY_MAY double affine_error(const subject *s) {
    double away = 0, error, stress;
    int i, c, n = 0;
    for (i = 0; i < s->count; i++) {
        double at[3];
        if (s->grip[i]) continue;
        plan_place(&s->p, 1, s->rest + 3 * i, at);
        for (c = 0; c < 3; c++) away += pow(s->mean[3 * i + c] / s->weight - at[c], 2);
        n++;
    }
    error = sqrt(away / n) / s->p.spacing;
    if (s->p.m != MAP_STRETCH || !s->world) return error;
    stress = stress_error(s);
    return stress <= error ? error : stress;
}

/* ---- the two together -------------------------------------------------------------------------------------------- */

/* g NULL: the solution is affine. */
STABILITY_MAY cell driven_cell(const plan *p, int method, peri_solver solver, const guide *g) {
    subject s;
    cell c;
    uint32_t seed = 7;
    int i, k;
    subject_begin(&s, p, method, solver);
    for (i = 0; !p->drive && i < s.count; i++) {
        plan_place(p, 1, s.rest + 3 * i, s.x + 3 * i);
        for (k = 0; k < 3 && p->shake > 0; k++) {
            double r = stability_random(&seed) - 0.5;
            if (!s.grip[i]) s.x[3 * i + k] += 2 * p->shake * p->spacing * r;
        }
    }
    if (!p->drive) subject_put(&s);
    for (k = 0; k < p->steps && !s.lost; k++) {
        if (p->drive) subject_grip(&s, k < p->drive ? (double)(k + 1) / p->drive : 1);
        subject_step(&s, plan_weight(p, k));
    }
    c = subject_cell(&s, s.lost ? HUGE_VAL : g ? guided_error(&s, g) : affine_error(&s), 1);
    subject_end(&s);
    return c;
}

/* ---- collapse ---------------------------------------------------------------------------------------------------- */

STABILITY_MAY double misfit(const subject *s) {
    double from[3] = {0}, to[3] = {0}, a[9] = {0}, r[9], sum = 0;
    int i, j, k;
    for (i = 0; i < 3 * s->count; i++) {
        from[i % 3] += s->rest[i] / s->count;
        to[i % 3] += s->x[i] / s->count;
    }
    for (i = 0; i < s->count; i++)
        for (j = 0; j < 3; j++)
            for (k = 0; k < 3; k++) a[3 * j + k] += (s->x[3 * i + j] - to[j]) * (s->rest[3 * i + k] - from[k]);
    peri_polar3(a, r);
    for (i = 0; i < s->count; i++)
        for (j = 0; j < 3; j++) {
            double away = s->x[3 * i + j] - to[j];
            for (k = 0; k < 3; k++) away -= r[3 * j + k] * (s->rest[3 * i + k] - from[k]);
            sum += away * away;
        }
    return sqrt(sum / s->count) / s->p.spacing;
}

/* Exactly flattened, mirrored or dealt out: no noise. */
STABILITY_MAY void collapse(subject *s, int kind) {
    uint32_t seed = 2017;
    double middle = s->p.cells[0] * s->p.spacing / 2;
    int i, j, k;
    for (i = s->count - 1; i >= 0; i--) {
        double *x = s->x + 3 * i;
        if (kind <= 3) x[1] = middle;
        if (kind == 2 || kind == 3) x[0] = middle;
        if (kind == 3) x[2] = middle;
        if (kind == 4) x[0] = 2 * middle - x[0];
    }
    for (i = s->count - 1; kind == 5 && i >= 0; i--)
        for (j = (int)(stability_random(&seed) * (i + 1)), k = 0; k < 3; k++) {
            double t = s->x[3 * i + k];
            s->x[3 * i + k] = s->x[3 * j + k];
            s->x[3 * j + k] = t;
        }
}

STABILITY_MAY cell collapse_cell(const plan *p, int kind, int method, peri_solver solver) {
    subject s;
    cell c;
    double error = HUGE_VAL;
    int k;
    subject_begin(&s, p, method, solver);
    collapse(&s, kind);
    subject_put(&s);
    for (k = 0; k < p->steps && !s.lost && error > 0.05; k++) {
        subject_step(&s, 0);
        error = misfit(&s);
    }
    s.capped = 0; /* what counts is whether it is back */
    c = subject_cell(&s, error, 0.5);
    subject_end(&s);
    return c;
}

/* ---- contact ----------------------------------------------------------------------------------------------------- */

/* Ratio of length under a pressure, sides held, by the law: by bisection, where the pressure still grows. */
STABILITY_MAY double squeezed(int stvk, double mu, double lambda, double pressure) {
    double low = stvk ? 0.58 : 0.05, high = 1;
    int k;
    for (k = 0; k < 60; k++) {
        double l = (low + high) / 2;
        double push = stvk ? (lambda + 2 * mu) * l * (1 - l * l) / 2 : mu * (1 / l - l) - lambda * log(l) / l;
        if (push > pressure) low = l; else high = l;
    }
    return (low + high) / 2;
}

/* Shortening between the lower cube's second and fourth layer of particles by the load above. */
STABILITY_MAY double exact_shortening(const plan *p, int stvk) {
    double mu = p->young / (2 * (1 + p->poisson)), sum = 0, side = p->cells[2] * p->spacing;
    double lambda = p->young * p->poisson / ((1 + p->poisson) * (1 - 2 * p->poisson));
    int k, parts = 200;
    for (k = 0; k < parts; k++) {
        double z = p->spacing * (1.5 + 2 * (k + 0.5) / parts);
        double pressure = 9.81 * (1000 * side + p->density * (side - z));
        sum += (1 - squeezed(stvk, mu, lambda, pressure)) * 2 * p->spacing / parts;
    }
    return sum;
}

STABILITY_MAY double layer_height(const subject *s, int layer) {
    int n = s->p.cells[0] * s->p.cells[1], i;
    double sum = 0;
    for (i = 0; i < n; i++) sum += s->mean[3 * (layer * n + i) + 2] / s->weight;
    return sum / n;
}

/* A plane without friction whose normal is axis c, towards + (side 0) or - (1). */
STABILITY_MAY peri_collider_id stability_wall(peri_world *world, int c, int side, double at) {
    static const double turn[3][2][3] = {{{0, 1, 0}, {0, -1, 0}}, {{-1, 0, 0}, {1, 0, 0}}, {{0, 0, 0}, {0, 0, 0}}};
    peri_collider_def d = peri_default_collider_def();
    const double *t = turn[c][side];
    d.type = PERI_FRICTION_SLIP;
    if (c == 0) d.position.x = (peri_real)at;
    if (c == 1) d.position.y = (peri_real)at;
    if (c < 2) {
        d.rotation.x = (peri_real)(t[0] * sqrt(0.5));
        d.rotation.y = (peri_real)(t[1] * sqrt(0.5));
        d.rotation.w = (peri_real)sqrt(0.5);
    }
    return peri_collider_create(world, &d);
}

STABILITY_MAY cell contact_cell(const plan *p, int method, peri_solver solver) {
    subject s;
    cell c;
    peri_body_def bd = peri_default_body_def();
    peri_collider_id ground;
    peri_material m;
    peri_body_id top;
    peri_real *points;
    double exact = exact_shortening(p, method == STVK), side = p->cells[2] * p->spacing, weight;
    double push = 0, error = HUGE_VAL, high = 0;
    int i, k, half = p->steps / 2, n;
    subject_begin(&s, p, method, solver);
    n = s.count;
    ground = stability_wall(s.world, 2, 0, 0);
    for (i = 0; i < 4; i++) stability_wall(s.world, i / 2, i % 2, i % 2 ? side : 0);
    points = (peri_real *)malloc(3 * (size_t)n * sizeof *points);
    for (i = 0; i < 3 * n; i++) points[i] = (peri_real)s.rest[i];
    m = stability_material(method, p, 1000);
    bd.points = points;
    bd.count = n;
    bd.spacing = (peri_real)p->spacing;
    bd.position.z = (peri_real)side;
    bd.friction = 0;
    bd.material = peri_material_create(s.world, &m);
    top = peri_body_create(s.world, &bd);
    free(points);
    for (k = 0; k < p->steps && !s.lost; k++) {
        peri_vec3 impulse = {0, 0, 0};
        const peri_real *x;
        subject_step(&s, k >= half);
        if (k < half) continue;
        peri_collider_impulse(s.world, ground, &impulse, NULL);
        push -= (double)impulse.z / p->dt / (p->steps - half);
        x = peri_body_positions(s.world, top);
        for (i = 0; i < n; i++) high += (double)x[3 * i + 2] / n / (p->steps - half);
    }
    if (!s.lost) {
        double shorter = 2 * p->spacing - (layer_height(&s, 3) - layer_height(&s, 1)), e;
        weight = 9.81 * (1000 + p->density) * side * side * side;
        error = fabs(shorter / exact - 1);
        e = fabs(push / weight - 1);
        if (!(e <= error)) error = e;
        if (!(high > side)) s.lost = 1; /* the upper one is not above any more */
    }
    c = subject_cell(&s, error, 1);
    subject_end(&s);
    return c;
}

/* ---- one cell of any map ----------------------------------------------------------------------------------------- */

/* The references of a cell, made once for all methods; [0] neo-Hookean, [1] St. Venant-Kirchhoff. */
STABILITY_MAY void guides_begin(guide g[2], map m, double x, double y) {
    plan p = plan_of(m, x, y);
    memset(g, 0, 2 * sizeof *g);
    if (!map_guided(m)) return;
    guide_begin(&g[0], &p, FEM_NEO_HOOKEAN, 0);
    guide_begin(&g[1], &p, FEM_STVK, 0);
}

STABILITY_MAY void guides_end(guide g[2]) {
    guide_end(&g[0]);
    guide_end(&g[1]);
}

STABILITY_MAY cell map_cell(map m, double x, double y, int method, peri_solver solver, const guide g[2]) {
    plan p = plan_of(m, x, y);
    int follows = method == STVK || method == MODELS + (int)BASELINE_STVK;
    if (m == MAP_COLLAPSE) return collapse_cell(&p, (int)x, method, solver);
    if (m == MAP_CONTACT) return contact_cell(&p, method, solver);
    if (!map_guided(m)) return driven_cell(&p, method, solver, NULL);
    return driven_cell(&p, method, solver, follows && !g[1].bad ? &g[1] : &g[0]);
}

/* Why a method has no part in a row of a map, y; NULL: it has. */
STABILITY_MAY const char *cell_without(map m, double y, int method) {
    baseline_method b = (baseline_method)(method - MODELS);
    if (method < MODELS) return NULL;
    if (m == MAP_CONTACT) return "no contact";
    if (m != MAP_REMOVED) return NULL;
    if (b == BASELINE_STVK || b == BASELINE_COROTATED) return "the points left would want another mesh";
    if (b == BASELINE_SHAPE) return stability_neighbours(y) == 26 ? NULL : "its clusters of eight are in one row only";
    return stability_neighbours(y) ? NULL : "26 neighbours at most";
}

#endif
