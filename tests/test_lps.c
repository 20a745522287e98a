/* tests/test_lps.c - the stretch model B1/B1 beside the linear peridynamic solid (state-based; Silling, Epton, Weckner,
   Xu, Askari 2007) in the discrete form that LAMMPS documents for pair_style peri/lps: influence function 1/r, volumes
   of particles within half a spacing of the horizon ramped down. Written here from those formulas, in double, knowing
   nothing of the library; LAMMPS itself is asked by examples/lammps_export --check where it is installed.

   The solid's bonds weigh r^2 times its influence function in terms of stretches, so 1/r there is w ~ r here:
   kernel_power -1 (with partial_volume 1). ls and ms of the library are then 9/2 K - 15/2 mu and 15/2 mu. */
#define PERI_IMPLEMENTATION
#include "../peri.h"
#include "test.h"
#include "scenes.h"

/* Of the largest force. In double the same sums in another order; in float the positions' rounding over a stretch. */
#define SAME (IS_DOUBLE ? 1e-8 : 1e-4)

/* Points and their state, and what the solid is made of. */
typedef struct lps {
    int n;
    const peri_real *rest, *now;
    double *volume, *weighted, *dilatation, *force;     /* m^3, m^5 / m, 1, N */
    double bulk, shear, horizon, spacing;               /* Pa, Pa, m, m */
} lps;

/* Length of X_j - X_i and x_j - x_i, the latter's vector in y; the ramp of the neighbour's volume, 0 for no bond. The
   library leaves out what is a hundred-thousandth from the horizon, as rounding would decide there. */
static double bond(const lps *s, int i, int j, double y[3], double *rest, double *now) {
    double xi[3], half = s->spacing / 2;
    int c;
    for (c = 0; c < 3; c++) {
        xi[c] = (double)s->rest[3 * j + c] - (double)s->rest[3 * i + c];
        y[c] = (double)s->now[3 * j + c] - (double)s->now[3 * i + c];
    }
    *rest = norm(xi, 3);
    *now = norm(y, 3);
    if (i == j || *rest > s->horizon * (1 - 1e-5)) return 0;
    return s->horizon - *rest <= half ? (s->horizon + half - *rest) / (2 * half) : 1;
}

/* Weighted volume m = sum w r^2 V and dilatation 3/m sum w r e V with w = 1/r, e the extension. */
static void lps_dilatation(lps *s) {
    int i, j;
    for (i = 0; i < s->n; i++) {
        double m = 0, sum = 0, y[3], r, now;
        for (j = 0; j < s->n; j++) {
            double volume = bond(s, i, j, y, &r, &now) * s->volume[j];
            m += r * volume;
            sum += (now - r) * volume;
        }
        s->weighted[i] = m;
        s->dilatation[i] = m > 0 ? 3 * sum / m : 0;
    }
}

/* Force per volume on i: sum over j of (t_i + t_j) V_j along the bond, with the force state of each end
   t = w/m [(3 K - 5 G) r theta + 15 G e]. */
static void lps_forces(lps *s) {
    int i, j, c;
    lps_dilatation(s);
    for (i = 0; i < 3 * s->n; i++) s->force[i] = 0;
    for (i = 0; i < s->n; i++)
        for (j = 0; j < s->n; j++) {
            double y[3], r, now, ramp = bond(s, i, j, y, &r, &now), state;
            if (ramp <= 0) continue;
            state = (3 * s->bulk - 5 * s->shear) * r * (s->dilatation[i] / s->weighted[i] +
                                                        s->dilatation[j] / s->weighted[j]) +
                    15 * s->shear * (1 / s->weighted[i] + 1 / s->weighted[j]) * (now - r);
            state *= ramp / r;
            for (c = 0; c < 3; c++) s->force[3 * i + c] += state * s->volume[j] * s->volume[i] * y[c] / now;
        }
}

