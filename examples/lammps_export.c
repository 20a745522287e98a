/* lammps_export.c - an elastic scene as LAMMPS data file and input script: the same bonds on many machines.
 *
 * Who outgrows one machine runs on with LAMMPS' MPI (package PERI, pair_style peri/lps or peri/pmb; units si): shape,
 * material, held side, gravity and a load are chosen here, written, and, when the program `lmp` is installed and the
 * scene small enough, run by it and by the library, side by side.  With --check the forces of both on the same deformed
 * points are compared, and the scene's motion.
 *
 *     cc -O2 examples/lammps_export.c -lm -o lammps_export && ./lammps_export --shape rabbit --across 200
 *     cd build/out/lammps_export && mpirun -np 64 lmp -in rabbit.in
 *
 * The same solid in the library: peri_material_linear, kernel_power -1, partial_volume 1, the same horizon.  peri/lps
 * has influence 1/r: its bonds weigh r^2/r in terms of stretches.  peri/pmb is bond-based: Poisson's ratio 1/4; its
 * constant is taken from the lattice's sum, so that inside a body the forces are the library's; at surfaces they are
 * not (it does not normalise its weights, which leaves surfaces soft).
 *
 * Of LAMMPS (29 Sep 2021): forces are per volume, particles' masses are densities, and energies are sums of densities
 * (and lps reports half of the deviatoric part): compare forces and stresses.  Pairs nearer than 0.9 of their distance
 * at rest repel each other, too, so bonds must not be compressed by 10 % where both are to agree.  Bonds are made of
 * the positions read, in a first step at rest.  Periodic boxes spoil the weighted volume: the box is free.
 *
 * Writes to --out: NAME.data, NAME.in, lammps_export.png.  Contents: options, scene, files, the library's run, LAMMPS'
 * run, checks, pictures, main.
 */
#include "studio.h"

#define PERI_DOUBLE     /* forces are compared to 1e-8 */
#define PERI_IMPLEMENTATION
#include "../peri.h"
#include "studio_peri.h"
#include "shapes.h"

static const studio_app app = {
    "lammps_export", "an elastic scene as LAMMPS data file and input script",
    "  --shape NAME   beam block ball ring star rabbit teapot flower; or give a mesh (.obj, .ply) (beam)\n"
    "  --style NAME   lps or pmb (lps)\n"
    "  --length M     longest side (1)\n"
    "  --across N     particles along it (30)\n"
    "  --horizon X    in spacings (3.01)\n"
    "  --young PA     Young's modulus (5000000)\n"
    "  --poisson X    Poisson's ratio; pmb: 1/4 (0.3)\n"
    "  --density X    kg/m^3 (1000)\n"
    "  --hold WHAT    left, bottom or none: two layers of particles that stay (left)\n"
    "  --gravity X    downwards, m/s^2 (9.81)\n"
    "  --load N       downwards on the two layers opposite those held, in newtons (0)\n"
    "  --time S       simulated (0.1)\n"
    "  --no-run       only write the files\n", 1};

enum { BEAM, BLOCK, BALL, RING, STAR, RABBIT, TEAPOT, FLOWER, MESH, SHAPES };
static const char *const shape_name[SHAPES] = {"beam", "block", "ball", "ring", "star", "rabbit", "teapot", "flower",
                                               "mesh"};
enum { LPS, PMB };
static const char *const style_name[2] = {"lps", "pmb"};
enum { FREE, HELD, LOADED, ROLES };     /* LAMMPS' atom types less one */
enum { RUN_AT_MOST = 20000 };           /* particles that are also run here */

typedef struct job {
    studio_options options;
    int shape, style, hold, count, members[ROLES];
    double spacing, horizon, young, poisson, density, gravity, load, time;
    double volume, bulk, shear, c, dt;  /* of a particle, m^3; Pa; constant of pmb, N/m^6; step of LAMMPS, s */
    double *point, *now, *here, *there; /* at rest; deformed for the check; at the end: the library's, LAMMPS' */
    unsigned char *role;
    peri_material material;
    peri_world *world;
    peri_body_id body;
    int lammps;                         /* lmp is installed */
    double seconds[2];                  /* of the runs: the library's, LAMMPS' */
} job;

