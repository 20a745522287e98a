/* tests/scenes.h - what the physics tests share: random numbers, small tensors, lattice blocks, a world with one block.

   Include it after peri.h (with PERI_IMPLEMENTATION) and test.h. Everything is static; a program uses what it needs. */
#ifndef PERI_SCENES_H
#define PERI_SCENES_H

#include <stdlib.h>

#if defined(__GNUC__) || defined(__clang__)
#define SCENE_MAY static __attribute__((unused))
#else
#define SCENE_MAY static
#endif

/* Rounding of one operation in peri_real: half a unit in the last place of 1. */
#define EPS (sizeof(peri_real) == 4 ? 5.96e-8 : 1.11e-16)
#define IS_DOUBLE (sizeof(peri_real) == 8)

#define FIGURE(name, value) printf("    %s = %.4g\n", name, (double)(value))

/* ---- random numbers: the same on every machine --------------------------------------------------------------- */

static uint64_t scene_random_state = 0x9e3779b97f4a7c15ull;

SCENE_MAY void random_seed(uint64_t seed) { scene_random_state = 0x9e3779b97f4a7c15ull * (seed + 1); }

SCENE_MAY uint64_t random_bits(void) {
    uint64_t z = scene_random_state += 0x9e3779b97f4a7c15ull;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
    return z ^ (z >> 31);
}

/* Between -1 and 1. */
SCENE_MAY double uniform(void) { return (double)(int64_t)random_bits() / 9223372036854775808.0; }
SCENE_MAY double between(double low, double high) { return low + (high - low) * (uniform() + 1) / 2; }

/* ---- small tensors: 3x3 by rows, symmetric ones 00 11 22 12 02 01 ---------------------------------------------- */

static const int voigt_row[6] = {0, 1, 2, 1, 0, 0}, voigt_col[6] = {0, 1, 2, 2, 2, 1};

SCENE_MAY peri_vec3 vec3(double x, double y, double z) {
    peri_vec3 v;
    v.x = (peri_real)x;
    v.y = (peri_real)y;
    v.z = (peri_real)z;
    return v;
}

SCENE_MAY double norm(const double *v, int n) {
    double sum = 0;
    int k;
    for (k = 0; k < n; k++) sum += v[k] * v[k];
    return sqrt(sum);
}

SCENE_MAY double distance(const double *a, const double *b, int n) {
    double sum = 0;
    int k;
    for (k = 0; k < n; k++) sum += (a[k] - b[k]) * (a[k] - b[k]);
    return sqrt(sum);
}

SCENE_MAY void cross(const double *a, const double *b, double *out) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

SCENE_MAY void apply(const double f[9], const double *x, double *y) {
    int i;
    for (i = 0; i < 3; i++) y[i] = f[3 * i] * x[0] + f[3 * i + 1] * x[1] + f[3 * i + 2] * x[2];
}

SCENE_MAY void transpose(const double a[9], double t[9]) {
    int i, j;
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++) t[3 * i + j] = a[3 * j + i];
}

SCENE_MAY peri_quat random_quat(void) {
    double q[4], length;
    peri_quat out;
    int k;
    do {
        for (k = 0; k < 4; k++) q[k] = uniform();
        length = norm(q, 4);
    } while (length > 1 || length < 0.1);
    out.x = (peri_real)(q[0] / length);
    out.y = (peri_real)(q[1] / length);
    out.z = (peri_real)(q[2] / length);
    out.w = (peri_real)(q[3] / length);
    return out;
}

SCENE_MAY peri_quat axis_quat(int axis, double angle) {
    double q[3] = {0, 0, 0};
    peri_quat out;
    q[axis] = sin(angle / 2);
    out.x = (peri_real)q[0];
    out.y = (peri_real)q[1];
    out.z = (peri_real)q[2];
    out.w = (peri_real)cos(angle / 2);
    return out;
}

SCENE_MAY void quat_matrix(peri_quat q, double r[9]) {
    double x = (double)q.x, y = (double)q.y, z = (double)q.z, w = (double)q.w;
    r[0] = 1 - 2 * (y * y + z * z); r[1] = 2 * (x * y - z * w); r[2] = 2 * (x * z + y * w);
    r[3] = 2 * (x * y + z * w); r[4] = 1 - 2 * (x * x + z * z); r[5] = 2 * (y * z - x * w);
    r[6] = 2 * (x * z - y * w); r[7] = 2 * (y * z + x * w); r[8] = 1 - 2 * (x * x + y * y);
}

/* A rotation, exact to double rounding. */
SCENE_MAY void random_rotation(double r[9]) {
    double f[9], u[9], sigma[3], v[9], t[9];
    int k;
    for (k = 0; k < 9; k++) f[k] = uniform();
    peri_svd3(f, u, sigma, v);
    transpose(v, t);
    peri_mul3(u, t, r);
}