static void lps_begin(lps *s, const scene *of, const peri_material *m, const peri_real *volumes) {
    double e = (double)m->young, nu = (double)m->poisson;
    size_t n = (size_t)of->n;
    int i;
    s->n = of->n;
    s->rest = of->points;
    s->now = peri_body_positions(of->world, of->body);
    s->volume = (double *)malloc(6 * n * sizeof(double));
    s->weighted = s->volume + n;
    s->dilatation = s->weighted + n;
    s->force = s->dilatation + n;
    for (i = 0; i < s->n; i++) s->volume[i] = volumes ? (double)volumes[i] : of->d * of->d * of->d;
    s->bulk = e / (3 * (1 - 2 * nu));
    s->shear = e / (2 * (1 + nu));
    s->horizon = (double)of->body_def.horizon * of->d;
    s->spacing = of->d;
}

/* Largest difference of a force over the largest force, the library's against the solid's. */
static double difference(scene *s, const peri_material *m, const peri_real *volumes) {
    peri_real *f = (peri_real *)malloc(3 * (size_t)s->n * sizeof *f);
    double worst = 0, most = 0;
    lps solid;
    int i;
    lps_begin(&solid, s, m, volumes);
    lps_forces(&solid);
    if (peri_body_forces(s->world, s->body, f)) complain_of(s->world, "forces");
    for (i = 0; i < 3 * s->n; i++) {
        worst = fmax(worst, fabs((double)f[i] - solid.force[i]));
        most = fmax(most, fabs(solid.force[i]));
    }
    free(solid.volume);
    free(f);
    return worst / most;
}

static void block(scene *s, double horizon) {
    scene_begin(s, 9, 8, 7, 0.05);
    s->body_def.horizon = (peri_real)horizon;
    s->body_def.kernel_power = -1;
    s->body_def.partial_volume = 1;
}

/* Bent, twisted and shaken by a hundredth of a spacing. */
static void deform(scene *s) {
    int i, c;
    for (i = 0; i < s->n; i++) {
        double p[3], q[3];
        for (c = 0; c < 3; c++) p[c] = (double)s->points[3 * i + c];
        q[0] = p[0] + 0.3 * p[0] * p[2] + 0.05 * p[1];
        q[1] = p[1] * (1 - 0.04 * p[0]) - 0.4 * p[0] * p[2];
        q[2] = p[2] + 0.6 * p[0] * p[0] + 0.4 * p[0] * p[1];
        for (c = 0; c < 3; c++) s->x[3 * i + c] = (peri_real)(q[c] + 0.01 * s->d * uniform());
    }
    if (peri_body_set_positions(s->world, s->body, 0, s->n, s->x)) complain_of(s->world, "set_positions");
}

/* On a lattice: three Poisson's ratios, three horizons. */
static void forces_on_a_lattice(void) {
    static const double horizon[3] = {2.1, 3.01, 4.01}, poisson[3] = {0.05, 0.25, 0.42};
    double worst = 0;
    int h, k;
    random_seed(5);
    for (h = 0; h < 3; h++)
        for (k = 0; k < 3; k++) {
            peri_material m = peri_material_linear((peri_real)1e5, (peri_real)poisson[k], 1000);
            scene s;
            block(&s, horizon[h]);
            scene_make(&s, &m);
            deform(&s);
            worst = fmax(worst, difference(&s, &m, NULL));
            scene_end(&s);
        }
    FIGURE("largest difference over the largest force", worst);
    NEAR(worst, 0, SAME);
}

