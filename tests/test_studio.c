/* test_studio.c - the examples' helper: meshes, pictures, animations, plots and the command line.
 *
 * Contents: tiny inflate and GIF readers, mesh tests, fuzzing, pictures, renderer, options.  Scratch files go to
 * build/out/test_studio.  Run from the top of the checkout (the figure is read from examples/models). */
#include "../examples/studio.h"

#include "test.h"

#define DIR "build/out/test_studio"

static unsigned random_state = 12345u;

static unsigned random_bits(void) {
    random_state = random_state * 1664525u + 1013904223u;
    return random_state >> 8;
}

/* ---------------------------------------------------------------------------------- readers --------- */

typedef struct reader {
    const unsigned char *p;
    size_t size, at; /* at counts bits */
    int bad;
} reader;

static unsigned take(reader *r, int bits) {
    unsigned value = 0;
    int i;
    for (i = 0; i < bits; ++i, ++r->at) {
        if (r->at / 8 >= r->size) return r->bad = 1, 0u;
        value |= (unsigned)(r->p[r->at / 8] >> (r->at & 7) & 1) << i;
    }
    return value;
}

/* Decodes one symbol of the canonical code with these lengths. */
static int symbol(reader *r, const unsigned char *length, int n) {
    int code = 0, first = 0, size, i;
    for (size = 1; size < 16 && !r->bad; ++size) {
        int count = 0;
        code |= (int)take(r, 1);
        for (i = 0; i < n; ++i) count += length[i] == size;
        if (code - first < count) {
            int want = code - first;
            for (i = 0; i < n; ++i)
                if (length[i] == size && want-- == 0) return i;
        }
        first = (first + count) << 1;
        code <<= 1;
    }
    r->bad = 1;
    return 0;
}

/* The sum of 2^-length must be exactly one. */
static int complete(const unsigned char *length, int n) {
    long sum = 0;
    int i;
    for (i = 0; i < n; ++i) sum += length[i] ? 32768L >> length[i] : 0;
    return sum == 32768L;
}

static void tables(reader *r, unsigned char *length, int *literals, int *distances) {
    static const unsigned char order[19] = {16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15};
    unsigned char small[19];
    int i, n = 0, sent;
    *literals = 257 + (int)take(r, 5);
    *distances = 1 + (int)take(r, 5);
    sent = 4 + (int)take(r, 4);
    memset(small, 0, sizeof small);
    for (i = 0; i < sent; ++i) small[order[i]] = (unsigned char)take(r, 3);
    if (!complete(small, 19)) r->bad = 1;
    while (n < *literals + *distances && !r->bad) {
        int s = symbol(r, small, 19), repeat = 1;
        unsigned char value = (unsigned char)s;
        if (s == 16 && n > 0) value = length[n - 1];
        if (s == 16) repeat = 3 + (int)take(r, 2);
        if (s == 17) repeat = 3 + (int)take(r, 3);
        if (s == 18) repeat = 11 + (int)take(r, 7);
        if (s > 16) value = 0;
        while (repeat-- > 0 && n < 320) length[n++] = value;
    }
    if (n != *literals + *distances || !complete(length, *literals)) r->bad = 1;
}

/* Decodes a zlib stream of dynamic blocks; returns the number of bytes, 0 when anything is wrong. */
static size_t inflate(const unsigned char *p, size_t size, unsigned char *out, size_t room) {
    reader r;
    size_t n = 0, i;
    int last = 0, k;
    uint32_t a = 1, b = 0, sum;
    memset(&r, 0, sizeof r);
    r.p = p;
    r.size = size;
    if (take(&r, 16) % 256 != 0x78 || (p[0] * 256 + p[1]) % 31 != 0) return 0;
    while (!last && !r.bad) {
        unsigned char length[320];
        int literals, distances, s = 0;
        last = (int)take(&r, 1);
        if (take(&r, 2) != 2) return 0;
        memset(length, 0, sizeof length);
        tables(&r, length, &literals, &distances);
        while (!r.bad && (s = symbol(&r, length, literals)) != 256) {
            size_t count = 3, distance = 1;
            if (s < 256) {
                if (n >= room) return 0;
                out[n++] = (unsigned char)s;
                continue;
            }
            for (k = 257; k < s; ++k) count += k < 265 ? 1u : 1u << ((k - 261) / 4);
            if (s == 285) count = 258;
            else count += s < 265 ? 0u : take(&r, (s - 261) / 4);
            s = symbol(&r, length + literals, distances);
            for (k = 0; k < s; ++k) distance += k < 4 ? 1u : 1u << (k / 2 - 1);
            distance += s < 4 ? 0u : take(&r, s / 2 - 1);
            if (distance > n || n + count > room) return 0;
            for (i = 0; i < count; ++i, ++n) out[n] = out[n - distance];
        }
    }
    r.at = (r.at + 7) / 8;
    for (i = 0; i < n; ++i) {
        a = (a + out[i]) % 65521u;
        b = (b + a) % 65521u;
    }
    if (r.bad || r.at + 4 != size) return 0;
    sum = (uint32_t)p[r.at] << 24 | (uint32_t)p[r.at + 1] << 16 | (uint32_t)p[r.at + 2] << 8 | p[r.at + 3];
    return sum == (b << 16 | a) ? n : 0;
}

static uint32_t big_endian(const unsigned char *p) {
    return (uint32_t)p[0] << 24 | (uint32_t)p[1] << 16 | (uint32_t)p[2] << 8 | p[3];
}

/* 1 when the file is a well-formed PNG that holds exactly this image. */
static int png_holds(const char *path, const studio_image *im) {
    studio_bytes f;
    size_t at = 8, row = 3 * (size_t)im->width, n = (row + 1) * (size_t)im->height, i, y;
    unsigned char *raw = (unsigned char *)malloc(n + 1);
    int same = raw != NULL, chunks = 0;
    if (studio_read(path, &f)) return free(raw), 0;
    same = same && f.size > 8 && memcmp(f.data, "\x89PNG\r\n\x1a\n", 8) == 0;
    while (same && at + 12 <= f.size) {
        size_t size = big_endian(f.data + at);
        const unsigned char *data = f.data + at + 8;
        if (size > f.size - at - 12) break;
        same = studio_crc(0, data - 4, size + 4) == big_endian(data + size);
        if (memcmp(data - 4, "IHDR", 4) == 0)
            same = same && big_endian(data) == (uint32_t)im->width && big_endian(data + 4) == (uint32_t)im->height;
        if (memcmp(data - 4, "IDAT", 4) == 0) same = same && inflate(data, size, raw, n + 1) == n;
        at += size + 12;
        ++chunks;
    }
    same = same && chunks == 3 && at == f.size;
    for (y = 0; same && y < (size_t)im->height; ++y)
        for (i = 0; i < row; ++i) {
            unsigned char *line = raw + (row + 1) * y + 1;
            int a = i < 3 ? 0 : line[i - 3], b = y ? line[i - row - 1] : 0, c = i < 3 || !y ? 0 : line[i - row - 4];
            int kind = line[-1], pa = abs(b - c), pb = abs(a - c), pc = abs(a + b - 2 * c), guess = 0;
            if (kind == 1) guess = a;
            if (kind == 2) guess = b;
            if (kind == 3) guess = (a + b) / 2;
            if (kind == 4) guess = pa <= pb && pa <= pc ? a : pb <= pc ? b : c;
            line[i] = (unsigned char)(line[i] + guess);
            if (line[i] != im->rgb[y * row + i]) same = 0;
        }
    free(raw);
    free(f.data);
    return same;
}

