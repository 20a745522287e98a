/* poisson.c - heat goes from a chip through a heat sink into the air; then its base cracks.
 *
 * Shows peri_solver.h by itself, without particles: a matrix from triplets, analysed once, factorised, solved;
 * values of a few rows changed and the factor updated; refinement in double over a factor in float.  The same
 * five-point scheme is checked on the unit square, -lap u = 1 and u = 0 on the border, against the series:
 * u = 0.0736713533 in the middle.
 *
 *     cc -O2 examples/poisson.c -lm -o poisson && ./poisson
 *
 * Writes to --out: poisson.png.
 */
#include "studio.h"

#define PERI_IMPLEMENTATION
#include "../peri_solver.h"

static const studio_app app = {"poisson", "heat in a heat sink, by the sparse solver alone",
                               "  --cells N      cells along each side (240)\n", 1};

static const double copper = 400, air = 0.6 /* W/m/K, moving a little */, power = 1000 /* W per m depth */;

enum { AIR, COPPER, CHIP };

typedef struct plate {
    int cells, count;           /* along a side; of triplets */
    int *what;                  /* of a cell */
    int *i, *j;
    peri_real *value;
    double *heat, *rise;        /* W per m; K */
    double largest, out, ms[4]; /* analyse, factor, solve, update */
    double residual;
    int refinements;
    size_t entries;
    peri_sparse *a;
    peri_cholesky *f;
} plate;

static double milliseconds(void) { return 1e3 * (double)clock() / CLOCKS_PER_SEC; }

/* What stands in the middle of a cell: base and fins, a chip under them. x, y in shares of the side. */
static int matter(double x, double y) {
    double fin = fmod(x - 0.2, 0.1);
    if (x > 0.4 && x < 0.6 && y > 0.16 && y < 0.2) return CHIP;
    if (x < 0.2 || x > 0.84 || y < 0.2 || y > 0.78) return AIR;
    return y < 0.28 || fin < 0.04 ? COPPER : AIR;
}

static void put(plate *p, int i, int j, double value) {
    p->i[p->count] = i;
    p->j[p->count] = j;
    p->value[p->count++] = (peri_real)value;
}

/* Five points: what flows between two cells is the harmonic mean of their conductivities times the difference; the
   border is kept at the temperature of the room. The first call says where entries stand, the next what they are. */
static void assemble(plate *p) {
    static const int step[4][2] = {{1, 0}, {0, 1}, {-1, 0}, {0, -1}};
    int x, y, d, n = p->cells;
    p->count = 0;
    for (y = 0; y < n; y++)
        for (x = 0; x < n; x++) {
            int cell = y * n + x;
            double own = p->what[cell] == AIR ? air : copper, sum = 0;
            for (d = 0; d < 4; d++) {
                int u = x + step[d][0], v = y + step[d][1], inside = u >= 0 && v >= 0 && u < n && v < n;
                double other = inside && p->what[v * n + u] != AIR ? copper : air;
                double flow = inside ? 2 * own * other / (own + other) : 2 * own;
                sum += flow;
                if (inside && d >= 2) put(p, cell, v * n + u, -flow); /* the lower triangle */
            }
            put(p, cell, cell, sum);
        }
}

static int create(plate *p) {
    size_t n = (size_t)p->cells * (size_t)p->cells, k;
    double chips = 0;
    peri_error err;
    p->what = (int *)studio_alloc(n, sizeof *p->what);
    p->i = (int *)studio_alloc(3 * n, sizeof *p->i);
    p->j = (int *)studio_alloc(3 * n, sizeof *p->j);
    p->value = (peri_real *)studio_alloc(3 * n, sizeof *p->value);
    p->heat = (double *)studio_alloc(n, sizeof *p->heat);
    p->rise = (double *)studio_alloc(n, sizeof *p->rise);
    if (!p->what || !p->i || !p->j || !p->value || !p->heat || !p->rise) return -1;
    for (k = 0; k < n; k++) {
        int x = (int)(k % (size_t)p->cells), y = (int)(k / (size_t)p->cells);
        p->what[k] = matter((x + 0.5) / p->cells, (y + 0.5) / p->cells);
        chips += p->what[k] == CHIP;
    }
    for (k = 0; k < n; k++) p->heat[k] = p->what[k] == CHIP ? power / chips : 0;
    assemble(p);
    if (peri_sparse_from_triplets((int)n, p->count, p->i, p->j, PERI_TRIANGLE_LOWER, NULL, &p->a, &err) ||
        peri_sparse_set(p->a, p->value, &err))
        return studio_error("%s", err.text);
    p->ms[0] = milliseconds();
    if (peri_cholesky_create(peri_sparse_matrix(p->a), NULL, NULL, &p->f, &err)) return studio_error("%s", err.text);
    p->ms[1] = milliseconds();
    p->ms[0] = p->ms[1] - p->ms[0];
    if (peri_cholesky_factor(p->f, peri_sparse_matrix(p->a), &err)) return studio_error("%s", err.text);
    p->ms[1] = milliseconds() - p->ms[1];
    p->entries = peri_cholesky_entries(p->f);
    return 0;
}

