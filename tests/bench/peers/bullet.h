/* tests/bench/peers/bullet.h - Bullet as a peer: its soft bodies on the swing of a cantilever and the drop of a cube. The
   C side of bullet.cpp. */
#ifndef PERI_BENCH_BULLET_H
#define PERI_BENCH_BULLET_H

#ifdef __cplusplus
extern "C" {
#endif

enum {
    BULLET_NEO_HOOKEAN, /* btDeformableMultiBodyDynamicsWorld, btDeformableNeoHookeanForce, implicit */
    BULLET_COROTATED,   /* the same, btDeformableLinearElasticityForce */
    BULLET_LINKS,       /* btSoftRigidDynamicsWorld: links between nodes, `iterations` sweeps; knows no Pa */
    BULLET_METHODS
};

typedef struct bullet_scene {
    int method, across;     /* cells over 0.2 m */
    int search;             /* deformable: 1 Newton with line search, 0 one linear solve a step (Bullet's default) */
    int iterations;         /* of links: position iterations; Bullet's default is 1 */
    double young, poisson, density, gravity, step, duration; /* Pa, 1, kg/m^3, m/s^2, s, s */
    double patience;        /* ms of processor time after which a run is given up */
} bullet_scene;

/* A beam of 1 x 0.2 x 0.2 m, held at x = 0, gravity from t = 0 on. tip: displacement along x and z (m) of the end face's
   centroid at `moments` equal times up to the duration, which the step must divide. ms: processor time of the steps.
   Returns 0 when it was lost: not finite, or out of patience. */
int bullet_swing(const bullet_scene *s, int moments, double (*tip)[2], double *ms);

/* A cube of 0.2 m falls 0.2 m onto a plane. tip: height (m) of the centre of mass above the plane, and of the cube's
   upper face's centre above its lower one. */
int bullet_drop(const bullet_scene *s, int moments, double (*tip)[2], double *ms);

/* A name for tables. */
const char *bullet_name(int method);

#ifdef __cplusplus
}
#endif
#endif