/* Points off the lattice, each with a volume of its own: families and weighted volumes differ everywhere. */
static void forces_of_scattered_points(void) {
    peri_material m = peri_material_linear((peri_real)1e5, (peri_real)0.35, 1000);
    peri_real volumes[9 * 8 * 7];
    double worst;
    scene s;
    int i;
    random_seed(6);
    block(&s, 3.01);
    for (i = 0; i < s.n; i++) volumes[i] = (peri_real)(between(0.5, 1.5) * s.d * s.d * s.d);
    for (i = 0; i < 3 * s.n; i++) s.points[i] += (peri_real)(0.2 * s.d * uniform());
    s.body_def.volumes = volumes;
    scene_make(&s, &m);
    deform(&s);
    worst = difference(&s, &m, volumes);
    FIGURE("largest difference over the largest force", worst);
    NEAR(worst, 0, SAME);
    scene_end(&s);
}

/* Other kernels, or volumes that are not ramped, are another solid: the comparison sees it. */
static void other_weights_are_seen(void) {
    peri_material m = peri_material_linear((peri_real)1e5, (peri_real)0.35, 1000);
    int k;
    for (k = 0; k < 3; k++) {
        double off;
        scene s;
        random_seed(7);
        block(&s, 3.01);
        if (k == 0) s.body_def.kernel_power = 1;
        if (k == 1) s.body_def.kernel_power = 0;
        if (k == 2) s.body_def.partial_volume = 0;
        scene_make(&s, &m);
        deform(&s);
        off = difference(&s, &m, NULL);
        FIGURE(k == 0 ? "difference with w ~ 1/r" : k == 1 ? "with w = 1" : "with whole volumes", off);
        CHECK(off > 1e-3);
        scene_end(&s);
    }
}

/* Stress of the middle particle under three small strains. */
static void stress(scene *s, int axis_a, int axis_b, double size, double out[6]) {
    double f[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    peri_real *all = (peri_real *)malloc(6 * (size_t)s->n * sizeof *all);
    int c;
    if (axis_a == axis_b) f[4 * axis_a] += size;
    else f[3 * axis_a + axis_b] += size / 2, f[3 * axis_b + axis_a] += size / 2;
    scene_affine(s, f, NULL);
    if (peri_body_stress(s->world, s->body, all)) complain_of(s->world, "stress");
    for (c = 0; c < 6; c++) out[c] = (double)all[6 * (s->n / 2) + c];
    free(all);
}

/* Moduli C11, C12, C44 inside a lattice, in GPa, as LAMMPS (29 Sep 2021, peri/lps, K 1 GPa, G 0.6 GPa) gave them by the
   virial stress of strains of +-1e-4. */
static void moduli_of_a_lattice(void) {
    static const double lammps[3][4] = {{2.1, 1.82672, 0.58664, 0.58664},
                                        {3.01, 1.72848, 0.635762, 0.635762},
                                        {4.01, 1.78006, 0.609968, 0.609968}};
    const double size = 1e-4, tolerance = IS_DOUBLE ? 2e-5 : 5e-3;
    int k, c;
    for (k = 0; k < 3; k++) {
        peri_material m = peri_material_linear((peri_real)1.5e9, (peri_real)0.25, 1000);
        double plus[6], minus[6], got[3];
        scene s;
        scene_begin(&s, 9, 9, 9, 0.0625);
        s.body_def.horizon = (peri_real)lammps[k][0];
        s.body_def.kernel_power = -1;
        s.body_def.partial_volume = 1;
        scene_make(&s, &m);
        stress(&s, 0, 0, size, plus);
        stress(&s, 0, 0, -size, minus);
        got[0] = (plus[0] - minus[0]) / (2e9 * size);
        got[1] = (plus[1] - minus[1]) / (2e9 * size);
        stress(&s, 1, 2, size, plus);
        stress(&s, 1, 2, -size, minus);
        got[2] = (plus[3] - minus[3]) / (2e9 * size);
        for (c = 0; c < 3; c++) NEAR(got[c], lammps[k][1 + c], tolerance);
        scene_end(&s);
    }
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(forces_on_a_lattice);
    RUN(forces_of_scattered_points);
    RUN(other_weights_are_seen);
    RUN(moduli_of_a_lattice);
    return test_end();
}
