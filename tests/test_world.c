/* test_world.c - the physics of the world: exactness under affine maps, invariance, momenta, time stepping, contact,
 * recovery.
 *
 * Contents: affine patch, rigid motion and momenta, integrators, independence of everything that must not matter,
 * particles and bodies, colliders, memory, recovery. EPS is half a unit in the last place of peri_real; every tolerance
 * says what it is made of. */
#define PERI_IMPLEMENTATION
#include "../peri.h"

#include "test.h"

#include "scenes.h"

/* Upper bound of what one bond can put on a particle at unit strain, N / (E d^2): V omega / r times twice the stiffest
   second derivative (stabiliser 3 times 15/2 mu, mu <= E/2, both ends), all weight on one bond. */
#define BOND_FORCE 45.0

/* ---- affine patch -------------------------------------------------------------------------------------------- */

/* Correspondence: stress and energy of every particle, surfaces included, under random maps. Rounding: positions
   (up to 3 d from the origin) and differences to EPS of them, so the strain to 6 EPS, against a strain of 0.2 and
   amplified by the fit of a corner's 7 bonds (condition about 20): 1e-5 in float; 26 sums of doubles the same way:
   1e-11 is demanded. */
static void affine_correspondence(void) {
    double worst_stress = 0, worst_energy = 0, tolerance = IS_DOUBLE ? 1e-11 : 1e-5;
    int k, t, i, c;
    random_seed(1);
    for (k = M_NEO_HOOKEAN; k <= M_USER; k++)
        for (t = 0; t < 10; t++) {
            peri_material m = material_of(k, 1e5, t % 2 ? 0.3 : 0.45);
            double f[9], p[9], exact[6], psi, move[3];
            peri_real stress[6 * 60], energy[60];
            scene s;
            scene_begin(&s, 5, 4, 3, 0.125);
            if (t > 6) s.body_def.horizon = (peri_real)3.01, s.body_def.kernel_power = 1;
            scene_make(&s, &m);
            random_map(f, 0.2);
            for (c = 0; c < 3; c++) move[c] = 0.1 * uniform();
            scene_affine(&s, f, move);
            psi = peri_material_point(&m, f, p);
            cauchy_of(p, f, exact);
            CHECK(!peri_body_stress(s.world, s.body, stress));
            CHECK(!peri_body_values(s.world, s.body, PERI_VALUE_ENERGY, energy));
            for (i = 0; i < s.n; i++) {
                double got[6], e;
                for (c = 0; c < 6; c++) got[c] = (double)stress[6 * i + c];
                e = distance(got, exact, 6) / norm(exact, 6);
                if (!(e <= worst_stress)) worst_stress = e;
                e = fabs((double)energy[i] / psi - 1);
                if (!(e <= worst_energy)) worst_energy = e;
            }
            scene_end(&s);
        }
    FIGURE("affine patch, correspondence: Cauchy stress, relative", worst_stress);
    FIGURE("affine patch, correspondence: energy, relative", worst_energy);
    NEAR(worst_stress, 0, tolerance);
    NEAR(worst_energy, 0, tolerance);
}

/* Weighted moments <nx^4> and <nx^2 ny^2> of the full family of a cubic lattice. */
static void lattice_moments(double horizon, double power, double *four, double *two_two) {
    double sum = 0, a = 0, b = 0;
    int i, j, k;
    for (i = -3; i <= 3; i++)
        for (j = -3; j <= 3; j++)
            for (k = -3; k <= 3; k++) {
                double r2 = i * i + j * j + k * k, w;
                if (r2 == 0 || sqrt(r2) > horizon) continue;
                w = pow(r2, -power / 2);
                sum += w;
                a += w * i * i * i * i / (r2 * r2);
                b += w * i * i * j * j / (r2 * r2);
            }
    *four = a / sum;
    *two_two = b / sum;
}

/* Cauchy stress of the middle particle of a 5^3 (7^3: horizon 3.01) block at F, Voigt order. */
static void middle_stress(const peri_material *m, int size, double horizon, double power, const double f[9],
                          double out[6], double *energy) {
    peri_real *stress, *values;
    scene s;
    int c, middle;
    scene_begin(&s, size, size, size, 0.125);
    s.body_def.horizon = (peri_real)horizon;
    s.body_def.kernel_power = (peri_real)power;
    scene_make(&s, m);
    scene_affine(&s, f, NULL);
    stress = (peri_real *)malloc(6 * (size_t)s.n * sizeof *stress);
    values = (peri_real *)malloc((size_t)s.n * sizeof *values);
    peri_body_stress(s.world, s.body, stress);
    peri_body_values(s.world, s.body, PERI_VALUE_ENERGY, values);
    middle = s.n / 2;
    for (c = 0; c < 6; c++) out[c] = (double)stress[6 * middle + c];
    *energy = (double)values[middle];
    free(stress);
    free(values);
    scene_end(&s);
}

/* Stretch B_1/B_1 at small strain against Lame: inside a lattice the only error is that of the fourth moments. The
   default family's are 1/5 and 1/15 to 7e-4 (printed; computed here from the shells apart from the library), so the
   promised 1e-3 holds; 122 neighbours are 1 % off, which is measured and bounded by 2 %. Strain e = +-0.01: the
   difference of both signs leaves e^2 times a few and 6 EPS / e. */
static void affine_linear(void) {
    static const double horizons[2] = {1.75, 3.01}, powers[2] = {0.7, 1}, promised[2] = {1e-3, 2e-2};
    int k, t, c, side;
    random_seed(2);
    for (k = 0; k < 2; k++) {
        double worst = 0, four, two_two, off;
        lattice_moments(horizons[k], powers[k], &four, &two_two);
        off = fabs(15 * two_two - 1) > fabs(5 * four - 1) ? fabs(15 * two_two - 1) : fabs(5 * four - 1);
        for (t = 0; t < 12; t++) {
            double nu = t % 3 == 0 ? 0 : t % 3 == 1 ? 0.25 : 0.4, e[9], f[9], got[2][6], mean[6], hooke[6], energy;
            double size;
            double mu = 1e5 / (2 * (1 + nu)), lambda = 1e5 * nu / ((1 + nu) * (1 - 2 * nu));
            peri_material m = material_of(M_LINEAR, 1e5, nu);
            for (c = 0; c < 6; c++)
                e[3 * voigt_row[c] + voigt_col[c]] = e[3 * voigt_col[c] + voigt_row[c]] =
                    t < 3 ? c == 3 : t < 6 ? c == 0 : uniform();
            size = 0.003 / norm(e, 9);
            for (side = 0; side < 2; side++) {
                for (c = 0; c < 9; c++) f[c] = (c % 4 == 0) + (side ? -1 : 1) * size * e[c];
                middle_stress(&m, k ? 7 : 5, horizons[k], powers[k], f, got[side], &energy);
            }
            for (c = 0; c < 6; c++) {
                mean[c] = (got[0][c] - got[1][c]) / 2;
                hooke[c] = size * (2 * mu * e[3 * voigt_row[c] + voigt_col[c]] +
                                   (c < 3 ? lambda * (e[0] + e[4] + e[8]) : 0));
            }
            if (distance(mean, hooke, 6) / norm(hooke, 6) > worst) worst = distance(mean, hooke, 6) / norm(hooke, 6);
        }
        printf("    stretch B_1/B_1 against Lame, horizon %.2f = %.3g (its lattice sums are off by %.3g)\n",
               horizons[k], worst, off);
        NEAR(worst, 0, promised[k]);
        CHECK(off < promised[k]);
    }
}

/* 3 B_3 - B_1 at nu = 1/4: the energy of a particle is 15/2 mu E_ij E_kl <n_i n_j n_k n_l>, for a lattice 15/2 mu
   [<nx^4> sum E_ii^2 + <nx^2 ny^2> (sum over i != j of E_ii E_jj + 2 E_ij^2)], exactly (ls = 0). So it equals that to
   rounding, and St. Venant-Kirchhoff to the moments' 7e-4. */
static void affine_stvk(void) {
    double worst_lattice = 0, worst_exact = 0, worst_stress = 0, four, two_two;
    int t, i, j;
    lattice_moments(1.75, (double)(peri_real)0.7, &four, &two_two);
    random_seed(3);
    for (t = 0; t < 10; t++) {
        peri_material m = material_of(M_STVK, 1e5, 0.25), exact = material_of(M_STVK_EXACT, 1e5, 0.25);
        double f[9], p[9], h[6], got[6], wanted[6], energy, sum = 0, psi, e[9];
        random_map(f, 0.2);
        cauchy_green(f, h);
        for (i = 0; i < 6; i++) e[3 * voigt_row[i] + voigt_col[i]] = e[3 * voigt_col[i] + voigt_row[i]] = h[i] / 2;
        for (i = 0; i < 3; i++)
            for (j = 0; j < 3; j++)
                sum += i == j ? four * e[4 * i] * e[4 * i]
                              : two_two * (e[4 * i] * e[4 * j] + 2 * e[3 * i + j] * e[3 * i + j]);
        sum *= 7.5 * 4e4;
        middle_stress(&m, 5, 1.75, 0.7, f, got, &energy);
        psi = peri_material_point(&exact, f, p);
        cauchy_of(p, f, wanted);
        if (fabs(energy / sum - 1) > worst_lattice) worst_lattice = fabs(energy / sum - 1);
        if (fabs(energy / psi - 1) > worst_exact) worst_exact = fabs(energy / psi - 1);
        if (distance(got, wanted, 6) / norm(wanted, 6) > worst_stress)
            worst_stress = distance(got, wanted, 6) / norm(wanted, 6);
    }
    FIGURE("3 B_3 - B_1 at nu 1/4: energy against the family's fourth moments", worst_lattice);
    FIGURE("3 B_3 - B_1 at nu 1/4: energy against StVK", worst_exact);
    FIGURE("3 B_3 - B_1 at nu 1/4: stress against StVK", worst_stress);
    NEAR(worst_lattice, 0, 200 * EPS);  /* strain to 6 EPS against 0.1, twice, and the weights */
    NEAR(worst_exact, 0, 1e-3);
    NEAR(worst_stress, 0, 1e-3);
}

/* Displacement (-1)^(i+j+k) eps d costs at least half of what a uniform shear with the same mean square bond strain
   does (a shear, because a uniform dilatation has lambda in it); rms over bonds by their weights, first order. */
static double bond_strain(const scene *s, const peri_real *x) {
    double sum = 0, weights = 0, reach = (double)s->body_def.horizon * s->d;
    int i, j, c;
    for (i = 0; i < s->n; i++) {
        double total = 0, part = 0;
        for (j = 0; j < s->n; j++) {
            double xi[3], y[3], r, w, e;
            for (c = 0; c < 3; c++) {
                xi[c] = (double)s->points[3 * j + c] - (double)s->points[3 * i + c];
                y[c] = (double)x[3 * j + c] - (double)x[3 * i + c];
            }
            r = norm(xi, 3);
            if (i == j || r > reach) continue;
            w = pow(r / s->d, -0.7);
            e = norm(y, 3) / r - 1;
            part += w * e * e;
            total += w;
        }
        sum += part / total;
        weights += 1;
    }
    return sqrt(sum / weights);
}