/* ---- options ---- */

/* second: of --check, a block for peri/pmb, wide enough to have an inside. */
static int choose(job *s, int second) {
    static const char *const holds[] = {"left", "bottom", "none"};
    int across = s->options.check ? second ? 16 : 20 : 30;
    s->shape = s->options.input ? MESH : studio_choice("--shape", studio_extra("--shape"), shape_name, MESH);
    s->style = studio_choice("--style", studio_extra("--style"), style_name, 2);
    s->hold = studio_choice("--hold", studio_extra("--hold"), holds, 3);
    if (second) s->shape = BLOCK, s->style = PMB;
    if (s->shape < 0 || s->style < 0 || s->hold < 0) return -1;
    s->spacing = studio_number("--length", 1) / studio_number("--across", across);
    s->horizon = studio_number("--horizon", 3.01) * s->spacing;
    s->young = studio_number("--young", 5e6);
    s->poisson = s->style == PMB ? 0.25 : studio_number("--poisson", 0.3);
    s->density = studio_number("--density", 1000);
    s->gravity = studio_number("--gravity", 9.81);
    s->load = studio_number("--load", 0);
    s->time = studio_number("--time", s->options.check ? 0.05 : 0.1);
    s->bulk = s->young / (3 * (1 - 2 * s->poisson));
    s->shear = s->young / (2 * (1 + s->poisson));
    if (!(s->spacing > 0 && s->time > 0)) return studio_error("--length, --across and --time must be above 0");
    s->material = peri_material_linear(s->young, s->poisson, s->density);
    return 0;
}

/* ---- scene ---- */

/* Fills a shape with particles and puts its lowest ones half a spacing above z = 0. */
static int fill(job *s, const peri_shape *shape) {
    double low = HUGE_VAL;
    int i;
    if (studio_fill_shape(shape, s->spacing, &s->point, &s->count)) return -1;
    for (i = 0; i < s->count; i++) low = fmin(low, s->point[3 * i + 2]);
    for (i = 0; i < s->count; i++) s->point[3 * i + 2] += s->spacing / 2 - low;
    return 0;
}

static int fill_field(job *s, double length) {
    static studio_field *const field[SHAPES] = {NULL, NULL, NULL, shapes_ring, shapes_star, shapes_rabbit,
                                                shapes_teapot, shapes_flower, NULL};
    static const float longest[SHAPES] = {1, 1, 1, 1, 1, 1, 1.3f, 1.1f, 1};
    studio_solid solid;
    peri_shape shape;
    memset(&solid, 0, sizeof solid);
    solid.field = field[s->shape];
    studio_set(solid.lo, -0.8f, -0.8f, -0.1f);
    studio_set(solid.hi, 0.8f, 0.8f, 1.3f);
    solid.size = (float)length / longest[s->shape];
    shape = studio_solid_shape(&solid);
    return fill(s, &shape);
}

static int fill_mesh(job *s, double length) {
    static const float origin[3] = {0, 0, 0};
    studio_mesh mesh;
    peri_shape shape;
    double *vertices;
    int i, bad;
    if (studio_mesh_load(s->options.input, &mesh)) return -1;
    studio_mesh_fit(&mesh, origin, (float)length);
    vertices = (double *)studio_alloc(3 * (size_t)mesh.vertices, sizeof(double));
    for (i = 0; vertices && i < 3 * mesh.vertices; i++) vertices[i] = (double)mesh.v[i];
    shape = peri_shape_mesh(vertices, mesh.vertices, mesh.t, mesh.triangles);
    bad = !vertices || fill(s, &shape);
    free(vertices);
    studio_mesh_free(&mesh);
    return bad ? -1 : 0;
}

