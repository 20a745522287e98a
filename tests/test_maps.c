/* test_maps.c - bodies whose particles differ: in material, stiffness, material directions and density. */
#define PERI_IMPLEMENTATION
#include "../peri.h"

#include "test.h"

#include "scenes.h"

enum { MAX = 512 };

typedef struct maps {
    peri_material material[3];
    peri_material_id id[2];
    unsigned char of[MAX];
    peri_real stiffness[MAX], direction[9 * MAX];
} maps;

enum { MIX_PROJECTIVE, MIX_STRETCH, MIX_DIRECTIONS, MIX_CORRESPONDENCE, MIXES };
static const char *const mix_name[MIXES] = {"projective", "stretch", "directions", "correspondence"};

/* Three materials that differ in all that may differ, dealt out at random; random stiffness factors and, in the third
   mix, random directions. */
static void mix_make(scene *s, maps *p, int mix) {
    double r[9];
    int i, k;
    random_seed(40 + (uint64_t)mix);
    for (k = 0; k < 3; k++) {
        double young = k == 0 ? 1e5 : k == 1 ? 3e5 : 4e4, nu = k == 0 ? 0.3 : k == 1 ? 0.1 : 0.4;
        static const int law[3] = {M_NEO_HOOKEAN, M_STVK_EXACT, M_USER};
        if (mix == MIX_PROJECTIVE) p->material[k] = material_of(M_PROJECTIVE, young, 0.25);
        if (mix == MIX_PROJECTIVE) p->material[k].a *= (peri_real)(1 + k);
        if (mix == MIX_STRETCH) p->material[k] = material_of(M_LINEAR, young, nu);
        if (mix == MIX_STRETCH && k) p->material[k].g = material_of(k == 1 ? M_MIXED : M_PAPERS, young, nu).g;
        if (mix == MIX_DIRECTIONS) p->material[k] = material_of(k == 2 ? M_LINEAR : M_ANISOTROPIC, young, nu);
        if (mix == MIX_DIRECTIONS && k == 1) p->material[k].strength[0] = 1, p->material[k].strength[1] = 2;
        if (mix == MIX_CORRESPONDENCE) p->material[k] = material_of(law[k], young, nu);
        if (mix == MIX_CORRESPONDENCE) p->material[k].stabiliser = (peri_real)(1 + k);
        p->material[k].density = (peri_real)(500 * (k + 1));
    }
    random_seed(60 + (uint64_t)mix);
    for (i = 0; i < s->n; i++) {
        p->of[i] = (unsigned char)(random_bits() % 3);
        p->stiffness[i] = (peri_real)between(0.3, 3);
        random_rotation(r);
        for (k = 0; k < 9; k++) p->direction[9 * i + k] = (peri_real)r[k];
    }
    scene_make(s, NULL);
    for (k = 0; k < 2; k++) p->id[k] = peri_material_create(s->world, &p->material[k + 1]);
    s->body_def.materials = p->id;
    s->body_def.material_count = 2;
    s->body_def.material_of = p->of;
    s->body_def.stiffness = p->stiffness;
    if (mix == MIX_DIRECTIONS) s->body_def.directions = p->direction;
    s->body = scene_body(s, &p->material[0]);
}

static double elastic_at(scene *s, const double *from, const double *u, double step, double *at) {
    int k;
    for (k = 0; k < 3 * s->n; k++) {
        s->x[k] = (peri_real)(from[k] + step * u[k]);
        at[k] = (double)s->x[k];
    }
    peri_body_set_positions(s->world, s->body, 0, s->n, s->x);
    return scene_measure(s).elastic;
}

/* Work of the forces along random moves of step e and 2 e against the difference of the energies, extrapolated. The
   move has a part along the forces. Truncation is of fourth order, e^4 times a fifth derivative of some hundreds: 1e-10
   at e = 1e-3. Rounding: the energy's terms are good to some EPS and the difference is e of them, but they are random
   over the bonds, of which there are a thousand: 20 EPS / (e sqrt 1000) = 6e-4 in float at 1e-3. */