static void checkerboard(void) {
    static const double ways[3][3] = {{1, 0, 0}, {0.6, 0.8, 0}, {0.577, 0.577, 0.578}};
    static const double shears[2][9] = {{1, 0.01, 0, 0, 1, 0, 0, 0, 1}, {1.005, 0, 0, 0, 0.995, 0, 0, 0, 1}};
    double least = 1e9;
    int k, t, i, c;
    for (k = 0; k < M_COUNT; k++) {
        peri_material m = material_of(k, 1e5, 0.3);
        double lowest = 1e9, shear = 0;
        scene s;
        if (k == M_ANISOTROPIC) continue;   /* a shear there costs what its direction says */
        scene_begin(&s, 6, 6, 6, 0.125);
        scene_make(&s, &m);
        for (t = 0; t < 2; t++) {
            double ratio;
            scene_affine(&s, shears[t], NULL);
            ratio = scene_measure(&s).elastic / pow(bond_strain(&s, s.x), 2);
            if (ratio > shear) shear = ratio;
        }
        for (t = 0; t < 3; t++) {
            double ratio;
            for (i = 0; i < s.n; i++)
                for (c = 0; c < 3; c++)
                    s.x[3 * i + c] =
                        (peri_real)((double)s.points[3 * i + c] +
                                    ((i % 6 + i / 6 % 6 + i / 36) % 2 ? -1 : 1) * 0.005 * s.d * ways[t][c]);
            peri_body_set_positions(s.world, s.body, 0, s.n, s.x);
            ratio = scene_measure(&s).elastic / pow(bond_strain(&s, s.x), 2) / shear;
            if (ratio < lowest) lowest = ratio;
        }
        printf("    checkerboard energy over shear energy, %s = %.3f\n", material_name[k], lowest);
        CHECK(lowest >= 0.5);
        if (lowest < least) least = lowest;
        scene_end(&s);
    }
    FIGURE("checkerboard energy over shear energy, least", least);
}

/* Presses a block of 8^3 by its outer layer, in 12 steps, and waits. Returns the rms distance of the inner particles from
   the affine map, the exact solution, in spacings; *stress: relative error of the mean Cauchy stress of the middle. */
static double press(const peri_material *m, const double ratio[3], double *stress) {
    double f[9] = {0}, p[9], exact[6], mean[6] = {0}, sum = 0;
    int k, i, c, inner = 0, middle = 0, n = 8;
    peri_real *all;
    const peri_real *x;
    scene s;
    scene_begin(&s, n, n, n, 0.025);
    scene_make(&s, m);
    for (c = 0; c < 3; c++) f[4 * c] = ratio[c];
    for (k = 1; k <= 32; k++) {
        for (i = 0; i < s.n; i++) {
            double to[3];
            int at[3] = {i % n, i / n % n, i / n / n}, outer = 0;
            for (c = 0; c < 3; c++) {
                outer |= at[c] == 0 || at[c] == n - 1;
                to[c] = (double)s.points[3 * i + c] * (1 + (ratio[c] - 1) * (k < 12 ? k : 12) / 12);
            }
            if (outer && k == 1) CHECK(!peri_body_set_fixed(s.world, s.body, i, 1));
            if (outer) peri_body_move(s.world, s.body, i, vec3(to[0], to[1], to[2]));
        }
        scene_run(&s, 1, 1.0 / 30);
    }
    all = (peri_real *)malloc(6 * (size_t)s.n * sizeof *all);
    CHECK(!peri_body_stress(s.world, s.body, all));
    x = peri_body_positions(s.world, s.body);
    for (i = 0; i < s.n; i++) {
        int at[3] = {i % n, i / n % n, i / n / n}, depth = n;
        for (c = 0; c < 3; c++) {
            if (at[c] < depth) depth = at[c];
            if (n - 1 - at[c] < depth) depth = n - 1 - at[c];
        }
        for (c = 0; c < 3 && depth > 0; c++)
            sum += pow(((double)x[3 * i + c] - ratio[c] * (double)s.points[3 * i + c]) / s.d, 2);
        for (c = 0; c < 6 && depth > 1; c++) mean[c] += (double)all[6 * i + c];
        inner += depth > 0;
        middle += depth > 1;
    }
    peri_material_point(m, f, p);
    cauchy_of(p, f, exact);
    for (c = 0; c < 6; c++) mean[c] /= middle;
    *stress = distance(mean, exact, 6) / norm(exact, 6);
    free(all);
    scene_end(&s);
    return sqrt(sum / inner);
}

/* Pressed matter keeps straight: it does not buckle between its bonds (as it did without peri__brace: 0.4 d and more,
   stresses half as large or less). What is left comes from the surfaces: their one-sided families are stiffer, and the
   middle is pressed the more. Bounds: a tenth of a spacing, a tenth of the stress, as in the stability atlas. */
static void pressed_block(void) {
    static const double ratios[5][3] = {{0.7, 1, 1}, {0.6, 1, 1}, {0.5, 1, 1}, {0.5, 0.7, 1}, {0.65, 0.65, 0.65}};
    static const int kinds[3] = {M_NEO_HOOKEAN, M_STVK_EXACT, M_STABLE};
    double worst = 0, stress = 0;
    int k, r, nu;
    for (k = 0; k < 3; k++)
        for (nu = k > 0; nu < 2; nu++) /* the stiffer one of both is the harder */
            for (r = 0; r < 5; r++) {
                peri_material m = material_of(kinds[k], 1e5, nu ? 0.4 : 0.25);
                double off, e;
                off = press(&m, ratios[r], &e);
                if (!(off < 0.1 && e < 0.1))
                    printf("    %s, nu %.2f, pressed to %.2f %.2f %.2f: %.3f d, stress %.3f off\n",
                           material_name[kinds[k]], nu ? 0.4 : 0.25, ratios[r][0], ratios[r][1], ratios[r][2], off, e);
                if (!(off <= worst)) worst = off;
                if (!(e <= stress)) stress = e;
            }
    FIGURE("pressed block, from the affine map, spacings", worst);
    FIGURE("pressed block, Cauchy stress of the middle, relative", stress);
    CHECK(worst < 0.1);
    CHECK(stress < 0.1);
}

/* ---- rigid motion and momenta -------------------------------------------------------------------------------- */

/* Rotation and translation by R, t: strains are rounding only, e = 4 EPS |x|/d per bond; every bond then gives
   BOND_FORCE E d^2 e at most, and the energy is below BOND_FORCE/2 E V e^2 per particle; basis functions are
   differences of numbers of order one in double, which leaves 4 roundings of double. */
static void rigid_motion(void) {
    double worst_force = 0, worst_energy = 0, reach = 10;
    int k, t, c;
    random_seed(4);
    for (k = 0; k < M_COUNT; k++)
        for (t = 0; t < 3; t++) {
            peri_material m = material_of(k, 1e5, 0.3);
            double r[9], move[3], e = 4 * EPS * reach, unit = 1e5 * 0.125 * 0.125;
            peri_real force[3 * 125];
            scene s;
            scene_begin(&s, 5, 5, 5, 0.125);
            scene_make(&s, &m);
            random_seed(40 + (uint64_t)t);
            random_rotation(r);
            for (c = 0; c < 3; c++) move[c] = 0.125 * 4 * uniform();
            scene_affine(&s, r, move);
            peri_body_forces(s.world, s.body, force);
            for (c = 0; c < 3 * s.n; c++)
                if (!(fabs((double)force[c]) / unit <= worst_force)) worst_force = fabs((double)force[c]) / unit;
            worst_energy = fmax(worst_energy, scene_measure(&s).elastic / (s.n * unit * 0.125));
            NEAR(worst_force, 0, BOND_FORCE * e);
            NEAR(worst_energy, 0, BOND_FORCE / 2 * (e * e + 4 * 1.11e-16));
            scene_end(&s);
        }
    FIGURE("rigid motion: largest force, E d^2", worst_force);
    FIGURE("rigid motion: energy density, E", worst_energy);
}

/* Sum and torque of the inner forces of a block shaken by 0.1 d. A particle's force is a sum of 52 terms (both ends
   of 26 bonds) each below 1/5 of the bound at strain 0.2, rounded to EPS of the partial sums: independent roundings
   add by their root, six standard deviations. Torque: about a point 2 d away at most. */
static void inner_forces(void) {
    int k, t, i, c;
    for (k = 0; k < M_COUNT; k++) {
        double worst_sum = 0, worst_torque = 0, rms = 0, bound = 6 * EPS * sqrt(125 * 52.0) * BOND_FORCE / 5 * 0.2;
        for (t = 0; t < 5; t++) {
            peri_material m = material_of(k, 1e5, 0.3);
            double sum[3] = {0, 0, 0}, torque[3] = {0, 0, 0}, unit = 1e5 * 0.125 * 0.125;
            peri_real force[3 * 125];
            scene s;
            scene_begin(&s, 5, 5, 5, 0.125);
            if (t == 4) s.body_def.horizon = (peri_real)2.5;
            scene_make(&s, &m);
            random_seed(50 + (uint64_t)t);
            scene_shake(&s, 0.1);
            peri_body_forces(s.world, s.body, force);
            for (i = 0; i < s.n; i++) {
                double f[3], x[3], turn[3];
                for (c = 0; c < 3; c++) f[c] = (double)force[3 * i + c] / unit, x[c] = (double)s.x[3 * i + c] / s.d;
                cross(x, f, turn);
                for (c = 0; c < 3; c++) sum[c] += f[c], torque[c] += turn[c], rms += f[c] * f[c] / (5 * s.n);
            }
            worst_sum = fmax(worst_sum, norm(sum, 3));
            worst_torque = fmax(worst_torque, norm(torque, 3));
            scene_end(&s);
        }
        printf("    inner forces, %s = sum %.2g E d^2, torque %.2g E d^3 (rms force %.2g E d^2)\n", material_name[k],
               worst_sum, worst_torque, sqrt(rms));
        NEAR(worst_sum, 0, bound);
        if (k != M_PROJECTIVE) NEAR(worst_torque, 0, 3.5 * bound);
    }
}