static int make_points(job *s) {
    double length = studio_number("--length", 1);
    peri_shape shape = peri_shape_box(length / 2, length / 2, length / 2);
    if (s->shape == MESH) return fill_mesh(s, length);
    if (s->shape >= RING) return fill_field(s, length);
    if (s->shape == BEAM) shape = peri_shape_box(length / 2, length / 10, length / 10);
    if (s->shape == BALL) shape = peri_shape_ball(length / 2);
    return fill(s, &shape);
}

/* Who is held, who is loaded: two layers on either side. */
static int make_roles(job *s) {
    int axis = s->hold == 1 ? 2 : 0, i;
    double low = HUGE_VAL, high = -HUGE_VAL, reach = 1.5 * s->spacing;
    s->role = (unsigned char *)studio_alloc((size_t)s->count, 1);
    if (!s->role) return -1;
    for (i = 0; i < s->count; i++) {
        low = fmin(low, s->point[3 * i + axis]);
        high = fmax(high, s->point[3 * i + axis]);
    }
    for (i = 0; i < s->count; i++) {
        if (s->hold < 2 && s->point[3 * i + axis] < low + reach) s->role[i] = HELD;
        else if (s->point[3 * i + axis] > high - reach) s->role[i] = LOADED;
        s->members[s->role[i]]++;
    }
    return 0;
}

/* Share of the volume of a neighbour at distance r, m, that counts: none beyond the horizon. */
static double ramp(const job *s, double r) {
    if (r > s->horizon) return 0;
    return fmin(1, (s->horizon + s->spacing / 2 - r) / s->spacing);
}

/* Sum of r V over the full family of a lattice point. */
static double lattice_sum(const job *s) {
    int n = (int)(s->horizon / s->spacing) + 1, i, j, k;
    double sum = 0;
    for (i = -n; i <= n; i++)
        for (j = -n; j <= n; j++)
            for (k = -n; k <= n; k++) {
                double r = s->spacing * sqrt((double)(i * i + j * j + k * k));
                sum += r * ramp(s, r) * s->volume;
            }
    return sum;
}

/* The scene in the library, and the constants of LAMMPS. Of an explicit step the limit is about 1.1 spacings over the
 * speed of sound at horizon 2 and grows with it; 0.4 leaves the rest to what bends and presses. */
static int create(job *s) {
    peri_world_def def = peri_default_world_def();
    peri_body_def body = peri_default_body_def();
    unsigned char *fixed = (unsigned char *)studio_alloc((size_t)s->count, 1);
    peri_error err;
    int i;
    if (!fixed) return -1;
    for (i = 0; i < s->count; i++) fixed[i] = s->role[i] == HELD;
    s->volume = pow(s->spacing, 3);
    s->c = 4 * 7.5 * s->shear / lattice_sum(s);
    s->dt = 0.4 * s->spacing / sqrt((s->bulk + 4 * s->shear / 3) / s->density);
    def.gravity.z = -s->gravity;
    def.integrator = PERI_BDF2;
    def.tolerance = 1e-5;
    def.parallel.threads = s->options.threads;
    s->world = peri_world_create(&def, &err);
    if (!s->world) return free(fixed), studio_error("%s", err.text);
    body.material = peri_material_create(s->world, &s->material);
    body.points = s->point;
    body.count = s->count;
    body.spacing = s->spacing;
    body.horizon = s->horizon / s->spacing;
    body.kernel_power = -1;
    body.partial_volume = 1;
    body.fixed = fixed;
    s->body = peri_body_create(s->world, &body);
    free(fixed);
    return s->body.index1 ? 0 : studio_failed(s->world);
}

/* ---- files ---- */

static FILE *open_file(const job *s, const char *extension, char path[STUDIO_PATH]) {
    snprintf(path, STUDIO_PATH, "%s/%s%s", s->options.out, shape_name[s->shape], extension);
    return studio_create(path);
}

