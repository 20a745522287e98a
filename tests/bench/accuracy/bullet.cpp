/* tests/bench/accuracy/bullet.cpp - Bullet's soft bodies on swing, drop and pile, beside peri (Debian: apt-get install
   libbullet-dev). C++98, as Bullet is.

   Solids are cut into cubes of six tetrahedra. Damping, drag and sleep are off: what is lost is the integrator's.
       neo-Hookean    btDeformableMultiBodyDynamicsWorld, implicit, one linear solve a step (Bullet's default). Its
                      energy is that of Smith et al. 2018 in its own parameters: for Lame's mu and lambda at small
                      strain it takes 4/3 mu and lambda + 5/6 mu
       Newton         the same with setLineSearch(true)
       explicit       the same with setImplicit(false), as most of Bullet's own examples have it
       corotated      the same as the first, btDeformableLinearElasticityForce (with a line search it does not swing)
       links          btSoftRigidDynamicsWorld: links along the tetrahedra's edges, 20 sweeps of positions; it knows
                      no Pa, so its stiffness is what the sweeps leave

   Contact, as tried and found best: nodes against the ground (SDF_RD with SDF_RDN; without the second nothing touches
   it), nodes against faces between bodies (VF_DD); the ground a box 5 m deep, margins and the cells of its distance
   field in proportion to the mesh; setUseProjection(true), without which cubes sink in and burst. On the drop lengths
   scaled by 10 or 30, margins of 0.05 to 0.5 cells, m_deformable_erp of 0.06 or 0.3 and a largest correction of 0.1 or
   200 make little difference to the neo-Hookean cubes; the corotated ones burst when scaled. In the pile margins of
   0.25 cells throw the cubes up, and without friction they fall off. A line search (Newton) changes nothing on the
   drop. */
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

enum { NEO_HOOKEAN, NEWTON, EXPLICIT, COROTATED, LINKS };
const double poisson = 0.25, density = 1000, gravity = 9.81, margin = 0.05; /* margin: of contact, in cells */

/* A box of cells as nodes and tetrahedra, x fastest. */
struct grid {
    int n[3];   /* nodes along each axis */
    double cell;
    std::vector<btVector3> node;
    std::vector<btScalar> mass;
    std::vector<int> tetra;

    int at(int i, int j, int k) const { return i + n[0] * (j + n[1] * k); }