/* A block of 4 x 4 x 6, spinning and vibrating. */
static void spinning(scene *s, int material, int keep, peri_integrator integrator, const peri_vec3 velocity) {
    peri_material m = material_of(material, 1e5, 0.3);
    int i, c;
    double spin[3] = {3, 1, 4}, turn[3], x[3];
    scene_begin(s, 4, 4, 6, 0.125);
    s->world_def.keep_momentum = keep;
    s->world_def.integrator = integrator;
    scene_make(s, &m);
    random_seed(60);
    for (i = 0; i < s->n; i++) {
        for (c = 0; c < 3; c++) x[c] = (double)s->points[3 * i + c];
        cross(spin, x, turn);
        turn[2] += x[2] * 4;    /* stretching at 4 / s */
        s->x[3 * i] = (peri_real)(turn[0] + (double)velocity.x);
        s->x[3 * i + 1] = (peri_real)(turn[1] + (double)velocity.y);
        s->x[3 * i + 2] = (peri_real)(turn[2] + (double)velocity.z);
    }
    peri_body_set_velocities(s->world, s->body, 0, s->n, s->x);
}

/* 1000 free steps. keep_momentum: what is left is the rounding of v to peri_real, EPS |v| m per particle, component and
   step, independent: six standard deviations of sqrt(1000 n) of them, and the same of the double sums of n terms below
   m n |v|; angular momentum is about the centre of mass. */
static void momentum_kept(void) {
    static const int kinds[3] = {M_PROJECTIVE, M_LINEAR, M_NEO_HOOKEAN};
    int k, c, integrator;
    for (k = 0; k < 3; k++)
        for (integrator = 0; integrator < 2; integrator++) {
            double p[2][3], l[2][3], speed = 0, arm = 0, bound, mass, energy[2];
            scene s;
            int t;
            spinning(&s, kinds[k], 1, (peri_integrator)integrator, vec3(0.3, -0.2, 0.1));
            for (t = 0; t < 2; t++) {
                peri_measure a = scene_measure(&s);
                double turn[3];
                cross(a.centre, a.momentum, turn);
                for (c = 0; c < 3; c++) p[t][c] = a.momentum[c], l[t][c] = a.angular_momentum[c] - turn[c];
                energy[t] = a.kinetic + a.elastic;
                mass = a.mass;
                if (t == 0) scene_run(&s, 1000, 1 / 60.0);
            }
            speed = 3;      /* m/s: 0.37 of moving along, 5 rad/s and 4 /s at 0.45 m */
            arm = 0.5;
            bound = 6 * (EPS / s.n + 1.11e-16) * speed * mass * sqrt(1000.0 * s.n);
            printf("    1000 steps, keep_momentum 1, %s, %s = momentum %.2g, angular momentum %.2g of itself "
                   "(energy left %.2g)\n", material_name[kinds[k]], integrator ? "BDF2" : "Euler",
                   distance(p[0], p[1], 3) / norm(p[0], 3), distance(l[0], l[1], 3) / norm(l[0], 3),
                   energy[1] / energy[0]);
            NEAR(distance(p[0], p[1], 3), 0, bound);
            NEAR(distance(l[0], l[1], 3), 0, bound * arm);
            scene_end(&s);
        }
}

/* The bare integrators: printed, and backward Euler must lose (else keep_momentum above proves nothing). */
static void momentum_of_the_bare_integrators(void) {
    double left[2];
    int integrator;
    for (integrator = 0; integrator < 2; integrator++) {
        scene s;
        peri_measure a, b;
        spinning(&s, M_NEO_HOOKEAN, 0, (peri_integrator)integrator, vec3(0, 0, 0));
        a = scene_measure(&s);
        scene_run(&s, 100, 1 / 60.0);
        b = scene_measure(&s);
        left[integrator] = norm(b.angular_momentum, 3) / norm(a.angular_momentum, 3);
        printf("    100 steps of 1/60 s at 5 rad/s, keep_momentum 0, %s = angular momentum left %.3f\n",
               integrator ? "BDF2" : "Euler", left[integrator]);
        scene_end(&s);
    }
    CHECK(left[0] < 0.95);
    CHECK(left[1] > left[0]);
}

/* 1000 explicit steps (kick, drift) with peri_body_forces: the forces alone keep both momenta. State in double;
   each kick adds the forces' rounding (bound of inner_forces, at strain 0.1: pulled at 4 /s with a frequency of 42
   /s), new every step because positions move by far more than EPS; the positions handed over are rounded: their
   torque, EPS |x| f, is a part of it. */
static void momentum_of_the_forces(void) {
    static const int kinds[5] = {M_PROJECTIVE, M_LINEAR, M_PAPERS, M_NEO_HOOKEAN, M_STABLE};
    int k, t, i, c;
    for (k = 0; k < 5; k++) {
        double *x, *v, p[3] = {0, 0, 0}, l[2][3], m, dt, size = 0, bound;
        peri_real *force;
        scene s;
        spinning(&s, kinds[k], 0, PERI_BACKWARD_EULER, vec3(0, 0, 0));
        x = (double *)malloc(3 * (size_t)s.n * sizeof *x);
        v = (double *)malloc(3 * (size_t)s.n * sizeof *v);
        force = (peri_real *)malloc(3 * (size_t)s.n * sizeof *force);
        m = 1000 * 0.125 * 0.125 * 0.125;
        dt = 0.1 * 0.125 / 10;      /* a tenth of the time that a wave of 10 m/s takes over d */
        for (i = 0; i < 3 * s.n; i++) {
            x[i] = (double)s.points[i];
            v[i] = (double)peri_body_velocities(s.world, s.body)[i];
        }
        memset(l, 0, sizeof l);
        for (t = 0; t <= 1000; t++) {
            for (i = 0; i < 3 * s.n; i++) s.x[i] = (peri_real)x[i];
            for (i = 0; i < s.n && t % 1000 == 0; i++) {
                double turn[3];
                cross(x + 3 * i, v + 3 * i, turn);
                for (c = 0; c < 3; c++) l[t / 1000][c] += m * turn[c], p[c] += t ? m * v[3 * i + c] : -m * v[3 * i + c];
                if (!t) size += m * norm(v + 3 * i, 3);
            }
            if (t == 1000) break;
            peri_body_set_positions(s.world, s.body, 0, s.n, s.x);
            peri_body_forces(s.world, s.body, force);
            for (i = 0; i < 3 * s.n; i++) v[i] += dt * (double)force[i] / m;
            for (i = 0; i < 3 * s.n; i++) x[i] += dt * v[i];
        }
        bound = sqrt(1000.0) * dt * 1e5 * 0.125 * 0.125 * 6 * EPS * sqrt(s.n * 52.0) * BOND_FORCE / 5 * 0.1;
        bound += 20 * 1.11e-16 * size;     /* sums of 96 momenta in double */
        printf("    1000 explicit steps, %s = momentum %.2g, angular momentum %.2g of themselves\n",
               material_name[kinds[k]], norm(p, 3) / size, distance(l[0], l[1], 3) / norm(l[0], 3));
        NEAR(norm(p, 3), 0, bound);
        if (kinds[k] != M_PROJECTIVE) NEAR(distance(l[0], l[1], 3), 0, 0.5 * bound);
        free(x);
        free(v);
        free(force);
        scene_end(&s);
    }
}

/* ---- integrators --------------------------------------------------------------------------------------------- */

/* A bar 3 x 3 x 12 stretched in its first longitudinal wave (free ends, length 12 d, speed sqrt(E / rho) = 10 m/s,
   period 2 L / c = 0.3 s). Energy left after `time` seconds in `steps` steps. */
static double vibrate(peri_integrator integrator, int steps, double time) {
    peri_material m = material_of(M_LINEAR, 1e5, 0);
    double before;
    peri_measure measure;
    scene s;
    int i;
    scene_begin(&s, 3, 3, 12, 0.125);
    s.world_def.integrator = integrator;
    s.world_def.tolerance = (peri_real)(IS_DOUBLE ? 1e-6 : 1e-5);
    scene_make(&s, &m);
    for (i = 0; i < 3 * s.n; i++)
        s.x[i] = (peri_real)((double)s.points[i] +
                             (i % 3 == 2 ? 0.05 * sin(3.14159265358979 * (double)s.points[i] / 1.5) * 0.5 : 0));
    peri_body_set_positions(s.world, s.body, 0, s.n, s.x);
    measure = scene_measure(&s);
    before = measure.elastic;
    scene_run(&s, steps, time / steps);
    measure = scene_measure(&s);
    scene_end(&s);
    return (measure.elastic + measure.kinetic) / before;
}

/* Of a harmonic wave, dt = T/20 (w h = 0.314), one step leaves 1/(1 + (w h)^2) of the energy in backward Euler: 0.152
   after a period, 0.0035 after three; BDF2 loses (w h)^4/2 = 0.0049 a step, 0.74 after three. Surfaces change the
   period by 10 % and a tenth of the energy is in faster waves: between 0.5 and 0.85 for BDF2, below 0.02 for Euler. */
static void damping(void) {
    double euler = vibrate(PERI_BACKWARD_EULER, 60, 0.9), bdf2 = vibrate(PERI_BDF2, 60, 0.9);
    FIGURE("energy left after 3 periods of 20 steps, backward Euler", euler);
    FIGURE("energy left after 3 periods of 20 steps, BDF2", bdf2);
    CHECK(euler > 0 && euler < 0.02);
    CHECK(bdf2 > 0.5 && bdf2 < 0.85);
}

/* Eight particles, all bonded to each other, so that every frequency is resolved (w between c/d and 2 c/d, 80 to
   160 per second): pulled apart by a fifth, let go, 0.05 s. Reference: explicit velocity Verlet with
   peri_body_forces, error (w dt)^2/24 w t = 1e-6 of the motion with 4096 steps. With w h = 0.06 to 0.12 at the
   coarse step the next order changes the ratio of the errors, 2 and 4, by about w h: 15 %. The solver's part must
   stay below that in float too, where its tolerance is 1e-6 d: a step that did not iterate at all below its
   tolerance would add up to n^2/2 tolerances. */
static void unfold(scene *s, double *x) {
    static const double pull[9] = {1.2, 0.1, 0, 0, 1, 0, 0, 0, 0.9};
    double p[3];
    int i, c;
    for (i = 0; i < 8; i++) {
        for (c = 0; c < 3; c++) p[c] = (double)s->points[3 * i + c];
        apply(pull, p, x + 3 * i);
        for (c = 0; c < 3; c++) s->x[3 * i + c] = (peri_real)x[3 * i + c];
    }
    peri_body_set_positions(s->world, s->body, 0, 8, s->x);
}

