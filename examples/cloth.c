/* cloth.c - sheets: bending that a material's share, or horizon and kernel, decide; an anisotropic trampoline.
 *
 * Answers PP figure 5 (cloth with growing resistance to bending), SH figure 9 (horizon and kernel) and SH figure 6 (an
 * anisotropic sheet); PP = Peng et al., "Projective Peridynamics", SH = Xu et al. 2018, "Reformulating Hyperelastic
 * Materials with Peridynamic Modeling".  Shows peri_default_sheet_def, contact of a sheet with a solid, and material
 * directions.
 *
 *     cc -O2 examples/cloth.c -lm -o cloth && ./cloth
 *
 * Writes to --out: cloth_bending.png, cloth_horizon.png, cloth_trampoline.png, cloth.csv.
 */
#include "studio.h"

#define PERI_IMPLEMENTATION
#include "../peri.h"
#include "studio_peri.h"

static const float dt = 1.0f / 60;

static const studio_app app = {"cloth", "three scenes of sheets: bending share, horizon and kernel, trampoline", "",
                               180};

typedef struct cloth {
    studio_options options;
    studio_stand stand;
    int n;              /* points across */
    double droop[6];    /* of each cloth: how far its free edge hangs at rest, m */
    double wrong;       /* particles on the wrong side, largest number */
    double sag[2];      /* of the trampoline along and across its strong direction */
    double settled;     /* kinetic energy at the end, J */
    FILE *csv;
} cloth;

static peri_world *make_world(const cloth *s) {
    peri_world_def def = peri_default_world_def();
    peri_error err;
    peri_world *w;
    def.parallel.threads = s->options.threads;
    w = peri_world_create(&def, &err);
    if (!w) studio_error("%s", err.text);
    return w;
}

/* A square cloth of n x n points, 1 m wide, at x, y, z; fixed: one for each point. */
static peri_body_id add_cloth(cloth *s, peri_body_def d, peri_material m, const unsigned char *fixed) {
    peri_body_id none = {0, 0}, id;
    peri_real *points = (peri_real *)studio_alloc(3 * (size_t)(s->n * s->n), sizeof *points);
    int count = 0;
    peri_error err;
    if (!points) return none;
    if (peri_sample_rectangle(1, 1, (peri_real)(1.0 / s->n), points, s->n * s->n, &count, &err))
        return studio_error("%s", err.text), none;
    d.points = points;
    d.count = count;
    d.spacing = (peri_real)(1.0 / s->n);
    d.fixed = fixed;
    d.material = peri_material_create(s->stand.world, &m);
    id = peri_body_create(s->stand.world, &d);
    free(points);
    if (!id.index1) studio_failed(s->stand.world);
    return id;
}

/* ---- cloths that hang over an edge: one side is held, the other falls ---- */

/* How far the free edge hangs below the held one, m: the mean over its points. */
static double droop(const cloth *s, peri_body_id id) {
    const peri_real *x = peri_body_positions(s->stand.world, id);
    double sum = 0;
    int j;
    for (j = 0; j < s->n; j++) sum -= (double)x[3 * (j * s->n + s->n - 1) + 2] / s->n;
    return sum;
}

/* Three cloths side by side whose left edges are held; `which` 0: PP 5, the bending share of the projective model; 1:
 * SH 9, horizon and kernel of the stretch model, and beside them a plate in physical units. */