/* Solves from zero and refines until the residual is small: copper conducts 700 times what air does, which costs a
   float factor digits. Then the largest rise, and what flows out at the border. */
static int solve(plate *p) {
    int n = p->cells, k;
    peri_real *work = (peri_real *)studio_alloc(3 * (size_t)n * (size_t)n, sizeof *work);
    double begin = milliseconds();
    if (!work) return -1;
    memset(p->rise, 0, (size_t)n * (size_t)n * sizeof *p->rise);
    for (p->residual = 1, p->refinements = -1; p->residual > 1e-9 && p->refinements < 30; p->refinements++)
        p->residual = peri_cholesky_refine(p->f, peri_sparse_matrix(p->a), 1, p->heat, p->rise, work);
    p->ms[2] = milliseconds() - begin;
    free(work);
    for (p->largest = p->out = 0, k = 0; k < n * n; k++) {
        int sides = (k % n == 0) + (k % n == n - 1) + (k / n == 0) + (k / n == n - 1);
        p->largest = fmax(p->largest, p->rise[k]);
        p->out += sides * 2 * (p->what[k] == AIR ? air : copper) * p->rise[k];
    }
    return 0;
}

/* A crack through the base parts the two fins on the left from the chip. Only the rows of its cells change. */
static int crack(plate *p) {
    int n = p->cells, k, count = 0, bad, *rows = (int *)studio_alloc((size_t)n * (size_t)n, sizeof *rows);
    peri_error err;
    if (!rows) return -1;
    for (k = 0; k < n * n; k++) {
        double x = (k % n + 0.5) / n, y = (k - k % n + 0.5 * n) / n / n;
        if (p->what[k] != COPPER || x < 0.36 || x > 0.375 || y > 0.28) continue;
        p->what[k] = AIR;
        rows[count++] = k;
    }
    assemble(p);
    bad = peri_sparse_set(p->a, p->value, &err);
    p->ms[3] = milliseconds();
    bad = bad || peri_cholesky_update(p->f, peri_sparse_matrix(p->a), count, rows, &err);
    p->ms[3] = milliseconds() - p->ms[3];
    free(rows);
    return bad ? studio_error("%s", err.text) : 0;
}

static void paint(const plate *p, studio_image *im, int left, double hottest, const char *caption) {
    static const float ink[3] = {0.12f, 0.13f, 0.16f}, edge[3] = {1, 1, 1};
    int size = 360, x, y, n = p->cells;
    for (y = 0; y < size; y++)
        for (x = 0; x < size; x++) {
            int cx = x * n / size, cy = (size - 1 - y) * n / size, cell = cy * n + cx;
            int border = cx + 1 < n && cy + 1 < n &&
                         (p->what[cell] != p->what[cell + 1] || p->what[cell] != p->what[cell + n]);
            float rgb[3];
            studio_colormap((float)(p->rise[cell] / hottest), rgb);
            studio_blend(im, left + x, 40 + y, rgb, 1);
            if (border) studio_blend(im, left + x, 40 + y, edge, 0.6f);
        }
    studio_text(im, (float)left, 26, 14, ink, caption);
}