static void unfold_steps(int integrator, int steps, double *x) {
    peri_material m = material_of(M_LINEAR, 1e5, 0.25);
    double v[24], mass = 1000 * 0.125 * 0.125 * 0.125, dt = 0.05 / steps;
    peri_real force[24];
    scene s;
    int i, t;
    scene_begin(&s, 2, 2, 2, 0.125);
    s.world_def.tolerance = (peri_real)(IS_DOUBLE ? 1e-9 : 1e-6);
    s.world_def.integrator = integrator == 1 ? PERI_BDF2 : PERI_BACKWARD_EULER;
    scene_make(&s, &m);
    unfold(&s, x);
    if (integrator < 2) {
        scene_run(&s, steps, dt);
        for (i = 0; i < 24; i++) x[i] = (double)peri_body_positions(s.world, s.body)[i];
    } else {
        memset(v, 0, sizeof v);
        for (t = 0; t <= steps; t++) {
            peri_body_forces(s.world, s.body, force);
            for (i = 0; i < 24; i++) v[i] += (t % steps ? dt : dt / 2) * (double)force[i] / mass;
            for (i = 0; i < 24 && t < steps; i++) x[i] += dt * v[i], s.x[i] = (peri_real)x[i];
            peri_body_set_positions(s.world, s.body, 0, 8, s.x);
        }
    }
    scene_end(&s);
}

static void convergence(void) {
    double exact[24], x[24], ratio[2], error[2];
    int integrator, k;
    unfold_steps(2, 4096, exact);
    for (integrator = 0; integrator < 2; integrator++) {
        for (k = 0; k < 2; k++) {
            unfold_steps(integrator, (integrator ? 64 : 512) << k, x);
            error[k] = distance(x, exact, 24) / 0.125;
        }
        ratio[integrator] = error[0] / error[1];
        printf("    error after 0.05 s, %s = %.3g d, at half the step %.3g d\n",
               integrator ? "BDF2, 64 steps" : "Euler, 512 steps", error[0], error[1]);
    }
    FIGURE("error ratio of halved dt, backward Euler", ratio[0]);
    FIGURE("error ratio of halved dt, BDF2", ratio[1]);
    NEAR(ratio[0], 2, 0.3);
    NEAR(ratio[1], 4, 0.6);
}

/* ---- what must not matter ------------------------------------------------------------------------------------ */

/* A block 4 x 4 x 5 hanging by a corner column of fixed particles, thrown sideways; 10 steps of 1/120 s. E is 1e4: with
   m/h^2 = 28100 N/m and a row of at most 2 * 26 bonds of 15 mu d 2 / 26 each (half of it in the matrix), 29000 N/m, the
   preconditioned system has a condition below 1 + 2 * 29000 / 28100 = 3, so a step ends within 3 tolerances of the
   answer; ten such errors carried on as velocities give at most 10 * 11 / 2 * 3 tolerances. */
#define INDEPENDENT 165.0
typedef struct variant {
    int solver, lbfgs, cap, permute, material;
    double unit, tolerance; /* length unit in metres^-1 */
} variant;

static void hang(const variant *v, double *x, int *unconverged, uint64_t *hash) {
    peri_material m = material_of(v->material, 1e4 / v->unit, 0.3);
    unsigned char fixed[80];
    int order[80], i, c, k;
    scene s;
    peri_real *points;
    scene_begin(&s, 4, 4, 5, 0.125 * v->unit);
    m.density = (peri_real)(2000 / (v->unit * v->unit * v->unit));
    s.world_def.solver = (peri_solver)v->solver;
    s.world_def.lbfgs = v->lbfgs;
    s.world_def.max_iterations = v->cap;
    s.world_def.tolerance = (peri_real)v->tolerance;
    s.world_def.gravity = vec3(0, 0, -9.81 * v->unit);
    s.body_def.velocity = vec3(0.5 * v->unit, 0.2 * v->unit, 0);
    points = (peri_real *)malloc(3 * (size_t)s.n * sizeof *points);
    for (i = 0; i < s.n; i++) order[i] = i;
    random_seed(70);
    for (i = s.n - 1; i > 0 && v->permute; i--) {
        int j = (int)(random_bits() % (uint64_t)(i + 1)), t = order[i];
        order[i] = order[j];
        order[j] = t;
    }
    for (i = 0; i < s.n; i++) {
        for (c = 0; c < 3; c++) points[3 * i + c] = s.points[3 * order[i] + c];
        fixed[i] = order[i] % 16 == 0;
    }
    s.body_def.points = points;
    s.body_def.fixed = fixed;
    scene_make(&s, &m);
    *unconverged = 0;
    for (k = 0; k < 10; k++) {
        scene_run(&s, 1, 1 / 128.0);
        *unconverged += !peri_world_stats(s.world).converged;
    }
    for (i = 0; i < s.n; i++)
        for (c = 0; c < 3; c++)
            x[3 * order[i] + c] = (double)peri_body_positions(s.world, s.body)[3 * i + c] / v->unit;
    if (hash) *hash = peri_world_hash(s.world);
    free(points);
    scene_end(&s);
}

static void independence(void) {
    static const int kinds[3] = {M_PROJECTIVE, M_LINEAR, M_NEO_HOOKEAN};
    static const char *const names[7] = {"no L-BFGS", "Jacobi", "Chebyshev", "position", "numbering", "metre / 1000",
                                         "auto"};
    double x[240], y[240], tolerance = IS_DOUBLE ? 1e-8 : 1e-5, worst[7] = {0, 0, 0, 0, 0, 0, 0}, moved = 0, e;
    uint64_t first, second;
    int k, t, i, late;
    for (k = 0; k < 3; k++) {
        variant a = {PERI_SOLVER_CHOLESKY, 5, 200, 0, 0, 1, 0};
        a.material = kinds[k];
        a.tolerance = tolerance;
        hang(&a, x, &late, &first);
        CHECK(late == 0);
        a.cap = 400;
        hang(&a, y, &late, &second);
        CHECK(first == second);
        for (t = 0; t < 7; t++) {
            variant b = a;
            b.cap = 4000;
            if (t == 0) b.lbfgs = 0;
            if (t == 1) b.solver = PERI_SOLVER_JACOBI;
            if (t == 2) b.solver = PERI_SOLVER_CHEBYSHEV;
            if (t == 3) b.solver = PERI_SOLVER_POSITION;
            if (t == 4) b.permute = 1;
            if (t == 5) b.unit = 1000;
            if (t == 6) b.solver = PERI_SOLVER_AUTO;
            hang(&b, y, &late, NULL);
            CHECK(late == 0);
            for (i = 0; i < 240; i++)
                if (!((e = fabs(x[i] - y[i]) / 0.125) <= worst[t])) worst[t] = e;
        }
        /* lengths in units of 2^-10 m: the same mantissas, so the same bits */
        a.unit = 1024;
        hang(&a, y, &late, NULL);
        for (i = 0, e = 0; i < 240; i++) e = fmax(e, fabs(x[i] - y[i]));
        if (e > 0) printf("    %s: unit of 2^-10 m differs by %g m\n", material_name[kinds[k]], e);
        CHECK(e == 0);
    }
    for (i = 0; i < 240; i++) {
        scene s;
        if (i) break;
        scene_begin(&s, 4, 4, 5, 0.125);
        for (t = 0; t < 240; t++) moved = fmax(moved, fabs(x[t] - (double)s.points[t]) / 0.125);
        scene_end(&s);
    }
    FIGURE("independence: motion, d", moved);
    CHECK(moved > 0.3);
    for (t = 0; t < 7; t++) {
        printf("    independence of %s = %.2g d\n", names[t], worst[t]);
        NEAR(worst[t], 0, INDEPENDENT * tolerance + 1000 * EPS);
    }
}

/* ---- particles and bodies ------------------------------------------------------------------------------------ */

static void fixed_and_driven(void) {
    peri_material m = material_of(M_NEO_HOOKEAN, 1e5, 0.3);
    unsigned char fixed[100];
    peri_vec3 aim;
    peri_measure a;
    const peri_real *x, *v;
    double pull = 0;
    peri_real force[300];
    scene s;
    int i, k, c;
    scene_begin(&s, 5, 5, 4, 0.125);
    for (i = 0; i < 100; i++) fixed[i] = i >= 75;
    s.body_def.fixed = fixed;
    s.world_def.gravity = vec3(0, 0, -9.81);
    s.world_def.tolerance = (peri_real)(IS_DOUBLE ? 1e-8 : 1e-5);
    scene_make(&s, &m);
    scene_run(&s, 200, 1 / 30.0);
    x = peri_body_positions(s.world, s.body);
    v = peri_body_velocities(s.world, s.body);
    for (i = 225; i < 300; i++) CHECK(x[i] == s.points[i] && v[i] == 0);
    CHECK(x[2] < s.points[2] - (peri_real)1e-3);
    /* hanging still, the fixed face carries the weight of the free particles: minus the sum of its inner forces. What
       is left unbalanced is the solver's: stats.residual per particle */
    peri_body_forces(s.world, s.body, force);
    for (i = 75; i < 100; i++) pull += (double)force[3 * i + 2];
    a = scene_measure(&s);
    FIGURE("reaction of a hanging block over its weight", -pull / (a.mass * 0.75 * 9.81));
    NEAR(-pull, a.mass * 0.75 * 9.81, 75 * peri_world_stats(s.world).residual + 1e-3 * a.mass * 9.81);
    /* driven: exactly at its aim after the step, with the velocity of the move, and it stays */
    for (k = 0; k < 10; k++) {
        for (i = 75; i < 100; i++) {
            aim = vec3((double)x[3 * i], (double)x[3 * i + 1] + 0.01, (double)x[3 * i + 2]);
            for (c = 0; c < 3; c++) s.x[3 * i + c] = (&aim.x)[c];
            CHECK(!peri_body_move(s.world, s.body, i, aim));
        }
        scene_run(&s, 1, 1 / 32.0);
        for (i = 225; i < 300; i++) CHECK(x[i] == s.x[i]);
    }
    NEAR(v[3 * 80 + 1], 0.32, 32 * 4 * EPS);
    CHECK(x[1] > s.points[1] + (peri_real)0.05);
    scene_run(&s, 1, 1 / 32.0);
    for (i = 225; i < 300; i++) CHECK(x[i] == s.x[i] && v[i] == 0);
    /* freed: it falls */
    for (i = 75; i < 100; i++) CHECK(!peri_body_set_fixed(s.world, s.body, i, 0));
    a = scene_measure(&s);
    scene_run(&s, 32, 1 / 32.0);
    NEAR(scene_measure(&s).momentum[2] - a.momentum[2], -9.81 * a.mass, 1e-4 * 9.81 * a.mass);
    CHECK(peri_body_move(s.world, s.body, 3, aim) == PERI_ERROR_ARGUMENT);
    scene_end(&s);
}

/* A constant force on a free body: v = F t / M and, with backward Euler, x = F/M h^2 n (n + 1)/2. Rounding: v to
   EPS per particle and step, 60 steps. Gravity and its change likewise. keep_momentum 0 leaves it to the solver:
   each step ends within a few tolerances of the answer in x, so v within 3 tolerance d / h, and the errors add. */