static double force_error(scene *s, double e) {
    static double from[3 * MAX], u[3 * MAX], high[3 * MAX], low[3 * MAX];
    static peri_real force[3 * MAX];
    const peri_real *x = peri_body_positions(s->world, s->body);
    double rms = 0, work[2], difference[2], slope, wanted;
    int k, t, n = 3 * s->n;
    for (k = 0; k < n; k++) from[k] = (double)x[k];
    peri_body_forces(s->world, s->body, force);
    for (k = 0; k < n; k++) rms += (double)force[k] * (double)force[k] / n;
    for (k = 0; k < n; k++) u[k] = uniform() + 0.5 * (double)force[k] / sqrt(rms);
    for (t = 0; t < 2; t++) {
        double step = (t + 1) * e * s->d;
        difference[t] = elastic_at(s, from, u, step, high);
        difference[t] -= elastic_at(s, from, u, -step, low);
        for (work[t] = 0, k = 0; k < n; k++) work[t] -= (double)force[k] * (high[k] - low[k]);
    }
    slope = 8 * difference[0] - difference[1];
    wanted = 8 * work[0] - work[1];
    return fabs(slope / wanted - 1);
}

static void forces_are_derivatives(void) {
    int mix;
    for (mix = MIX_STRETCH; mix < MIXES; mix++) {
        static maps p;
        scene s;
        double e;
        scene_begin(&s, 5, 4, 4, 0.1);
        mix_make(&s, &p, mix);
        scene_shake(&s, 0.15);
        e = force_error(&s, 1e-3);
        printf("    %s: forces against the energy's differences %.3g\n", mix_name[mix], e);
        NEAR(e, 0, IS_DOUBLE ? 1e-8 : 6e-4);
        scene_end(&s);
    }
}

/* A particle out of shape, of a material with another restoring stiffness, too: its mode is set by a step. */
static void restored_forces_are_derivatives(void) {
    static maps p;
    scene s;
    double e;
    int k;
    scene_begin(&s, 4, 4, 4, 0.1);
    mix_make(&s, &p, MIX_CORRESPONDENCE);
    for (k = 0; k < 3 * s.n; k++)
        s.x[k] = (k % 3 == 0 ? (peri_real)-0.6 : (peri_real)0.8) * s.points[k] + (peri_real)(0.02 * s.d * uniform());
    peri_body_set_positions(s.world, s.body, 0, s.n, s.x);
    scene_run(&s, 1, 1e-5);
    CHECK(peri_world_stats(s.world).unhealthy == s.n);
    e = force_error(&s, 1e-3);
    FIGURE("restored particles of three materials: forces against differences", e);
    NEAR(e, 0, IS_DOUBLE ? 1e-8 : 6e-4);
    scene_end(&s);
}

/* Forces come in pairs, whatever the two ends are made of; torques too where forces lie along bonds. The rounding of a
   sum of n forces of rms size f, each made of about 20 bonds: 20 EPS f n at the very most. */
static void inner_forces_keep_momentum(void) {
    int mix, i, c;
    for (mix = 0; mix < MIXES; mix++) {
        static maps p;
        static peri_real f[3 * MAX];
        double sum[3] = {0, 0, 0}, torque[3] = {0, 0, 0}, size = 0;
        const peri_real *x;
        scene s;
        scene_begin(&s, 5, 4, 4, 0.1);
        mix_make(&s, &p, mix);
        scene_shake(&s, 0.15);
        x = peri_body_positions(s.world, s.body);
        peri_body_forces(s.world, s.body, f);
        for (i = 0; i < s.n; i++) {
            double a[3], b[3], t[3];
            for (c = 0; c < 3; c++) a[c] = (double)x[3 * i + c], b[c] = (double)f[3 * i + c], sum[c] += b[c];
            cross(a, b, t);
            for (c = 0; c < 3; c++) torque[c] += t[c];
            size += norm(b, 3);
        }
        printf("    %s: momentum %.3g, torque %.3g of the forces\n", mix_name[mix], norm(sum, 3) / size,
               norm(torque, 3) / (size * 0.5));
        NEAR(norm(sum, 3) / size, 0, 20 * EPS);
        if (mix != MIX_PROJECTIVE) NEAR(norm(torque, 3) / (size * 0.5), 0, 20 * EPS);
        scene_end(&s);
    }
}

/* A factor 2 or 1/2 on the stiffness is a material of twice or half the moduli: doubling is exact, so the forces differ
   by nothing but the order of sums: a body of several materials is computed particle by particle, the other in lanes (26
   terms of either sign, each rounded a few times: 16 EPS of the largest). */
