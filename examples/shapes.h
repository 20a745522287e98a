/* shapes.h - solids for the examples, made of a few parts each: rabbit, teapot, star, ring, flower.
 *
 * Signed distances (studio_field): tapered capsules, ellipsoids and rings, joined by a smooth minimum.  One unit is
 * about the height of each; z is up, faces look along -y.  Only roots, no sines: the same bits everywhere.
 *
 * License: MIT.
 */
#ifndef SHAPES_H
#define SHAPES_H

#include "studio.h"

/* A tapered capsule from a (radius ra) to b (radius rb); a ball when a = b. */
typedef struct shapes_part {
    float a[3], ra, b[3], rb, blend;
    int twin;           /* also mirrored at x = 0 */
} shapes_part;

/* Minimum of two distances whose edge is rounded over a width of about k. */
STUDIO_API float shapes_join(float a, float b, float k) {
    float h = k > 0 ? fmaxf(k - fabsf(a - b), 0) / k : 0;
    return fminf(a, b) - 0.25f * h * h * k;
}

STUDIO_API float shapes_capsule(const float *p, const float *a, float ra, const float *b, float rb) {
    float ab[3], ap[3], t, l;
    studio_along(b, -1, a, ab);
    studio_along(p, -1, a, ap);
    l = studio_dot(ab, ab);
    t = l > 0 ? studio_clamp(studio_dot(ap, ab) / l, 0, 1) : 0;
    studio_along(ap, -t, ab, ap);
    return sqrtf(studio_dot(ap, ap)) - ra - t * (rb - ra);
}

/* About the distance to an ellipsoid with half axes r along u, v and their cross product (unit vectors). */
STUDIO_API float shapes_ellipsoid(const float *p, const float *c, const float *u, const float *v, const float *r) {
    float d[3], w[3], q[3], k0, k1;
    studio_along(p, -1, c, d);
    studio_cross(u, v, w);
    studio_set(q, studio_dot(d, u) / r[0], studio_dot(d, v) / r[1], studio_dot(d, w) / r[2]);
    k0 = sqrtf(studio_dot(q, q));
    studio_set(q, q[0] / r[0], q[1] / r[1], q[2] / r[2]);
    k1 = sqrtf(studio_dot(q, q));
    return k0 < 1e-6f ? -fminf(r[0], fminf(r[1], r[2])) : k0 * (k0 - 1) / fmaxf(k1, 1e-6f);
}

STUDIO_API float shapes_parts(const float *p, const shapes_part *part, int count) {
    float d = 1e9f, m[3];
    int i;
    studio_set(m, -p[0], p[1], p[2]);
    for (i = 0; i < count; i++) {
        const shapes_part *q = part + i;
        float e = shapes_capsule(p, q->a, q->ra, q->b, q->rb);
        if (q->twin) e = fminf(e, shapes_capsule(m, q->a, q->ra, q->b, q->rb));
        d = i ? shapes_join(d, e, q->blend) : e;
    }
    return d;
}

/* A sitting rabbit, 1 high, thick enough for 10 particles from foot to ear. */
STUDIO_API float shapes_rabbit(const float p[3], void *context) {
    static const shapes_part part[] = {
        {{0, 0.08f, 0.26f}, 0.25f, {0, -0.02f, 0.38f}, 0.20f, 0, 0},               /* body */
        {{0, -0.12f, 0.58f}, 0.165f, {0, -0.17f, 0.57f}, 0.155f, 0.08f, 0},        /* head */
        {{0.035f, -0.29f, 0.53f}, 0.075f, {0.035f, -0.29f, 0.53f}, 0.075f, 0.06f, 1}, /* snout */
        {{0.075f, -0.06f, 0.70f}, 0.062f, {0.13f, 0.03f, 0.93f}, 0.070f, 0.05f, 1},   /* ears */
        {{0.17f, 0.06f, 0.17f}, 0.16f, {0.19f, 0.02f, 0.14f}, 0.14f, 0.05f, 1},    /* thighs */
        {{0.17f, -0.04f, 0.065f}, 0.075f, {0.17f, -0.22f, 0.065f}, 0.075f, 0.04f, 1}, /* hind feet */
        {{0.09f, -0.17f, 0.34f}, 0.075f, {0.08f, -0.26f, 0.20f}, 0.070f, 0.05f, 1},   /* fore feet */
        {{0, 0.36f, 0.20f}, 0.10f, {0, 0.36f, 0.20f}, 0.10f, 0.04f, 0}};           /* tail */
    (void)context;
    return shapes_parts(p, part, (int)(sizeof part / sizeof part[0]));
}