/* F = R (1 + size * random), R random; det F > 0 for size up to 0.2. */
SCENE_MAY void random_map(double f[9], double size) {
    double r[9], u[9];
    int k;
    random_rotation(r);
    do {
        for (k = 0; k < 9; k++) u[k] = (k % 4 == 0) + size * uniform();
    } while (!(peri_det3(u) > 0.05));
    peri_mul3(r, u, f);
}

/* H = F^T F - 1. */
SCENE_MAY void cauchy_green(const double f[9], double h[6]) {
    int c, k;
    for (c = 0; c < 6; c++) {
        h[c] = -(c < 3);
        for (k = 0; k < 3; k++) h[c] += f[3 * k + voigt_row[c]] * f[3 * k + voigt_col[c]];
    }
}

/* Cauchy stress P F^T / det F in Voigt order. */
SCENE_MAY void cauchy_of(const double p[9], const double f[9], double s[6]) {
    double j = peri_det3(f);
    int c, k;
    for (c = 0; c < 6; c++)
        for (s[c] = 0, k = 0; k < 3; k++) s[c] += p[3 * voigt_row[c] + k] * f[3 * voigt_col[c] + k] / j;
}

/* ---- materials ------------------------------------------------------------------------------------------------- */

/* A user's law, polynomial and so finite everywhere: St. Venant-Kirchhoff plus a cubic term, E 1e5 Pa, nu 0.3. */
#define USER_MU (1e5 / 2.6)
#define USER_LAMBDA (1e5 * 0.3 / (1.3 * 0.4))
SCENE_MAY double user_law(const double c[6], double dpsi[6], void *context) {
    double trace = c[0] + c[1] + c[2] - 3, squares = 0, cubic = *(const double *)context;
    int k;
    for (k = 0; k < 6; k++) {
        double h = c[k] - (k < 3);
        squares += (k < 3 ? 1 : 2) * h * h;
        dpsi[k] = USER_MU / 2 * h + (k < 3 ? USER_LAMBDA / 4 * trace + 3 * cubic * trace * trace : 0);
    }
    return USER_MU / 4 * squares + USER_LAMBDA / 8 * trace * trace + cubic * trace * trace * trace;
}
static double user_cubic = 2e4;

/* A user's basis function: s (s - 1)^2, f''(1) = 2. */
SCENE_MAY double user_basis(double s, double *first, void *context) {
    (void)context;
    *first = (s - 1) * (3 * s - 1);
    return s * (s - 1) * (s - 1);
}

enum {
    M_PROJECTIVE, M_LINEAR, M_PAPERS, M_STVK, M_MIXED, M_ANISOTROPIC, M_NEO_HOOKEAN, M_STVK_EXACT, M_STABLE, M_USER,
    M_COUNT
};
static const char *const material_name[M_COUNT] = {
    "projective", "linear", "neo_hookean_papers", "stvk", "mixed_basis", "anisotropic", "neo_hookean", "stvk_exact",
    "stable_neo_hookean", "user_law"};

/* Material number k of the list above, density 1000; E and nu do not act on the user's law. */
SCENE_MAY peri_material material_of(int k, double young, double poisson) {
    peri_real e = (peri_real)young, nu = (peri_real)poisson, rho = 1000;
    peri_material m = peri_material_linear(e, nu, rho);
    double r[9];
    int c;
    switch (k) {
    case M_PROJECTIVE: return peri_material_projective(e, (peri_real)0.4, rho);
    case M_PAPERS: return peri_material_neo_hookean_papers(e, nu, rho);
    case M_STVK: return peri_material_stvk(e, nu, rho);
    case M_NEO_HOOKEAN: return peri_material_neo_hookean(e, nu, rho);
    case M_STVK_EXACT: return peri_material_stvk_exact(e, nu, rho);
    case M_STABLE: return peri_material_stable_neo_hookean(e, nu, rho);
    case M_USER: return peri_material_user(user_law, &user_cubic, (peri_real)1e5, (peri_real)0.3, rho);
    case M_MIXED: /* every kind of term; h'' is 2 by its coefficients and 2 by the user's, so ms is halved */
        m.g.b[0] = m.g.a[1] = m.g.svk = m.g.b[3] = (peri_real)0.25;
        m.h.b[0] = m.h.a[2] = m.h.svk = m.h.b[5] = (peri_real)0.25;
        m.h.user = user_basis;
        m.ms /= 2;
        return m;
    case M_ANISOTROPIC:
        m.anisotropic = 1;
        m.strength[0] = 2;
        m.strength[1] = 1;
        m.strength[2] = (peri_real)0.5;
        random_seed(77);
        random_rotation(r);
        for (c = 0; c < 9; c++) m.direction[c] = (peri_real)r[c];
        return m;
    default: return m;
    }
}