static void stiffness_is_modulus(void) {
    static const int kind[4] = {M_PROJECTIVE, M_LINEAR, M_STVK, M_NEO_HOOKEAN};
    int t, i, k;
    for (t = 0; t < 4; t++) {
        static maps p;
        static peri_real f[2][3 * MAX], x[2][3 * MAX];
        double most = 0, differ = 0, moved = 0;
        int way;
        for (way = 0; way < 2; way++) {
            scene s;
            scene_begin(&s, 6, 4, 4, 0.1);
            scene_make(&s, NULL);
            for (k = 0; k < 3; k++) p.material[k] = material_of(kind[t], k == 0 ? 1e5 : k == 1 ? 2e5 : 5e4, 0.25);
            for (k = 0; k < 2; k++) p.id[k] = peri_material_create(s.world, &p.material[k + 1]);
            random_seed(7);
            for (i = 0; i < s.n; i++) {
                p.of[i] = (unsigned char)(random_bits() % 3);
                p.stiffness[i] = p.of[i] == 0 ? 1 : p.of[i] == 1 ? 2 : (peri_real)0.5;
            }
            if (way) s.body_def.stiffness = p.stiffness;
            else s.body_def.materials = p.id, s.body_def.material_count = 2, s.body_def.material_of = p.of;
            s.body = scene_body(&s, &p.material[0]);
            scene_shake(&s, 0.15);
            peri_body_forces(s.world, s.body, f[way]);
            scene_run(&s, 10, 1 / 60.0);
            memcpy(x[way], peri_body_positions(s.world, s.body), 3 * (size_t)s.n * sizeof(peri_real));
            scene_end(&s);
        }
        for (k = 0; k < 3 * 96; k++) {
            if (fabs((double)f[0][k]) > most) most = fabs((double)f[0][k]);
            if (fabs((double)(f[0][k] - f[1][k])) > differ) differ = fabs((double)(f[0][k] - f[1][k]));
            if (fabs((double)(x[0][k] - x[1][k])) > moved) moved = fabs((double)(x[0][k] - x[1][k]));
        }
        printf("    %s: forces differ by %.3g of the largest, positions after 10 steps by %.3g d\n",
               material_name[kind[t]], differ / most, moved / 0.1);
        if (!(differ / most <= 4 * EPS)) printf("    MISSED: 4 EPS, which one order of sums would give\n");
        NEAR(differ / most, 0, 16 * EPS);
        NEAR(moved / 0.1, 0, 1e4 * EPS);
    }
}

/* Strain between two slices of a bar along x, from the means of the slices' positions. */
static double bar_strain(const scene *s, int nx, int from, int to) {
    const peri_real *x = peri_body_positions(s->world, s->body);
    double a = 0, b = 0;
    int i, rows = s->n / nx;
    for (i = 0; i < rows; i++) {
        a += (double)x[3 * (i * nx + from)] / rows;
        b += (double)x[3 * (i * nx + to)] / rows;
    }
    return (b - a) / ((to - from) * s->d) - 1;
}

/* A bar of two halves in series, moduli 1 : 3, drawn by 1 % between held ends: the same force goes through both, so the
   strains are as 3 : 1. Measured a bar's width away from the ends and the joint, where their disturbance has died down
   to e^-pi = 4 % of the difference of lateral strains (none: nu = 0; in the projective model a quarter of the strains).
   Strains of 1.5 % bend the law by as much: 3 % in all. */
static void series_of_two(void) {
    static const int kind[3] = {M_PROJECTIVE, M_LINEAR, M_NEO_HOOKEAN};
    const int nx = 24;
    int t, i, way;
    for (t = 0; t < 3; t++)
        for (way = 0; way < 2; way++) {
            static maps p;
            static unsigned char fixed[MAX];
            scene s;
            double soft, hard;
            scene_begin(&s, nx, 4, 4, 0.1);
            s.world_def.tolerance = (peri_real)1e-4;
            s.world_def.max_iterations = 500;
            scene_make(&s, NULL);
            p.material[0] = material_of(kind[t], 1e5, 0);
            p.material[1] = material_of(kind[t], 3e5, 0);
            p.id[0] = peri_material_create(s.world, &p.material[1]);
            for (i = 0; i < s.n; i++) {
                p.of[i] = i % nx >= nx / 2;
                p.stiffness[i] = p.of[i] ? 3 : 1;
                fixed[i] = i % nx == 0 || i % nx == nx - 1;
            }
            s.body_def.fixed = fixed;
            s.body_def.materials = p.id;
            s.body_def.material_count = way == 0;
            if (way) s.body_def.stiffness = p.stiffness;
            else s.body_def.material_of = p.of;
            s.body = scene_body(&s, &p.material[0]);
            for (i = 0; i < s.n; i++) {
                peri_vec3 x = vec3((double)s.points[3 * i] * 1.01, (double)s.points[3 * i + 1], (double)s.points[3 * i + 2]);
                if (fixed[i]) CHECK(peri_body_move(s.world, s.body, i, x) == PERI_OK);
            }
            scene_run(&s, 30, 1);
            soft = bar_strain(&s, nx, 4, 7);
            hard = bar_strain(&s, nx, nx - 8, nx - 5);
            printf("    %s by %s: strains %.5f and %.5f, ratio %.4f\n", material_name[kind[t]],
                   way ? "stiffness" : "materials", soft, hard, soft / hard);
            NEAR(soft / hard, 3, 0.09);
            scene_end(&s);
        }
}