/* Decodes the LZW code of one GIF frame into indices; returns how many there are. */
static size_t gif_indices(const unsigned char *p, size_t size, unsigned char *out, size_t room) {
    static int before[4096];
    static unsigned char tail[4096], stack[4096];
    reader r;
    size_t n = 0;
    int next = 258, bits = 9, previous = -1, code, c, depth;
    unsigned char head = 0;
    memset(&r, 0, sizeof r);
    r.p = p;
    r.size = size;
    for (;;) {
        code = (int)take(&r, bits);
        if (r.bad || code == 257) break;
        if (code == 256) {
            next = 258;
            bits = 9;
            previous = -1;
            continue;
        }
        if (code > next || (code == next && previous < 0)) return 0;
        c = code == next ? previous : code;
        depth = 0;
        if (code == next) stack[depth++] = head;
        for (; c >= 258; c = before[c]) stack[depth++] = tail[c];
        stack[depth++] = head = (unsigned char)c;
        if (code == next) stack[0] = head;
        if (previous >= 0 && next < 4096) {
            before[next] = previous;
            tail[next++] = head;
            if (next == 1 << bits && bits < 12) ++bits;
        }
        if (n + (size_t)depth > room) return 0;
        while (depth > 0) out[n++] = stack[--depth];
        previous = code;
    }
    return r.bad ? 0 : n;
}

static size_t little(const unsigned char *p) { return p[0] + 256u * p[1]; }

/* Plays the file; after frame number `count` the screen is in rgb.  Returns the frames seen, -1 when damaged. */
static int gif_play(const char *path, int width, int height, int count, unsigned char *rgb) {
    studio_bytes f, code;
    size_t at = 13 + 768, w, h, x, y, i;
    int frames = 0;
    unsigned char *index = (unsigned char *)malloc((size_t)width * (size_t)height);
    if (studio_read(path, &f)) return free(index), -1;
    if (memcmp(f.data, "GIF89a", 6) || little(f.data + 6) != (size_t)width || little(f.data + 8) != (size_t)height)
        frames = -1;
    while (frames >= 0 && frames < count && at + 11 < f.size && f.data[at] != ';') {
        const unsigned char *palette = f.data + 13, *head = f.data + at;
        if (head[0] == '!') {
            for (at += 2; f.data[at]; at += 1u + f.data[at]) continue;
            ++at;
            continue;
        }
        x = little(head + 1);
        y = little(head + 3);
        w = little(head + 5);
        h = little(head + 7);
        at += 10;
        if (head[9] & 0x80) palette = f.data + at, at += 768;
        memset(&code, 0, sizeof code);
        for (++at; at < f.size && f.data[at]; at += 1u + f.data[at]) studio_put(&code, f.data + at + 1, f.data[at]);
        ++at;
        if (head[0] != ',' || x + w > (size_t)width || y + h > (size_t)height ||
            gif_indices(code.data, code.size, index, w * h) != w * h)
            frames = -2;
        for (i = 0; i < w * h && frames >= 0; ++i)
            if (index[i] != 255)
                memcpy(rgb + 3 * ((y + i / w) * (size_t)width + x + i % w), palette + 3 * index[i], 3);
        free(code.data);
        ++frames;
    }
    free(f.data);
    free(index);
    return frames;
}

/* ----------------------------------------------------------------------------------- meshes --------- */

/* Parses text of `size` bytes as a mesh file. */
static int parse(const char *text, size_t size, studio_mesh *m) {
    studio_bytes b;
    memset(&b, 0, sizeof b);
    studio_put(&b, text, size);
    studio_put(&b, "", 1);
    --b.size;
    return studio_mesh_parse("text", &b, m);
}

#define CUBE_V "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\n"
#define CUBE CUBE_V "f 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n"

/* Six times the volume; positive when the triangles face outwards. */
static double volume(const studio_mesh *m) {
    double sum = 0.0;
    int i;
    for (i = 0; i < m->triangles; ++i) {
        float c[3];
        studio_cross(m->v + 3 * m->t[3 * i + 1], m->v + 3 * m->t[3 * i + 2], c);
        sum += (double)studio_dot(m->v + 3 * m->t[3 * i], c);
    }
    return sum / 6.0;
}

static void obj_forms(void) {
    static const char *forms[] = {
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n",
        "# note\r\n  v 0 0 0\r\nv 1 0 0 1\r\nv\t0 1 0\r\nvn 0 0 1\r\nf 1//1 2//1 3//1 # end\r\n",
        "o a\ng b\nv 0 0 0\nv 1e0 0 0\nv 0 +1 0\nusemtl x\ns off\nf 1/1/1 2/1/1 3/1/1",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\n",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3//-1 -2//-1 -1//-1\n"};
    studio_mesh m;
    size_t i;
    for (i = 0; i < sizeof forms / sizeof forms[0]; ++i) {
        CHECK(parse(forms[i], strlen(forms[i]), &m) == 0);
        CHECK(m.vertices == 3 && m.triangles == 1);
        if (m.triangles == 1) CHECK(m.t[0] == 0 && m.t[1] == 1 && m.t[2] == 2 && m.v[3] == 1.0f && m.v[7] == 1.0f);
        if (m.n) NEAR(m.n[2], 1.0, 1e-6);
        studio_mesh_free(&m);
    }
    CHECK(parse(CUBE, strlen(CUBE), &m) == 0);
    CHECK(m.vertices == 8 && m.triangles == 12);
    NEAR(volume(&m), 1.0, 1e-6);
    studio_mesh_free(&m);
}

static void obj_refused(void) {
    static const char *bad[][2] = {
        {"v 0 0\n", "text:1:"},          {"v 0 0 x\n", "text:1:"},        {"v 0 0 nan\n", "three numbers"},
        {"v 0 0 1e39\n", "text:1:"},     {CUBE_V "f 1 2\n", "text:9:"},   {CUBE_V "f 1 2 9\n", "8 vertices"},
        {CUBE_V "f 0 1 2\n", "range"},   {CUBE_V "f 1 2 -9\n", "range"},  {CUBE_V "f 1 2 a\n", "corner"},
        {CUBE_V "f 1 2 3x\n", "text:9:"}, {CUBE_V "f 1 2 99999999999999999999\n", "text:9:"}, {"", "no vertices"},
        {"hello\n", "no vertices"},      {"f 1 2 3\n", "text:1:"}};
    studio_mesh m;
    size_t i;
    studio_state()->mute = 1;
    for (i = 0; i < sizeof bad / sizeof bad[0]; ++i) {
        CHECK(parse(bad[i][0], strlen(bad[i][0]), &m) != 0);
        CHECK(m.v == NULL && m.vertices == 0);
        if (!strstr(studio_state()->message, bad[i][1])) test_complain(__FILE__, (int)i, studio_state()->message);
    }
    CHECK(studio_mesh_load(DIR "/not there.obj", &m) != 0);
    CHECK(strstr(studio_state()->message, "not there.obj") != NULL);
    studio_state()->mute = 0;
}