static void force_on_free_body(void) {
    int k, t, i;
    for (k = 0; k < 3; k++)
        for (t = 0; t < 2; t++) {
            static const int kinds[3] = {M_PROJECTIVE, M_LINEAR, M_NEO_HOOKEAN};
            peri_material m = material_of(kinds[k], 1e5, 0.3);
            double tolerance = IS_DOUBLE ? 1e-8 : 1e-5, speed, position, error;
            double mass = 64 * 1000 * 0.125 * 0.125 * 0.125;
            scene s;
            peri_measure a;
            scene_begin(&s, 4, 4, 4, 0.125);
            s.world_def.keep_momentum = t;
            s.world_def.tolerance = (peri_real)tolerance;
            scene_make(&s, &m);
            memset(s.x, 0, 3 * (size_t)s.n * sizeof *s.x);
            for (i = 0; i < 8; i++) s.x[3 * i] = 5;     /* N, on eight of its particles: it turns and bends */
            CHECK(!peri_body_set_forces(s.world, s.body, 0, s.n, s.x));
            scene_run(&s, 60, 1 / 64.0);
            a = scene_measure(&s);
            speed = 40 / mass * 60 / 64;
            position = 40 / mass / (64 * 64) * 60 * 61 / 2;
            error = t ? 60 * EPS * 2 : 60 * 3 * tolerance * 0.125 * 64;
            if (t) printf("    constant force, %s = speed off by %.2g, path by %.2g\n", material_name[kinds[k]],
                          fabs(a.momentum[0] / mass / speed - 1), fabs(a.centre[0] / position - 1));
            NEAR(a.momentum[0] / mass, speed, error);
            NEAR(a.centre[0], position, error);
            CHECK(!peri_body_set_forces(s.world, s.body, 0, s.n, NULL));
            scene_run(&s, 10, 1 / 64.0);
            NEAR(scene_measure(&s).momentum[0] / mass, speed, error * 2);
            CHECK(!peri_world_set_gravity(s.world, vec3(0, 2, 0)));
            scene_run(&s, 32, 1 / 64.0);
            NEAR(scene_measure(&s).momentum[1] / mass, 1, error * 2);
            CHECK(!peri_world_set_gravity(s.world, vec3(0, -2, 0)));
            scene_run(&s, 32, 1 / 64.0);
            NEAR(scene_measure(&s).momentum[1] / mass, 0, error * 4);
            scene_end(&s);
        }
}

/* v = velocity + spin x arm about the centre of mass, in the world's frame, wherever the body is put. */
static void initial_spin(void) {
    peri_material m = material_of(M_LINEAR, 1e5, 0.3);
    scene s;
    peri_measure a;
    double centre[3], spin[3] = {1, -2, 3}, arm[3], turn[3];
    int i, c;
    scene_begin(&s, 3, 4, 5, 0.125);
    s.body_def.position = vec3(1, 2, 3);
    random_seed(80);
    s.body_def.rotation = random_quat();
    s.body_def.spin = vec3(1, -2, 3);
    s.body_def.velocity = vec3(4, 5, 6);
    scene_make(&s, &m);
    a = scene_measure(&s);
    for (c = 0; c < 3; c++) centre[c] = a.centre[c];
    NEAR(centre[0], 1, 20 * EPS);
    NEAR(centre[2], 3, 20 * EPS);
    NEAR(a.momentum[1], 5 * a.mass, 60 * EPS * a.mass);
    for (i = 0; i < s.n; i++) {
        for (c = 0; c < 3; c++) arm[c] = (double)peri_body_positions(s.world, s.body)[3 * i + c] - centre[c];
        cross(spin, arm, turn);
        for (c = 0; c < 3; c++)
            NEAR(peri_body_velocities(s.world, s.body)[3 * i + c], 4 + c + turn[c], 40 * EPS);
    }
    scene_end(&s);
}

/* Three bodies on a floor; the middle one goes after ten steps. The others must not notice: the same bits. */
static void body_removed(void) {
    peri_material m = material_of(M_NEO_HOOKEAN, 1e5, 0.3);
    peri_real *kept[2] = {NULL, NULL};
    peri_body_id ids[3], again;
    int t, k, i;
    for (t = 0; t < 2; t++) {
        scene s;
        scene_begin(&s, 4, 4, 3, 0.125);
        s.world_def.gravity = vec3(0, 0, -9.81);
        s.world_def.integrator = PERI_BDF2;
        scene_make(&s, NULL);
        scene_floor(&s, PERI_FRICTION_COULOMB, 0.3);
        for (k = 0; k < 3; k++) {
            s.body_def.position = vec3(k, 0.1 * k, 0.3 + 0.1 * k);
            s.body_def.velocity = vec3(0.4, 0, -1);
            ids[k] = scene_body(&s, &m);
        }
        scene_run(&s, 10, 1 / 60.0);
        if (t) {
            peri_real junk[3] = {0, 0, 0};
            CHECK(!peri_body_destroy(s.world, ids[1]));
            CHECK(!peri_body_is_valid(s.world, ids[1]));
            CHECK(peri_body_count(s.world, ids[1]) == 0);
            CHECK(peri_body_positions(s.world, ids[1]) == NULL);
            CHECK(peri_body_velocities(s.world, ids[1]) == NULL);
            CHECK(peri_body_set_positions(s.world, ids[1], 0, 1, junk) == PERI_ERROR_ID);
            CHECK(peri_body_destroy(s.world, ids[1]) == PERI_ERROR_ID);
            CHECK(peri_world_stats(s.world).bodies == 2);
            CHECK(peri_world_stats(s.world).particles == 96);
        }
        scene_run(&s, 30, 1 / 60.0);
        kept[t] = (peri_real *)malloc(6 * 48 * sizeof **kept);
        memcpy(kept[t], peri_body_positions(s.world, ids[0]), 144 * sizeof **kept);
        memcpy(kept[t] + 144, peri_body_positions(s.world, ids[2]), 144 * sizeof **kept);
        if (t) {    /* a new body in the old place has another id */
            again = scene_body(&s, &m);
            CHECK(peri_body_is_valid(s.world, again));
            CHECK(!peri_body_is_valid(s.world, ids[1]));
            CHECK(again.index1 != ids[1].index1 || again.generation != ids[1].generation);
        }
        scene_end(&s);
    }
    for (i = 0, k = 0; i < 288; i++) k += kept[0][i] != kept[1][i];
    CHECK(k == 0);
    free(kept[0]);
    free(kept[1]);
}

/* The mirror image of a stretch body stores nothing: all that is measured there is the pull back, and told apart. */
static void restoring_apart(void) {
    peri_material m = material_of(M_LINEAR, 1e5, 0.25);
    peri_measure measure;
    scene s;
    int i;
    scene_begin(&s, 4, 4, 4, 0.125);
    scene_make(&s, &m);
    CHECK(!peri_world_step(s.world, (peri_real)1e-6));
    CHECK(scene_measure(&s).restoring == 0);
    for (i = 0; i < 3 * s.n; i++) s.x[i] = i % 3 ? s.points[i] : -s.points[i];
    peri_body_set_positions(s.world, s.body, 0, s.n, s.x);
    CHECK(!peri_world_step(s.world, (peri_real)1e-6)); /* no time to move: it only finds them out of shape */
    measure = scene_measure(&s);
    CHECK(peri_world_stats(s.world).unhealthy == s.n);
    CHECK(measure.restoring > 0);
    NEAR((measure.elastic - measure.restoring) / measure.elastic, 0, 1e-4);
    scene_end(&s);
}

/* set_positions puts particles where they are told, keeps the rest shape, and keeps velocities; a part only too. */
static void positions_set(void) {
    peri_material m = material_of(M_LINEAR, 1e5, 0.3);
    scene s;
    int i;
    peri_real part[3] = {(peri_real)0.01, (peri_real)0.02, (peri_real)0.03};
    scene_begin(&s, 3, 3, 3, 0.125);
    s.body_def.velocity = vec3(1, 0, 0);
    s.world_def.tolerance = (peri_real)1e-5;
    scene_make(&s, &m);
    CHECK(!peri_body_set_positions(s.world, s.body, 13, 1, part));
    for (i = 0; i < 81; i++)
        CHECK(peri_body_positions(s.world, s.body)[i] == (i / 3 == 13 ? part[i - 39] : s.points[i]));
    CHECK(peri_body_velocities(s.world, s.body)[0] == 1);
    CHECK(scene_measure(&s).elastic > 0);
    scene_run(&s, 300, 1 / 30.0);
    /* it has pulled itself back: each end of a bond to 3 tolerances, energy BOND_FORCE / 2 E V e^2 at most */
    NEAR(scene_measure(&s).elastic, 0, BOND_FORCE / 2 * 1e5 * 27 * 0.125 * 0.125 * 0.125 * 6e-5 * 6e-5);
    NEAR(scene_measure(&s).momentum[0] / scene_measure(&s).mass, 1, 600 * EPS);
    CHECK(peri_body_set_positions(s.world, s.body, 27, 1, part) == PERI_ERROR_INDEX);
    scene_end(&s);
}

/* ---- colliders ----------------------------------------------------------------------------------------------- */

static peri_real cone(peri_vec3 p, peri_vec3 *gradient, void *context) {
    double slope = *(const double *)context, r = sqrt((double)p.x * (double)p.x + (double)p.y * (double)p.y);
    double length = sqrt(1 + slope * slope);
    if (gradient) *gradient = vec3((double)p.x / r * slope / length, (double)p.y / r * slope / length, 1 / length);
    return (peri_real)(((double)p.z + slope * r) / length);
}

/* Distance from the definition: to the nearest point of the solid, or of its outside, by an independent formula. */
static double plain_distance(const peri_shape *s, const double p[3]) {
    double r = sqrt(p[0] * p[0] + p[1] * p[1]), q[3], half[3], outside = 0, inside = -1e9, along;
    int c;
    half[0] = (double)s->half.x;
    half[1] = (double)s->half.y;
    half[2] = (double)s->half.z;
    switch (s->kind) {
    case PERI_SHAPE_PLANE: return p[2];
    case PERI_SHAPE_BALL: return norm(p, 3) - (double)s->radius;
    case PERI_SHAPE_CAPSULE:
        along = fmax(fabs(p[2]) - (double)s->half_length, 0);
        return sqrt(r * r + along * along) - (double)s->radius;
    case PERI_SHAPE_BOX:
        for (c = 0; c < 3; c++) {
            q[c] = fabs(p[c]) - half[c];
            outside += fmax(q[c], 0) * fmax(q[c], 0);
            inside = fmax(inside, q[c]);
        }
        return inside > 0 ? sqrt(outside) : inside;
    case PERI_SHAPE_CYLINDER:
        q[0] = r - (double)s->radius;
        q[1] = fabs(p[2]) - (double)s->half_length;
        inside = fmax(q[0], q[1]);
        return inside > 0 ? sqrt(fmax(q[0], 0) * fmax(q[0], 0) + fmax(q[1], 0) * fmax(q[1], 0)) : inside;
    default: return 0;
    }
}

