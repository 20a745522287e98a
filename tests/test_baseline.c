/* test_baseline.c - the methods of tests/baseline where each of them ought to be right. */
#define PERI_DOUBLE
#define PERI_STATIC
#define PERI_IMPLEMENTATION
#include "baseline/baseline.h"

#include "test.h"

static baseline_def definition(baseline_method method, int across, double length) {
    baseline_def d;
    memset(&d, 0, sizeof d);
    d.method = method;
    d.spacing = 0.2 / across;
    d.size[0] = length;
    d.size[1] = d.size[2] = 0.2;
    d.young = 1e5;
    d.poisson = 0.25;
    d.density = 1000;
    return d;
}

static void falls_freely(void) {
    int m;
    for (m = 0; m < BASELINE_METHODS; m++) {
        baseline_def d = definition((baseline_method)m, 2, 0.4);
        double h = 1e-3;
        baseline *b;
        int s, i;
        d.gravity[2] = -9.81;
        if (!(b = baseline_create(&d))) continue;
        for (s = 0; s < 10; s++) CHECK(baseline_step(b, h) == 0);
        for (i = 0; i < b->count; i++) NEAR(b->x[3 * i + 2] - b->rest[3 * i + 2], -9.81 * h * h * 55, 1e-12);
        baseline_destroy(b);
    }
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(falls_freely);
    return test_end();
}