static int hang(cloth *s, int which) {
    static const float share[3] = {0.02f, 0.2f, 0.9f};
    static const float tint[3][3] = {{0.85f, 0.35f, 0.3f}, {0.3f, 0.62f, 0.42f}, {0.3f, 0.45f, 0.8f}};
    unsigned char *fixed;
    peri_body_id id[3];
    studio_actor *a;
    int k, i, bad = 0, steps = s->options.frames, n = s->n;
    char text[96];
    if (which) s->n = 21;   /* four spacings must be something against what bends */
    fixed = (unsigned char *)studio_alloc((size_t)(s->n * s->n), 1);
    if (!fixed) return -1;
    studio_stand_begin(&s->stand, make_world(s), 2);
    for (i = 0; i < s->n * s->n; i++) fixed[i] = i % s->n < 2;
    for (k = 0; k < 3 && !bad; k++) {
        peri_body_def d = peri_default_sheet_def((peri_real)(which && k == 2 ? 0.01 : 0.004));
        peri_material m = peri_material_linear((peri_real)8e6, (peri_real)0.25, 300);
        d.position.y = (peri_real)(1.25 * (k - 1));
        d.touches = 0;
        d.bending = 0;
        if (!which) m = peri_material_projective((peri_real)2e5, share[k], 300);
        else if (k == 0) d.horizon = 2, d.kernel = PERI_KERNEL_SHIFTED;
        else if (k == 1) d.horizon = 4, d.kernel = PERI_KERNEL_POWER, d.kernel_power = -1;   /* |xi|/delta */
        else d.bending = 1;
        id[k] = add_cloth(s, d, m, fixed);
        bad = !id[k].index1;
        if (bad) break;
        a = studio_stand_add(&s->stand, id[k], 0, tint[k][0], tint[k][1], tint[k][2]);
        a->nx = a->ny = s->n;
    }
    studio_set(s->stand.target, 0.05f, 0, -0.35f);
    s->stand.distance = 7.2f;
    s->stand.turn = 28;
    s->stand.rise = 16;
    s->stand.floor = -1.15f;
    s->stand.stage = 2.2f;
    for (i = 1; i <= steps && !bad; i++) {
        bad = studio_stand_step(&s->stand, dt);
        studio_progress(&s->options, i, steps, which ? "horizon and kernel" : "bending share");
        if (s->options.check || bad || (i != steps / 8 && i != steps)) continue;
        snprintf(text, sizeof text, which ? "%.1f s: 2 d; 4 d; plate of 10 mm" : "%.1f s: bending share 0.02, 0.2, 0.9",
                 (double)((float)i * dt));
        bad = studio_stand_moment(&s->stand, 2, text);
    }
    for (i = 0; i < 40 && !bad; i++)
        bad = studio_stand_step(&s->stand, 0.5f); /* long steps: what swings comes to rest */
    for (k = 0; k < 3 && !bad; k++) {
        s->droop[3 * which + k] = droop(s, id[k]);
        if (s->csv) fprintf(s->csv, "%s,%d,%.5f\n", which ? "horizon" : "share", k, s->droop[3 * which + k]);
    }
    bad |= studio_stand_end(&s->stand, &s->options, which ? "cloth_horizon.png" : "cloth_bending.png");
    peri_world_destroy(s->stand.world);
    free(fixed);
    s->n = n;
    return bad;
}

/* ---- trampoline ---- */