static void ply_round_trip(void) {
    static const char ascii[] = "ply\r\nformat ascii 1.0\r\ncomment x\r\nelement vertex 4\r\nproperty double x\r\n"
                                "property float y\r\nproperty float z\r\nproperty uchar red\r\nelement face 1\r\n"
                                "property list uchar uint vertex_index\r\nend_header\r\n"
                                "0 0 0 9\r\n1 0 0 9\r\n1 1 0 9\r\n0 1 0 9\r\n4 0 1 2 3\r\n";
    const char *path = DIR "/mesh.ply";
    float scalar[8] = {0, 1, 2, 3, 4, 5, 6, 7};
    studio_mesh m, back;
    CHECK(parse(CUBE, strlen(CUBE), &m) == 0);
    CHECK(studio_ply_mesh(path, &m) == 0);
    CHECK(studio_mesh_load(path, &back) == 0);
    CHECK(back.vertices == m.vertices && back.triangles == m.triangles);
    if (back.vertices == m.vertices && back.triangles == m.triangles) {
        CHECK(memcmp(back.v, m.v, 24 * sizeof(float)) == 0);
        CHECK(memcmp(back.t, m.t, 36 * sizeof(int)) == 0);
        NEAR(back.n[0], m.n[0], 1e-6);
    }
    studio_mesh_free(&back);
    CHECK(studio_ply_points(path, m.vertices, m.v, scalar, "stretch") == 0);
    CHECK(studio_mesh_load(path, &back) == 0);
    CHECK(back.vertices == 8 && back.triangles == 0 && memcmp(back.v, m.v, 24 * sizeof(float)) == 0);
    studio_mesh_free(&back);
    studio_mesh_free(&m);
    CHECK(parse(ascii, sizeof ascii - 1, &m) == 0);
    CHECK(m.vertices == 4 && m.triangles == 2);
    studio_mesh_free(&m);
}

#define PLY "ply\nformat ascii 1.0\n"
#define XYZ "property float x\nproperty float y\nproperty float z\n"
#define FACE "element face 1\nproperty list uchar int vertex_indices\n"

static void ply_refused(void) {
    static const char *bad[][2] = {
        {PLY "element vertex 1\n" XYZ, "end_header"},
        {"ply\nformat binary_big_endian 1.0\nelement vertex 0\n" XYZ "end_header\n", "binary_little_endian"},
        {PLY "element vertex 2\n" XYZ "end_header\n0 0 0\n", "row 2 of element 1"},
        {PLY "element vertex 1\nproperty float x\nend_header\n0\n", "x, y and z"},
        {PLY "element vertex -1\n" XYZ "end_header\n", "element NAME COUNT"},
        {PLY "element vertex 1\nproperty quad x\nend_header\n0\n", "cannot use"},
        {PLY "property float x\nend_header\n", "cannot use"},
        {PLY "element vertex 1\n" XYZ FACE "end_header\n0 0 0\n3 0 0 1\n", "1 vertices"},
        {PLY "element vertex 1\n" XYZ FACE "end_header\n0 0 0\n99999999 0\n", "damaged"},
        {PLY "element vertex 4000000000\n" XYZ "end_header\n0 0 0\n", "cut short"},
        {PLY "element other 4000000000\nend_header\n", "damaged"},
        {PLY "element vertex 1\n" XYZ "end_header\n0 0 inf\n", "damaged"},
        {PLY "element vertex 1\n" XYZ "element vertex 1\n" XYZ "end_header\n0 0 0\n1 1 1\n", "more than one"},
        {PLY "end_header\n", "no vertices"}};
    studio_mesh m;
    size_t i;
    studio_state()->mute = 1;
    for (i = 0; i < sizeof bad / sizeof bad[0]; ++i) {
        CHECK(parse(bad[i][0], strlen(bad[i][0]), &m) != 0);
        CHECK(m.v == NULL);
        if (!strstr(studio_state()->message, bad[i][1])) test_complain(__FILE__, (int)i, studio_state()->message);
    }
    studio_state()->mute = 0;
}

/* Changes up to 4 bytes, or cuts the end off, and parses; only a crash can fail.  Whatever is accepted must be
 * a mesh that can be drawn. */
static void fuzz(const char *text, size_t size, int rounds) {
    char *copy = (char *)malloc(size);
    studio_mesh m;
    int i, k, accepted = 0;
    if (!copy) return;
    studio_state()->mute = 1;
    for (i = 0; i < rounds; ++i) {
        size_t cut = random_bits() % 8 == 0 ? random_bits() % size : size;
        memcpy(copy, text, size);
        for (k = (int)(random_bits() % 4); k >= 0; --k) {
            static const char likely[] = "0123456789-/ \nvf.e";
            char c = random_bits() & 1 ? likely[random_bits() % (sizeof likely - 1)] : (char)(random_bits() & 127);
            copy[random_bits() % size] = c;
        }
        if (parse(copy, cut, &m)) continue;
        ++accepted;
        for (k = 0; k < 3 * m.triangles; ++k)
            if (m.t[k] < 0 || m.t[k] >= m.vertices) test_complain(__FILE__, __LINE__, "corner out of range");
        studio_mesh_free(&m);
    }
    CHECK(accepted > 0);
    studio_state()->mute = 0;
    free(copy);
}

static void fuzz_meshes(void) {
    const char *path = DIR "/fuzz.ply";
    static const char ascii[] = PLY "element vertex 3\n" XYZ "property float nx\nproperty float ny\n"
                                    "property float nz\n" FACE
                                    "end_header\n0 0 0 0 0 1\n1 0 0 0 0 1\n0 1 0 0 0 1\n3 0 1 2\n";
    studio_mesh m;
    studio_bytes b;
    fuzz(CUBE, strlen(CUBE), 2000);
    fuzz(ascii, sizeof ascii - 1, 2000);
    CHECK(parse(CUBE, strlen(CUBE), &m) == 0);
    CHECK(studio_ply_mesh(path, &m) == 0);
    studio_mesh_free(&m);
    if (studio_read(path, &b)) return;
    fuzz((const char *)b.data, b.size, 2000);
    free(b.data);
}

static int edge_order(const void *a, const void *b) { return memcmp(a, b, 2 * sizeof(int)); }