static void distances(void) {
    static double slope = 0.7;
    peri_shape shapes[6];
    double worst = 0, worst_gradient = 0, step = IS_DOUBLE ? 1e-6 : 1e-3;
    int k, t, c;
    shapes[0] = peri_shape_plane();
    shapes[1] = peri_shape_box((peri_real)0.5, (peri_real)0.3, (peri_real)0.8);
    shapes[2] = peri_shape_ball((peri_real)0.6);
    shapes[3] = peri_shape_capsule((peri_real)0.3, (peri_real)0.5);
    shapes[4] = peri_shape_cylinder((peri_real)0.4, (peri_real)0.5);
    shapes[5] = peri_shape_distance(cone, &slope, vec3(-1, -1, -1), vec3(1, 1, 1));
    random_seed(90);
    for (k = 0; k < 6; k++)
        for (t = 0; t < 500; t++) {
            peri_vec3 p = vec3(1.2 * uniform(), 1.2 * uniform(), 1.2 * uniform()), gradient;
            double x[3], g[3], plus, minus;
            x[0] = (double)p.x;
            x[1] = (double)p.y;
            x[2] = (double)p.z;
            plus = (double)peri_shape_evaluate(&shapes[k], p, &gradient);
            if (k < 5) worst = fmax(worst, fabs(plus - plain_distance(&shapes[k], x)));
            g[0] = (double)gradient.x;
            g[1] = (double)gradient.y;
            g[2] = (double)gradient.z;
            NEAR(norm(g, 3), 1, 4 * EPS);
            /* along its own gradient the distance rises at rate 1 (kinks lie on the middle planes, left out below) */
            for (c = 0; c < 3; c++) x[c] += step * g[c];
            plus = (double)peri_shape_evaluate(&shapes[k], vec3(x[0], x[1], x[2]), NULL);
            for (c = 0; c < 3; c++) x[c] -= 2 * step * g[c];
            minus = (double)peri_shape_evaluate(&shapes[k], vec3(x[0], x[1], x[2]), NULL);
            if (plus < -0.2 || (k == 5 && x[0] * x[0] + x[1] * x[1] < 0.01)) continue;
            worst_gradient = fmax(worst_gradient, fabs((plus - minus) / (2 * step) - 1));
        }
    FIGURE("shapes: distance against formulas, m", worst);
    FIGURE("shapes: slope along the gradient, off 1", worst_gradient);
    NEAR(worst, 0, 6 * EPS);    /* numbers up to 2, a root */
    /* rounding 4 EPS / step; curved shapes have no second order along their own normal; a corner seen from within the
       step can take off half of it, so points nearer than a step to a kink would fail: none of these 3000 is */
    NEAR(worst_gradient, 0, 8 * EPS / step + (IS_DOUBLE ? 1e-9 : 1e-6));
}

/* A single particle is driven into each shape, turned and moved, from many sides: it stops at its radius, and in
   the end rests at the distance where the spring carries its push: one step's push m v / h on a spring of m / h^2
   at least, so v h = 0.2 of a radius deep at most. */
static void particle_against_shapes(void) {
    peri_material m = material_of(M_LINEAR, 1e5, 0.3);
    double deepest = 0;
    int k, t, i, c;
    for (k = 1; k < 5; k++)
        for (t = 0; t < 8; t++) {
            peri_shape shape = k == 1 ? peri_shape_box((peri_real)0.5, (peri_real)0.3, (peri_real)0.8)
                             : k == 2 ? peri_shape_ball((peri_real)0.6)
                             : k == 3 ? peri_shape_capsule((peri_real)0.3, (peri_real)0.5)
                                      : peri_shape_cylinder((peri_real)0.4, (peri_real)0.5);
            peri_collider_def def = peri_default_collider_def();
            double turn[9], back[9], way[3], arm[3], local[3];
            peri_vec3 p;
            scene s;
            scene_begin(&s, 1, 1, 1, 0.1);
            random_seed((uint64_t)(900 + 10 * k + t));
            do for (c = 0; c < 3; c++) way[c] = uniform(); while (norm(way, 3) < 0.3);
            for (c = 0; c < 3; c++) arm[c] = way[c] / norm(way, 3);
            s.body_def.position = vec3(1 + 1.3 * arm[0], 2 + 1.3 * arm[1], 3 + 1.3 * arm[2]);
            s.body_def.velocity = vec3(-0.6 * arm[0], -0.6 * arm[1], -0.6 * arm[2]);
            s.world_def.gravity = vec3(-arm[0], -arm[1], -arm[2]);
            scene_make(&s, &m);
            def.shape = shape;
            def.position = vec3(1, 2, 3);
            def.rotation = random_quat();
            def.type = PERI_FRICTION_STICK;
            peri_collider_create(s.world, &def);
            quat_matrix(def.rotation, turn);
            transpose(turn, back);
            for (i = 0; i < 150; i++) {
                const peri_real *x = peri_body_positions(s.world, s.body);
                double depth;
                scene_run(&s, 1, 1 / 60.0);
                arm[0] = (double)x[0] - 1;
                arm[1] = (double)x[1] - 2;
                arm[2] = (double)x[2] - 3;
                apply(back, arm, local);
                p = vec3(local[0], local[1], local[2]);
                depth = 0.05 - (double)peri_shape_evaluate(&shape, p, NULL);
                deepest = fmax(deepest, depth / 0.05);
                if (i == 149) CHECK(depth > -0.01 && peri_world_stats(s.world).contacts == 1);
            }
            scene_end(&s);
        }
    FIGURE("particle against shapes: deepest, radii", deepest);
    NEAR(deepest, 0, (0.6 + 150 / 60.0) / 60 / 0.05);
}

/* A block of 6 x 6 x 3 on a plane turned by an angle about y: what it does in the second and third second. */
typedef struct slide {
    double moved;           /* down the slope, m, in 2 s after 1 s to settle */
    double tangential, normal;  /* impulse on the collider in those 2 s, N s */
    double speed;           /* at the end, down the slope */
    double weight;          /* N */
} slide;

static slide run_slope(double degrees, peri_friction type, double mu, peri_vec3 floor_velocity,
                       peri_integrator integrator, double tolerance) {
    peri_material m = material_of(M_NEO_HOOKEAN, 2e5, 0.3);
    double angle = degrees * 3.14159265358979 / 180, along[3], up[3], start = 0;
    peri_collider_def def = peri_default_collider_def();
    peri_collider_id floor_id;
    peri_measure a;
    slide out = {0, 0, 0, 0, 0};
    scene s;
    int k;
    along[0] = cos(angle); along[1] = 0; along[2] = -sin(angle);
    up[0] = sin(angle); up[1] = 0; up[2] = cos(angle);
    scene_begin(&s, 6, 6, 3, 0.125);
    s.world_def.gravity = vec3(0, 0, -9.81);
    s.world_def.integrator = integrator;
    s.world_def.tolerance = (peri_real)tolerance;
    s.body_def.rotation = axis_quat(1, angle);
    s.body_def.position = vec3(up[0] * 0.187, 0, up[2] * 0.187);
    scene_make(&s, &m);
    def.rotation = axis_quat(1, angle);
    def.type = type;
    def.friction = (peri_real)mu;
    def.velocity = floor_velocity;
    floor_id = peri_collider_create(s.world, &def);
    for (k = 0; k < 180; k++) {
        peri_vec3 impulse = {0, 0, 0};
        if (k == 60) {
            a = scene_measure(&s);
            start = a.centre[0] * along[0] + a.centre[2] * along[2];
        }
        scene_run(&s, 1, 1 / 60.0);
        peri_collider_impulse(s.world, floor_id, &impulse, NULL);
        if (k < 60) continue;
        out.tangential += (double)impulse.x * along[0] + (double)impulse.z * along[2];
        out.normal -= (double)impulse.x * up[0] + (double)impulse.z * up[2];
    }
    a = scene_measure(&s);
    out.moved = a.centre[0] * along[0] + a.centre[2] * along[2] - start;
    out.speed = (a.momentum[0] * along[0] + a.momentum[2] * along[2]) / a.mass;
    out.weight = a.mass * 9.81;
    scene_end(&s);
    return out;
}

/* The weight of a block at rest is the impulse that the floor is given per second. */
static void resting_weight(void) {
    int k;
    for (k = 0; k < 2; k++) {
        slide r = run_slope(0, PERI_FRICTION_COULOMB, 0.5, vec3(0, 0, 0), (peri_integrator)k, 1e-3);
        printf("    resting block: impulse per second over weight, %s = %.6f\n", k ? "BDF2" : "Euler",
               r.normal / 2 / r.weight);
        NEAR(r.normal / 2 / r.weight, 1, 0.01);
        NEAR(r.tangential / 2 / r.weight, 0, 0.01);
        NEAR(r.moved, 0, 1e-3 * 0.125);
    }
}

/* Coulomb, mu = 0.5: atan mu = 26.57 degrees. One degree below it holds for good (its hold is a spring: no creep,
   so less than a hundredth of d in two seconds); one degree above it slides, and gains speed by g (sin - mu cos):
   0.198 m/s^2. The angle at which a block lets go is that of the floor's pressure, which an elastic block
   distributes unevenly, but all of it must slip before it goes: the acceleration is that of a rigid one within the
   chatter of a settling block. */
static void slope_coulomb(void) {
    slide below = run_slope(25.6, PERI_FRICTION_COULOMB, 0.5, vec3(0, 0, 0), PERI_BACKWARD_EULER, 1e-4);
    slide coarse = run_slope(25.6, PERI_FRICTION_COULOMB, 0.5, vec3(0, 0, 0), PERI_BACKWARD_EULER, 1e-3);
    slide above = run_slope(27.6, PERI_FRICTION_COULOMB, 0.5, vec3(0, 0, 0), PERI_BACKWARD_EULER, 1e-3);
    slide steep = run_slope(40, PERI_FRICTION_COULOMB, 0.5, vec3(0, 0, 0), PERI_BACKWARD_EULER, 1e-3);
    double pi = 3.14159265358979, rate;
    FIGURE("slope 25.6 degrees, mu 0.5: moved in 2 s at tolerance 1e-4, d", below.moved / 0.125);
    FIGURE("slope 25.6 degrees, mu 0.5: moved in 2 s at tolerance 1e-3, d", coarse.moved / 0.125);
    FIGURE("slope 27.6 degrees, mu 0.5: moved in 2 s, d", above.moved / 0.125);
    FIGURE("slope 27.6 degrees: tangential over normal impulse", above.tangential / above.normal);
    NEAR(below.moved, 0, 0.01 * 0.125);
    /* the default tolerance: every one of 120 steps may leave it 1e-3 d from the answer, all downhill at worst */
    NEAR(coarse.moved, 0, 0.12 * 0.125);
    /* from rest at 1 s at the latest: g (sin - mu cos) 2^2 / 2; half of it for a late start */
    CHECK(above.moved > 0.5 * 9.81 * (sin(27.6 * pi / 180) - 0.5 * cos(27.6 * pi / 180)) * 2);
    NEAR(above.tangential / above.normal, 0.5, 0.005);
    /* 40 degrees: slides from the start, 3 s of g (sin - mu cos), to 1 % */
    rate = 9.81 * (sin(40 * pi / 180) - 0.5 * cos(40 * pi / 180));
    FIGURE("slope 40 degrees, mu 0.5: speed after 3 s over g (sin - mu cos) t", steep.speed / (3 * rate));
    NEAR(steep.speed, 3 * rate, 0.01 * 3 * rate);
}

