/* tests/bench/accuracy/peri.c - peri for the benchmark of speed against accuracy: the scenes. Compiled twice,
   without and with PERI_DOUBLE; all of peri is private to each of the two, so that one program holds both. */
#define PERI_STATIC
#define PERI_IMPLEMENTATION
#define PERI_NO_SKINNING
#define PERI_NO_DRAW
#include "../../../peri.h"
#include "../bench.h"
#include "scene.h"

enum { LAYERS = 2 };    /* held beyond the clamp plane, which lies half way to the first free layer */

#define REAL(x) ((peri_real)(x))
static const double turn = 3.14159265358979323846, pulled = 0.5;    /* at the end: angle of twist, elongation in m */

typedef struct stage {
    const setup *s;
    peri_world *world;
    peri_body_id body[CUBES];
    peri_real *points, *x, *force;  /* of all bodies, one after the other: at rest; at present; forces on the first */
    int bodies, count, face;        /* count: particles; face: those of a cross-section of beam or cube */
    double spacing;
    double start[SEEN];     /* what was seen before the first step, of scenes that tell what has changed */
} stage;

static int cubic(const stage *t) { return t->s->scene == DROP || t->s->scene == PILE; }

static peri_material material(int scene, int model) {
    peri_real young = REAL(scene == SWING ? 1e6 : scene == FALL ? 2e5 : 1e5), nu = REAL(0.25);
    peri_real rho = REAL(scene == STRETCH || scene == TWIST ? 10 : scene == FALL ? 500 : 1000);
    if (model == LINEAR) return peri_material_linear(young, nu, rho);
    if (model == PAPERS) return peri_material_neo_hookean_papers(young, nu, rho);
    if (model == PROJECTIVE) return peri_material_projective(young, REAL(0.5), rho);
    return peri_material_neo_hookean(young, nu, rho);
}

/* Layers of the beam's cross-section, the held ones first and, where the far end is gripped, last. */
static unsigned char *beam(stage *t) {
    int far_layers = t->s->scene == SWING ? 0 : LAYERS, across = t->s->across, along = 5 * across, i, j, k, c = 0;
    unsigned char *fixed;
    t->face = across * across;
    t->count = (LAYERS + along + far_layers) * t->face;
    t->spacing = 0.2 / across;
    t->points = (peri_real *)bench_obtain(3 * sizeof *t->points * (size_t)t->count);
    fixed = (unsigned char *)bench_obtain((size_t)t->count);
    for (i = -LAYERS; i < along + far_layers; i++)
        for (j = 0; j < across; j++)
            for (k = 0; k < across; k++, c++) {
                t->points[3 * c] = REAL((i + 0.5) * t->spacing);
                t->points[3 * c + 1] = REAL((j + 0.5) * t->spacing - 0.1);
                t->points[3 * c + 2] = REAL((k + 0.5) * t->spacing - 0.1);
                fixed[c] = (unsigned char)(i < 0 || i >= along);
            }
    return fixed;
}

static void figure(stage *t, const mesh *m) {
    peri_real *v = (peri_real *)bench_obtain(3 * sizeof *v * (size_t)m->vertex_count);
    peri_shape shape;
    int k;
    for (k = 0; k < 3 * m->vertex_count; k++) v[k] = REAL((double)m->vertices[k]);
    shape = peri_shape_mesh(v, m->vertex_count, m->triangles, m->triangle_count);
    t->spacing = 1.0 / t->s->across;
    peri_sample(&shape, REAL(t->spacing), NULL, 0, &t->count, NULL);
    t->points = (peri_real *)bench_obtain(3 * sizeof *t->points * (size_t)t->count);
    peri_sample(&shape, REAL(t->spacing), t->points, t->count, &t->count, NULL);
    free(v);
}

/* Cubes at their places, layer by layer from below. Positions at rest are those of the start, so each body's are its
   part of the points. */
static void cubes(stage *t) {
    int n = t->s->across, q, i, j, k, c = 0;
    t->bodies = scene_cubes(t->s->scene);
    t->face = n * n;
    t->count = t->bodies * n * n * n;
    t->points = (peri_real *)bench_obtain(3 * sizeof *t->points * (size_t)t->count);
    for (q = 0; q < t->bodies; q++) {
        double d = scene_side(t->s->scene, q) / n, floor = scene_height(t->s->scene, q);
        for (k = 0; k < n; k++)
            for (j = 0; j < n; j++)
                for (i = 0; i < n; i++, c++) {
                    t->points[3 * c] = REAL((i + 0.5 - 0.5 * n) * d);
                    t->points[3 * c + 1] = REAL((j + 0.5 - 0.5 * n) * d);
                    t->points[3 * c + 2] = REAL(floor + (k + 0.5) * d);
                }
    }
}