/* The figure is a closed surface: every edge once in each direction. */
static void figure_is_closed(void) {
    studio_mesh m;
    float lo[3], hi[3];
    int (*edge)[2], i, n, good = 1;
    CHECK(studio_mesh_load("examples/models/figure.obj", &m) == 0);
    n = 3 * m.triangles;
    CHECK(m.triangles >= 6000 && m.triangles <= 9000);
    CHECK(volume(&m) > 0.05);
    studio_bounds(m.v, m.vertices, lo, hi);
    NEAR(lo[2], 0.0, 1e-4);
    NEAR(hi[2], 1.0, 1e-4);
    edge = (int (*)[2])malloc((size_t)(n + 1) * sizeof *edge);
    for (i = 0; i < n && edge; ++i) {
        edge[i][0] = m.t[i];
        edge[i][1] = m.t[i % 3 == 2 ? i - 2 : i + 1];
    }
    if (edge && n > 0) qsort(edge, (size_t)n, sizeof *edge, edge_order);
    for (i = 0; i < n && edge; ++i) {
        int back[2];
        back[0] = edge[i][1];
        back[1] = edge[i][0];
        if (i > 0 && edge_order(edge[i], edge[i - 1]) == 0) good = 0;
        if (!bsearch(back, edge, (size_t)n, sizeof *edge, edge_order)) good = 0;
    }
    CHECK(good);
    free(edge);
    studio_mesh_free(&m);
}

static void mesh_fits(void) {
    const float centre[3] = {1.0f, 2.0f, 3.0f};
    float lo[3], hi[3];
    studio_mesh m;
    CHECK(parse(CUBE, strlen(CUBE), &m) == 0);
    studio_mesh_fit(&m, centre, 4.0f);
    studio_bounds(m.v, m.vertices, lo, hi);
    NEAR(lo[0], -1.0, 1e-6);
    NEAR(hi[1], 4.0, 1e-6);
    NEAR(hi[2], 5.0, 1e-6);
    studio_mesh_free(&m);
}

/* --------------------------------------------------------------------------------- pictures --------- */

/* A picture with flat, smooth and noisy parts. */
static void paint(studio_image *im, int shift) {
    int x, y;
    for (y = 0; y < im->height; ++y)
        for (x = 0; x < im->width; ++x) {
            unsigned char *p = im->rgb + 3 * (y * im->width + x);
            p[0] = (unsigned char)(y < im->height / 3 ? 200 : (x * 255) / im->width);
            p[1] = (unsigned char)(40 + y % 150);
            if (x > im->width / 2 && y > im->height / 2) p[1] = (unsigned char)(random_bits() & 63u);
            p[2] = (unsigned char)((x - shift) * (x - shift) + y * y < 900 ? 250 : 90);
        }
}

static void png_is_exact(void) {
    static const int sizes[][2] = {{1, 1}, {2, 3}, {7, 5}, {64, 1}, {301, 200}};
    studio_image im;
    studio_bytes b;
    size_t i;
    for (i = 0; i < sizeof sizes / sizeof sizes[0]; ++i) {
        CHECK(studio_image_make(&im, sizes[i][0], sizes[i][1]) == 0);
        CHECK(studio_png(DIR "/a.png", &im) == 0);
        CHECK(png_holds(DIR "/a.png", &im));
        paint(&im, 20);
        CHECK(studio_png(DIR "/b.png", &im) == 0);
        CHECK(png_holds(DIR "/b.png", &im));
        studio_image_free(&im);
    }
    CHECK(studio_image_make(&im, 640, 480) == 0);
    CHECK(studio_png(DIR "/flat.png", &im) == 0);
    CHECK(studio_read(DIR "/flat.png", &b) == 0);
    CHECK(b.size < 6000);
    free(b.data);
    studio_state()->mute = 1;
    CHECK(studio_png(DIR "/a.png/x.png", &im) != 0);
    studio_image_free(&im);
    CHECK(studio_image_make(&im, 0, 5) != 0);
    CHECK(studio_image_make(&im, 5, 1 << 20) != 0);
    studio_state()->mute = 0;
}

/* Counts like Fibonacci numbers make the deepest Huffman trees; long runs and far copies must come back too. */
static void deflate_is_exact(void) {
    const size_t n = 400000;
    unsigned char *p = (unsigned char *)malloc(n), *q = (unsigned char *)malloc(n + 1);
    size_t i, kind;
    if (!p || !q) return;
    for (kind = 0; kind < 4; ++kind) {
        studio_bytes b;
        size_t size = kind == 3 ? 0 : n;
        for (i = 0; i < n; ++i) {
            unsigned r = random_bits() & 0xffffffu, c = 0;
            while (c < 22 && r > 14829735u) { /* each value 0.618 times as frequent as the one before */
                r = random_bits() & 0xffffffu;
                ++c;
            }
            p[i] = (unsigned char)(kind == 0 ? r >> 16 : kind == 1 ? c * 11 + (r & 1 ? 1 : 0) * (i % 3) : i / 70000);
            if (kind == 1 && i > 40000 && i % 1000 < 300) p[i] = p[i - 32768];
        }
        memset(&b, 0, sizeof b);
        studio_deflate(p, size, &b);
        CHECK(!b.failed);
        CHECK(inflate(b.data, b.size, q, n + 1) == size);
        CHECK(size == 0 || memcmp(p, q, n) == 0);
        free(b.data);
    }
    free(p);
    free(q);
}

static void huffman_is_limited(void) {
    unsigned freq[40], a = 1, b = 1;
    unsigned char length[40];
    uint16_t code[40];
    int i, longest = 0;
    for (i = 0; i < 40; ++i) {
        freq[i] = a;
        b += a;
        a = b - a;
    }
    studio_huffman(freq, 40, 15, length, code);
    for (i = 0; i < 40; ++i) longest = length[i] > longest ? length[i] : longest;
    CHECK(longest <= 15);
    CHECK(complete(length, 40));
}

/* Three scenes in turn: small movements, then quite different colours, so that a new palette is needed. */
static void gif_is_exact(void) {
    const int w = 160, h = 120, frames = 6;
    const char *path = DIR "/a.gif";
    unsigned char *screen = (unsigned char *)calloc(3, 160 * 120), *played = (unsigned char *)calloc(3, 160 * 120);
    studio_image im;
    studio_gif *g;
    int f, own = 0;
    size_t i, n = (size_t)(w * h);
    double error = 0.0;
    if (!screen || !played) return;
    CHECK(studio_image_make(&im, w, h) == 0);
    for (f = 1; f <= frames; ++f) {
        int k;
        random_state = 7u;
        g = studio_gif_begin(path, w, h, 4);
        CHECK(g != NULL);
        if (!g) return;
        memset(screen, 0, 3 * n);
        for (k = 0; k < f; ++k) {
            paint(&im, 20 + 3 * k);
            for (i = 0; i < 3 * n && k > 3; ++i) im.rgb[i] = (unsigned char)(255 - im.rgb[i] / 2);
            CHECK(studio_gif_frame(g, &im) == 0);
            for (i = 0; i < n; ++i)
                if (g->index[i] != 255) memcpy(screen + 3 * i, g->palette + 3 * g->index[i], 3);
        }
        own += g->own;
        CHECK(studio_gif_end(g) == 0);
        memset(played, 0, 3 * n);
        CHECK(gif_play(path, w, h, 1000, played) == f);
        CHECK(memcmp(played, screen, 3 * n) == 0);
    }
    CHECK(own > 0); /* the palette changed */
    for (i = 0; i < 3 * n; ++i) error += fabs((double)im.rgb[i] - (double)screen[i]) / (3.0 * (double)n);
    CHECK(error < 6.0);
    studio_state()->mute = 1;
    CHECK(studio_gif_begin(path, 0, 5, 4) == NULL);
    g = studio_gif_begin(path, w + 1, h, 4);
    CHECK(studio_gif_frame(g, &im) != 0);
    CHECK(studio_gif_end(g) != 0);
    CHECK(studio_gif_frame(NULL, &im) != 0);
    studio_state()->mute = 0;
    studio_image_free(&im);
    free(screen);
    free(played);
}

