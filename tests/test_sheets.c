/* test_sheets.c - one layer of points: plane stress of the membrane, bending of the plate, flat and curved.
 *
 * Exact values are computed here: plane stress by minimising the law over the thickness, bending by Kirchhoff's plate. */
#define PERI_IMPLEMENTATION
#include "../peri.h"

#include "test.h"

#include "scenes.h"

/* A flat sheet of nx * ny points about the origin in the plane z = 0, or (radius > 0) rolled about the x axis. */
static void sheet_begin(scene *s, int nx, int ny, double d, double thickness, double radius, peri_material m) {
    peri_real *points;
    int i;
    scene_begin(s, nx, ny, 1, d);
    points = (peri_real *)malloc(3 * (size_t)s->n * sizeof *points);
    memcpy(points, s->points, 3 * (size_t)s->n * sizeof *points);
    s->body_def = peri_default_sheet_def((peri_real)thickness);
    for (i = 0; i < s->n && radius > 0; i++) {
        double angle = (double)points[3 * i + 1] / radius;
        points[3 * i + 1] = (peri_real)(radius * sin(angle));
        points[3 * i + 2] = (peri_real)(radius * (1 - cos(angle)) + 0.1 * (double)points[3 * i] * (double)points[3 * i]);
    }
    free(s->points);
    s->points = points;
    s->body_def.points = points;
    s->body_def.count = s->n;
    s->body_def.spacing = (peri_real)d;
    (void)m;
}

static double energy_of(scene *s) {
    peri_measure m;
    if (peri_body_measure(s->world, s->body, &m)) complain_of(s->world, "measure");
    return m.elastic;
}

/* Puts the points at f x, with random departures of size `noise`. */
static void deform(scene *s, const double f[9], double noise) {
    int i, c;
    for (i = 0; i < s->n; i++) {
        double x[3], y[3];
        for (c = 0; c < 3; c++) x[c] = (double)s->points[3 * i + c];
        apply(f, x, y);
        for (c = 0; c < 3; c++) s->x[3 * i + c] = (peri_real)(y[c] + noise * uniform());
    }
    if (peri_body_set_positions(s->world, s->body, 0, s->n, s->x)) complain_of(s->world, "set");
}

/* Psi of a law in plane stress (normal z) under the in-plane strains of h: the least over h[2], by golden section. */
static double plane_energy(const peri_material *m, double h[6]) {
    double low = -0.95, high = 2, ratio = 0.61803398874989485, dpsi[6], a, b;
    int it;
    h[3] = h[4] = 0;
    for (it = 0; it < 100; it++) {
        a = high - ratio * (high - low);
        b = low + ratio * (high - low);
        h[2] = a;
        a = peri_law_value(m, h, dpsi);
        h[2] = b;
        b = peri_law_value(m, h, dpsi);
        if (a < b) high = low + ratio * (high - low);
        else low = high - ratio * (high - low);
    }
    return a < b ? a : b;
}

/* Every law of the correspondence model under random affine maps of the plane, stretches up to 40 %, turned in space: the
   energy is that of plane stress at every particle, borders and corners too. In float the squares of strains of 0.1 lose
   their last digits: 1e-5 of the energy. */
static void plane_stress_affine(void) {
    double worst = 0;
    int law, t;
    random_seed(5);
    for (law = M_NEO_HOOKEAN; law <= M_STABLE; law++) {
        scene s;
        peri_material m = material_of(law, 1e5, 0.3);
        sheet_begin(&s, 7, 6, 0.1, 0.02, 0, m);
        s.body_def.bending = 0;
        scene_make(&s, &m);
        for (t = 0; t < 10; t++) {
            double f[9], h[6], r[9], u[9], area = 42 * 0.01 * 0.02;
            int k;
            for (k = 0; k < 9; k++) u[k] = k % 4 == 0;
            u[0] += 0.4 * uniform();
            u[4] += 0.4 * uniform();
            u[1] = 0.3 * uniform();
            random_rotation(r);
            peri_mul3(r, u, f);
            deform(&s, f, 0);
            cauchy_green(f, h);
            h[2] = 0;
            {
                double wanted = area * plane_energy(&m, h), e = fabs(energy_of(&s) / wanted - 1);
                if (e > worst) worst = e;
            }
        }
        scene_end(&s);
    }
    FIGURE("plane stress, correspondence: energy off by", worst);
    CHECK(worst < (IS_DOUBLE ? 1e-9 : 1e-5));
}