/* A teapot, full of tea: 0.75 high, 1.3 long, spout along +x. */
STUDIO_API float shapes_teapot(const float p[3], void *context) {
    static const float centre[3] = {0, 0, 0.30f}, u[3] = {1, 0, 0}, v[3] = {0, 1, 0}, half[3] = {0.40f, 0.40f, 0.30f};
    static const shapes_part spout[] = {
        {{0.26f, 0, 0.22f}, 0.13f, {0.46f, 0, 0.30f}, 0.095f, 0, 0},
        {{0.46f, 0, 0.30f}, 0.095f, {0.56f, 0, 0.44f}, 0.078f, 0.05f, 0},
        {{0.56f, 0, 0.44f}, 0.078f, {0.67f, 0, 0.54f}, 0.072f, 0.04f, 0}};
    static const shapes_part lid[] = {{{0, 0, 0.62f}, 0.045f, {0, 0, 0.66f}, 0.085f, 0, 0}};
    static const shapes_part foot[] = {{{0, 0, 0.07f}, 0.07f, {0, 0, 0.07f}, 0.07f, 0, 0}};
    float d = shapes_ellipsoid(p, centre, u, v, half), q[3], ring, r;
    (void)context;
    (void)foot;
    d = fmaxf(d, 0.035f - p[2]);                                    /* a flat bottom */
    r = sqrtf(p[0] * p[0] + p[1] * p[1]);
    d = shapes_join(d, sqrtf((r - 0.235f) * (r - 0.235f) + (p[2] - 0.55f) * (p[2] - 0.55f)) - 0.035f, 0.03f); /* rim */
    d = shapes_join(d, shapes_parts(p, spout, 3), 0.06f);
    d = shapes_join(d, shapes_parts(p, lid, 1), 0.03f);
    studio_set(q, p[0] + 0.37f, p[1], p[2] - 0.34f);                /* handle: a ring standing at the back */
    r = sqrtf(q[0] * q[0] + 1.1f * q[2] * q[2]) - 0.185f;
    ring = sqrtf(r * r + q[1] * q[1]) - 0.070f;
    return shapes_join(d, fmaxf(ring, p[0] + 0.22f), 0.04f);
}

/* A star with five points, thick and rounded, upright in the plane x z, 1 high. */
STUDIO_API float shapes_star(const float p[3], void *context) {
    /* the points are 72 degrees apart; outer radius 0.5, inner 0.25 */
    static const float tip[5][2] = {{0, 1}, {0.95105652f, 0.30901699f}, {0.58778525f, -0.80901699f},
                                    {-0.58778525f, -0.80901699f}, {-0.95105652f, 0.30901699f}};
    float d = 1e9f, centre[3];
    int k;
    (void)context;
    studio_set(centre, 0, 0, 0.5f);
    for (k = 0; k < 5; k++) {
        float end[3], e;
        studio_set(end, 0.40f * tip[k][0], 0, 0.5f + 0.40f * tip[k][1]);
        e = shapes_capsule(p, centre, 0.21f, end, 0.095f);
        d = k ? shapes_join(d, e, 0.08f) : e;
    }
    return d;
}

/* A ring lying in the plane x y, 1 across. */
STUDIO_API float shapes_ring(const float p[3], void *context) {
    float r = sqrtf(p[0] * p[0] + p[1] * p[1]) - 0.34f, z = p[2] - 0.16f;
    (void)context;
    return sqrtf(r * r + z * z) - 0.16f;
}

STUDIO_API float shapes_ball(const float p[3], void *context) {
    (void)context;
    return sqrtf(p[0] * p[0] + p[1] * p[1] + (p[2] - 0.5f) * (p[2] - 0.5f)) - 0.5f;
}