    /* Six tetrahedra about the cube's diagonal, one for each way along its edges. Neighbours are each other's mirror
       images: with all diagonals alike a body is lopsided, and in a pile it rolls off. */
    void cube(int i, int j, int k) {
        static const int way[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {1, 0, 2}, {0, 2, 1}, {2, 1, 0}};
        const int odd[3] = {i & 1, j & 1, k & 1};
        for (int w = 0; w < 6; w++) {
            int place[3] = {i + odd[0], j + odd[1], k + odd[2]}, corner[4];
            corner[0] = at(place[0], place[1], place[2]);
            for (int c = 0; c < 3; c++) {
                place[way[w][c]] += odd[way[w][c]] ? -1 : 1;
                corner[c + 1] = at(place[0], place[1], place[2]);
            }
            if ((w >= 3) != ((odd[0] + odd[1] + odd[2]) % 2 == 1)) std::swap(corner[2], corner[3]);
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

/* The ground, z = 0. */
struct floor_body {
    btBoxShape shape;
    btDefaultMotionState place;
    btRigidBody body;

    /* Nodes stop a margin above it. */
    explicit floor_body(double gap)
        : shape(btVector3(5, 5, 5)),
          place(btTransform(btQuaternion::getIdentity(), btVector3(0, 0, (btScalar)(-5 - gap)))),
          body(btRigidBody::btRigidBodyConstructionInfo(0, &place, &shape)) {}
};

/* A world of either kind with its soft bodies. */
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
    floor_body *ground;
    std::vector<btSoftBody *> bodies;

    btSoftBodyWorldInfo &info() { return soft_world ? soft_world->getWorldInfo() : link_world->getWorldInfo(); }

    /* cell: of the finest mesh, what the distance field of the ground is cut into a quarter of */
    stage(int kind, double young, double cell)
        : dispatcher(&configuration), world(NULL), soft_world(NULL), link_world(NULL), force(NULL), weight(NULL),
          ground(NULL) {
        const btVector3 down(0, 0, (btScalar)-gravity);
        if (kind == LINKS) {
            world = link_world = new btSoftRigidDynamicsWorld(&dispatcher, &broadphase, &rigid_contacts,
                                                              &configuration);
        } else {
            contacts.setDeformableSolver(&deformable);
            world = soft_world = new btDeformableMultiBodyDynamicsWorld(&dispatcher, &broadphase, &contacts,
                                                                        &configuration, &deformable);
            soft_world->setImplicit(kind != EXPLICIT);
            soft_world->setUseProjection(true);     /* without it 3.24 does not move at all */
            soft_world->setLineSearch(kind == NEWTON);
        }
        world->setGravity(down);
        info().m_dispatcher = &dispatcher;
        info().m_broadphase = &broadphase;
        info().m_gravity = down;
        info().air_density = info().water_density = 0;
        info().m_sparsesdf.Initialize();
        info().m_sparsesdf.setDefaultVoxelsz((btScalar)(0.25 * cell));
        if (soft_world) make_forces(kind, young, down);
    }

    /* Friction of two deformables is the product of theirs, of one and a rigid body the product, too. */
    void make_ground(double cell, double friction) {
        ground = new floor_body(margin * cell);
        ground->body.setFriction((btScalar)std::sqrt(friction));
        world->addRigidBody(&ground->body);
    }

    btSoftBody *make_body(const grid &g, double friction) {
        btSoftBody *body = new btSoftBody(&info(), (int)g.node.size(), &g.node[0], &g.mass[0]);
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
        body->m_cfg.kDF = (btScalar)std::sqrt(friction);
        body->m_cfg.collisions = !ground ? 0
                                 : soft_world ? btSoftBody::fCollision::SDF_RD | btSoftBody::fCollision::SDF_RDN |
                                                    btSoftBody::fCollision::VF_DD
                                              : btSoftBody::fCollision::SDF_RS | btSoftBody::fCollision::VF_SS;
        body->getCollisionShape()->setMargin((btScalar)(margin * g.cell));
        body->setSelfCollision(false);
        body->setActivationState(DISABLE_DEACTIVATION);
        body->m_sleepingThreshold = 0;
        if (soft_world) {
            soft_world->addSoftBody(body);
            soft_world->addForce(body, force);
            soft_world->addForce(body, weight);
        } else link_world->addSoftBody(body);
        bodies.push_back(body);
        return body;
    }

    void make_forces(int kind, double young, const btVector3 &down) {
        const double mu = young / (2 + 2 * poisson);
        const double lambda = young * poisson / ((1 + poisson) * (1 - 2 * poisson));
        if (kind == COROTATED) force = new btDeformableLinearElasticityForce((btScalar)mu, (btScalar)lambda, 0, 0);
        else force = new btDeformableNeoHookeanForce((btScalar)(4 * mu / 3), (btScalar)(lambda + 5 * mu / 6), 0);
        weight = new btDeformableGravityForce(down);
    }

    /* One step, its processor time added to out. */
    void advance(double step, course *out) {
        const std::clock_t start = std::clock();
        world->stepSimulation((btScalar)step, 0);
        out->ms += 1e3 * (double)(std::clock() - start) / CLOCKS_PER_SEC;
        out->steps++;
        out->iterations++;
    }

    ~stage() {
        if (ground) world->removeRigidBody(&ground->body);
        for (size_t q = 0; q < bodies.size(); q++) {
            if (soft_world) soft_world->removeSoftBody(bodies[q]);
            else link_world->removeSoftBody(bodies[q]);
        }
        delete world;
        for (size_t q = 0; q < bodies.size(); q++) delete bodies[q];
        delete ground;
        delete force;
        delete weight;
    }
};

/* Mean of the nodes of the face at `layer` across an axis, by area: half on its edges, a quarter at its corners. */
btVector3 face(const btSoftBody *body, const grid &g, int axis, int layer) {
    const int u = (axis + 1) % 3, v = (axis + 2) % 3;
    btVector3 sum(0, 0, 0);
    double all = 0;
    int at[3];
    at[axis] = layer;
    for (at[v] = 0; at[v] < g.n[v]; at[v]++)
        for (at[u] = 0; at[u] < g.n[u]; at[u]++) {
            const double w =
                (at[u] == 0 || at[u] == g.n[u] - 1 ? 0.5 : 1) * (at[v] == 0 || at[v] == g.n[v] - 1 ? 0.5 : 1);
            sum += body->m_nodes[g.at(at[0], at[1], at[2])].m_x * (btScalar)w;
            all += w;
        }
    return sum / (btScalar)all;
}

int swing(const rival *by, const setup *s, course *out) {
    const int moments = scene_moments(s->scene), steps = (int)(scene_duration(s->scene) / moments / s->step + 0.5);
    const grid g(5 * s->across, s->across, s->across, 0.2 / s->across);
    stage t(by->kind, 1e6, g.cell);
    btSoftBody *beam = t.make_body(g, 0);
    const btVector3 rest = face(beam, g, 0, g.n[0] - 1);
    std::memset(out, 0, sizeof *out);
    for (int k = 0; k < g.n[2]; k++)
        for (int j = 0; j < g.n[1]; j++) beam->setMass(g.at(0, j, k), 0);
    for (int m = 0; m < moments && !out->lost; m++) {
        for (int k = 0; k < steps && !out->lost; k++) {
            t.advance(s->step, out);
            out->lost = out->ms > s->patience;
        }
        const btVector3 moved = face(beam, g, 0, g.n[0] - 1) - rest;
        out->seen[m][0] = (double)moved.x();
        out->seen[m][1] = (double)moved.z();
        out->lost |= !(moved.length() < 1e3);
    }
    return !out->lost;
}

/* Height of a body's centre of mass; 1 when a node is half a cube under the ground, far off, or no number. */
int centre(const btSoftBody *body, double *height) {
    double sum = 0, mass = 0;
    int lost = 0;
    for (int i = 0; i < body->m_nodes.size(); i++) {
        const btVector3 x = body->m_nodes[i].m_x;
        const double m = 1 / (double)body->m_nodes[i].m_im;
        lost |= !(x.z() > -0.1 && x.length() < 2);
        sum += m * (double)x.z();
        mass += m;
    }
    *height = sum / mass;
    return lost;
}

int cubes(const rival *by, const setup *s, course *out) {
    const int moments = scene_moments(s->scene), steps = (int)(scene_duration(s->scene) / moments / s->step + 0.5);
    const int count = scene_cubes(s->scene), n = s->across;
    stage t(by->kind, 1e5, scene_side(s->scene, count - 1) / n);
    double first[CUBES], now[CUBES];
    std::memset(out, 0, sizeof *out);
    t.make_ground(scene_side(s->scene, 0) / n, scene_friction(s->scene));
    for (int q = 0; q < count; q++) {
        const double side = scene_side(s->scene, q);
        btSoftBody *body = t.make_body(grid(n, n, n, side / n), scene_friction(s->scene));
        body->translate(btVector3((btScalar)(-side / 2), (btScalar)(-side / 2), (btScalar)scene_height(s->scene, q)));
        body->setVelocity(btVector3(0, 0, (btScalar)-scene_speed(s->scene)));
        for (int i = 0; i < body->m_nodes.size(); i++) body->m_nodes[i].m_vn = body->m_nodes[i].m_v;
        centre(body, &first[q]);
    }
    const grid g(n, n, n, scene_side(s->scene, 0) / n);
    for (int m = 0; m < moments && !out->lost; m++) {
        for (int k = 0; k < steps && !out->lost; k++) {
            t.advance(s->step, out);
            for (int q = 0; q < count; q++) out->lost |= centre(t.bodies[(size_t)q], &now[q]);
            out->lost |= out->ms > s->patience;
        }
        double mass = 0, sum = 0;
        for (int q = 0; q < count; q++) {
            const double own = std::pow(scene_side(s->scene, q), 3);
            sum += own * (now[q] - first[q]);
            mass += own;
        }
        out->seen[m][0] = sum / mass;
        out->seen[m][1] = now[count - 1] - first[count - 1];
        if (s->scene == DROP) {
            const btVector3 tall = face(t.bodies[0], g, 2, n) - face(t.bodies[0], g, 2, 0);
            out->seen[m][1] = (double)tall.z() - scene_side(DROP, 0);
        }
    }
    return !out->lost;
}

} // namespace

const rival bench_bullet[] = {
    {"Bullet neo-Hookean", SWING, NEO_HOOKEAN, swing},
    {"Bullet neo-Hookean, Newton", SWING, NEWTON, swing},
    {"Bullet corotated", SWING, COROTATED, swing},
    {"Bullet links, 20 sweeps", SWING, LINKS, swing},
    {"Bullet neo-Hookean", DROP, NEO_HOOKEAN, cubes},
    {"Bullet neo-Hookean, explicit", DROP, EXPLICIT, cubes},
    {"Bullet corotated", DROP, COROTATED, cubes},
    {"Bullet links, 20 sweeps", DROP, LINKS, cubes},
    {"Bullet neo-Hookean", PILE, NEO_HOOKEAN, cubes},
    {"Bullet neo-Hookean, explicit", PILE, EXPLICIT, cubes},
    {"Bullet corotated", PILE, COROTATED, cubes},
    {"Bullet links, 20 sweeps", PILE, LINKS, cubes},
    {NULL, 0, 0, NULL},
};