/* The lowest particle touches the ground when it is its contact distance above it. */
static double ground_under(const stage *t) {
    double low = 1e30;
    int i;
    for (i = 2; i < 3 * t->count; i += 3)
        if ((double)t->points[i] < low) low = (double)t->points[i];
    return low - 0.5 * t->spacing;
}

static int begin(stage *t, const setup *s, const mesh *m) {
    static const peri_solver solver[SOLVERS] = {PERI_SOLVER_CHOLESKY, PERI_SOLVER_TWO_LEVEL, PERI_SOLVER_JACOBI,
                                                PERI_SOLVER_CHEBYSHEV, PERI_SOLVER_POSITION};
    peri_world_def wd = peri_default_world_def();
    peri_body_def bd = peri_default_body_def();
    peri_collider_def ground = peri_default_collider_def();
    peri_material stuff = material(s->scene, s->model);
    unsigned char *fixed = NULL;
    int q;
    memset(t, 0, sizeof *t);
    t->s = s;
    t->bodies = 1;
    if (s->scene == FALL) figure(t, m);
    else if (cubic(t)) cubes(t);
    else fixed = beam(t);
    t->x = (peri_real *)bench_obtain(3 * sizeof *t->x * (size_t)t->count);
    t->force = (peri_real *)bench_obtain(3 * sizeof *t->force * (size_t)t->count);
    if (s->scene == STRETCH || s->scene == TWIST) wd.gravity.z = 0;
    wd.solver = solver[s->solver];
    wd.lbfgs = s->lbfgs ? wd.lbfgs : 0;
    wd.tolerance = REAL(s->tolerance);
    wd.integrator = s->bdf2 ? PERI_BDF2 : PERI_BACKWARD_EULER;
    wd.max_iterations = s->max_iterations;
    wd.sleep_speed = 0;
    wd.parallel.threads = 1;
    t->world = peri_world_create(&wd, NULL);
    bd.count = t->count / t->bodies;
    bd.fixed = fixed;
    bd.material = peri_material_create(t->world, &stuff);
    if (s->scene == FALL) bd.position.z = REAL(0.05 - ground_under(t));
    if (s->scene == FALL || cubic(t)) {
        bd.velocity.z = REAL(-scene_speed(s->scene));
        bd.friction = ground.friction = REAL(scene_friction(s->scene));
        peri_collider_create(t->world, &ground);
    }
    for (q = 0; q < t->bodies; q++) {
        bd.points = t->points + 3 * q * bd.count;
        bd.spacing = REAL(cubic(t) ? scene_side(s->scene, q) / s->across : t->spacing);
        t->body[q] = peri_body_create(t->world, &bd);
        if (!t->body[q].index1) {
            printf("no body: %s\n", peri_last_error(t->world)->text);
            break;
        }
    }
    free(fixed);
    return q == t->bodies;
}

static void end(stage *t) {
    peri_world_destroy(t->world);
    free(t->points);
    free(t->x);
    free(t->force);
}

/* Sends the gripped end to where it is at the time `at`, in shares of the duration. */
static void drive(stage *t, double at) {
    int i, gripped = t->count - LAYERS * t->face;
    double c = cos(turn * at), s = sin(turn * at);
    if (t->s->scene != STRETCH && t->s->scene != TWIST) return;
    for (i = gripped; i < t->count; i++) {
        double y = (double)t->points[3 * i + 1], z = (double)t->points[3 * i + 2];
        peri_vec3 x;
        x.x = REAL((double)t->points[3 * i] + (t->s->scene == STRETCH ? pulled * at : 0));
        x.y = REAL(t->s->scene == TWIST ? c * y - s * z : y);
        x.z = REAL(t->s->scene == TWIST ? s * y + c * z : z);
        peri_body_move(t->world, t->body[0], i, x);
    }
}

/* End face's centroid: the last layer's mean displacement, carried half a spacing on by the slope. */
static void see_tip(const stage *t, double seen[SEEN]) {
    const peri_real *x = t->x;
    int last = t->count - t->face, q, c;
    for (c = 0; c < 2; c++) {
        double tip = 0, before = 0;
        for (q = 3 * last + 2 * c; q < 3 * t->count; q += 3) {
            tip += (double)x[q] - (double)t->points[q];
            before += (double)x[q - 3 * t->face] - (double)t->points[q - 3 * t->face];
        }
        seen[c] = (tip + (tip - before) / 2) / t->face;
    }
}