/* ---- a flower, 1.1 high: parts by number, for their stiffness and colour */

enum { SHAPES_STEM, SHAPES_LEAF, SHAPES_PETAL, SHAPES_HEART, SHAPES_PARTS };

/* Distances to the four kinds of part. */
STUDIO_API void shapes_flower_parts(const float p[3], float out[SHAPES_PARTS]) {
    static const shapes_part stem[] = {
        {{0, 0, -0.02f}, 0.050f, {0.025f, 0, 0.22f}, 0.046f, 0, 0},
        {{0.025f, 0, 0.22f}, 0.046f, {0.025f, 0, 0.45f}, 0.042f, 0.02f, 0},
        {{0.025f, 0, 0.45f}, 0.042f, {0, 0, 0.66f}, 0.040f, 0.02f, 0},
        {{0, 0, 0.66f}, 0.040f, {-0.03f, -0.03f, 0.84f}, 0.042f, 0.02f, 0}};
    /* leaves: from the stem outwards and up, flat */
    static const float root[2][3] = {{0.025f, 0, 0.26f}, {0.02f, 0, 0.36f}};
    static const float along[2][3] = {{0.80f, 0, 0.60f}, {-0.78f, 0.1959592f, 0.5942925f}};
    /* the blossom looks forward and up */
    static const float face[3] = {-0.10f, -0.82f, 0.56355f}, middle[3] = {-0.035f, -0.075f, 0.88f};
    static const float tip[6][2] = {{1, 0}, {0.5f, 0.8660254f}, {-0.5f, 0.8660254f},
                                    {-1, 0}, {-0.5f, -0.8660254f}, {0.5f, -0.8660254f}};
    float d, a[3], b[3], n[3], c[3], r[3], side[3];
    int k;
    out[SHAPES_STEM] = shapes_parts(p, stem, 4);
    out[SHAPES_LEAF] = 1e9f;
    studio_set(side, 0, 1, 0);
    for (k = 0; k < 2; k++) {
        memcpy(a, along[k], sizeof a);
        studio_unit(a);
        studio_cross(a, side, n);
        studio_unit(n);
        studio_cross(n, a, b);
        studio_along(root[k], 0.19f, a, c);
        studio_set(r, 0.215f, 0.085f, 0.036f);
        d = shapes_ellipsoid(p, c, a, b, r);
        out[SHAPES_LEAF] = fminf(out[SHAPES_LEAF], d);
    }
    memcpy(n, face, sizeof n);
    studio_unit(n);
    studio_set(side, 1, 0, 0);
    studio_cross(n, side, b);
    studio_unit(b);
    studio_cross(b, n, side);
    out[SHAPES_PETAL] = 1e9f;
    for (k = 0; k < 6; k++) {
        float across[3], out_dir[3];
        int c3;
        for (c3 = 0; c3 < 3; c3++) {
            out_dir[c3] = tip[k][0] * side[c3] + tip[k][1] * b[c3];
            across[c3] = -tip[k][1] * side[c3] + tip[k][0] * b[c3];
        }
        studio_along(out_dir, 0.22f, n, a);     /* petals lean forward a little */
        studio_unit(a);
        studio_along(middle, 0.165f, a, c);
        studio_set(r, 0.155f, 0.088f, 0.036f);
        d = shapes_ellipsoid(p, c, a, across, r);
        out[SHAPES_PETAL] = fminf(out[SHAPES_PETAL], d);
    }
    studio_along(middle, 0.015f, n, c);
    studio_set(r, 0.085f, 0.085f, 0.06f);
    out[SHAPES_HEART] = shapes_ellipsoid(p, c, side, b, r);
}

STUDIO_API float shapes_flower(const float p[3], void *context) {
    float d[SHAPES_PARTS];
    (void)context;
    shapes_flower_parts(p, d);
    return shapes_join(shapes_join(d[SHAPES_STEM], d[SHAPES_LEAF], 0.03f),
                       shapes_join(d[SHAPES_PETAL], d[SHAPES_HEART], 0.015f), 0.03f);
}

#endif /* SHAPES_H */
