/* tests/bench/accuracy/bullet.cpp - Bullet's soft bodies on the swing, beside peri (Debian: apt-get install
   libbullet-dev). C++98, as Bullet is.

   Solids are cut into cubes of six tetrahedra. Damping, drag and sleep are off: what is lost is the integrator's.
       neo-Hookean    btDeformableMultiBodyDynamicsWorld, implicit, one linear solve a step (Bullet's default). Its
                      energy is that of Smith et al. 2018 in its own parameters: for Lame's mu and lambda at small
                      strain it takes 4/3 mu and lambda + 5/6 mu
       Newton         the same with setLineSearch(true)
       corotated      the same as the first, btDeformableLinearElasticityForce (with a line search it does not swing)
       links          btSoftRigidDynamicsWorld: links along the tetrahedra's edges, 20 sweeps of positions; it knows
                      no Pa, so its stiffness is what the sweeps leave */
#include <BulletSoftBody/btDeformableBodySolver.h>
#include <BulletSoftBody/btDeformableLinearElasticityForce.h>
#include <BulletSoftBody/btDeformableMultiBodyConstraintSolver.h>
#include <BulletSoftBody/btDeformableMultiBodyDynamicsWorld.h>
#include <BulletSoftBody/btDeformableNeoHookeanForce.h>
#include <BulletSoftBody/btSoftBodyHelpers.h>
#include <BulletSoftBody/btSoftBodyRigidBodyCollisionConfiguration.h>
#include <BulletSoftBody/btSoftRigidDynamicsWorld.h>

#include <btBulletDynamicsCommon.h>

#include "scene.h"

#include <cmath>
#include <cstring>
#include <ctime>
#include <vector>

namespace {

enum { NEO_HOOKEAN, NEWTON, COROTATED, LINKS };
const double young = 1e6, poisson = 0.25, density = 1000, gravity = 9.81;   /* of the swing */

/* A box of cells as nodes and tetrahedra, x fastest. */
struct grid {
    int n[3];   /* nodes along each axis */
    double cell;
    std::vector<btVector3> node;
    std::vector<btScalar> mass;
    std::vector<int> tetra;

    int at(int i, int j, int k) const { return i + n[0] * (j + n[1] * k); }

    /* Six tetrahedra about the cube's diagonal, one for each way along its edges. */
    void cube(int i, int j, int k) {
        static const int way[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {1, 0, 2}, {0, 2, 1}, {2, 1, 0}};
        for (int w = 0; w < 6; w++) {
            int place[3] = {i, j, k}, corner[4];
            corner[0] = at(i, j, k);
            for (int c = 0; c < 3; c++) {
                place[way[w][c]]++;
                corner[c + 1] = at(place[0], place[1], place[2]);
            }
            if (w >= 3) std::swap(corner[2], corner[3]);
            for (int c = 0; c < 4; c++) {
                tetra.push_back(corner[c]);
                mass[(size_t)corner[c]] += (btScalar)(density * cell * cell * cell / 24);
            }
        }
    }

    grid(int x, int y, int z, double side) : cell(side) {
        n[0] = x + 1, n[1] = y + 1, n[2] = z + 1;
        for (int k = 0; k <= z; k++)
            for (int j = 0; j <= y; j++)
                for (int i = 0; i <= x; i++)
                    node.push_back(btVector3((btScalar)(i * side), (btScalar)(j * side), (btScalar)(k * side)));
        mass.assign(node.size(), 0);
        for (int k = 0; k < z; k++)
            for (int j = 0; j < y; j++)
                for (int i = 0; i < x; i++) cube(i, j, k);
    }
};

/* A world of either kind with one soft body. */
struct stage {
    btSoftBodyRigidBodyCollisionConfiguration configuration;
    btCollisionDispatcher dispatcher;
    btDbvtBroadphase broadphase;
    btDeformableBodySolver deformable;
    btDeformableMultiBodyConstraintSolver contacts;
    btSequentialImpulseConstraintSolver rigid_contacts;
    btDiscreteDynamicsWorld *world;
    btDeformableMultiBodyDynamicsWorld *soft_world;     /* one of the two, or NULL */
    btSoftRigidDynamicsWorld *link_world;
    btDeformableLagrangianForce *force, *weight;
    btSoftBody *body;

    btSoftBodyWorldInfo &info() { return soft_world ? soft_world->getWorldInfo() : link_world->getWorldInfo(); }

    stage(int kind, const grid &g)
        : dispatcher(&configuration), world(NULL), soft_world(NULL), link_world(NULL), force(NULL), weight(NULL) {
        const btVector3 down(0, 0, (btScalar)-gravity);
        if (kind == LINKS) {
            world = link_world = new btSoftRigidDynamicsWorld(&dispatcher, &broadphase, &rigid_contacts,
                                                              &configuration);
        } else {
            contacts.setDeformableSolver(&deformable);
            world = soft_world = new btDeformableMultiBodyDynamicsWorld(&dispatcher, &broadphase, &contacts,
                                                                        &configuration, &deformable);
            soft_world->setImplicit(true);
            soft_world->setUseProjection(true);     /* without it 3.24 does not move at all */
            soft_world->setLineSearch(kind == NEWTON);
        }
        world->setGravity(down);
        info().m_dispatcher = &dispatcher;
        info().m_broadphase = &broadphase;
        info().m_gravity = down;
        info().air_density = info().water_density = 0;
        info().m_sparsesdf.setDefaultVoxelsz((btScalar)0.25);
        info().m_sparsesdf.Initialize();
        make_body(g);
        if (soft_world) make_forces(kind, down);
    }