static int write_data(const job *s) {
    char path[STUDIO_PATH];
    double lo[3] = {HUGE_VAL, HUGE_VAL, HUGE_VAL}, hi[3] = {-HUGE_VAL, -HUGE_VAL, -HUGE_VAL};
    FILE *f = open_file(s, ".data", path);
    int i, c;
    if (!f) return -1;
    for (i = 0; i < 3 * s->count; i++) {
        lo[i % 3] = fmin(lo[i % 3], s->point[i] - s->spacing);
        hi[i % 3] = fmax(hi[i % 3], s->point[i] + s->spacing);
    }
    fprintf(f, "%s: points at rest; types 1 free, 2 held, 3 loaded\n\n%d atoms\n%d atom types\n", shape_name[s->shape],
            s->count, ROLES);
    for (c = 0; c < 3; c++) fprintf(f, "%.17g %.17g %clo %chi\n", lo[c], hi[c], "xyz"[c], "xyz"[c]);
    fprintf(f, "\nAtoms # peri: id type volume density x y z\n\n");
    for (i = 0; i < s->count; i++)
        fprintf(f, "%d %d %.17g %.17g %.17g %.17g %.17g\n", i + 1, s->role[i] + 1, s->volume, s->density,
                s->point[3 * i], s->point[3 * i + 1], s->point[3 * i + 2]);
    return studio_finish(f, path);
}

/* Everything up to the step at rest, in which the bonds are made. */
static void write_head(const job *s, FILE *f) {
    const char *name = shape_name[s->shape];
    fprintf(f, "# %s: %d particles, E %g Pa, nu %g, %g kg/m^3, spacing %g m, horizon %g spacings\n", name, s->count,
            s->young, s->poisson, s->density, s->spacing, s->horizon / s->spacing);
    fprintf(f, "#   lmp -in %s.in        mpirun -np 64 lmp -in %s.in\n", name, name);
    fprintf(f, "# In the library: peri_material_linear, horizon %g, kernel_power -1, partial_volume 1.\n",
            s->horizon / s->spacing);
    fprintf(f, "# Forces are per volume and masses are densities; energies are sums of densities.\n\n");
    fprintf(f, "units           si\nboundary        s s s\natom_style      peri\natom_modify     map array\n");
    fprintf(f, "lattice         sc %.17g    # tells the pair style the spacing\n", s->spacing);
    fprintf(f, "read_data       %s.data\n", name);
    fprintf(f, "group           held type 2\ngroup           loaded type 3\n\n");
    fprintf(f, "pair_style      peri/%s\n", style_name[s->style]);
    if (s->style == LPS)
        fprintf(f, "pair_coeff      * * %.17g %.17g %.17g 1e30 0    # K, G, horizon; no bond breaks\n", s->bulk,
                s->shear, s->horizon);
    else
        fprintf(f, "pair_coeff      * * %.17g %.17g 1e30 0    # c (N/m^6), horizon; no bond breaks\n", s->c,
                s->horizon);
    fprintf(f, "neighbor        %g bin\ncomm_modify     cutoff %g    # partners of stretched bonds, on other ranks\n",
            s->spacing, 1.5 * s->horizon + s->spacing);
    fprintf(f, "timestep        %g\nfix             move all nve\n", s->dt);
    fprintf(f, "run             1    # at rest: bonds are made here\n");
}