static void gif_repeats_are_small(void) {
    studio_image im;
    studio_bytes b;
    studio_gif *g = studio_gif_begin(DIR "/still.gif", 200, 150, 5);
    unsigned char *rgb = (unsigned char *)calloc(3, 200 * 150);
    size_t first = 0;
    int i;
    if (!rgb) return;
    CHECK(g && studio_image_make(&im, 200, 150) == 0);
    paint(&im, 50);
    for (i = 0; i < 20; ++i) {
        CHECK(studio_gif_frame(g, &im) == 0);
        if (i == 0) first = (size_t)ftell(g->f);
    }
    CHECK(studio_gif_end(g) == 0);
    CHECK(studio_read(DIR "/still.gif", &b) == 0);
    CHECK(b.size < first + 20 * 40);
    CHECK(gif_play(DIR "/still.gif", 200, 150, 1000, rgb) == 20);
    free(b.data);
    free(rgb);
    studio_image_free(&im);
}

static void colormap_gets_lighter(void) {
    float last = -1.0f, rgb[3], linear[3];
    int i;
    for (i = 0; i <= 1000; ++i) {
        float y;
        studio_colormap((float)i / 1000.0f, rgb);
        studio_linear(rgb, linear);
        y = 0.2126f * linear[0] + 0.7152f * linear[1] + 0.0722f * linear[2];
        CHECK(y > last);
        CHECK(rgb[0] >= 0.0f && rgb[0] <= 1.0f && rgb[1] <= 1.0f && rgb[2] <= 1.0f);
        last = y;
    }
    studio_colormap(-5.0f, rgb);
    studio_colormap(7.0f, linear);
    CHECK(rgb[0] < linear[0]);
    studio_colormap((float)sqrt(-1.0), linear);
    CHECK(linear[0] == rgb[0]);
}

/* Every glyph has ink where it says, and text off the picture is harmless. */
static void text_has_ink(void) {
    const float black[3] = {0.0f, 0.0f, 0.0f};
    studio_image im;
    char text[2] = " ";
    int c, i;
    CHECK(studio_image_make(&im, 40, 40) == 0);
    for (c = 32; c < 127; ++c) {
        int ink = 0;
        studio_image_fill(&im, 1.0f, 1.0f, 1.0f);
        text[0] = (char)c;
        studio_text(&im, 8.0f, 28.0f, 20.0f, black, text);
        for (i = 0; i < 40 * 40; ++i) ink += im.rgb[3 * i] < 128;
        CHECK(c == 32 ? ink == 0 : ink > 2);
        CHECK(studio_glyph(c) != NULL && studio_text_width(text, 10.0f) >= 0.0f);
    }
    studio_text(&im, -500.0f, 900.0f, 30.0f, black, "far away");
    studio_text_at(&im, 20.0f, 20.0f, 30.0f, black, 0.5f, 1, "over\xff the edge");
    studio_text(&im, (float)sqrt(-1.0), 0.0f, 30.0f, black, "nowhere");
    studio_colorbar(&im, 2, 10, 5, 25, 1.0, 1.0, "none");
    studio_colorbar(&im, 2, 10, 5, 25, 1e9, 1e9 + 1e-7, "tight");
    studio_colorbar(&im, 2, 10, 5, 25, -HUGE_VAL, HUGE_VAL, "endless");
    studio_image_free(&im);
}

static void plots_take_anything(void) {
    studio_plot p;
    studio_image im;
    int i, k, s;
    CHECK(studio_image_make(&im, 300, 200) == 0);
    for (i = 0; i < 10; ++i) {
        studio_plot_begin(&p, "title", "x [m]", i & 1 ? "y" : NULL);
        p.log_x = i & 1;
        p.log_y = i >> 1 & 1;
        s = studio_plot_series(&p, "a", i % 3, NULL);
        for (k = 0; k < 10 * (i & 4); ++k) CHECK(studio_plot_point(&p, s, k - 3, exp(0.3 * k) - 5.0) == 0);
        if (i > 5) CHECK(studio_plot_point(&p, s, sqrt(-1.0), HUGE_VAL) == 0);
        if (i > 6) CHECK(studio_plot_point(&p, s, 1e300, -1e300) == 0);
        if (i == 8) p.x_lo = -1.0, p.x_hi = HUGE_VAL;
        studio_plot_draw(&p, &im);
        studio_plot_end(&p);
    }
    studio_plot_begin(&p, NULL, NULL, NULL);
    studio_state()->mute = 1;
    for (i = 0; i < STUDIO_SERIES; ++i) CHECK(studio_plot_series(&p, "", STUDIO_LINE, NULL) == i);
    CHECK(studio_plot_series(&p, "", STUDIO_LINE, NULL) == -1);
    CHECK(studio_plot_point(&p, 99, 0.0, 0.0) != 0 && studio_plot_point(&p, -1, 0.0, 0.0) != 0);
    studio_state()->mute = 0;
    CHECK(studio_plot_write(&p, DIR "/plot.png", 40, 30) == 0);
    studio_plot_end(&p);
    studio_image_free(&im);
}

/* -------------------------------------------------------------------------------- the scene --------- */

/* Brightness 0..255 of the pixel where a point of the scene appears. */
static double brightness(const studio_scene *s, const studio_image *im, float x, float y, float z) {
    float p[3], px, py;
    const unsigned char *c;
    studio_set(p, x, y, z);
    if (!studio_where(s, p, &px, &py) || px < 0.0f || py < 0.0f || px >= (float)im->width || py >= (float)im->height)
        return -1.0;
    c = im->rgb + 3 * ((int)py * im->width + (int)px);
    return (c[0] + c[1] + c[2]) / 3.0;
}