    void make_body(const grid &g) {
        body = new btSoftBody(&info(), (int)g.node.size(), &g.node[0], &g.mass[0]);
        for (size_t t = 0; t < g.tetra.size(); t += 4)
            body->appendTetra(g.tetra[t], g.tetra[t + 1], g.tetra[t + 2], g.tetra[t + 3]);
        /* Each edge once. The deformable world takes no force from links, but builds its trees of them, for ever where
           there are none. */
        for (size_t t = 0; t < g.tetra.size(); t += 4)
            for (int a = 0; a < 4; a++)
                for (int b = a + 1; b < 4; b++)
                    body->appendLink(g.tetra[t + (size_t)a], g.tetra[t + (size_t)b], 0, true);
        btSoftBodyHelpers::generateBoundaryFaces(body);
        body->initializeDmInverse();
        body->m_tetraScratches.resize(body->m_tetras.size());
        body->m_tetraScratchesTn.resize(body->m_tetras.size());
        body->m_cfg.kDP = body->m_cfg.kDG = body->m_cfg.kLF = body->m_cfg.drag = 0;
        body->m_cfg.m_maxStress = 0;
        body->m_cfg.piterations = 20;
        body->m_materials[0]->m_kLST = 1;
        body->m_cfg.collisions = 0;
        body->getCollisionShape()->setMargin((btScalar)(0.05 * g.cell));
        body->setSelfCollision(false);
        body->setActivationState(DISABLE_DEACTIVATION);
        body->m_sleepingThreshold = 0;
        if (soft_world) soft_world->addSoftBody(body);
        else link_world->addSoftBody(body);
    }

    void make_forces(int kind, const btVector3 &down) {
        const double mu = young / (2 + 2 * poisson);
        const double lambda = young * poisson / ((1 + poisson) * (1 - 2 * poisson));
        if (kind == NEO_HOOKEAN || kind == NEWTON) {
            force = new btDeformableNeoHookeanForce((btScalar)(4 * mu / 3), (btScalar)(lambda + 5 * mu / 6), 0);
        } else {
            force = new btDeformableLinearElasticityForce((btScalar)mu, (btScalar)lambda, 0, 0);
        }
        weight = new btDeformableGravityForce(down);
        soft_world->addForce(body, force);
        soft_world->addForce(body, weight);
    }

    void hold(int node) { body->setMass(node, 0); }

    ~stage() {
        if (soft_world) soft_world->removeSoftBody(body);
        else link_world->removeSoftBody(body);
        delete world;
        delete body;
        delete force;
        delete weight;
    }

    btVector3 where(int node) const { return body->m_nodes[node].m_x; }
};

/* Mean of the end face's nodes, by area: half on its edges, a quarter at its corners. */
btVector3 end(const stage &t, const grid &g) {
    btVector3 sum(0, 0, 0);
    double all = 0;
    for (int k = 0; k < g.n[2]; k++)
        for (int j = 0; j < g.n[1]; j++) {
            const double w = (j == 0 || j == g.n[1] - 1 ? 0.5 : 1) * (k == 0 || k == g.n[2] - 1 ? 0.5 : 1);
            sum += t.where(g.at(g.n[0] - 1, j, k)) * (btScalar)w;
            all += w;
        }
    return sum / (btScalar)all;
}

int swing(const rival *by, const setup *s, course *out) {
    const int moments = scene_moments(s->scene), steps = (int)(scene_duration(s->scene) / moments / s->step + 0.5);
    const grid g(5 * s->across, s->across, s->across, 0.2 / s->across);
    stage t(by->kind, g);
    const btVector3 rest = end(t, g);
    std::memset(out, 0, sizeof *out);
    for (int k = 0; k < g.n[2]; k++)
        for (int j = 0; j < g.n[1]; j++) t.hold(g.at(0, j, k));
    for (int m = 0; m < moments && !out->lost; m++) {
        for (int k = 0; k < steps && !out->lost; k++) {
            const std::clock_t start = std::clock();
            t.world->stepSimulation((btScalar)s->step, 0);
            out->ms += 1e3 * (double)(std::clock() - start) / CLOCKS_PER_SEC;
            out->steps++;
            out->lost = out->ms > s->patience;
        }
        const btVector3 moved = end(t, g) - rest;
        out->seen[m][0] = (double)moved.x();
        out->seen[m][1] = (double)moved.z();
        out->lost |= !(moved.length() < 1e3);
    }
    out->iterations = out->steps;
    return !out->lost;
}

} // namespace

const rival bench_bullet[] = {
    {"Bullet neo-Hookean", SWING, NEO_HOOKEAN, swing},
    {"Bullet neo-Hookean, Newton", SWING, NEWTON, swing},
    {"Bullet corotated", SWING, COROTATED, swing},
    {"Bullet links, 20 sweeps", SWING, LINKS, swing},
    {NULL, 0, 0, NULL},
};