/* ---- blocks ---------------------------------------------------------------------------------------------------- */

/* Cubic lattice of nx * ny * nz points about the origin, x fastest (malloc). */
SCENE_MAY peri_real *lattice(int nx, int ny, int nz, double d) {
    peri_real *x = (peri_real *)malloc(3 * (size_t)(nx * ny * nz) * sizeof *x), *p = x;
    int i, j, k;
    for (k = 0; k < nz; k++)
        for (j = 0; j < ny; j++)
            for (i = 0; i < nx; i++) {
                *p++ = (peri_real)((i - 0.5 * (nx - 1)) * d);
                *p++ = (peri_real)((j - 0.5 * (ny - 1)) * d);
                *p++ = (peri_real)((k - 0.5 * (nz - 1)) * d);
            }
    return x;
}

/* A world, usually with one body. */
typedef struct scene {
    peri_world_def world_def;
    peri_body_def body_def;
    peri_world *world;
    peri_body_id body;
    peri_real *points, *x;      /* reference positions; scratch of the same size */
    int n;
    double d;
} scene;

SCENE_MAY void complain_of(const peri_world *w, const char *what) {
    printf("    %s: %s\n", what, w ? peri_last_error(w)->text : "no world");
    test_bad++;
}

/* Definitions with a block of nx * ny * nz, spacing d, no gravity. Change them, then scene_make. */
SCENE_MAY void scene_begin(scene *s, int nx, int ny, int nz, double d) {
    memset(s, 0, sizeof *s);
    s->world_def = peri_default_world_def();
    s->world_def.gravity = vec3(0, 0, 0);
    s->body_def = peri_default_body_def();
    s->n = nx * ny * nz;
    s->d = d;
    s->points = lattice(nx, ny, nz, d);
    s->x = (peri_real *)malloc(3 * (size_t)s->n * sizeof *s->x);
    s->body_def.points = s->points;
    s->body_def.count = s->n;
    s->body_def.spacing = (peri_real)d;
}

/* Adds another body by the definition of s. */
SCENE_MAY peri_body_id scene_body(scene *s, const peri_material *m) {
    peri_body_id id;
    s->body_def.material = peri_material_create(s->world, m);
    id = peri_body_create(s->world, &s->body_def);
    if (!peri_body_is_valid(s->world, id)) complain_of(s->world, "body");
    return id;
}

SCENE_MAY void scene_make(scene *s, const peri_material *m) {
    peri_error err;
    s->world = peri_world_create(&s->world_def, &err);
    if (!s->world) {
        printf("    world: %s\n", err.text);
        test_bad++;
        return;
    }
    if (m) s->body = scene_body(s, m);
}

SCENE_MAY void scene_end(scene *s) {
    peri_world_destroy(s->world);
    free(s->points);
    free(s->x);
}

/* Runs `steps` steps; every one must succeed. */
SCENE_MAY void scene_run(scene *s, int steps, double dt) {
    int k;
    for (k = 0; k < steps; k++)
        if (peri_world_step(s->world, (peri_real)dt)) {
            complain_of(s->world, "step");
            return;
        }
}

/* Puts the block at F X + t. */
SCENE_MAY void scene_affine(scene *s, const double f[9], const double t[3]) {
    double p[3], y[3];
    int i, c;
    for (i = 0; i < s->n; i++) {
        for (c = 0; c < 3; c++) p[c] = (double)s->points[3 * i + c];
        apply(f, p, y);
        for (c = 0; c < 3; c++) s->x[3 * i + c] = (peri_real)(y[c] + (t ? t[c] : 0));
    }
    if (peri_body_set_positions(s->world, s->body, 0, s->n, s->x)) complain_of(s->world, "set_positions");
}

/* Puts the block at X + amount d * random. */
SCENE_MAY void scene_shake(scene *s, double amount) {
    int k;
    for (k = 0; k < 3 * s->n; k++) s->x[k] = (peri_real)((double)s->points[k] + amount * s->d * uniform());
    if (peri_body_set_positions(s->world, s->body, 0, s->n, s->x)) complain_of(s->world, "set_positions");
}

SCENE_MAY peri_measure scene_measure(const scene *s) {
    peri_measure m;
    memset(&m, 0, sizeof m);
    if (peri_body_measure(s->world, s->body, &m)) complain_of(s->world, "measure");
    return m;
}

SCENE_MAY peri_collider_id scene_floor(scene *s, peri_friction type, double friction) {
    peri_collider_def c = peri_default_collider_def();
    c.type = type;
    c.friction = (peri_real)friction;
    return peri_collider_create(s->world, &c);
}

#endif
