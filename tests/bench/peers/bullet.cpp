/* tests/bench/peers/bullet.cpp - Bullet's soft bodies on scenes of ours (Debian: apt-get install libbullet-dev). C++98,
   as Bullet is.

   Solids are cut into cubes of six tetrahedra. Damping, drag and sleep are off: what is lost is the integrator's.
   btDeformableNeoHookeanForce is the stable neo-Hookean energy of Smith et al. 2018 in its own parameters: for Lame's mu
   and lambda at small strain it takes 4/3 mu and lambda + 5/6 mu. */
#include "bullet.h"

#include <BulletSoftBody/btDeformableBodySolver.h>
#include <BulletSoftBody/btDeformableLinearElasticityForce.h>
#include <BulletSoftBody/btDeformableMultiBodyConstraintSolver.h>
#include <BulletSoftBody/btDeformableMultiBodyDynamicsWorld.h>
#include <BulletSoftBody/btDeformableNeoHookeanForce.h>
#include <BulletSoftBody/btSoftBodyHelpers.h>
#include <BulletSoftBody/btSoftBodyRigidBodyCollisionConfiguration.h>
#include <BulletSoftBody/btSoftRigidDynamicsWorld.h>

#include <btBulletDynamicsCommon.h>

#include <cmath>
#include <ctime>
#include <vector>

const char *bullet_name(int method) {
    static const char *const name[BULLET_METHODS] = {"Bullet neo-Hookean", "Bullet corotated", "Bullet links"};
    return name[method];
}

namespace {

/* A box of cells as nodes and tetrahedra, x fastest. */
struct grid {
    int n[3];   /* nodes along each axis */
    double cell;
    std::vector<btVector3> node;
    std::vector<btScalar> mass;
    std::vector<int> tetra;

    int at(int i, int j, int k) const { return i + n[0] * (j + n[1] * k); }