/* Directions given per particle are in the frame of the points: a turned body with them pulls as the body at home with
   the material's own, turned. */
static void directions_turn_with_the_body(void) {
    static maps p;
    static peri_real f[2][3 * MAX];
    peri_material m = material_of(M_ANISOTROPIC, 1e5, 0.3);
    double q[9], most = 0, differ = 0;
    int way, i, c;
    for (way = 0; way < 3; way++) {     /* 2: directions left out, so that the test sees that they matter */
        scene s;
        scene_begin(&s, 5, 4, 4, 0.1);
        if (way) {
            random_seed(5);
            s.body_def.rotation = random_quat();
        }
        quat_matrix(s.body_def.rotation, q);
        for (i = 0; i < s.n; i++)
            for (c = 0; c < 9; c++) p.direction[9 * i + c] = m.direction[c];
        if (way == 1) s.body_def.directions = p.direction;
        scene_make(&s, &m);
        random_seed(6);
        for (i = 0; i < s.n; i++) {
            double a[3], b[3];
            for (c = 0; c < 3; c++) a[c] = (double)s.points[3 * i + c] + 0.1 * s.d * uniform();
            apply(q, a, b);
            for (c = 0; c < 3; c++) s.x[3 * i + c] = (peri_real)b[c];
        }
        peri_body_set_positions(s.world, s.body, 0, s.n, s.x);
        peri_body_forces(s.world, s.body, f[way > 0]);
        for (most = differ = 0, i = 0; i < s.n && way; i++) {
            double a[3], b[3], g[3];
            for (c = 0; c < 3; c++) a[c] = (double)f[0][3 * i + c], g[c] = (double)f[1][3 * i + c];
            apply(q, a, b);
            if (norm(a, 3) > most) most = norm(a, 3);
            if (distance(b, g, 3) > differ) differ = distance(b, g, 3);
        }
        /* positions are rounded by EPS of 0.4 m on bonds of 0.1 m strained by 0.1: 4 EPS / 0.1, and the quaternion's
           entries by EPS times some, the same on all bonds */
        if (way == 1) FIGURE("directions per particle, turned: forces differ", differ / most);
        if (way == 1) NEAR(differ / most, 0, 200 * EPS);
        if (way == 2) CHECK(differ / most > 0.05);
        scene_end(&s);
    }
}

/* Each particle weighs what its material weighs. */
static void density_is_per_particle(void) {
    static maps p;
    double mass = 0;
    scene s;
    int i;
    scene_begin(&s, 5, 4, 4, 0.1);
    mix_make(&s, &p, MIX_CORRESPONDENCE);
    for (i = 0; i < s.n; i++) mass += 500 * (p.of[i] + 1) * 1e-3;
    NEAR(scene_measure(&s).mass, mass, mass * 20 * EPS);
    scene_end(&s);
}

/* What a body is made of does not end with the ids' arrays, nor cost a body that has no maps anything. */
static void maps_are_copied(void) {
    static maps p;
    scene s;
    double before;
    scene_begin(&s, 5, 4, 4, 0.1);
    mix_make(&s, &p, MIX_DIRECTIONS);
    scene_shake(&s, 0.1);
    before = scene_measure(&s).elastic;
    memset(&p, 0, sizeof p);
    NEAR(scene_measure(&s).elastic, before, 0);
    CHECK(before > 0);
    scene_end(&s);
}