/* Slip: no tangential impulse but the rounding of the normal, and g sin all the way. Stick: 60 degrees hold. */
static void slope_slip_and_stick(void) {
    slide slip = run_slope(30, PERI_FRICTION_SLIP, 0.5, vec3(0, 0, 0), PERI_BACKWARD_EULER, 1e-3);
    slide stick = run_slope(60, PERI_FRICTION_STICK, 0, vec3(0, 0, 0), PERI_BACKWARD_EULER, 1e-3);
    FIGURE("slip: tangential over normal impulse", slip.tangential / slip.normal);
    FIGURE("slip: speed after 3 s over g sin(30) t", slip.speed / (3 * 9.81 * 0.5));
    FIGURE("stick at 60 degrees: moved in 2 s, d", stick.moved / 0.125);
    NEAR(slip.tangential / slip.normal, 0, 20 * EPS);
    NEAR(slip.speed, 3 * 9.81 * 0.5, 0.01 * 3 * 9.81 * 0.5);
    NEAR(stick.moved, 0, 0.01 * 0.125);
}

/* A floor that moves at 0.5 m/s takes the block along, to within 1 % after 3 s (friction 0.5 needs 0.1 s for that). */
static void moving_floor(void) {
    slide r = run_slope(0, PERI_FRICTION_COULOMB, 0.5, vec3(0.5, 0, 0), PERI_BACKWARD_EULER, 1e-3);
    slide slip = run_slope(0, PERI_FRICTION_SLIP, 0.5, vec3(0.5, 0, 0), PERI_BACKWARD_EULER, 1e-5);
    FIGURE("block on a floor of 0.5 m/s: speed", r.speed);
    NEAR(r.speed, 0.5, 0.005);
    NEAR(r.moved, 1, 0.01);
    NEAR(slip.speed, 0, 10 * 3e-5 * 0.125 * 60);    /* a step errs by 3 tolerances; ten of them the same way */
}

/* Every step: the body's change of momentum is gravity's impulse less what the collider was handed. Left over is the
   solver's unbalanced force (stats.residual, rms per particle: at most n times it) and the rounding of velocities and
   of the 216 forces. */
static void impulses(void) {
    static const int kinds[3] = {M_PROJECTIVE, M_LINEAR, M_NEO_HOOKEAN};
    double worst = 0, largest = 0;
    int k, t, c;
    for (k = 0; k < 3; k++) {
        peri_material m = material_of(kinds[k], 1e5, 0.3);
        peri_collider_id floor_id;
        peri_measure a, b;
        scene s;
        scene_begin(&s, 6, 6, 6, 0.125);
        s.world_def.gravity = vec3(0, 0, -9.81);
        s.body_def.position = vec3(0, 0, 0.5);
        s.body_def.velocity = vec3(1, 0.5, -3);
        s.body_def.rotation = axis_quat(0, 0.3);
        scene_make(&s, &m);
        floor_id = scene_floor(&s, PERI_FRICTION_COULOMB, 0.4);
        a = scene_measure(&s);
        for (t = 0; t < 60; t++) {
            peri_vec3 impulse = {0, 0, 0};
            double got[3], change, bound;
            scene_run(&s, 1, 1 / 60.0);
            b = scene_measure(&s);
            peri_collider_impulse(s.world, floor_id, &impulse, NULL);
            got[0] = (double)impulse.x;
            got[1] = (double)impulse.y;
            got[2] = (double)impulse.z;
            bound = s.n * peri_world_stats(s.world).residual / 60 + 10 * EPS * b.mass * 5;
            for (c = 0; c < 3; c++) {
                change = b.momentum[c] - a.momentum[c] + got[c] + (c == 2 ? b.mass * 9.81 / 60 : 0);
                NEAR(change, 0, bound);
                worst = fmax(worst, fabs(change) / (b.mass * 9.81 / 60));
                largest = fmax(largest, fabs(got[c]) / (b.mass * 9.81 / 60));
            }
            a = b;
        }
        CHECK(largest > 2);     /* it did hit the floor */
        scene_end(&s);
    }
    FIGURE("impulse: momentum not accounted for, of the weight's impulse in a step", worst);
    FIGURE("impulse: largest", largest);
}

/* A drop: contact gives no energy. While particles touch, their springs hold some that cannot be seen here, but never
   less than none: so kinetic + elastic + potential is at no time above the least that it was while nothing touched.
   The solver's share: a step ends within 3 tolerances of the answer against its residual force, per particle. */
static void contact_energy(void) {
    static const int kinds[3] = {M_PROJECTIVE, M_LINEAR, M_NEO_HOOKEAN};
    int k, t, integrator;
    for (k = 0; k < 3; k++)
        for (integrator = 0; integrator < 2; integrator++) {
            peri_material m = material_of(kinds[k], 1e5, 0.3);
            double energy = 0, least, first, h = 1 / 60.0, rise = 0, slack = 0;
            int flights = 0, touched = 0;
            peri_measure a;
            scene s;
            scene_begin(&s, 5, 5, 5, 0.125);
            s.world_def.gravity = vec3(0, 0, -9.81);
            s.world_def.integrator = (peri_integrator)integrator;
            s.world_def.tolerance = (peri_real)1e-5;
            s.body_def.position = vec3(0, 0, 0.8);
            s.body_def.rotation = axis_quat(0, 0.4);
            s.body_def.velocity = vec3(1, 0, 0);
            scene_make(&s, &m);
            scene_floor(&s, PERI_FRICTION_COULOMB, 0.3);
            a = scene_measure(&s);
            first = least = a.kinetic + a.potential + a.elastic;
            for (t = 0; t < 120; t++) {
                peri_stats stats;
                scene_run(&s, 1, h);
                a = scene_measure(&s);
                stats = peri_world_stats(s.world);
                energy = a.kinetic + a.potential + a.elastic;
                slack += s.n * stats.residual * 3e-5 * s.d + 1e-6 * first;
                if (energy - least > rise) rise = energy - least;
                if (!(energy <= least + slack)) CHECK(!"energy rises");
                if (stats.contacts) touched = 1;
                else flights += touched, touched = 0, least = energy < least ? energy : least;
            }
            CHECK(energy < first);
            CHECK(flights > 0 || integrator == 0);  /* it did bounce; backward Euler may swallow that */
            printf("    drop, %s, %s = energy rises by %.2g of the first, ends at %.3f (%d bounces)\n",
                   material_name[kinds[k]], integrator ? "BDF2" : "Euler", rise / first, energy / first, flights);
            scene_end(&s);
        }
}

/* ---- memory -------------------------------------------------------------------------------------------------- */

static size_t hook_calls;

static void *counting(void *ptr, size_t old_bytes, size_t new_bytes, void *user) {
    (void)old_bytes;
    (void)user;
    if (new_bytes) hook_calls++;
    if (!new_bytes) {
        free(ptr);
        return NULL;
    }
    return realloc(ptr, new_bytes);
}

static void settled_steps(void) {
    int k, solver;
    for (k = 0; k < M_COUNT; k++)
        for (solver = PERI_SOLVER_CHOLESKY; solver <= PERI_SOLVER_POSITION; solver++) {
            peri_material m = material_of(k, 1e5, 0.3);
            size_t calls, allocations;
            scene s;
            scene_begin(&s, 4, 4, 4, 0.125);
            s.world_def.gravity = vec3(0, 0, -9.81);
            s.world_def.memory.resize = counting;
            s.world_def.solver = (peri_solver)solver;
            s.world_def.integrator = solver % 2 ? PERI_BDF2 : PERI_BACKWARD_EULER;
            s.body_def.position = vec3(0, 0, 0.26);
            scene_make(&s, &m);
            scene_floor(&s, PERI_FRICTION_COULOMB, 0.5);
            scene_run(&s, 5, 1 / 60.0);
            calls = hook_calls;
            allocations = peri_world_stats(s.world).allocations;
            CHECK(allocations > 0);
            scene_run(&s, 20, 1 / 60.0);
            CHECK(hook_calls == calls);
            CHECK(peri_world_stats(s.world).allocations == allocations);
            CHECK(peri_world_stats(s.world).contacts > 0);
            scene_end(&s);
        }
}

/* ---- recovery ------------------------------------------------------------------------------------------------ */

/* Rms distance of the particles to the rest shape put rigidly over them, in spacings. */
static double out_of_shape(const scene *s) {
    const peri_real *x = peri_body_positions(s->world, s->body);
    double centre[3] = {0, 0, 0}, h[9], r[9], sum = 0, p[3], y[3];
    int i, a, b;
    memset(h, 0, sizeof h);
    for (i = 0; i < s->n; i++)
        for (a = 0; a < 3; a++) centre[a] += (double)x[3 * i + a] / s->n;
    for (i = 0; i < s->n; i++)
        for (a = 0; a < 3; a++)
            for (b = 0; b < 3; b++) h[3 * a + b] += ((double)x[3 * i + a] - centre[a]) * (double)s->points[3 * i + b];
    peri_polar3(h, r);
    for (i = 0; i < s->n; i++) {
        for (a = 0; a < 3; a++) p[a] = (double)s->points[3 * i + a];
        apply(r, p, y);
        for (a = 0; a < 3; a++) sum += pow((double)x[3 * i + a] - centre[a] - y[a], 2) / s->n;
    }
    return sqrt(sum) / s->d;
}

/* A 6^3 block out of shape comes back within 5 % of d (rms) in 60 steps of 1/60 s, and stays. A straight line of
   identical particles has no direction to unfold in, so each case starts with a shake of 1e-3 d. */