    /* Six tetrahedra about the cube's diagonal, one for each way along its edges. */
    void cube(int i, int j, int k, double density) {
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

    grid(int x, int y, int z, double side, double lift, double density) : cell(side) {
        n[0] = x + 1, n[1] = y + 1, n[2] = z + 1;
        for (int k = 0; k <= z; k++)
            for (int j = 0; j <= y; j++)
                for (int i = 0; i <= x; i++)
                    node.push_back(btVector3((btScalar)(i * side), (btScalar)(j * side), (btScalar)(k * side + lift)));
        mass.assign(node.size(), 0);
        for (int k = 0; k < z; k++)
            for (int j = 0; j < y; j++)
                for (int i = 0; i < x; i++) cube(i, j, k, density);
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
    btCollisionShape *plane;
    btRigidBody *ground;

    btSoftBodyWorldInfo &info() { return soft_world ? soft_world->getWorldInfo() : link_world->getWorldInfo(); }

    stage(const bullet_scene &s, const grid &g)
        : dispatcher(&configuration), world(NULL), soft_world(NULL), link_world(NULL), force(NULL), weight(NULL),
          plane(NULL), ground(NULL) {
        const btVector3 down(0, 0, (btScalar)-s.gravity);
        if (s.method == BULLET_LINKS) {
            world = link_world = new btSoftRigidDynamicsWorld(&dispatcher, &broadphase, &rigid_contacts,
                                                              &configuration);
        } else {
            contacts.setDeformableSolver(&deformable);
            world = soft_world = new btDeformableMultiBodyDynamicsWorld(&dispatcher, &broadphase, &contacts,
                                                                        &configuration, &deformable);
            soft_world->setImplicit(true);
            soft_world->setUseProjection(true);     /* without it 3.24 does not move at all */
            soft_world->setLineSearch(s.search != 0);
        }
        world->setGravity(down);
        info().m_dispatcher = &dispatcher;
        info().m_broadphase = &broadphase;
        info().m_gravity = down;
        info().air_density = info().water_density = 0;
        info().m_sparsesdf.setDefaultVoxelsz((btScalar)0.25);
        info().m_sparsesdf.Initialize();
        make_body(s, g);
        if (soft_world) make_forces(s, down);
    }

    void make_body(const bullet_scene &s, const grid &g) {
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
        body->m_cfg.piterations = s.iterations;
        body->m_cfg.kDF = (btScalar)0.5;
        body->m_materials[0]->m_kLST = 1;
        body->m_cfg.collisions = soft_world ? (int)btSoftBody::fCollision::SDF_RD : (int)btSoftBody::fCollision::SDF_RS;
        body->m_cfg.kCHR = body->m_cfg.kKHR = 1;
        body->getCollisionShape()->setMargin((btScalar)(0.05 * g.cell));
        body->setSelfCollision(false);
        body->setActivationState(DISABLE_DEACTIVATION);
        body->m_sleepingThreshold = 0;
        if (soft_world) soft_world->addSoftBody(body);
        else link_world->addSoftBody(body);
    }

    void make_forces(const bullet_scene &s, const btVector3 &down) {
        const double mu = s.young / (2 + 2 * s.poisson);
        const double lambda = s.young * s.poisson / ((1 + s.poisson) * (1 - 2 * s.poisson));
        if (s.method == BULLET_NEO_HOOKEAN) {
            force = new btDeformableNeoHookeanForce((btScalar)(4 * mu / 3), (btScalar)(lambda + 5 * mu / 6), 0);
        } else {
            force = new btDeformableLinearElasticityForce((btScalar)mu, (btScalar)lambda, 0, 0);
        }
        weight = new btDeformableGravityForce(down);
        soft_world->addForce(body, force);
        soft_world->addForce(body, weight);
    }

    void hold(int node) { body->setMass(node, 0); }

    void make_ground() {
        plane = new btBoxShape(btVector3(2, 2, 1));
        ground = new btRigidBody(btRigidBody::btRigidBodyConstructionInfo(0, NULL, plane));
        ground->setWorldTransform(btTransform(btQuaternion::getIdentity(), btVector3(0, 0, -1)));
        ground->setFriction((btScalar)0.5);
        world->addRigidBody(ground);
    }

    ~stage() {
        if (ground) world->removeRigidBody(ground);
        if (soft_world) soft_world->removeSoftBody(body);
        else link_world->removeSoftBody(body);
        delete world;
        delete body;
        delete force;
        delete weight;
        delete ground;
        delete plane;
    }

    btVector3 where(int node) const { return body->m_nodes[node].m_x; }
};

/* Runs, and calls `look` at each of the moments. */
template <class looker>
int run(const bullet_scene &s, stage &t, int moments, const looker &look, double (*tip)[2], double *ms) {
    const int steps = (int)(s.duration / moments / s.step + 0.5);
    *ms = 0;
    for (int m = 0; m < moments; m++) {
        for (int k = 0; k < steps; k++) {
            const std::clock_t start = std::clock();
            t.world->stepSimulation((btScalar)(s.duration / moments / steps), 0);
            *ms += 1e3 * (double)(std::clock() - start) / CLOCKS_PER_SEC;
            if (*ms > s.patience) return 0;
        }
        look(t, tip[m]);
        if (!(std::fabs(tip[m][0]) < 1e3) || !(std::fabs(tip[m][1]) < 1e3)) return 0;
    }
    return 1;
}

/* Mean of a face of nodes, by area: half on its edges, a quarter at its corners. axis: the one it is normal to. */
btVector3 face(const stage &t, const grid &g, int axis, int layer) {
    const int u = (axis + 1) % 3, v = (axis + 2) % 3;
    btVector3 sum(0, 0, 0);
    double all = 0;
    for (int a = 0; a < g.n[u]; a++)
        for (int b = 0; b < g.n[v]; b++) {
            int place[3];
            place[axis] = layer, place[u] = a, place[v] = b;
            const double w = (a == 0 || a == g.n[u] - 1 ? 0.5 : 1) * (b == 0 || b == g.n[v] - 1 ? 0.5 : 1);
            sum += t.where(g.at(place[0], place[1], place[2])) * (btScalar)w;
            all += w;
        }
    return sum / (btScalar)all;
}

struct tip_looker {
    const grid &g;
    btVector3 rest;
    tip_looker(const stage &t, const grid &of) : g(of), rest(face(t, of, 0, of.n[0] - 1)) {}
    void operator()(const stage &t, double out[2]) const {
        const btVector3 moved = face(t, g, 0, g.n[0] - 1) - rest;
        out[0] = moved.x();
        out[1] = moved.z();
    }
};

struct drop_looker {
    const grid &g;
    explicit drop_looker(const grid &of) : g(of) {}
    void operator()(const stage &t, double out[2]) const {
        double sum = 0, all = 0;
        for (size_t i = 0; i < g.mass.size(); i++) {
            sum += (double)g.mass[i] * (double)t.where((int)i).z();
            all += (double)g.mass[i];
        }
        out[0] = sum / all;
        out[1] = (double)(face(t, g, 2, g.n[2] - 1) - face(t, g, 2, 0)).z();
    }
};

} // namespace

int bullet_swing(const bullet_scene *s, int moments, double (*tip)[2], double *ms) {
    const grid g(5 * s->across, s->across, s->across, 0.2 / s->across, 0, s->density);
    stage t(*s, g);
    for (int k = 0; k < g.n[2]; k++)
        for (int j = 0; j < g.n[1]; j++) t.hold(g.at(0, j, k));
    return run(*s, t, moments, tip_looker(t, g), tip, ms);
}

int bullet_drop(const bullet_scene *s, int moments, double (*tip)[2], double *ms) {
    const grid g(s->across, s->across, s->across, 0.2 / s->across, 0.2, s->density);
    stage t(*s, g);
    t.make_ground();
    return run(*s, t, moments, drop_looker(g), tip, ms);
}