static int write_scene(const job *s) {
    char path[STUDIO_PATH];
    const char *name = shape_name[s->shape];
    FILE *f = open_file(s, ".in", path);
    int steps = (int)ceil(s->time / s->dt), every = steps > 20 ? steps / 20 : 1;
    if (!f) return -1;
    write_head(s, f);
    fprintf(f, "\nreset_timestep  0\ntimestep        %.17g\n", s->time / steps);
    if (fabs(s->gravity) > 0) fprintf(f, "fix             gravity all gravity %.17g vector 0 0 -1\n", s->gravity);
    if (fabs(s->load) > 0 && s->members[LOADED])
        fprintf(f, "fix             load loaded addforce 0 0 %.17g    # %g N over their volume\n",
                -s->load / (s->members[LOADED] * s->volume), -s->load);
    if (s->members[HELD]) fprintf(f, "fix             held held setforce 0 0 0\n");
    fprintf(f, "compute         damage all damage/atom\ncompute         worst all reduce max c_damage\n");
    fprintf(f, "thermo_style    custom step time ke c_worst\nthermo          %d\n", every);
    fprintf(f, "dump            path all custom %d %s.*.dump id type x y z vx vy vz\n", every, name);
    fprintf(f, "dump_modify     path sort id\n");
    fprintf(f, "run             %d\n", steps);
    fprintf(f, "write_dump      all custom %s.end.dump id x y z modify sort id format float %%.17g\n", name);
    return studio_finish(f, path);
}

/* The script of the check: forces at the deformed points. */
static int write_probe(const job *s) {
    char path[STUDIO_PATH];
    const char *name = shape_name[s->shape];
    FILE *f = open_file(s, ".now.dump", path);
    int i, c;
    if (!f) return -1;
    fprintf(f, "ITEM: TIMESTEP\n1\nITEM: NUMBER OF ATOMS\n%d\nITEM: BOX BOUNDS ss ss ss\n", s->count);
    for (c = 0; c < 3; c++) fprintf(f, "%g %g\n", -1e3, 1e3);
    fprintf(f, "ITEM: ATOMS id x y z\n");
    for (i = 0; i < s->count; i++)
        fprintf(f, "%d %.17g %.17g %.17g\n", i + 1, s->now[3 * i], s->now[3 * i + 1], s->now[3 * i + 2]);
    if (studio_finish(f, path)) return -1;
    f = open_file(s, ".check.in", path);
    if (!f) return -1;
    write_head(s, f);
    fprintf(f, "read_dump       %s.now.dump 1 x y z box no\nrun             0\n", name);
    fprintf(f, "write_dump      all custom %s.force.dump id fx fy fz modify sort id format float %%.17g\n", name);
    return studio_finish(f, path);
}

/* Three values per particle from a dump sorted by id. */
static int read_dump(const job *s, const char *extension, double *out) {
    char path[STUDIO_PATH], line[512];
    FILE *f;
    int i = 0;
    snprintf(path, sizeof path, "%s/%s%s", s->options.out, shape_name[s->shape], extension);
    f = fopen(path, "rb");
    if (!f) return studio_error("cannot open %s: %s", path, strerror(errno));
    while (fgets(line, sizeof line, f) && strncmp(line, "ITEM: ATOMS", 11) != 0) continue;
    for (; i < s->count && fgets(line, sizeof line, f); i++) {
        char *at = line;
        int c, id = (int)strtol(at, &at, 10);
        if (id != i + 1) break;
        for (c = 0; c < 3; c++) out[3 * i + c] = strtod(at, &at);
    }
    fclose(f);
    return i == s->count ? 0 : studio_error("%s ends at particle %d of %d", path, i, s->count);
}

/* ---- the library's run ---- */

static int run_here(job *s) {
    const int steps = (int)ceil(s->time / (s->options.check ? s->dt : 1e-3));  /* the check: LAMMPS' own */
    double *force = (double *)studio_alloc(3 * (size_t)s->count, sizeof(double)), start = studio_seconds();
    int i, bad = !force;
    for (i = 0; i < s->count && !bad; i++)
        if (s->role[i] == LOADED) force[3 * i + 2] = -s->load / s->members[LOADED];
    bad = bad || peri_body_set_forces(s->world, s->body, 0, s->count, force);
    for (i = 0; i < steps && !bad; i++) {
        studio_progress(&s->options, i, steps, "the library");
        bad = peri_world_step(s->world, s->time / steps) != PERI_OK;
    }
    studio_progress(&s->options, steps, steps, NULL);
    s->seconds[0] = studio_seconds() - start;
    free(force);
    if (bad) return studio_failed(s->world);
    memcpy(s->here, peri_body_positions(s->world, s->body), 3 * (size_t)s->count * sizeof(double));
    return 0;
}