/* u in the middle of the unit square, n - 1 inner points along a side. */
static double middle(int n) {
    int m = n - 1, x, y, count = 0, *i = (int *)studio_alloc((size_t)(3 * m * m), sizeof *i);
    int *j = (int *)studio_alloc((size_t)(3 * m * m), sizeof *j);
    peri_real *value = (peri_real *)studio_alloc((size_t)(6 * m * m), sizeof *value), *work = value + 3 * m * m;
    double *b = (double *)studio_alloc((size_t)(2 * m * m), sizeof *b), *u = b + m * m, answer = 0;
    peri_sparse *a = NULL;
    peri_cholesky *f = NULL;
    for (y = 0; y < m; y++)
        for (x = 0; x < m; x++) {
            int d;
            for (d = 0; d < 3; d++) { /* itself, left, below */
                if ((d == 1 && x == 0) || (d == 2 && y == 0)) continue;
                i[count] = y * m + x;
                j[count] = y * m + x - (d == 1) - m * (d == 2);
                value[count++] = d == 0 ? 4 : -1;
            }
            b[y * m + x] = 1.0 / n / n;
        }
    if (!peri_sparse_from_triplets(m * m, count, i, j, PERI_TRIANGLE_LOWER, NULL, &a, NULL) &&
        !peri_sparse_set(a, value, NULL) && !peri_cholesky_create(peri_sparse_matrix(a), NULL, NULL, &f, NULL) &&
        !peri_cholesky_factor(f, peri_sparse_matrix(a), NULL)) {
        for (x = 0; x < 3; x++) peri_cholesky_refine(f, peri_sparse_matrix(a), 1, b, u, work);
        answer = u[m * m / 2];
    }
    peri_cholesky_destroy(f);
    peri_sparse_destroy(a);
    free(i);
    free(j);
    free(value);
    free(b);
    return answer;
}

static int draw(plate *p, studio_options *o) {
    char path[STUDIO_PATH], text[100];
    studio_image im;
    double hottest = p->largest * 1.25;
    int bad;
    if (studio_image_make(&im, 860, 430)) return -1;
    studio_image_fill(&im, 1, 1, 1);
    snprintf(text, sizeof text, "chip %.1f K above the room", p->largest);
    paint(p, &im, 20, hottest, text);
    bad = crack(p) || solve(p);
    snprintf(text, sizeof text, "the base has cracked: %.1f K", p->largest);
    paint(p, &im, 400, hottest, text);
    studio_colorbar(&im, 780, 50, 16, 330, 0, hottest, "K");
    snprintf(path, sizeof path, "%s/poisson.png", o->out);
    if (!o->check) bad |= studio_png(path, &im);
    studio_image_free(&im);
    return bad;
}

int main(int argc, char **argv) {
    static plate p;
    studio_options o;
    const double exact = 0.0736713533;
    double whole, coarse, fine;
    int bad;
    if (studio_begin(&app, argc, argv, &o)) return studio_exit_code();
    p.cells = (int)studio_number("--cells", o.check ? 80 : 240);
    if (p.cells < 20 || p.cells > 2000) return studio_error("--cells is %d; take 20 to 2000", p.cells), 2;
    bad = create(&p) || solve(&p);
    whole = p.largest;
    if (!bad)
        printf("%d unknowns, %lu entries of L: analysed in %.1f ms, factorised in %.1f, solved and "
               "refined %d times in %.1f\n", p.cells * p.cells, (unsigned long)p.entries, p.ms[0], p.ms[1],
               p.refinements, p.ms[2]);
    bad = bad || draw(&p, &o);
    coarse = fabs(middle(32) - exact);
    fine = fabs(middle(64) - exact);
    if (!bad) {
        printf("a crack: factor updated in %.1f ms\n", p.ms[3]);
        studio_check("heat that leaves over heat that enters", p.out / power, "", 0.99, 1.01);
        studio_check("chip with the crack over without", p.largest / whole, "", 1.02, 2);
        studio_check("residual", p.residual, "", 0, 1e-9);
        studio_check("unit square: middle, error at 1/64", fine, "", 0, 2e-5);
        studio_check("unit square: error falls with the spacing's power", log(coarse / fine) / log(2.0), "", 1.9, 2.1);
    }
    peri_cholesky_destroy(p.f);
    peri_sparse_destroy(p.a);
    free(p.what);
    free(p.i);
    free(p.j);
    free(p.value);
    free(p.heat);
    free(p.rise);
    return bad ? 1 : studio_end(&o);
}
