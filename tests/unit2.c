/* tests/unit2.c - a second translation unit: includes the header without its implementation, which is in test_headers.c */
#include "../peri.h"
#include "../peri.h" /* twice is fine */

int unit2_counts(const peri_shape *shape, peri_real spacing);
size_t unit2_world_bytes(void);
const char *unit2_version(void);
uint64_t unit2_falls(int steps);

int unit2_counts(const peri_shape *shape, peri_real spacing) {
    int count = 0;
    return peri_sample(shape, spacing, NULL, 0, &count, NULL) == PERI_OK ? count : -1;
}

/* The size of what both units must see alike. */
size_t unit2_world_bytes(void) {
    return sizeof(peri_world_def) + sizeof(peri_body_def) + sizeof(peri_material) + sizeof(peri_stats) +
           sizeof(peri_real);
}

const char *unit2_version(void) { return PERI_VERSION; }

uint64_t unit2_falls(int steps) {
    peri_world_def wd = peri_default_world_def();
    peri_world *world = peri_world_create(&wd, NULL);
    peri_material rubber = peri_material_neo_hookean((peri_real)1e5, (peri_real)0.3, 1000);
    peri_body_def bd = peri_default_body_def();
    peri_real points[3 * 27];
    uint64_t hash;
    int i;
    for (i = 0; i < 27; i++) {
        points[3 * i] = (peri_real)(0.1 * (i % 3));
        points[3 * i + 1] = (peri_real)(0.1 * (i / 3 % 3));
        points[3 * i + 2] = (peri_real)(0.1 * (i / 9));
    }
    bd.points = points;
    bd.count = 27;
    bd.spacing = (peri_real)0.1;
    bd.material = peri_material_create(world, &rubber);
    peri_body_create(world, &bd);
    for (i = 0; i < steps; i++) peri_world_step(world, (peri_real)(1.0 / 30));
    hash = peri_world_hash(world);
    peri_world_destroy(world);
    return hash;
}