static void ball_casts_shadow(void) {
    const float centre[3] = {0.0f, 0.0f, 0.8f}, red[3] = {0.8f, 0.1f, 0.1f}, target[3] = {0.0f, 0.0f, 0.4f};
    studio_scene s;
    studio_camera c;
    studio_image im, again;
    float px, py;
    const unsigned char *at;
    CHECK(studio_image_make(&im, 160, 120) == 0 && studio_image_make(&again, 160, 120) == 0);
    studio_scene_begin(&s);
    studio_orbit(&c, target, 5.0f, 0.0f, 25.0f, 30.0f);
    studio_set(s.look.light, 0.0f, 0.0f, 1.0f);
    CHECK(studio_scene_ball(&s, centre, 0.3f, red) == 0);
    CHECK(studio_render(&s, &c, &im) == 0);
    CHECK(brightness(&s, &im, 0.0f, 0.0f, 0.0f) + 20.0 < brightness(&s, &im, 0.9f, 0.0f, 0.0f));
    CHECK(studio_where(&s, centre, &px, &py));
    at = im.rgb + 3 * ((int)py * im.width + (int)px);
    CHECK(at[0] > 2 * at[1] && at[0] > 2 * at[2]);
    CHECK(studio_render(&s, &c, &again) == 0);
    CHECK(memcmp(im.rgb, again.rgb, 3 * 160 * 120) == 0);
    studio_scene_end(&s);
    studio_image_free(&im);
    studio_image_free(&again);
}

/* The colour at the picture's pixel x, y. */
static const unsigned char *pixel(const studio_image *im, int x, int y) {
    return im->rgb + 3 * ((size_t)y * (size_t)im->width + (size_t)x);
}

/* A ball far away covers the disc that it should: its area to a row of pixels around it, no holes in a line of it,
 * both its sides at the same distance from the middle to one pixel.  Over (c/r)^2 = 1e6 the rounding of h^2 - d^2
 * c^2 in float is a part of r^2 itself. */
static void distant_balls_are_round(void) {
    const float centre[3] = {0.0f, 0.0f, 0.0f}, red[3] = {0.9f, 0.1f, 0.1f}, radius[2] = {4.0f, 0.5f};
    studio_image im;
    int x, y, k;
    CHECK(studio_image_make(&im, 400, 400) == 0);
    for (k = 0; k < 2; ++k) {
        const double r = 200.0 * (double)radius[k] / (1000.0 * tan(0.5 * STUDIO_PI / 180.0));
        int area = 0, worst = 0;
        studio_scene s;
        studio_camera c;
        studio_scene_begin(&s);
        s.look.ground = 0;
        studio_orbit(&c, centre, 1000.0f, 31.0f, 12.0f, 1.0f);
        CHECK(studio_scene_ball(&s, centre, radius[k], red) == 0 && studio_render(&s, &c, &im) == 0);
        for (y = 0; y < 400; ++y) {
            int left = -1, right = -1, count = 0;
            for (x = 0; x < 400; ++x)
                if (pixel(&im, x, y)[0] > 1.3 * pixel(&im, x, y)[1]) {
                    if (left < 0) left = x;
                    right = x;
                    ++count;
                }
            area += count;
            if (count && abs(left + right - 399) > worst) worst = abs(left + right - 399);
            CHECK(count == 0 || count == right - left + 1);
        }
        NEAR(area, STUDIO_PI * r * r, 2.0 * STUDIO_PI * r);
        CHECK(worst <= 2);
        studio_scene_end(&s);
    }
    studio_image_free(&im);
}

/* The sheet reaches half a spacing over its points, passes through them, and bends as a parabola does. */
static void grids_are_surfaces(void) {
    enum { NX = 7, NY = 5, FINE = 2 };
    float points[3 * NX * NY], lo[3], hi[3];
    int i, j, vx = studio_grid_side(NX, FINE);
    studio_mesh m;
    for (j = 0; j < NY; ++j)
        for (i = 0; i < NX; ++i) {
            float x = 0.1f * (float)i, y = 0.1f * (float)j;
            studio_set(points + 3 * (j * NX + i), x, y, x * x - 2.0f * y * y + x * y);
        }
    CHECK(studio_mesh_grid(&m, points, NX, NY, FINE) == 0);
    CHECK(m.vertices == 15 * 11 && m.triangles == 2 * 14 * 10);
    studio_bounds(m.v, m.vertices, lo, hi);
    NEAR(lo[0], -0.05, 1e-6);
    NEAR(hi[0], 0.65, 1e-6);
    NEAR(lo[1], -0.05, 1e-6);
    NEAR(hi[1], 0.45, 1e-6);
    for (j = 0; j < NY; ++j)
        for (i = 0; i < NX; ++i) {
            const float *v = m.v + 3 * ((FINE * j + 1) * vx + FINE * i + 1), *p = points + 3 * (j * NX + i);
            NEAR(v[2], p[2], 1e-6);
            CHECK(m.n[2 + 3 * ((FINE * j + 1) * vx + FINE * i + 1)] > 0.0f);
            if (i < 1 || j < 1 || i >= NX - 2 || j >= NY - 2) continue;
            v += 3 * (vx + 1); /* half way to the next ones */
            NEAR(v[2], (p[0] + 0.05f) * (p[0] + 0.05f) - 2.0f * (p[1] + 0.05f) * (p[1] + 0.05f) +
                       (p[0] + 0.05f) * (p[1] + 0.05f), 1e-6);
        }
    studio_mesh_free(&m);
    studio_state()->mute = 1;
    CHECK(studio_mesh_grid(&m, points, 1, NY, FINE) != 0);
    studio_state()->mute = 0;
}

static float ring_field(const float p[3], void *context) {
    float r = sqrtf(p[0] * p[0] + p[1] * p[1]) - 0.4f;
    (void)context;
    return sqrtf(r * r + p[2] * p[2]) - 0.15f;
}

/* A closed surface uses every edge once in each direction. */
static int open_edges(const studio_mesh *m) {
    int i, j, k, l, open = 0;
    for (i = 0; i < m->triangles; ++i)
        for (k = 0; k < 3; ++k) {
            int a = m->t[3 * i + k], b = m->t[3 * i + (k + 1) % 3], found = 0;
            for (j = 0; j < m->triangles; ++j)
                for (l = 0; l < 3; ++l) found += m->t[3 * j + l] == b && m->t[3 * j + (l + 1) % 3] == a;
            open += found != 1;
        }
    return open;
}

static double enclosed(const studio_mesh *m) {
    double sum = 0.0;
    int i;
    for (i = 0; i < m->triangles; ++i) {
        float n[3];
        studio_cross(m->v + 3 * m->t[3 * i], m->v + 3 * m->t[3 * i + 1], n);
        sum += (double)studio_dot(n, m->v + 3 * m->t[3 * i + 2]) / 6.0;
    }
    return sum;
}