/* ---- LAMMPS' run ---- */

static int find_lammps(void) {
#ifdef _WIN32
    return system("lmp -h > NUL 2>&1") == 0;
#else
    return system("lmp -h > /dev/null 2>&1") == 0;
#endif
}

static int run_lammps(const job *s, const char *extension) {
    char command[2 * STUDIO_PATH];
    const char *name = shape_name[s->shape];
    if (strchr(s->options.out, '"')) return studio_error("no quotes in --out, please");
    snprintf(command, sizeof command, "cd \"%s\" && lmp -in %s%s -screen none -log %s.log", s->options.out, name,
             extension, name);
    if (system(command) != 0) return studio_error("failed: %s; see the end of %s.log there", command, name);
    return 0;
}

static int run_there(job *s) {
    double start = studio_seconds();
    if (run_lammps(s, ".in") || read_dump(s, ".end.dump", s->there)) return -1;
    s->seconds[1] = studio_seconds() - start;
    return 0;
}

/* ---- checks ---- */

/* Bends, twists and stretches the scene: bonds change by some per cent. */
static void deform(job *s) {
    double size = studio_number("--length", 1);
    int i;
    for (i = 0; i < s->count; i++) {
        double x = s->point[3 * i] / size, y = s->point[3 * i + 1] / size, z = s->point[3 * i + 2] / size;
        s->now[3 * i] = size * (x + 0.03 * x * x + 0.05 * x * z);
        s->now[3 * i + 1] = size * (y - 0.06 * x * z + 0.02 * y);
        s->now[3 * i + 2] = size * (z + 0.08 * x * x + 0.06 * x * y);
    }
}

/* Marks the particles whose bonds all lead to particles with full families: where peri/pmb is the library's solid. */
static int mark_inner(const job *s, unsigned char *inner) {
    double full = lattice_sum(s), *sum = (double *)studio_alloc((size_t)s->count, sizeof(double));
    int pass, i, j, c;
    for (pass = 0; sum && pass < 2; pass++)
        for (i = 0; i < s->count; i++) {
            inner[i] = sum[i] > (1 - 1e-9) * full;
            for (j = 0; j < s->count; j++) {
                double r = 0;
                for (c = 0; c < 3; c++) r += pow(s->point[3 * j + c] - s->point[3 * i + c], 2);
                r = sqrt(r);
                if (pass == 0) sum[i] += r * ramp(s, r) * s->volume;
                else if (r <= s->horizon && sum[j] <= (1 - 1e-9) * full) inner[i] = 0;
            }
        }
    free(sum);
    return sum ? 0 : -1;
}

/* Largest difference of a force from LAMMPS' over the largest force. */
static int compare_forces(job *s, double *worst, int *compared) {
    size_t n = 3 * (size_t)s->count;
    double *here = (double *)studio_alloc(n, sizeof(double)), *there = (double *)studio_alloc(n, sizeof(double));
    unsigned char *inner = (unsigned char *)studio_alloc((size_t)s->count, 1);
    double most = 0;
    int i, bad = !here || !there || !inner;
    if (!bad) memset(inner, 1, (size_t)s->count);
    bad = bad || (s->style == PMB && mark_inner(s, inner));
    bad = bad || write_probe(s) || run_lammps(s, ".check.in") || read_dump(s, ".force.dump", there);
    if (!bad && (peri_body_set_positions(s->world, s->body, 0, s->count, s->now) ||
                 peri_body_forces(s->world, s->body, here) ||
                 peri_body_set_positions(s->world, s->body, 0, s->count, s->point)))
        bad = studio_failed(s->world);
    *worst = 0;
    *compared = 0;
    for (i = 0; !bad && i < 3 * s->count; i++) {
        if (!inner[i / 3]) continue;
        *worst = fmax(*worst, fabs(here[i] - s->volume * there[i]));
        most = fmax(most, fabs(here[i]));
        *compared += i % 3 == 0;
    }
    *worst /= most;
    free(here);
    free(there);
    free(inner);
    return bad ? -1 : 0;
}