/* The stretch and projective models have the moduli that the header says, at small strain, inside the sheet: 8 neighbours
   of equal weight are isotropic, so lattice sums are exact. Strain 1e-3: nonlinear terms of 1e-3 at most. */
static void plane_stress_moduli(void) {
    static const int models[3] = {M_LINEAR, M_STVK, M_PROJECTIVE};
    int k, t;
    for (k = 0; k < 3; k++) {
        scene s;
        double nu = models[k] == M_PROJECTIVE ? 1 / 3.0 : 0.3, e = 1e-3, f[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
        peri_real value[81];
        peri_material m = material_of(models[k], 1e5, 0.3);
        sheet_begin(&s, 9, 9, 0.1, 0.02, 0, m);
        s.body_def.bending = 0;
        scene_make(&s, &m);
        for (t = 0; t < 3; t++) {       /* tension, shear, and along a diagonal */
            double psi = t == 1 ? 1e5 / (2 * (1 + nu)) * e * e / 2 : 1e5 * e * e / 2;
            f[0] = t == 0 ? 1 + e : t == 1 ? 1 : 1 + e * (1 - nu) / 2;
            f[4] = t == 0 ? 1 - nu * e : f[0];
            f[1] = f[3] = t == 0 ? 0 : t == 1 ? e / 2 : e * (1 + nu) / 2;
            deform(&s, f, 0);
            peri_body_values(s.world, s.body, PERI_VALUE_ENERGY, value);
            printf("    %s, case %d: energy density over plane stress = %.5f\n", material_name[models[k]], t,
                   (double)value[40] / psi);
            NEAR((double)value[40] / psi, 1, 3e-3);
        }
        scene_end(&s);
    }
}

/* Forces are minus the slope of the energy, for flat and curved sheets out of shape, every model but the projective one
   (whose force is the slope of no energy); central differences of step 1e-6 d in double: 1e-6 of the largest force. The
   bending alone, which is what is new here, is measured by the difference of two bodies: with and without it. */
static void forces_are_slopes(void) {
    static const int models[4] = {M_LINEAR, M_NEO_HOOKEAN, M_STABLE, M_STVK};
    static const double same[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    double worst = 0;
    int k, curved, t;
    if (!IS_DOUBLE) return;
    random_seed(8);
    for (k = 0; k < 4; k++)
        for (curved = 0; curved < 2; curved++) {
            scene s;
            peri_material m = material_of(models[k], 1e5, 0.3);
            peri_real force[3 * 30];
            double largest = 0;
            sheet_begin(&s, 6, 5, 0.1, 0.05, curved ? 0.3 : 0, m);
            s.body_def.bending = 3;
            scene_make(&s, &m);
            deform(&s, same, 0.02);
            peri_body_forces(s.world, s.body, force);
            for (t = 0; t < 90; t++) largest = fabs((double)force[t]) > largest ? fabs((double)force[t]) : largest;
            for (t = 0; t < 90; t++) {
                double low, high, h = 1e-7;
                peri_real keep = s.x[t];
                s.x[t] = keep + (peri_real)h;
                peri_body_set_positions(s.world, s.body, 0, s.n, s.x);
                high = energy_of(&s);
                s.x[t] = keep - (peri_real)h;
                peri_body_set_positions(s.world, s.body, 0, s.n, s.x);
                low = energy_of(&s);
                s.x[t] = keep;
                low = fabs((low - high) / (2 * h) - (double)force[t]) / largest;
                if (low > worst) worst = low;
            }
            scene_end(&s);
        }
    FIGURE("forces of sheets against the slope of their energy", worst);
    CHECK(worst < 1e-6);
}

/* At rest, and turned as a whole, a sheet has no energy and no force, curved ones too; out of shape its inner forces
   have no sum and no moment. Rounding of n points: the bounds of test_world's rigid_motion. */
static void rest_and_momentum(void) {
    int curved, k;
    random_seed(12);
    for (curved = 0; curved < 2; curved++) {
        scene s;
        peri_material m = material_of(M_NEO_HOOKEAN, 1e5, 0.3);
        double r[9], same[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, sum[3] = {0, 0, 0}, moment[3] = {0, 0, 0}, size = 0, worst = 0;
        peri_real force[3 * 56];
        sheet_begin(&s, 8, 7, 0.1, 0.05, curved ? 0.4 : 0, m);
        s.body_def.bending = 2;
        scene_make(&s, &m);
        random_rotation(r);
        deform(&s, r, 0);
        peri_body_forces(s.world, s.body, force);
        for (k = 0; k < 3 * s.n; k++) worst = fabs((double)force[k]) > worst ? fabs((double)force[k]) : worst;
        FIGURE(curved ? "curved sheet, turned: largest force over E d t" : "flat sheet, turned: largest force over E d t",
               worst / (1e5 * 0.1 * 0.05));
        CHECK(worst < 200 * EPS * 1e5 * 0.1 * 0.05);
        deform(&s, same, 0.02);
        peri_body_forces(s.world, s.body, force);
        for (k = 0; k < s.n; k++) {
            double x[3], f[3], turn[3];
            int c;
            for (c = 0; c < 3; c++) {
                x[c] = (double)s.x[3 * k + c];
                f[c] = (double)force[3 * k + c];
                sum[c] += f[c];
            }
            size += norm(f, 3);
            cross(x, f, turn);
            for (c = 0; c < 3; c++) moment[c] += turn[c];
        }
        FIGURE("inner forces of a sheet out of shape: sum over sum of sizes", norm(sum, 3) / size);
        FIGURE("their moment over that and the half width", norm(moment, 3) / (size * 0.4));
        CHECK(norm(sum, 3) < 50 * EPS * size);
        CHECK(norm(moment, 3) < 50 * EPS * size * 0.4);
        scene_end(&s);
    }
}

/* Force of the sheet on its free particles under the displacement p, per unit: -K p, by a small displacement. */
static void stiffness_times(scene *s, const unsigned char *fixed, const double *p, double *out) {
    static peri_real force[3 * 2000];
    double largest = 1e-300, small;
    int k;
    for (k = 0; k < 3 * s->n; k++)
        if (fabs(p[k]) > largest) largest = fabs(p[k]);
    small = 1e-7 / largest;     /* m: second-order terms are 1e-7 d of the first */
    for (k = 0; k < 3 * s->n; k++) s->x[k] = (peri_real)((double)s->points[k] + small * p[k]);
    peri_body_set_positions(s->world, s->body, 0, s->n, s->x);
    peri_body_forces(s->world, s->body, force);
    for (k = 0; k < 3 * s->n; k++) out[k] = fixed[k / 3] ? 0 : -(double)force[k] / small;
}

/* Tip of a sheet clamped along one edge, 1 m long, of the given width, n points along, thickness 0.02 m, E 1e6 Pa, under
   its weight, over Kirchhoff's clamped beam rho g l^4 12/(8 E t^2). Two rows are fixed: the clamp acts half way between
   them (peri_default_sheet_def), and the free end is half a spacing beyond the last row. Linear: conjugate gradients on
   the library's forces at small displacements, to 1e-8 of the residual. */
static double clamped_tip(int n, double width, double nu, int model) {
    scene s;
    double d = 1.0 / n, t = 0.02, young = 1e6, rho = 1000, rr = 0, first, last = 0, previous = 0;
    peri_material m = material_of(model, young, nu);
    int nx = n + 1, ny = (int)(width * n + 0.5), i, it;
    size_t size = 3 * (size_t)(nx * ny) * sizeof(double);
    unsigned char *fixed = (unsigned char *)calloc((size_t)(nx * ny), 1);
    double *w = (double *)calloc(1, size), *r = (double *)calloc(1, size), *p = (double *)calloc(1, size),
           *q = (double *)calloc(1, size);
    m.density = (peri_real)rho;
    sheet_begin(&s, nx, ny, d, t, 0, m);
    for (i = 0; i < nx * ny; i++) fixed[i] = i % nx < 2;
    s.body_def.fixed = fixed;
    scene_make(&s, &m);
    for (i = 0; i < nx * ny; i++) r[3 * i + 2] = fixed[i] ? 0 : -rho * d * d * t;     /* g = 1 */
    memcpy(p, r, size);
    for (i = 0; i < 3 * nx * ny; i++) rr += r[i] * r[i];
    first = rr;
    for (it = 0; it < 5000 && rr > 1e-16 * first; it++) {
        double pq = 0, alpha, now = 0;
        stiffness_times(&s, fixed, p, q);
        for (i = 0; i < 3 * nx * ny; i++) pq += p[i] * q[i];
        alpha = rr / pq;
        for (i = 0; i < 3 * nx * ny; i++) {
            w[i] += alpha * p[i];
            r[i] -= alpha * q[i];
            now += r[i] * r[i];
        }
        for (i = 0; i < 3 * nx * ny; i++) p[i] = r[i] + now / rr * p[i];
        rr = now;
    }
    CHECK(it < 5000);
    for (i = 0; i < ny; i++) {
        last += w[3 * (i * nx + nx - 1) + 2] / ny;
        previous += w[3 * (i * nx + nx - 2) + 2] / ny;
    }
    free(fixed);
    free(w);
    free(r);
    free(p);
    free(q);
    scene_end(&s);
    return -(last + (last - previous) / 2) / (rho * 12 / (8 * young * t * t));
}

/* Issue: within 5 % at two spacings. A narrow strip must bend as the sheet does when nu is 0. With nu 0.3 a sheet as wide
   as long lies between the beam (1) and the plate that keeps its width (1 - nu^2 = 0.91). */
static void clamped_sheet(void) {
    double ratio;
    int n;
    if (!IS_DOUBLE) return;     /* displacements of 1e-7 m are below float's steps: the same code, in double */
    for (n = 16; n <= 32; n *= 2) {
        ratio = clamped_tip(n, 1, 0, M_NEO_HOOKEAN);
        printf("    clamped sheet, nu 0, 1/%d m: tip over plate theory = %.4f\n", n, ratio);
        NEAR(ratio, 1, 0.05);
    }
    ratio = clamped_tip(16, 0.25, 0, M_NEO_HOOKEAN);
    printf("    strip 4 across, nu 0: %.4f\n", ratio);
    NEAR(ratio, 1, 0.05);
    ratio = clamped_tip(16, 1, 0, M_LINEAR);
    printf("    stretch model, nu 0: %.4f\n", ratio);
    NEAR(ratio, 1, 0.05);
    ratio = clamped_tip(16, 1, 0.3, M_NEO_HOOKEAN);
    printf("    nu 0.3, as wide as long: %.4f of the beam\n", ratio);
    CHECK(ratio > 0.91 && ratio < 1.0);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(plane_stress_affine);
    RUN(plane_stress_moduli);
    RUN(forces_are_slopes);
    RUN(rest_and_momentum);
    RUN(clamped_sheet);
    return test_end();
}