/* A ring: closed, on the surface, outward, its volume short by the chords' (cell/r)^2/6, doubled for both turns. */
static void surfaces_of_distances(void) {
    const float lo[3] = {-0.6f, -0.6f, -0.2f}, hi[3] = {0.6f, 0.6f, 0.2f}, away[3] = {2.0f, 2.0f, 2.0f};
    const float far_off[3] = {3.0f, 3.0f, 3.0f};
    const double volume = 2.0 * STUDIO_PI * STUDIO_PI * 0.4 * 0.15 * 0.15;
    studio_mesh m;
    int i;
    CHECK(studio_mesh_surface(&m, ring_field, NULL, lo, hi, 0.05f) == 0);
    CHECK(m.triangles > 500 && open_edges(&m) == 0);
    NEAR(enclosed(&m), volume, volume * 0.05 * 0.05 / (0.15 * 0.15) / 3.0);
    for (i = 0; i < m.vertices; ++i) NEAR(ring_field(m.v + 3 * i, NULL), 0.0, 1e-4);
    CHECK(m.vertices - m.triangles / 2 == 0); /* Euler: a ring has one hole */
    studio_mesh_free(&m);
    studio_state()->mute = 1;
    CHECK(studio_mesh_surface(&m, ring_field, NULL, away, far_off, 0.05f) != 0 && !m.v);
    CHECK(studio_mesh_surface(&m, ring_field, NULL, hi, lo, 0.05f) != 0);
    studio_state()->mute = 0;
}

/* Carried around a closed plane curve a direction comes back to itself; along a tube of 12 sides the volume is
 * that of the prism, and the first vertex stands at the mark. */
static void tubes_and_marks(void) {
    enum { N = 40, SIDES = 12 };
    float a[3] = {1, 0, 0}, b[3], v[3] = {0, 0.6f, 0.8f}, mark[9] = {0, 0, 0};
    float points[9] = {0, 0, 0, 0, 0, 0.5f, 0, 0, 1};
    const double prism = SIDES * 0.5 * 0.2 * 0.2 * sin(2.0 * STUDIO_PI / SIDES);
    studio_mesh m;
    int i;
    for (i = 1; i <= N; ++i) {
        float angle = 2.0f * (float)STUDIO_PI * (float)i / N;
        studio_set(b, cosf(angle), sinf(angle), 0);
        studio_carry(a, b, v);
        NEAR(studio_dot(v, b), 0.0, 1e-5);
        NEAR(v[2], 0.8, 1e-4);
        memcpy(a, b, sizeof a);
    }
    NEAR(v[1], 0.6, 1e-4);
    for (i = 0; i < 3; ++i) studio_set(mark + 3 * i, 0.0f, 3.0f, 0.5f);
    CHECK(studio_mesh_tube(&m, points, 3, 0.2f, mark, SIDES) == 0);
    CHECK(open_edges(&m) == 0);
    NEAR(enclosed(&m), prism, 1e-6);
    NEAR(m.v[1], 0.2, 1e-6);
    studio_mesh_free(&m);
    CHECK(studio_mesh_tube(&m, points, 3, 0.2f, NULL, SIDES) == 0);
    NEAR(enclosed(&m), prism, 1e-6);
    studio_mesh_free(&m);
}

/* A sheet shows one colour from above and another from below, and its own shadow does not fall on it in slanting
 * light: of the 25 texels that make the soft border at most one corner's worth may be missed. */
static void sheets_have_two_sides(void) {
    const float target[3] = {0, 0, 0}, white[3] = {0.9f, 0.9f, 0.9f}, blue[3] = {0.2f, 0.2f, 1.0f};
    float points[3 * 25];
    studio_scene s;
    studio_camera c;
    studio_image im;
    studio_mesh m;
    int i, side;
    for (i = 0; i < 25; ++i) studio_set(points + 3 * i, 0.2f * (float)(i % 5 - 2), 0.2f * (float)(i / 5 - 2), 0.0f);
    CHECK(studio_image_make(&im, 80, 80) == 0 && studio_mesh_grid(&m, points, 5, 5, 2) == 0);
    for (side = 0; side < 2; ++side) {
        const unsigned char *at;
        studio_scene_begin(&s);
        s.look.ground = 0;
        studio_set(s.look.light, 1.0f, 0.3f, 0.35f);
        studio_orbit(&c, target, 3.0f, 20.0f, side ? -60.0f : 60.0f, 10.0f);
        CHECK(studio_scene_sheet(&s, &m, white, NULL, blue) == 0 && studio_render(&s, &c, &im) == 0);
        at = pixel(&im, 40, 40);
        if (side) CHECK(at[2] > 2 * at[0]);
        else CHECK(at[2] < 1.2 * at[0]);
        for (i = 0; i < 25 && !side; ++i) CHECK(studio_lit(&s, points + 3 * i, s.look.up) >= 0.88f);
        studio_scene_end(&s);
    }
    studio_mesh_free(&m);
    studio_image_free(&im);
}

/* Three rows of pixels are clear between the title and the numbers. */
static void colorbar_title_is_clear(void) {
    studio_image title, ticks;
    int i, low = 0, high = 300;
    CHECK(studio_image_make(&title, 200, 300) == 0 && studio_image_make(&ticks, 200, 300) == 0);
    studio_colorbar(&title, 60, 60, 14, 200, 0.0, 0.0, "gypsy stress, kPa");
    studio_colorbar(&ticks, 60, 60, 14, 200, 0.0, 20.0, NULL);
    for (i = 0; i < 200 * 300; ++i) {
        int x = i % 200, y = i / 200;
        if (x >= 60 && x < 75 && y >= 60 && y <= 260) continue; /* the bar itself */
        if (title.rgb[3 * i] < 250 && y > low) low = y;
        if (ticks.rgb[3 * i] < 250 && y < high) high = y;
    }
    CHECK(low > 30 && high < 70 && high - low > 3);
    studio_image_free(&title);
    studio_image_free(&ticks);
}

/* Neighbours in the row of colours differ by a fifth in some channel; all are colours. */
static void distinct_colours(void) {
    float last[3] = {0, 0, 0}, rgb[3];
    int k, c;
    for (k = 0; k < 200; ++k) {
        float most = 0.0f;
        studio_distinct(k, rgb);
        for (c = 0; c < 3; ++c) {
            CHECK(rgb[c] >= 0.1f && rgb[c] <= 0.9f);
            most = fmaxf(most, fabsf(rgb[c] - last[c]));
        }
        CHECK(most > 0.2f);
        memcpy(last, rgb, sizeof last);
    }
}