/* rms distance of the two ends over the rms way of the library's. */
static double apart(const job *s) {
    double off = 0, way = 0;
    int i;
    for (i = 0; i < 3 * s->count; i++) {
        off += pow(s->here[i] - s->there[i], 2);
        way += pow(s->here[i] - s->point[i], 2);
    }
    return sqrt(off / way);
}

/* What the files say, read again. */
static int check_files(const job *s) {
    char path[STUDIO_PATH];
    studio_bytes text;
    const char *at;
    double volume = 0, mass = 0, moved = 0;
    int i, c, held = 0;
    snprintf(path, sizeof path, "%s/%s.data", s->options.out, shape_name[s->shape]);
    if (studio_read(path, &text)) return -1;
    at = strstr((const char *)text.data, "x y z\n");
    for (i = 0; i < s->count && at; i++) {
        char *end = (char *)(size_t)(at + (i ? 0 : 6));
        double v[7];
        for (c = 0; c < 7; c++) v[c] = strtod(end, &end);
        held += v[1] < 2.5 && v[1] > 1.5;
        volume += v[2];
        mass += v[2] * v[3];
        for (c = 0; c < 3; c++) moved = fmax(moved, fabs(v[4 + c] - s->point[3 * i + c]));
        at = end;
    }
    free(text.data);
    studio_check("mass in the data file over the library's", mass / (s->density * s->volume * s->count), "", 1 - 1e-12,
                 1 + 1e-12);
    studio_check("volume over particles times spacing^3", volume / (s->volume * s->count), "", 1 - 1e-12, 1 + 1e-12);
    studio_check("points read again: largest difference", moved, "m", 0, 0);
    studio_check("held particles", held, "", s->members[HELD], s->members[HELD]);
    return 0;
}

/* Forces of both styles, and the motion of the scene, here and by LAMMPS. */
static int check(job *s) {
    double worst = 0;
    int compared = 0;
    if (check_files(s)) return -1;
    if (!s->lammps) {
        printf("not compared with LAMMPS: no program lmp (apt-get install lammps)\n");
        return 0;
    }
    deform(s);
    if (compare_forces(s, &worst, &compared)) return -1;
    if (compared == 0) return studio_error("no particle is two horizons inside: raise --across");
    printf("peri/%s: forces on %d of %d particles compared\n", style_name[s->style], compared, s->count);
    studio_check("difference from LAMMPS' forces over the largest", worst, "", 0, 1e-8);
    if (s->style == LPS) {
        if (run_here(s) || run_there(s)) return -1;
        studio_check("difference of the ends over the way", apart(s), "", 0, 0.02);
    }
    return 0;
}

/* ---- pictures ---- */

static int draw(const job *s, const double *x, studio_image *im) {
    static const float role_rgb[ROLES][3] = {{0.3f, 0.55f, 0.75f}, {0.5f, 0.52f, 0.56f}, {0.9f, 0.5f, 0.2f}};
    float target[3], lo[3] = {1e9f, 1e9f, 1e9f}, hi[3] = {-1e9f, -1e9f, -1e9f};
    double size = studio_number("--length", 1), most = 1e-9 * size;
    studio_camera camera;
    studio_scene scene;
    int i, c, bad = 0;
    studio_scene_begin(&scene);
    for (i = 0; i < 3 * s->count; i++) {
        lo[i % 3] = fminf(lo[i % 3], (float)s->point[i]);
        hi[i % 3] = fmaxf(hi[i % 3], (float)s->point[i]);
        if (i % 3 == 2) most = fmax(most, fabs(s->here[i] - s->point[i]));
    }
    for (c = 0; c < 3; c++) target[c] = 0.5f * (lo[c] + hi[c]);
    scene.look.height = lo[2] - (float)(0.5 * s->spacing + fmin(1.2 * most, size));
    studio_set(scene.look.centre, target[0], target[1], scene.look.height);
    scene.look.radius = (float)(0.8 * size);
    for (i = 0; i < s->count && !bad; i++) {
        float p[3], rgb[3];
        for (c = 0; c < 3; c++) p[c] = (float)x[3 * i + c];
        studio_colormap((float)(fabs(x[3 * i + 2] - s->point[3 * i + 2]) / most), rgb);
        bad = studio_scene_ball(&scene, p, 0.58f * (float)s->spacing, x == s->point ? role_rgb[s->role[i]] : rgb);
    }
    studio_orbit(&camera, target, (hi[2] - lo[2] > 0.6f * (float)size ? 4.2f : 3.2f) * (float)size, -30, 16, 22);
    bad = bad || studio_render(&scene, &camera, im);
    studio_scene_end(&scene);
    return bad;
}