/* What the grip must do: the sum of the forces on its layers, their moment about x. */
static void see_grip(const stage *t, double seen[SEEN]) {
    const peri_real *x = t->x;
    int i;
    peri_body_forces(t->world, t->body[0], t->force);
    for (i = t->count - LAYERS * t->face; i < t->count; i++) {
        const peri_real *f = t->force + 3 * i;
        if (t->s->scene == STRETCH) seen[0] -= (double)f[0] / 0.04;
        else seen[0] -= (double)x[3 * i + 1] * (double)f[2] - (double)x[3 * i + 2] * (double)f[1];
    }
}

/* Mean height of particles first .. end - 1, and the rms distance from it. */
static double mean_height(const stage *t, int first, int end, double *reach) {
    double sum = 0, squares = 0;
    int i;
    for (i = first; i < end; i++) sum += (double)t->x[3 * i + 2];
    sum /= end - first;
    for (i = first; i < end; i++) squares += ((double)t->x[3 * i + 2] - sum) * ((double)t->x[3 * i + 2] - sum);
    if (reach) *reach = sqrt(squares / (end - first));
    return sum;
}

/* The faces of a cube are half a spacing beyond its outer layers: each is carried on by the slope, as see_tip does. */
static double height_of_cube(const stage *t) {
    double lowest = mean_height(t, 0, t->face, NULL), next = mean_height(t, t->face, 2 * t->face, NULL);
    double highest = mean_height(t, t->count - t->face, t->count, NULL);
    double before = mean_height(t, t->count - 2 * t->face, t->count - t->face, NULL);
    return highest + (highest - before) / 2 - (lowest - (next - lowest) / 2);
}

/* All cubes of a pile are of one density and of as many particles: the side decides what each weighs. */
static void see_pile(const stage *t, double seen[SEEN]) {
    int each = t->count / t->bodies, q;
    double mass = 0;
    for (q = 0; q < t->bodies; q++) {
        double side = scene_side(PILE, q), own = side * side * side;
        seen[1] = mean_height(t, q * each, (q + 1) * each, NULL);
        seen[0] += own * seen[1];
        mass += own;
    }
    seen[0] /= mass;
}

/* Keeps the positions, and what is seen, in `keep` and `seen`. */
static void see(stage *t, double *keep, double seen[SEEN]) {
    int each = t->count / t->bodies, q, k;
    seen[0] = seen[1] = 0;
    for (q = 0; q < t->bodies; q++)
        memcpy(t->x + 3 * q * each, peri_body_positions(t->world, t->body[q]), 3 * sizeof *t->x * (size_t)each);
    for (k = 0; k < 3 * t->count; k++) keep[k] = (double)t->x[k];
    if (t->s->scene == SWING) see_tip(t, seen);
    else if (t->s->scene == FALL) seen[0] = mean_height(t, 0, t->count, &seen[1]);
    else if (t->s->scene == DROP) seen[0] = mean_height(t, 0, t->count, NULL), seen[1] = height_of_cube(t);
    else if (t->s->scene == PILE) see_pile(t, seen);
    else see_grip(t, seen);
    for (k = 0; k < SEEN; k++) seen[k] -= t->start[k];
}

#ifdef PERI_DOUBLE
int bench_accuracy_double(const setup *s, const mesh *m, course *out)
#else
int bench_accuracy_float(const setup *s, const mesh *m, course *out)
#endif
{
    stage t;
    double start[SEEN];
    int moments = scene_moments(s->scene), moment, k, part = 0;
    int per_moment = (int)(scene_duration(s->scene) / moments / s->step + 0.5);
    memset(out, 0, sizeof *out);
    out->lost = !begin(&t, s, m);
    out->count = t.count;
    out->x = (double *)bench_obtain(3 * sizeof(double) * (size_t)t.count * (size_t)(moments + 1));
    out->start = out->x + 3 * (size_t)t.count * (size_t)moments;
    if (!out->lost) {
        see(&t, out->start, start);
        if (s->scene == FALL || cubic(&t)) memcpy(t.start, start, sizeof start);
    }
    for (moment = 0; moment < moments && !out->lost; moment++) {
        for (k = 0; k < per_moment && !out->lost; k++, part++) {
            double start = bench_cpu();
            peri_stats q;
            drive(&t, (part + 1.0) / (moments * per_moment));
            out->lost = peri_world_step(t.world, REAL(s->step)) != PERI_OK;
            q = peri_world_stats(t.world);
            out->ms += bench_cpu() - start - (part ? 0 : q.profile.factor);
            out->iterations += q.iterations;
            out->capped += !q.converged;
            out->lost |= out->ms > s->patience;
        }
        if (!out->lost) see(&t, out->x + 3 * (size_t)t.count * (size_t)moment, out->seen[moment]);
    }
    out->steps = part;
    end(&t);
    return !out->lost;
}