/* Empty scenes, huge, tiny and not-a-number things, a camera inside: no crash, and the nearer thing wins. */
static void scene_takes_anything(void) {
    const float grey[3] = {0.5f, 0.5f, 0.5f}, target[3] = {0.0f, 0.0f, 0.0f}, white[3] = {1.0f, 1.0f, 1.0f};
    const float values[] = {0.0f, 1.0f, -1.0f, 1e-30f, 1e20f, -3e38f, (float)HUGE_VAL, (float)sqrt(-1.0)};
    studio_scene s;
    studio_camera c;
    studio_image im;
    studio_mesh m;
    int i, k;
    CHECK(studio_image_make(&im, 40, 30) == 0);
    CHECK(parse(CUBE, strlen(CUBE), &m) == 0);
    studio_scene_begin(&s);
    for (i = 0; i < 60; ++i) {
        float p[3], q[3];
        studio_scene_clear(&s);
        studio_orbit(&c, target, i % 7 == 0 ? 0.3f : 3.0f, (float)(7 * i), (float)(i % 3 * 45), 30.0f);
        for (k = 0; k < i; ++k) {
            studio_set(p, values[random_bits() & 7], values[random_bits() & 7], values[random_bits() & 7]);
            studio_set(q, values[random_bits() & 7], values[random_bits() & 7], values[random_bits() & 7]);
            CHECK(studio_scene_ball(&s, p, values[random_bits() & 7], grey) == 0);
            CHECK(studio_scene_line(&s, p, q, 2.0f, grey) == 0);
            memcpy(m.v + 3 * (random_bits() % 8), q, sizeof q);
        }
        CHECK(studio_scene_mesh(&s, &m, i & 1 ? grey : NULL, i & 2 ? m.v : NULL) == 0);
        if (i == 0) studio_scene_clear(&s);
        CHECK(studio_render(&s, &c, &im) == 0);
    }
    studio_scene_clear(&s);
    s.look.ground = 0;
    s.look.gloss = 0.0f;
    studio_set(c.eye, 0.0f, -5.0f, 0.0f);
    studio_set(s.look.light, 0.0f, -1.0f, 0.0f);
    CHECK(studio_scene_ball(&s, target, 0.5f, grey) == 0);
    studio_set(c.target, 0.0f, -2.0f, 0.0f);
    CHECK(studio_scene_ball(&s, c.target, 0.1f, white) == 0);
    CHECK(studio_render(&s, &c, &im) == 0);
    CHECK(brightness(&s, &im, 0.0f, -2.0f, 0.0f) > brightness(&s, &im, 0.3f, -0.4f, 0.0f) + 20.0);
    studio_scene_end(&s);
    studio_image_free(&im);
    studio_mesh_free(&m);
}

/* ---------------------------------------------------------------------------------- options --------- */

/* Splits a line into words and gives them to studio_begin. */
static int begin(const char *line, studio_options *o) {
    static const studio_app app = {"test_studio", "a test", "  --twist DEG  degrees\n  --fast       no pause\n", 24};
    static char text[400], *argv[32];
    int argc = 1;
    char *word;
    argv[0] = strcpy(text, "test");
    snprintf(text + 8, sizeof text - 8, "%s", line);
    for (word = strtok(text + 8, " "); word && argc < 31; word = strtok(NULL, " ")) argv[argc++] = word;
    studio_state()->mute = 1;
    return studio_begin(&app, argc, argv, o);
}

static void options_are_read(void) {
    studio_options o;
    CHECK(begin("", &o) == 0);
    CHECK(o.frames == 24 && strcmp(o.out, DIR) == 0 && !o.model && !o.solver && !o.input && o.threads == 0);
    CHECK(o.width == 640 && o.height == 480 && !o.check && !o.quiet);
    CHECK(begin("--frames 7 --out " DIR "/deep/er --model bond --solver=verlet --threads 2 --check --quiet in.obj "
                "--size 320x200 --twist -30 --fast", &o) == 0);
    CHECK(o.frames == 7 && strcmp(o.out, DIR "/deep/er") == 0 && o.threads == 2 && o.check && o.quiet);
    CHECK(o.model && strcmp(o.model, "bond") == 0 && o.solver && strcmp(o.solver, "verlet") == 0);
    CHECK(o.input && strcmp(o.input, "in.obj") == 0 && o.width == 320 && o.height == 200);
    CHECK(studio_extra("--fast") != NULL && studio_extra("--slow") == NULL);
    NEAR(studio_number("--twist", 5.0), -30.0, 1e-12);
    CHECK(begin("--model --twist --twist=4", &o) == 0); /* the first --twist is the value of --model */
    NEAR(studio_number("--twist", 5.0), 4.0, 1e-12);
    CHECK(studio_extra("--fast") == NULL);
}

static void options_are_refused(void) {
    static const char *bad[][2] = {
        {"--frame 3", "--frames N"}, {"--frames", "value"},          {"--frames x", "whole number"},
        {"--frames 0", "1 to"},      {"--frames 9999999999", "1 to"}, {"--size 3", "640x480"},
        {"--size 640x", "640x480"},  {"--check=1", "no value"},      {"-", "unknown"},
        {"--", "unknown"},           {"a.obj b.obj", "only one"},    {"--twist", "value"},
        {"--threads -1", "0 to"},    {"--nope", "--twist DEG"},      {"--fr", "unknown"}};
    studio_options o;
    size_t i;
    for (i = 0; i < sizeof bad / sizeof bad[0]; ++i) {
        CHECK(begin(bad[i][0], &o) == 1);
        CHECK(studio_exit_code() == 2);
        if (!strstr(studio_state()->message, bad[i][1])) test_complain(__FILE__, (int)i, studio_state()->message);
    }
    CHECK(begin("--help", &o) == 1);
    CHECK(studio_exit_code() == 0);
    CHECK(begin("--nope --help", &o) == 1);
    CHECK(studio_exit_code() == 2);
}

static void checks_are_counted(void) {
    studio_options o;
    CHECK(begin("--check", &o) == 0);
    CHECK(studio_check("inside", 2.0, "m", 1.0, 3.0) == 1);
    CHECK(studio_check("below", 2.0, "", -HUGE_VAL, 3.0) == 1);
    CHECK(studio_check("above", 2.0, NULL, 1.0, HUGE_VAL) == 1);
    CHECK(studio_end(&o) == 0);
    CHECK(studio_check("meant to fail", sqrt(-1.0), "m", -HUGE_VAL, HUGE_VAL) == 0);
    CHECK(studio_end(&o) == 1 && studio_exit_code() == 1);
    CHECK(begin("", &o) == 0 && studio_end(&o) == 0);
}

static void tables_are_written(void) {
    studio_bytes b;
    FILE *f = studio_csv(DIR "/new folder", "t.csv", "a,b");
    CHECK(f != NULL);
    if (!f) return;
    fprintf(f, "1,2\n");
    fclose(f);
    CHECK(studio_read(DIR "/new folder/t.csv", &b) == 0);
    CHECK(strcmp((const char *)b.data, "a,b\n1,2\n") == 0);
    free(b.data);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(obj_forms);
    RUN(obj_refused);
    RUN(ply_round_trip);
    RUN(ply_refused);
    RUN(mesh_fits);
    RUN(figure_is_closed);
    RUN(fuzz_meshes);
    RUN(png_is_exact);
    RUN(deflate_is_exact);
    RUN(huffman_is_limited);
    RUN(gif_is_exact);
    RUN(gif_repeats_are_small);
    RUN(colormap_gets_lighter);
    RUN(text_has_ink);
    RUN(plots_take_anything);
    RUN(ball_casts_shadow);
    RUN(distant_balls_are_round);
    RUN(grids_are_surfaces);
    RUN(surfaces_of_distances);
    RUN(tubes_and_marks);
    RUN(sheets_have_two_sides);
    RUN(colorbar_title_is_clear);
    RUN(distinct_colours);
    RUN(scene_takes_anything);
    RUN(options_are_read);
    RUN(options_are_refused);
    RUN(checks_are_counted);
    RUN(tables_are_written);
    return test_end();
}