/* The scene as written, and its end by the library and by LAMMPS. */
static int picture(const job *s) {
    const double *state[3];
    studio_image sheet = {0, 0, NULL}, panel = {0, 0, NULL};
    int w = s->options.width, h = s->options.height * 3 / 4, k, bad, panels = s->lammps ? 3 : 2;
    char text[128];
    state[0] = s->point;
    state[1] = s->here;
    state[2] = s->there;
    bad = studio_image_make(&sheet, w, panels * h) || studio_image_make(&panel, w, h);
    for (k = 0; k < panels && !bad; k++) {
        bad = draw(s, state[k], &panel);
        if (k == 0)
            snprintf(text, sizeof text, "written: %d particles, %d bonds; grey held, orange loaded", s->count,
                     peri_world_stats(s->world).bonds);
        else
            snprintf(text, sizeof text, "after %g s, %s (%.1f s): coloured by descent", s->time,
                     k == 1 ? "the library" : s->style == LPS ? "LAMMPS peri/lps" : "LAMMPS peri/pmb",
                     s->seconds[k - 1]);
        if (!bad) studio_panel(&sheet, &panel, 0, k, text);
    }
    studio_image_free(&panel);
    bad = bad || studio_png(studio_path(s->options.out, "lammps_export.png"), &sheet);
    studio_image_free(&sheet);
    return bad ? -1 : 0;
}

/* ---- main ---- */

static int run(job *s) {
    if (s->options.check) return check(s);
    if (s->count > RUN_AT_MOST || studio_extra("--no-run")) return 0;
    if (run_here(s) || (s->lammps && run_there(s))) return -1;
    if (s->lammps)
        printf("after %g s the library (%.1f s) and LAMMPS (%.1f s) differ by %.2g of the way\n", s->time,
               s->seconds[0], s->seconds[1], apart(s));
    else printf("not compared with LAMMPS: no program lmp (apt-get install lammps)\n");
    return picture(s);
}

static int scene(job *s, int second) {
    size_t n;
    int bad = choose(s, second) || make_points(s) || make_roles(s) || create(s) || studio_folder(s->options.out);
    n = 3 * (size_t)s->count;
    s->now = (double *)studio_alloc(3 * n, sizeof(double));
    bad = bad || !s->now;
    s->here = s->now + n;
    s->there = s->here + n;
    s->lammps = !bad && find_lammps();
    bad = bad || write_data(s) || write_scene(s) || run(s);
    free(s->point);
    free(s->now);
    free(s->role);
    peri_world_destroy(s->world);
    return bad ? -1 : 0;
}

int main(int argc, char **argv) {
    static job s[2];
    int bad;
    if (studio_begin(&app, argc, argv, &s[0].options)) return studio_exit_code();
    s[1].options = s[0].options;
    bad = scene(&s[0], 0);
    if (s[0].options.check && !studio_extra("--style")) bad = bad || scene(&s[1], 1);
    return bad ? 1 : studio_end(&s[0].options);
}