/* A ball on a sheet with a fixed border that is nine times as stiff along one diagonal as across it. */
static int trampoline(cloth *s) {
    unsigned char *fixed = (unsigned char *)studio_alloc((size_t)(s->n * s->n), 1);
    peri_body_def d = peri_default_sheet_def((peri_real)0.004), b = peri_default_body_def();
    peri_material m = peri_material_linear((peri_real)4e5, (peri_real)0.25, 300), rubber;
    peri_body_id sheet, ball;
    peri_shape shape = peri_shape_ball((peri_real)0.13);
    peri_measure measure;
    studio_actor *a;
    const peri_real *x, *y;
    const double root = 0.70710678118654752;
    int i, k, bad, steps = s->options.frames;
    char text[64];
    if (!fixed) return -1;
    studio_stand_begin(&s->stand, make_world(s), 2);
    for (i = 0; i < s->n * s->n; i++)
        fixed[i] = i % s->n == 0 || i % s->n == s->n - 1 || i / s->n == 0 || i / s->n == s->n - 1;
    m.anisotropic = 1;
    m.strength[0] = 3;
    m.strength[1] = (peri_real)(1 / 3.0);
    m.strength[2] = 1;
    m.direction[0] = m.direction[3] = m.direction[4] = (peri_real)root;    /* columns: along and across the diagonal */
    m.direction[1] = (peri_real)-root;
    m.direction[8] = 1;
    sheet = add_cloth(s, d, m, fixed);
    rubber = peri_material_neo_hookean((peri_real)2e5, (peri_real)0.4, 1000);
    b.material = peri_material_create(s->stand.world, &rubber);
    b.spacing = (peri_real)0.035;
    b.position.z = (peri_real)0.45;
    ball = studio_body(s->stand.world, &shape, &b);
    bad = !sheet.index1 || !ball.index1;
    if (!bad) {
        a = studio_stand_add(&s->stand, sheet, 0, 0.35f, 0.5f, 0.75f);
        a->nx = a->ny = s->n;
        studio_stand_add(&s->stand, ball, 0.022f, 0.9f, 0.55f, 0.2f);
    }
    studio_set(s->stand.target, 0, 0, 0);
    s->stand.distance = 4;
    s->stand.turn = 20;
    s->stand.rise = 35;
    s->stand.floor = -0.6f;
    for (i = 1; i <= steps && !bad; i++) {
        int below = 0;
        bad = studio_stand_step(&s->stand, dt);
        studio_progress(&s->options, i, steps, "trampoline");
        x = peri_body_positions(s->stand.world, sheet);
        y = peri_body_positions(s->stand.world, ball);
        for (k = 0; k < peri_body_count(s->stand.world, ball); k++) {     /* below the cell that it is over */
            int cx = (int)(((double)y[3 * k] + 0.5) * s->n), cy = (int)(((double)y[3 * k + 1] + 0.5) * s->n);
            if (cx >= 0 && cy >= 0 && cx < s->n && cy < s->n) below += y[3 * k + 2] < x[3 * (cy * s->n + cx) + 2];
        }
        if (below > s->wrong) s->wrong = below;
        if (s->options.check || bad || (i != steps / 6 && i != steps)) continue;
        snprintf(text, sizeof text, "%.2f s", (double)((float)i * dt));
        bad = studio_stand_moment(&s->stand, 2, text);
    }
    if (!bad) {     /* how far it hangs a quarter of the diagonal from the middle, along and across */
        int q = s->n / 4;
        x = peri_body_positions(s->stand.world, sheet);
        s->sag[0] = -(double)(x[3 * (q * s->n + q) + 2] + x[3 * ((s->n - 1 - q) * s->n + s->n - 1 - q) + 2]) / 2;
        s->sag[1] = -(double)(x[3 * (q * s->n + s->n - 1 - q) + 2] + x[3 * ((s->n - 1 - q) * s->n + q) + 2]) / 2;
        memset(&measure, 0, sizeof measure);
        peri_body_measure(s->stand.world, ball, &measure);
        s->settled = measure.kinetic;
    }
    bad |= studio_stand_end(&s->stand, &s->options, "cloth_trampoline.png");
    peri_world_destroy(s->stand.world);
    free(fixed);
    return bad;
}

static void check(const cloth *s) {
    studio_check("PP 5: share 0.02 hangs lower than 0.2 by", s->droop[0] - s->droop[1], "m", 0, 1);
    studio_check("PP 5: share 0.2 hangs lower than 0.9 by", s->droop[1] - s->droop[2], "m", 0, 1);
    studio_check("SH 9: horizon 2 d hangs lower than 4 d by", s->droop[3] - s->droop[4], "m", 0, 1);
    studio_check("longest cloth hangs", s->droop[0], "of its length", 0.3, 1.3);
    studio_check("trampoline: particles of the ball below the sheet", s->wrong, "", 0, 0);
    studio_check("trampoline: largest overlap", s->stand.overlap, "spacings", 0, 0.5);
    /* strong fibres carry the load to the border, and the sag with it */
    studio_check("trampoline: sag along the strong diagonal over that across", s->sag[0] / s->sag[1], "", 1.02, 5);
}

int main(int argc, char **argv) {
    static cloth s;
    int bad;
    if (studio_begin(&app, argc, argv, &s.options)) return studio_exit_code();
    s.n = s.options.check ? 21 : 41;
    if (!s.options.check) s.csv = studio_csv(s.options.out, "cloth.csv", "scene,cloth,droop_m");
    bad = hang(&s, 0) || hang(&s, 1) || trampoline(&s);
    if (s.csv) fclose(s.csv);
    if (!bad) check(&s);
    return bad ? 1 : studio_end(&s.options);
}