static void recovery(void) {
    static const int kinds[3] = {M_NEO_HOOKEAN, M_LINEAR, M_PROJECTIVE};
    static const char *const cases[5] = {"plane", "line", "point", "mirror image", "shuffled"};
    int k, t, i, step;
    for (k = 0; k < 3; k++)
        for (t = 0; t < 5; t++) {
            peri_material m = material_of(kinds[k], 1e5, 0.3);
            int back = 0, most = 0;
            double end;
            scene s;
            scene_begin(&s, 6, 6, 6, 0.125);
            scene_make(&s, &m);
            random_seed(100);
            for (i = 0; i < 3 * s.n; i++) {
                double keep = t == 0 ? i % 3 != 2 : t == 1 ? i % 3 == 0 : t == 2 ? 0 : t == 3 && i % 3 == 0 ? -1 : 1;
                s.x[i] = (peri_real)(keep * (double)s.points[i] + 1e-3 * s.d * uniform());
            }
            for (i = s.n - 1; i > 0 && t == 4; i--) {
                int j = (int)(random_bits() % (uint64_t)(i + 1)), c;
                for (c = 0; c < 3; c++) {
                    peri_real keep = s.x[3 * i + c];
                    s.x[3 * i + c] = s.x[3 * j + c];
                    s.x[3 * j + c] = keep;
                }
            }
            peri_body_set_positions(s.world, s.body, 0, s.n, s.x);
            CHECK(out_of_shape(&s) > 0.5);
            for (step = 1; step <= 60; step++) {
                scene_run(&s, 1, 1 / 60.0);
                if (peri_world_stats(s.world).iterations > most) most = peri_world_stats(s.world).iterations;
                if (out_of_shape(&s) > 0.05) back = 0;
                else if (!back) back = step;
            }
            end = out_of_shape(&s);
            printf("    recovery of %s from %s = %d steps (end %.3g d, at most %d iterations)\n",
                   material_name[kinds[k]], cases[t], back, end, most);
            CHECK(back > 0);
            scene_end(&s);
        }
}

#ifndef PERI_NO_SKINNING
/* Skins: F X + t under affine motion, to rounding: the weights' sums in peri_real of positions up to 5 d, condition
   of a family about 20. */
static void skin_follows(void) {
    peri_material m = material_of(M_NEO_HOOKEAN, 1e5, 0.3);
    peri_real vertices[300], got[300];
    double worst = 0, f[9], move[3], p[3], y[3];
    peri_skin_id skin;
    scene s;
    int i, c, t;
    scene_begin(&s, 4, 5, 6, 0.125);
    s.body_def.position = vec3(0.5, 0.25, -0.5);
    scene_make(&s, &m);
    random_seed(110);
    for (i = 0; i < 100; i++)
        for (c = 0; c < 3; c++) vertices[3 * i + c] = (peri_real)((4 + c) * 0.125 * 0.55 * uniform());
    skin = peri_skin_create(s.world, s.body, vertices, 100, NULL, 0);
    for (t = 0; t < 5; t++) {
        random_map(f, 0.2);
        for (c = 0; c < 3; c++) move[c] = uniform();
        scene_affine(&s, f, move);
        if (peri_skin_update(s.world, skin, got, NULL)) complain_of(s.world, "skin");
        for (i = 0; i < 100; i++) {
            for (c = 0; c < 3; c++) p[c] = (double)vertices[3 * i + c];
            apply(f, p, y);
            for (c = 0; c < 3; c++) worst = fmax(worst, fabs((double)got[3 * i + c] - y[c] - move[c]));
        }
    }
    FIGURE("skin: off the affine map, m", worst);
    NEAR(worst, 0, 20 * 10 * EPS);
    scene_end(&s);
}
#endif

/* What AUTO takes follows from counts, and can be read; whatever it takes, the answer is the same. */
static void solver_choice(void) {
    int k, solver;
    double reach = 0, apart = 0;
    static peri_real kept[3 * 2000];
    for (solver = PERI_SOLVER_AUTO; solver <= PERI_SOLVER_TWO_LEVEL; solver++)
        for (k = 0; k < 2; k++) {
            peri_world_def wd = peri_default_world_def();
            peri_body_def bd = peri_default_body_def();
            peri_material m = peri_material_neo_hookean(1e5f, 0.3f, 1000);
            int side = k ? 12 : 6, n = side * side * side, i, step;
            peri_real *points = (peri_real *)calloc(3 * (size_t)n, sizeof *points);
            unsigned char *fixed = (unsigned char *)calloc((size_t)n, 1);
            const peri_real *x;
            peri_choice c;
            peri_world *w;
            peri_body_id id;
            wd.solver = (peri_solver)solver;
            wd.tolerance = (peri_real)1e-5;
            w = peri_world_create(&wd, NULL);
            bd.spacing = (peri_real)0.05;
            for (i = 0; i < n; i++) {
                points[3 * i] = bd.spacing * (peri_real)(i % side);
                points[3 * i + 1] = bd.spacing * (peri_real)(i / side % side);
                points[3 * i + 2] = bd.spacing * (peri_real)(i / side / side);
                fixed[i] = i % side == 0;
            }
            bd.points = points;
            bd.fixed = fixed;
            bd.count = n;
            bd.material = peri_material_create(w, &m);
            id = peri_body_create(w, &bd);
            c = peri_body_solver(w, id);
            CHECK(c.solver == PERI_SOLVER_AUTO && strstr(c.why, "not chosen yet"));
            for (step = 0; step < 3; step++) CHECK(!peri_world_step(w, (peri_real)(1 / 60.0)));
            c = peri_body_solver(w, id);
            if (solver != PERI_SOLVER_AUTO) CHECK(c.solver == wd.solver && strstr(c.why, "asks for it"));
            else if (!k) CHECK(c.solver == PERI_SOLVER_CHOLESKY && strstr(c.why, "216 particles: a factor is cheap"));
            else {
                CHECK(c.cost[0] > 0 && c.cost[1] > 0 && c.entries > n && strstr(c.why, "1728 particles"));
                CHECK(c.solver == (c.cost[0] <= c.cost[1] ? PERI_SOLVER_CHOLESKY : PERI_SOLVER_TWO_LEVEL));
                printf("    %s\n", c.why);
            }
            x = peri_body_positions(w, id);
            for (i = 0; i < 3 * n && k; i++) {
                if (solver == PERI_SOLVER_CHOLESKY) kept[i] = x[i];
                if (solver == PERI_SOLVER_CHOLESKY && fabs((double)(x[i] - points[i])) > reach)
                    reach = fabs((double)(x[i] - points[i]));
                if (solver == PERI_SOLVER_TWO_LEVEL && fabs((double)(x[i] - kept[i])) > apart)
                    apart = fabs((double)(x[i] - kept[i]));
            }
            CHECK(peri_world_stats(w).factors_held == 1 && peri_world_stats(w).factor_bytes > 0);
            peri_body_destroy(w, id);
            CHECK(peri_world_stats(w).factors_held == 0 && peri_world_stats(w).factor_bytes == 0);
            c = peri_body_solver(w, id);
            CHECK(c.why[0] == 0 && c.solver == PERI_SOLVER_AUTO);
            peri_world_destroy(w);
            free(points);
            free(fixed);
        }
    /* three steps, each within the tolerance of 1e-5 spacings times what a correction hides, a few times itself */
    printf("    two levels against Cholesky, d = %.2g\n", apart / 0.05);
    CHECK(reach > 0.05 * 0.05 && apart < 1e-4 * 0.05);
}

#ifndef PERI_NO_CHOLESKY
/* A thousand copies factorise once. One that goes its own way, by a particle held, has numbers of its own and still the
   same analysis; the others keep theirs. */
static void copies_share(void) {
    enum { COPIES = 1000, SIDE = 3, N = SIDE * SIDE * SIDE };
    peri_world_def wd = peri_default_world_def();
    peri_body_def bd = peri_default_body_def();
    peri_material m = peri_material_neo_hookean(1e5f, 0.3f, 1000);
    static peri_body_id id[COPIES];
    peri_real points[3 * N];
    peri_world *w;
    const peri__factor *first;
    int i, k;
    wd.solver = PERI_SOLVER_CHOLESKY;
    wd.max_bodies = COPIES;
    w = peri_world_create(&wd, NULL);
    bd.spacing = (peri_real)0.1;
    for (i = 0; i < N; i++) {
        points[3 * i] = bd.spacing * (peri_real)(i % SIDE);
        points[3 * i + 1] = bd.spacing * (peri_real)(i / SIDE % SIDE);
        points[3 * i + 2] = bd.spacing * (peri_real)(i / SIDE / SIDE);
    }
    bd.points = points;
    bd.count = N;
    bd.material = peri_material_create(w, &m);
    for (k = 0; k < COPIES; k++) {
        bd.position.x = (peri_real)(k % 10);
        bd.position.y = (peri_real)(k / 10 % 10);
        bd.position.z = (peri_real)(k / 100);
        id[k] = peri_body_create(w, &bd);
    }
    CHECK(!peri_world_step(w, (peri_real)(1 / 60.0)));
    CHECK(peri_world_stats(w).factors == 1 && peri_world_stats(w).factors_held == 1);
    first = peri__body_at(w, 0)->factor;
    for (k = 0; k < COPIES; k++) CHECK(peri__body_at(w, k)->factor == first);
    CHECK(!peri_body_set_fixed(w, id[7], 0, 1));
    CHECK(!peri_world_step(w, (peri_real)(1 / 60.0)));
    CHECK(peri_world_stats(w).factors == 2 && peri_world_stats(w).factors_held == 2);
    CHECK(peri__body_at(w, 7)->factor != first && peri__body_at(w, 7)->factor->l->s == first->l->s);
    for (k = 0; k < COPIES; k++) CHECK(k == 7 || peri__body_at(w, k)->factor == first);
    peri_world_destroy(w);
}
#endif

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(affine_correspondence);
    RUN(affine_linear);
    RUN(affine_stvk);
    RUN(checkerboard);
    RUN(pressed_block);
    RUN(rigid_motion);
    RUN(inner_forces);
    RUN(momentum_kept);
    RUN(momentum_of_the_bare_integrators);
    RUN(momentum_of_the_forces);
    RUN(damping);
    RUN(convergence);
    RUN(independence);
    RUN(fixed_and_driven);
    RUN(force_on_free_body);
    RUN(initial_spin);
    RUN(body_removed);
    RUN(restoring_apart);
    RUN(positions_set);
    RUN(distances);
    RUN(particle_against_shapes);
    RUN(resting_weight);
    RUN(slope_coulomb);
    RUN(slope_slip_and_stick);
    RUN(moving_floor);
    RUN(impulses);
    RUN(contact_energy);
    RUN(settled_steps);
    RUN(recovery);
#ifndef PERI_NO_SKINNING
    RUN(skin_follows);
#endif
    RUN(solver_choice);
#ifndef PERI_NO_CHOLESKY
    RUN(copies_share);
#endif
    return test_end();
}