static void refused(scene *s, peri_result code, const char *word) {
    const peri_error *err = peri_last_error(s->world);
    int count = peri_world_stats(s->world).bodies;
    peri_body_id id = peri_body_create(s->world, &s->body_def);
    if (id.index1 || err->code != code || !strstr(err->text, word)) {
        printf("    wanted %d with '%s', got %d: %s\n", (int)code, word, (int)err->code, err->text);
        test_bad++;
    }
    CHECK(peri_world_stats(s->world).bodies == count);
}

static void errors(void) {
    static maps p;
    peri_material other = material_of(M_PAPERS, 1e5, 0.3), third = material_of(M_NEO_HOOKEAN, 1e5, 0.3);
    peri_material_id keep[2];
    peri_body_def good;
    scene s;
    scene_begin(&s, 4, 3, 3, 0.1);
    mix_make(&s, &p, MIX_DIRECTIONS);
    good = s.body_def;
    memcpy(keep, p.id, sizeof keep);
    p.id[1].generation += 7;
    refused(&s, PERI_ERROR_ID, "materials[1]");
    p.id[1] = peri_material_create(s.world, &third);
    refused(&s, PERI_ERROR_ARGUMENT, "model");
    p.id[1] = peri_material_create(s.world, &other);
    refused(&s, PERI_ERROR_ARGUMENT, "another h");
    memcpy(p.id, keep, sizeof keep);
    p.of[5] = 3;
    refused(&s, PERI_ERROR_INDEX, "material_of[5]");
    p.of[5] = 2;
    s.body_def.materials = NULL;
    refused(&s, PERI_ERROR_ARGUMENT, "materials is NULL");
    s.body_def = good;
    s.body_def.material_count = 256;
    refused(&s, PERI_ERROR_VALUE, "material_count");
    s.body_def.material_count = -1;
    refused(&s, PERI_ERROR_VALUE, "material_count");
    s.body_def = good;
    p.stiffness[3] = 0;
    refused(&s, PERI_ERROR_VALUE, "stiffness[3]");
    p.stiffness[3] = (peri_real)2e6;
    refused(&s, PERI_ERROR_VALUE, "stiffness[3]");
    p.stiffness[3] = 1;
    p.direction[9 * 7] += (peri_real)0.1;
    refused(&s, PERI_ERROR_VALUE, "particle 7");
    s.body_def.directions = NULL;
    CHECK(peri_body_is_valid(s.world, peri_body_create(s.world, &s.body_def)));
    p.direction[9 * 7] -= (peri_real)0.1;
    s.body_def.directions = p.direction;
    s.body_def.material_of = NULL;
    s.body_def.material = keep[1];      /* the isotropic one, alone */
    refused(&s, PERI_ERROR_ARGUMENT, "anisotropic");
    scene_end(&s);
}

/* A world in a buffer has room for maps. */
static void fits_a_buffer(void) {
    static maps p;
    peri_world_def wd = peri_default_world_def();
    peri_body_def bd;
    peri_world *w;
    size_t bytes;
    void *buffer;
    scene s;
    int k;
    scene_begin(&s, 5, 4, 4, 0.1);
    mix_make(&s, &p, MIX_DIRECTIONS);
    wd.max_particles = s.n;
    wd.max_bonds = peri_world_stats(s.world).bonds;
    wd.max_bodies = 1;
    wd.max_materials = 3;
    wd.max_colliders = wd.max_skins = 1;
    wd.spare_bytes = 1 << 20;
    bytes = peri_world_size(&wd);
    buffer = malloc(bytes);
    w = peri_world_create_in(&wd, buffer, bytes, NULL);
    bd = s.body_def;
    bd.material = peri_material_create(w, &p.material[0]);
    for (k = 0; k < 2; k++) p.id[k] = peri_material_create(w, &p.material[k + 1]);
    CHECK(peri_body_is_valid(w, peri_body_create(w, &bd)));
    CHECK(peri_world_step(w, (peri_real)0.01) == PERI_OK);
    free(buffer);
    scene_end(&s);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(forces_are_derivatives);
    RUN(restored_forces_are_derivatives);
    RUN(inner_forces_keep_momentum);
    RUN(stiffness_is_modulus);
    RUN(series_of_two);
    RUN(directions_turn_with_the_body);
    RUN(density_is_per_particle);
    RUN(maps_are_copied);
    RUN(errors);
    RUN(fits_a_buffer);
    return test_end();
}
