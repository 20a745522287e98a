/* studio.h - the stage around the examples: command line, meshes, pictures, plots, checks.
 *
 * Everything an example needs besides the physics, in one header of static functions: C99 (also C11,
 * C17 and C++11), only the C library and libm, plain float arrays, no global set-up.  It can be used
 * without the rest of the project.
 *
 *   INCLUDE IT FIRST: before any system header, because it asks for the POSIX names (mkdir, isatty)
 *   that -std=c99 hides.  Windows uses _mkdir and _isatty instead.
 *
 * Conventions: z is up; colours are sRGB floats in 0..1 unless a comment says linear; vectors are
 * float[3]; image pixels start at the top left; functions returning int give 0 for success and print
 * one clear line on stderr when they fail.  Nothing here is thread safe.
 *
 * Contents
 *    1  Basics            memory, errors, growing arrays, vectors
 *    2  Files             folders, opening, whole-file reading, the list of written files
 *    3  Command line      studio_begin, studio_extra, studio_exit_code
 *    4  Progress, checks  studio_progress, studio_check, studio_end
 *    5  Meshes            OBJ and PLY reading, normals, fitting, lattices as surfaces, surfaces of distances
 *    6  Data output       PLY points and meshes, CSV
 *    7  Images, drawing   pixels, anti-aliased strokes, text, colour map, colour bar
 *    8  PNG               own deflate
 *    9  GIF               own palette and LZW
 *   10  Scene, renderer   triangles, two-sided sheets, tubes, balls, lines, shadows, ground
 *   11  Plots             line charts
 *
 * License: MIT.
 */
#ifndef STUDIO_H
#define STUDIO_H

#if !defined(_POSIX_C_SOURCE) && !defined(_WIN32) && !defined(__cplusplus)
#define _POSIX_C_SOURCE 200809L
#endif
#if defined(_MSC_VER) && !defined(_CRT_SECURE_NO_WARNINGS)
#define _CRT_SECURE_NO_WARNINGS
#endif

#include <errno.h>
#include <float.h>
#include <limits.h>
#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#ifdef _WIN32
#include <direct.h>
#include <io.h>
#else
#include <sys/stat.h>
#include <sys/types.h>
#include <unistd.h>
#endif

#if defined(__GNUC__) || defined(__clang__)
#define STUDIO_API static __attribute__((unused))
#define STUDIO_PRINTF(a, b) __attribute__((format(printf, a, b)))
#else
#define STUDIO_API static
#define STUDIO_PRINTF(a, b)
#endif

#define STUDIO_PI 3.14159265358979323846
#define STUDIO_PATH 1024 /* longest path, with the final zero */

/* ============================================================== 1  Basics ======================= */

/* Everything remembered between calls; reached through studio_state(). */
typedef struct studio_memory {
    int exit_code, failures, checks;
    int argc;
    char **argv;
    const char *extra;
    char out[STUDIO_PATH];
    char written[64][STUDIO_PATH];
    int written_count;
    double progress_start, progress_last;
    int progress_step;
    int mute;          /* 1: studio_error keeps its message, prints nothing (for tests) */
    char message[2000]; /* the last error */
} studio_memory;

STUDIO_API studio_memory *studio_state(void) {
    static studio_memory memory;
    return &memory;
}

/* Prints "studio: ..." and a newline on stderr; returns -1 so that callers can return it. */
STUDIO_API STUDIO_PRINTF(1, 2) int studio_error(const char *format, ...) {
    studio_memory *s = studio_state();
    va_list args;
    va_start(args, format);
    vsnprintf(s->message, sizeof s->message, format, args);
    va_end(args);
    if (s->mute) return -1;
    fflush(stdout);
    fprintf(stderr, "studio: %s\n", s->message);
    return -1;
}

/* Zeroed memory for count items, or NULL with a message when there is none or the size overflows. */
STUDIO_API void *studio_alloc(size_t count, size_t item) {
    void *p = NULL;
    if (item != 0 && count <= SIZE_MAX / item) p = calloc(count ? count : 1, item);
    if (!p) studio_error("out of memory (%lu items of %lu bytes)", (unsigned long)count, (unsigned long)item);
    return p;
}

/* Makes room for `need` items in the array whose pointer is stored at `slot` (any object pointer) and
 * whose capacity is *cap; grows by half at a time.  Non-zero when out of memory, array unchanged. */
STUDIO_API int studio_reserve(void *slot, size_t *cap, size_t need, size_t item) {
    void *p;
    size_t room = *cap + *cap / 2;
    if (need <= *cap) return 0;
    if (room < need) room = need;
    if (room < 16) room = 16;
    memcpy(&p, slot, sizeof p);
    p = room <= SIZE_MAX / item ? realloc(p, room * item) : NULL;
    if (!p) return studio_error("out of memory (%lu items of %lu bytes)", (unsigned long)room, (unsigned long)item);
    memcpy(slot, &p, sizeof p);
    *cap = room;
    return 0;
}

/* x held to lo..hi; lo when x is not a number. */
STUDIO_API float studio_clamp(float x, float lo, float hi) { return x > lo ? (x < hi ? x : hi) : lo; }

/* 0 below a, 1 above b, a smooth cubic in between. */
STUDIO_API float studio_smooth(float a, float b, float x) {
    float t = studio_clamp((x - a) / (b - a), 0.0f, 1.0f);
    return t * t * (3.0f - 2.0f * t);
}

STUDIO_API float studio_dot(const float *a, const float *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

STUDIO_API void studio_set(float *o, float x, float y, float z) {
    o[0] = x;
    o[1] = y;
    o[2] = z;
}

STUDIO_API void studio_cross(const float *a, const float *b, float *o) {
    studio_set(o, a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]);
}

/* o = a + s b */
STUDIO_API void studio_along(const float *a, float s, const float *b, float *o) {
    studio_set(o, a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]);
}

/* Scales v to length 1 and returns the old length; a vector without length becomes (0, 0, 1). */
STUDIO_API float studio_unit(float *v) {
    float length = sqrtf(studio_dot(v, v));
    if (length > 1e-20f) studio_set(v, v[0] / length, v[1] / length, v[2] / length);
    else studio_set(v, 0.0f, 0.0f, 1.0f);
    return length;
}

/* Two unit vectors a, b that complete the unit vector n to a right-handed frame (a, b, n). */
STUDIO_API void studio_frame(const float *n, float *a, float *b) {
    float other[3];
    studio_set(other, fabsf(n[0]) > 0.9f ? 0.0f : 1.0f, fabsf(n[0]) > 0.9f ? 1.0f : 0.0f, 0.0f);
    studio_cross(n, other, b);
    studio_unit(b);
    studio_cross(b, n, a);
}

/* Seconds of wall time since some fixed moment. */
STUDIO_API double studio_seconds(void) {
#ifdef _WIN32
    return (double)clock() / CLOCKS_PER_SEC;
#else
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
#endif
}

/* A growing run of bytes; `failed` stays set after the first lack of memory. */
typedef struct studio_bytes {
    unsigned char *data;
    size_t size, cap;
    int failed;
} studio_bytes;

STUDIO_API void studio_put(studio_bytes *b, const void *data, size_t size) {
    if (b->failed || size == 0) return;
    if (size > SIZE_MAX - b->size || studio_reserve(&b->data, &b->cap, b->size + size, 1)) {
        b->failed = 1;
        return;
    }
    memcpy(b->data + b->size, data, size);
    b->size += size;
}

/* Appends the low `count` bytes of value, least significant first. */
STUDIO_API void studio_put_le(studio_bytes *b, unsigned long value, int count) {
    unsigned char bytes[4];
    int i;
    for (i = 0; i < count; ++i) bytes[i] = (unsigned char)((value >> (8 * i)) & 255u);
    studio_put(b, bytes, (size_t)count);
}

STUDIO_API void studio_put_float(studio_bytes *b, float value) {
    uint32_t bits;
    memcpy(&bits, &value, 4);
    studio_put_le(b, bits, 4);
}

/* =============================================================== 2  Files ======================= */

/* Makes the folder and its parents; an existing folder is fine.  Non-zero with a message on failure. */
STUDIO_API int studio_folder(const char *path) {
    char part[STUDIO_PATH];
    size_t i, n = strlen(path);
    int failed = 0;
    if (n == 0) return 0;
    if (n >= sizeof part) return studio_error("the path %.40s... is too long: use one under %d", path, STUDIO_PATH);
    for (i = 1; i <= n; ++i) {
        if (i < n && path[i] != '/' && path[i] != '\\') continue;
        memcpy(part, path, i);
        part[i] = 0;
#ifdef _WIN32
        failed = _mkdir(part) != 0 && errno != EEXIST && part[i - 1] != ':';
#else
        failed = mkdir(part, 0777) != 0 && errno != EEXIST;
#endif
    }
    if (failed) return studio_error("cannot make the folder %s: %s", path, strerror(errno));
    return 0;
}

/* "dir/name" in one of eight rotating buffers: use it at once, or copy it. */
STUDIO_API const char *studio_path(const char *dir, const char *name) {
    static char ring[8][STUDIO_PATH];
    static int next;
    char *out = ring[next = (next + 1) & 7];
    snprintf(out, STUDIO_PATH, "%s%s%s", dir ? dir : "", dir && dir[0] ? "/" : "", name);
    return out;
}

/* Opens a file for writing, making missing folders on the way; NULL with a message on failure. */
STUDIO_API FILE *studio_create(const char *path) {
    FILE *f = fopen(path, "wb");
    if (!f && errno == ENOENT) {
        char dir[STUDIO_PATH];
        const char *slash = strrchr(path, '/');
        size_t n = slash ? (size_t)(slash - path) : 0;
        if (n > 0 && n < sizeof dir) {
            memcpy(dir, path, n);
            dir[n] = 0;
            if (studio_folder(dir)) return NULL;
            f = fopen(path, "wb");
        }
    }
    if (!f) studio_error("cannot write %s: %s", path, strerror(errno));
    return f;
}

/* Remembers a written file for the list that studio_end prints. */
STUDIO_API void studio_written(const char *path) {
    studio_memory *s = studio_state();
    int i, room = (int)(sizeof s->written / sizeof s->written[0]);
    for (i = 0; i < s->written_count && i < room; ++i)
        if (strcmp(s->written[i], path) == 0) return;
    if (s->written_count < room) snprintf(s->written[s->written_count], STUDIO_PATH, "%s", path);
    ++s->written_count;
}

/* Closes f after checking that every byte arrived, and remembers the file. */
STUDIO_API int studio_finish(FILE *f, const char *path) {
    int bad = ferror(f) != 0;
    bad |= fclose(f) != 0;
    if (bad) return studio_error("could not write all of %s: is the disk full?", path);
    studio_written(path);
    return 0;
}

/* Writes the bytes to a new file and frees them. */
STUDIO_API int studio_save(const char *path, studio_bytes *b) {
    FILE *f = NULL;
    int bad = b->failed;
    if (!bad) f = studio_create(path);
    if (f) fwrite(b->data, 1, b->size, f);
    free(b->data);
    memset(b, 0, sizeof *b);
    return f ? studio_finish(f, path) : -1;
}

/* Reads a whole file and adds a zero byte that is not counted.  Non-zero with a message on failure. */
STUDIO_API int studio_read(const char *path, studio_bytes *b) {
    unsigned char part[16384];
    size_t n;
    FILE *f = fopen(path, "rb");
    memset(b, 0, sizeof *b);
    if (!f) return studio_error("cannot open %s: %s; check the name and the working folder", path, strerror(errno));
    while ((n = fread(part, 1, sizeof part, f)) > 0) studio_put(b, part, n);
    if (ferror(f)) b->failed = studio_error("cannot read %s: %s", path, strerror(errno));
    fclose(f);
    part[0] = 0;
    studio_put(b, part, 1);
    if (b->failed) {
        free(b->data);
        return -1;
    }
    --b->size;
    return 0;
}

/* ======================================================== 3  Command line ======================= */

/* What an example says about itself.  `extra` documents its own options, one per line:
 * "  --twist DEG   text" (takes a value: an upper-case word follows) or "  --fast   text" (a switch);
 * such options are accepted on the command line and read with studio_extra(). */
typedef struct studio_app {
    const char *name;    /* short, also the name of the output folder */
    const char *summary; /* several lines for --help */
    const char *extra;   /* may be NULL */
    int default_frames;
} studio_app;

typedef struct studio_options {
    int frames;         /* --frames N, at least 1 */
    const char *out;    /* --out DIR, made with its parents unless --check */
    const char *model;  /* --model NAME, or NULL */
    const char *solver; /* --solver NAME, or NULL */
    int threads;        /* --threads N, 0 for all */
    int check;          /* --check: draw nothing */
    int quiet;          /* --quiet */
    const char *input;  /* the first argument without dashes, or NULL */
    int width, height;  /* --size WxH, 640x480 when not given */
} studio_options;

STUDIO_API int studio_exit_code(void) { return studio_state()->exit_code; }

/* The options every example has, in the same form as studio_app.extra. */
STUDIO_API const char *studio_standard(void) {
    return "  --frames N     number of frames\n"
           "  --out DIR      folder for pictures and tables\n"
           "  --model NAME   material model\n"
           "  --solver NAME  time integrator or solver\n"
           "  --threads N    worker threads, 0 = all\n"
           "  --size WxH     picture size\n"
           "  --check        only compute and check the numbers, draw nothing\n"
           "  --quiet        no progress bar\n"
           "  --help         this text\n";
}

STUDIO_API void studio_help(const studio_app *app, const studio_options *o) {
    printf("%s - %s\n\nusage: %s [options] [file]\n\n%s", app->name, app->summary, app->name, studio_standard());
    if (app->extra) printf("%s%s", app->extra, strrchr(app->extra, '\n') ? "" : "\n");
    printf("\nWithout options: --frames %d --out %s --size %dx%d\n", o->frames, o->out, o->width, o->height);
}

/* Looks an option up in a help text: 0 not there, 1 a switch, 2 takes a value. */
STUDIO_API int studio_kind(const char *text, const char *option, size_t length) {
    const char *line = text;
    while (line && *line) {
        const char *s = line + strspn(line, " ");
        if (strncmp(s, option, length) == 0 && (s[length] == 0 || strchr(" \n", s[length]))) {
            const char *next = s + length;
            return next[0] == ' ' && ((next[1] >= 'A' && next[1] <= 'Z') || next[1] == '<') ? 2 : 1;
        }
        line = strchr(line, '\n');
        if (line) ++line;
    }
    return 0;
}

/* A whole number in lo..hi, or non-zero with a message that names the option. */
STUDIO_API int studio_whole(const char *option, const char *text, int lo, int hi, int *value) {
    char *end;
    long n;
    errno = 0;
    n = strtol(text, &end, 10);
    if (end == text || *end || errno || n < lo || n > hi)
        return studio_error("%s wants a whole number from %d to %d, not '%s'", option, lo, hi, text);
    *value = (int)n;
    return 0;
}

/* "WxH" with both sides in 16..8192. */
STUDIO_API int studio_size(const char *text, int *width, int *height) {
    char *end = NULL;
    long w = strtol(text, &end, 10), h = 0;
    if (*end == 'x' || *end == 'X') h = strtol(end + 1, &end, 10);
    if (*end || w < 16 || h < 16 || w > 8192 || h > 8192)
        return studio_error("--size wants WIDTHxHEIGHT with sides from 16 to 8192, such as 640x480, not '%s'", text);
    *width = (int)w;
    *height = (int)h;
    return 0;
}

/* Stores a standard option; non-zero when the value is wrong. */
STUDIO_API int studio_assign(const char *option, const char *value, studio_options *o) {
    if (strcmp(option, "--frames") == 0) return studio_whole(option, value, 1, 1000000, &o->frames);
    if (strcmp(option, "--threads") == 0) return studio_whole(option, value, 0, 4096, &o->threads);
    if (strcmp(option, "--size") == 0) return studio_size(value, &o->width, &o->height);
    if (strcmp(option, "--out") == 0) o->out = value;
    if (strcmp(option, "--model") == 0) o->model = value;
    if (strcmp(option, "--solver") == 0) o->solver = value;
    if (strcmp(option, "--check") == 0) o->check = 1;
    if (strcmp(option, "--quiet") == 0) o->quiet = 1;
    return 0;
}

/* Handles argv[*i], a word that starts with a dash, moving *i over its value.  Non-zero when wrong. */
STUDIO_API int studio_take(const studio_app *app, int argc, char **argv, int *i, studio_options *o) {
    const char *word = argv[*i], *equals = strchr(word, '='), *value = equals ? equals + 1 : "";
    size_t n = equals ? (size_t)(equals - word) : strlen(word);
    int own = studio_kind(app->extra, word, n), kind = own ? own : studio_kind(studio_standard(), word, n);
    char option[32];
    snprintf(option, sizeof option, "%.*s", (int)(n < 31 ? n : 31), word);
    if (kind == 0 || n < 3) {
        studio_error("unknown option %s; the options are\n%s%s", option, studio_standard(),
                     app->extra ? app->extra : "");
        return -1;
    }
    if (kind == 1 && equals) return studio_error("%s takes no value", option);
    if (kind == 2 && !equals && *i + 1 < argc) value = argv[++*i];
    if (kind == 2 && value[0] == 0) return studio_error("%s needs a value; see --help", option);
    return own ? 0 : studio_assign(option, value, o);
}

/* Reads the command line into *o.  Returns 0 to go on, 1 to stop with exit code studio_exit_code()
 * (0 after --help, 2 after a wrong option or when the output folder cannot be made). */
STUDIO_API int studio_begin(const studio_app *app, int argc, char **argv, studio_options *o) {
    studio_memory *s = studio_state();
    int i, bad = 0, mute = s->mute;
    memset(o, 0, sizeof *o);
    memset(s, 0, sizeof *s);
    s->mute = mute;
    s->argc = argc;
    s->argv = argv;
    s->extra = app->extra;
    snprintf(s->out, sizeof s->out, "build/out/%s", app->name);
    o->frames = app->default_frames;
    o->out = s->out;
    o->width = 640;
    o->height = 480;
    for (i = 1; i < argc && !bad; ++i) {
        if (strcmp(argv[i], "--help") == 0 || strcmp(argv[i], "-h") == 0) return studio_help(app, o), 1;
        if (argv[i][0] == '-') bad = studio_take(app, argc, argv, &i, o);
        else if (!o->input) o->input = argv[i];
        else bad = studio_error("only one file can be given: %s or %s?", o->input, argv[i]);
    }
    if (!bad && !o->check) bad = studio_folder(o->out);
    s->exit_code = bad ? 2 : 0;
    return bad ? 1 : 0;
}

/* The value of one of the example's own options (see studio_app.extra): the text after it, "" for a
 * switch that was given, NULL when it was not given.  The last one counts. */
STUDIO_API const char *studio_extra(const char *option) {
    const studio_memory *s = studio_state();
    const char *found = NULL;
    size_t n = strlen(option);
    int i;
    for (i = 1; i < s->argc; ++i) {
        size_t length = strcspn(s->argv[i], "=");
        const char *word = s->argv[i];
        int own = studio_kind(s->extra, word, length);
        int kind = own ? own : studio_kind(studio_standard(), word, length);
        int mine = length == n && strncmp(word, option, n) == 0;
        if (word[0] != '-') continue;
        if (kind == 2 && word[length] == 0 && i + 1 < s->argc) word = s->argv[++i];
        else word += word[length] ? length + 1 : length;
        if (mine) found = word;
    }
    return found;
}

/* A number from an example's own option, or `otherwise` when it is not given.  A value that is not a
 * number ends the program with exit code 2 and a message. */
STUDIO_API double studio_number(const char *option, double otherwise) {
    const char *text = studio_extra(option);
    char *end = NULL;
    double value = otherwise;
    if (!text) return otherwise;
    value = strtod(text, &end);
    if (end == text || *end || !(fabs(value) < 1e300)) {
        studio_error("%s wants a number, not '%s'", option, text);
        exit(2);
    }
    return value;
}

/* ==================================================== 4  Progress, checks ======================= */

/* "1:05" or "2:03:04" */
STUDIO_API void studio_clock(double seconds, char *out, size_t room) {
    long t = seconds > 0.0 && seconds < 1e8 ? (long)(seconds + 0.5) : 0;
    if (t >= 3600) snprintf(out, room, "%ld:%02ld:%02ld", t / 3600, t / 60 % 60, t % 60);
    else snprintf(out, room, "%ld:%02ld", t / 60, t % 60);
}

/* Shows on stderr that `done` of `total` steps are finished, with a short note (or NULL): one line drawn
 * again and again on a terminal, a line every tenth otherwise, nothing with --quiet.  Call it with done
 * = 0 first to start the clock; done = total ends the line. */
STUDIO_API void studio_progress(const studio_options *o, int done, int total, const char *note) {
    studio_memory *s = studio_state();
    double now = studio_seconds(), part = total > 0 ? (double)done / total : 1.0, spent, left;
    char elapsed[32], remaining[32], bar[32];
    int i, n, step = (int)(10.0 * part);
    if (o && o->quiet) return;
    if (done <= 0 || s->progress_start <= 0.0) {
        s->progress_start = now;
        s->progress_last = 0.0;
        s->progress_step = 0;
        if (done <= 0) return;
    }
    spent = now - s->progress_start;
    left = part > 0.0 ? spent * (1.0 - part) / part : 0.0;
    studio_clock(spent, elapsed, sizeof elapsed);
    studio_clock(left, remaining, sizeof remaining);
#ifdef _WIN32
    n = _isatty(_fileno(stderr));
#else
    n = isatty(fileno(stderr));
#endif
    if (n) {
        if (done < total && now - s->progress_last < 0.1) return;
        for (i = 0; i < 24; ++i) bar[i] = (double)i < 24.0 * part ? '#' : '.';
        bar[24] = 0;
        fprintf(stderr, "\r[%s] %3d%%  %s, %s left  %-30.30s%s", bar, (int)(100.0 * part), elapsed, remaining,
                note ? note : "", done >= total ? "\n" : "");
    } else {
        if (done < total && step <= s->progress_step) return;
        fprintf(stderr, "%3d%%  %s, %s left  %s\n", (int)(100.0 * part), elapsed, remaining, note ? note : "");
    }
    fflush(stderr);
    s->progress_last = now;
    s->progress_step = step;
    if (done >= total) s->progress_start = 0.0;
}

/* Prints "name = value unit (lo .. hi) ok" or FAIL, and remembers failures for studio_end.  Use
 * -HUGE_VAL or HUGE_VAL for a side without a limit; a value that is not a number fails. */
STUDIO_API int studio_check(const char *name, double value, const char *unit, double lo, double hi) {
    studio_memory *s = studio_state();
    int ok = value >= lo && value <= hi && fabs(value) <= DBL_MAX;
    char range[80], shown[40];
    if (value != value) snprintf(shown, sizeof shown, "nan");
    else snprintf(shown, sizeof shown, "%.6g", value);
    if (lo < -DBL_MAX && hi > DBL_MAX) snprintf(range, sizeof range, "finite");
    else if (lo < -DBL_MAX) snprintf(range, sizeof range, "< %.6g", hi);
    else if (hi > DBL_MAX) snprintf(range, sizeof range, "> %.6g", lo);
    else snprintf(range, sizeof range, "%.6g .. %.6g", lo, hi);
    printf("%s = %s%s%s (%s) %s\n", name, shown, unit && unit[0] ? " " : "", unit ? unit : "", range,
           ok ? "ok" : "FAIL");
    fflush(stdout);
    ++s->checks;
    s->failures += !ok;
    return ok;
}

/* Ends an example: lists the files written (not with --check) and returns the exit code, 1 when a check
 * failed, else 0. */
STUDIO_API int studio_end(const studio_options *o) {
    studio_memory *s = studio_state();
    int i, room = (int)(sizeof s->written / sizeof s->written[0]);
    if (!o->check && s->written_count > 0) {
        printf("wrote\n");
        for (i = 0; i < s->written_count && i < room; ++i) printf("  %s\n", s->written[i]);
        if (s->written_count > room) printf("  and %d more\n", s->written_count - room);
    }
    if (s->failures > 0) printf("%d of %d checks FAILED\n", s->failures, s->checks);
    s->exit_code = s->failures > 0;
    return s->exit_code;
}

/* ============================================================== 5  Meshes ======================= */

typedef struct studio_mesh {
    int vertices, triangles;
    float *v; /* 3*vertices positions */
    float *n; /* 3*vertices unit normals, or NULL */
    int *t;   /* 3*triangles corners, counter-clockwise seen from outside */
} studio_mesh;

STUDIO_API void studio_mesh_free(studio_mesh *m) {
    free(m->v);
    free(m->n);
    free(m->t);
    memset(m, 0, sizeof *m);
}

/* Fills m->n with area-weighted vertex normals.  Non-zero when out of memory. */
STUDIO_API int studio_mesh_normals(studio_mesh *m) {
    int i, k;
    float a[3], b[3], c[3];
    if (!m->n) m->n = (float *)studio_alloc(3 * (size_t)m->vertices, sizeof(float));
    if (!m->n) return -1;
    memset(m->n, 0, 3 * (size_t)m->vertices * sizeof(float));
    for (i = 0; i < m->triangles; ++i) {
        const int *t = m->t + 3 * (size_t)i;
        const float *p = m->v + 3 * (size_t)t[0], *q = m->v + 3 * (size_t)t[1], *r = m->v + 3 * (size_t)t[2];
        studio_along(q, -1.0f, p, a);
        studio_along(r, -1.0f, p, b);
        studio_cross(a, b, c);
        for (k = 0; k < 3; ++k) {
            float *n = m->n + 3 * (size_t)t[k];
            studio_along(n, 1.0f, c, n);
        }
    }
    for (i = 0; i < m->vertices; ++i) studio_unit(m->n + 3 * (size_t)i);
    return 0;
}

/* The corners of the box around the points; a box at the origin when there are none. */
STUDIO_API void studio_bounds(const float *v, int count, float lo[3], float hi[3]) {
    int i, k;
    for (k = 0; k < 3; ++k) lo[k] = hi[k] = count > 0 ? v[k] : 0.0f;
    for (i = 1; i < count; ++i)
        for (k = 0; k < 3; ++k) {
            float x = v[3 * (size_t)i + (size_t)k];
            if (x < lo[k]) lo[k] = x;
            if (x > hi[k]) hi[k] = x;
        }
}

/* Scales and moves the mesh so that its box is centred at `centre` and its longest side is `size`. */
STUDIO_API void studio_mesh_fit(studio_mesh *m, const float centre[3], float size) {
    float lo[3], hi[3], longest = 0.0f, scale;
    int i, k;
    studio_bounds(m->v, m->vertices, lo, hi);
    for (k = 0; k < 3; ++k)
        if (hi[k] - lo[k] > longest) longest = hi[k] - lo[k];
    scale = longest > 0.0f ? size / longest : 1.0f;
    for (i = 0; i < m->vertices; ++i)
        for (k = 0; k < 3; ++k) {
            float *x = m->v + 3 * (size_t)i + k;
            *x = centre[k] + scale * (*x - 0.5f * (lo[k] + hi[k]));
        }
}

/* ---- lattices drawn as surfaces */

/* Weights of the four points -1, 0, 1, 2 at t in 0..1 (Catmull and Rom): smooth, and through the points. */
STUDIO_API void studio_spline(float t, float w[4]) {
    w[0] = t * (-0.5f + t * (1.0f - 0.5f * t));
    w[1] = 1.0f + t * t * (-2.5f + 1.5f * t);
    w[2] = t * (0.5f + t * (2.0f - 1.5f * t));
    w[3] = t * t * (-0.5f + 0.5f * t);
}

/* Point i of a row (`step` floats apart), or beyond its ends where the last two points lead. */
STUDIO_API float studio_beyond(const float *row, int n, size_t step, int i) {
    const float *e;
    if (n == 1) return row[0];
    if (i >= 0 && i < n) return row[step * (size_t)i];
    e = i < 0 ? row : row + step * (size_t)(n - 1);
    if (i < 0) return e[0] - (float)i * (e[0] - e[step]);
    return e[0] + (float)(i - n + 1) * (e[0] - *(e - step));
}

/* Vertices per row of points when each is `fine` cells wide: the surface reaches half a spacing over the border. */
STUDIO_API int studio_grid_side(int n, int fine) { return n * fine + 1; }

/* Values (`dims` floats each: positions, colours) of a lattice of nx * ny points, x running fastest, at the vertices of
 * its surface, out: dims * studio_grid_side(nx) * studio_grid_side(ny) floats, x running fastest. */
STUDIO_API int studio_grid_values(const float *points, int dims, int nx, int ny, int fine, float *out) {
    int vx = studio_grid_side(nx, fine), vy = studio_grid_side(ny, fine), i, j, k, a;
    float *rows = (float *)studio_alloc((size_t)vx * (size_t)ny * (size_t)dims, sizeof(float));
    if (!rows) return -1;
    for (i = 0; i < vx; ++i) { /* along x, into rows */
        float u = ((float)i / (float)fine) - 0.5f, w[4];
        int cell = (int)floorf(u);
        studio_spline(u - (float)cell, w);
        for (j = 0; j < ny; ++j)
            for (k = 0; k < dims; ++k) {
                const float *row = points + (size_t)dims * (size_t)nx * (size_t)j + (size_t)k;
                float sum = 0.0f;
                for (a = 0; a < 4; ++a) sum += w[a] * studio_beyond(row, nx, (size_t)dims, cell - 1 + a);
                rows[(size_t)dims * ((size_t)j * (size_t)vx + (size_t)i) + (size_t)k] = sum;
            }
    }
    for (j = 0; j < vy; ++j) {
        float u = ((float)j / (float)fine) - 0.5f, w[4];
        int cell = (int)floorf(u);
        studio_spline(u - (float)cell, w);
        for (i = 0; i < dims * vx; ++i) {
            float sum = 0.0f;
            for (a = 0; a < 4; ++a)
                sum += w[a] * studio_beyond(rows + i, ny, (size_t)dims * (size_t)vx, cell - 1 + a);
            out[(size_t)dims * (size_t)vx * (size_t)j + (size_t)i] = sum;
        }
    }
    free(rows);
    return 0;
}

/* The surface of a lattice of nx * ny points, as a mesh with normals; `fine` cells between two points.
 * Counter-clockwise seen from +z when x and y of the lattice run as in the world. */
STUDIO_API int studio_mesh_grid(studio_mesh *m, const float *points, int nx, int ny, int fine) {
    int vx = studio_grid_side(nx, fine), vy = studio_grid_side(ny, fine), i, j, *t;
    memset(m, 0, sizeof *m);
    if (nx < 2 || ny < 2 || fine < 1) return studio_error("a surface needs 2 x 2 points, not %d x %d", nx, ny);
    m->vertices = vx * vy;
    m->triangles = 2 * (vx - 1) * (vy - 1);
    m->v = (float *)studio_alloc(3 * (size_t)m->vertices, sizeof(float));
    m->t = t = (int *)studio_alloc(3 * (size_t)m->triangles, sizeof(int));
    if (!m->v || !t || studio_grid_values(points, 3, nx, ny, fine, m->v)) return studio_mesh_free(m), -1;
    for (j = 0; j < vy - 1; ++j)
        for (i = 0; i < vx - 1; ++i, t += 6) { /* diagonals alternate, so that folds have no grain */
            int a = j * vx + i, b = a + 1, c = a + vx, d = c + 1, odd = (i + j) & 1;
            t[0] = a;
            t[1] = b;
            t[2] = odd ? c : d;
            t[3] = odd ? b : a;
            t[4] = d;
            t[5] = c;
        }
    return studio_mesh_normals(m);
}

/* ---- surfaces of signed distances */

/* A solid: negative inside, about the distance near the surface. */
typedef float studio_field(const float p[3], void *context);

/* A box of cells around a solid. */
typedef struct studio_net {
    studio_field *field;
    void *context;
    float lo[3], cell;
    int n[3];       /* corners along x, y, z */
    float *value;   /* of the corners */
    int *vertex;    /* of the cells, by their lowest corner; -1: none */
} studio_net;

STUDIO_API size_t studio_net_at(const studio_net *net, int x, int y, int z) {
    return (size_t)x + (size_t)net->n[0] * ((size_t)y + (size_t)net->n[1] * (size_t)z);
}

/* Pulls p onto the surface, by less than a cell. */
STUDIO_API void studio_net_pull(const studio_net *net, float *p) {
    int pass, k;
    for (pass = 0; pass < 3; ++pass) {
        float f = net->field(p, net->context), g[3], q[3], gg, e = 0.05f * net->cell;
        for (k = 0; k < 3; ++k) {
            memcpy(q, p, sizeof q);
            q[k] += e;
            g[k] = net->field(q, net->context);
            q[k] -= 2.0f * e;
            g[k] = (g[k] - net->field(q, net->context)) / (2.0f * e);
        }
        gg = studio_dot(g, g);
        if (!(gg > 1e-6f)) return;
        studio_along(p, studio_clamp(-f / gg, -0.5f * net->cell, 0.5f * net->cell), g, p);
    }
}

/* A mesh that is being read: growing arrays and the place in the text for messages. */
typedef struct studio_builder {
    const char *path;
    float *v, *n;
    int *t;
    size_t vcap, ncap, tcap, vertices, triangles;
    long line;
} studio_builder;

STUDIO_API int studio_add_vertex(studio_builder *b, const float p[3]) {
    if (b->vertices >= INT_MAX / 4) return studio_error("%s: too many vertices", b->path);
    if (studio_reserve(&b->v, &b->vcap, 3 * b->vertices + 3, sizeof(float))) return -1;
    memcpy(b->v + 3 * b->vertices++, p, 3 * sizeof(float));
    return 0;
}

STUDIO_API int studio_add_triangle(studio_builder *b, int i, int j, int k) {
    int *t;
    if (b->triangles >= INT_MAX / 4) return studio_error("%s: too many triangles", b->path);
    if (studio_reserve(&b->t, &b->tcap, 3 * b->triangles + 3, sizeof(int))) return -1;
    t = b->t + 3 * b->triangles++;
    t[0] = i;
    t[1] = j;
    t[2] = k;
    return 0;
}

/* The vertex of a cell: the middle of where the surface cuts its edges, pulled onto the surface. */
STUDIO_API int studio_net_vertex(const studio_net *net, int x, int y, int z, studio_builder *b) {
    float p[3] = {0, 0, 0}, sum[3] = {0, 0, 0};
    int a, k, cuts = 0;
    for (a = 0; a < 8; ++a)
        for (k = 0; k < 3; ++k) {
            int c = a | 1 << k;
            float f, g, t;
            if (a >> k & 1) continue;
            f = net->value[studio_net_at(net, x + (a & 1), y + (a >> 1 & 1), z + (a >> 2))];
            g = net->value[studio_net_at(net, x + (c & 1), y + (c >> 1 & 1), z + (c >> 2))];
            if ((f < 0.0f) == (g < 0.0f)) continue;
            t = f / (f - g);
            studio_set(p, (float)(a & 1), (float)(a >> 1 & 1), (float)(a >> 2));
            p[k] += t;
            studio_along(sum, 1.0f, p, sum);
            ++cuts;
        }
    if (!cuts) return 0;
    studio_set(p, (float)x, (float)y, (float)z);
    studio_along(p, 1.0f / (float)cuts, sum, p);
    studio_along(net->lo, net->cell, p, p);
    studio_net_pull(net, p);
    net->vertex[studio_net_at(net, x, y, z)] = (int)b->vertices;
    return studio_add_vertex(b, p);
}

/* The quad around the edge from corner x, y, z along axis k, when the surface cuts it. */
STUDIO_API int studio_net_quad(const studio_net *net, int x, int y, int z, int k, studio_builder *b) {
    int at[3], u = (k + 1) % 3, v = (k + 2) % 3, c[4], i;
    float f = net->value[studio_net_at(net, x, y, z)], g;
    at[0] = x;
    at[1] = y;
    at[2] = z;
    if (at[u] == 0 || at[v] == 0 || at[k] >= net->n[k] - 1) return 0;
    ++at[k];
    g = net->value[studio_net_at(net, at[0], at[1], at[2])];
    --at[k];
    if ((f < 0.0f) == (g < 0.0f)) return 0;
    for (i = 0; i < 4; ++i) { /* counter-clockwise seen from the end of the axis */
        int q[3];
        memcpy(q, at, sizeof q);
        q[u] -= i == 0 || i == 3;
        q[v] -= i < 2;
        c[i] = net->vertex[studio_net_at(net, q[0], q[1], q[2])];
    }
    if (f >= 0.0f) i = c[1], c[1] = c[3], c[3] = i;
    return studio_add_triangle(b, c[0], c[1], c[2]) || studio_add_triangle(b, c[0], c[2], c[3]);
}

/* The surface of a solid inside the box lo .. hi as a closed mesh with normals: one vertex in every cell of side `cell`
 * that the surface passes, one quad around every edge that it cuts.  Parts thinner than a cell are lost. */
STUDIO_API int studio_mesh_surface(studio_mesh *m, studio_field *field, void *context, const float lo[3],
                                   const float hi[3], float cell) {
    studio_net net;
    studio_builder b;
    float p[3];
    size_t count = 1, i;
    int x, y, z, k, bad = 0;
    memset(m, 0, sizeof *m);
    memset(&b, 0, sizeof b);
    b.path = "surface";
    net.field = field;
    net.context = context;
    net.cell = cell;
    for (k = 0; k < 3; ++k) {
        float cells = (hi[k] - lo[k]) / cell;
        if (!(cells > 0.0f) || cells > 1000.0f)
            return studio_error("a surface of %g cells is not possible", (double)cells);
        net.n[k] = (int)cells + 4; /* an empty layer all around closes the mesh */
        net.lo[k] = 0.5f * (lo[k] + hi[k] - cell * (float)(net.n[k] - 1));
        count *= (size_t)net.n[k];
    }
    net.value = (float *)studio_alloc(count, sizeof(float));
    net.vertex = (int *)studio_alloc(count, sizeof(int));
    bad = !net.value || !net.vertex;
    for (i = 0; i < count && !bad; ++i) {
        x = (int)(i % (size_t)net.n[0]);
        y = (int)(i / (size_t)net.n[0] % (size_t)net.n[1]);
        z = (int)(i / (size_t)net.n[0] / (size_t)net.n[1]);
        studio_set(p, (float)x, (float)y, (float)z);
        studio_along(net.lo, cell, p, p);
        net.value[i] = field(p, context);
        net.vertex[i] = -1;
    }
    for (z = 0; z < net.n[2] - 1 && !bad; ++z)
        for (y = 0; y < net.n[1] - 1 && !bad; ++y)
            for (x = 0; x < net.n[0] - 1 && !bad; ++x) bad = studio_net_vertex(&net, x, y, z, &b);
    for (z = 0; z < net.n[2] - 1 && !bad; ++z)
        for (y = 0; y < net.n[1] - 1 && !bad; ++y)
            for (x = 0; x < net.n[0] - 1 && !bad; ++x)
                for (k = 0; k < 3 && !bad; ++k) bad = studio_net_quad(&net, x, y, z, k, &b);
    free(net.value);
    free(net.vertex);
    m->v = b.v;
    m->t = b.t;
    m->vertices = (int)b.vertices;
    m->triangles = (int)b.triangles;
    if (!bad && m->triangles == 0) bad = studio_error("there is no surface in the box");
    bad = bad || studio_mesh_normals(m);
    if (bad) studio_mesh_free(m);
    return bad ? -1 : 0;
}

/* Reads three finite numbers from a line of text. */
STUDIO_API int studio_three(const char *s, float out[3]) {
    int k;
    for (k = 0; k < 3; ++k) {
        char *end;
        double x = strtod(s, &end);
        if (end == s || !(fabs(x) < 1e30)) return -1;
        out[k] = (float)x;
        s = end;
    }
    return 0;
}

/* One OBJ face: corners as v, v/vt, v//vn or v/vt/vn, counted from 1 or backwards from -1; polygons become
 * fans of triangles. */
STUDIO_API int studio_obj_face(studio_builder *b, const char *s) {
    int first = 0, last = 0, corners = 0;
    for (;;) {
        char *end;
        long index;
        s += strspn(s, " \t\r");
        if (*s == 0 || *s == '#') break;
        errno = 0;
        index = strtol(s, &end, 10);
        if (end == s || errno || end[strspn(end, "0123456789/-")] > ' ')
            return studio_error("%s:%ld: '%.20s' is not a face corner; write v, v/vt, v//vn or v/vt/vn", b->path,
                                b->line, s);
        if (index < 0) index += (long)b->vertices + 1;
        if (index < 1 || index > (long)b->vertices)
            return studio_error("%s:%ld: corner '%.20s' is out of range; there are %lu vertices so far", b->path,
                                b->line, s, (unsigned long)b->vertices);
        s = end + strspn(end, "0123456789/-");
        if (corners == 0) first = (int)index - 1;
        if (corners >= 2 && studio_add_triangle(b, first, last, (int)index - 1)) return -1;
        last = (int)index - 1;
        ++corners;
    }
    if (corners < 3) return studio_error("%s:%ld: a face needs at least 3 corners", b->path, b->line);
    return 0;
}

/* Reads OBJ text (changing it: line ends become zeros); everything but v and f is skipped. */
STUDIO_API int studio_obj(studio_builder *b, char *text, size_t size) {
    char *end = text + size, *next;
    float p[3];
    for (b->line = 1; text < end; ++b->line, text = next) {
        char *stop = (char *)memchr(text, '\n', (size_t)(end - text));
        next = stop ? stop + 1 : end;
        if (stop) *stop = 0;
        text += strspn(text, " \t");
        if (text[0] == 'v' && (text[1] == ' ' || text[1] == '\t')) {
            if (studio_three(text + 1, p))
                return studio_error("%s:%ld: a vertex needs three numbers: 'v x y z'", b->path, b->line);
            if (studio_add_vertex(b, p)) return -1;
        } else if (text[0] == 'f' && (text[1] == ' ' || text[1] == '\t')) {
            if (studio_obj_face(b, text + 1)) return -1;
        }
    }
    return 0;
}

/* PLY: number types, and where a property goes. */
enum { STUDIO_I8 = 1, STUDIO_U8, STUDIO_I16, STUDIO_U16, STUDIO_I32, STUDIO_U32, STUDIO_F32, STUDIO_F64 };

typedef struct studio_property {
    int type, count_type; /* count_type is 0 unless the property is a list */
    int role;             /* 0..5 for x y z nx ny nz, 6 for the corners of a face, -1 otherwise */
} studio_property;

typedef struct studio_element {
    int kind; /* 'v' vertex, 'f' face, 0 other */
    unsigned long count;
    int properties;
    studio_property property[32];
} studio_element;

typedef struct studio_ply {
    int ascii, elements;
    studio_element element[8];
    const char *at, *end;
} studio_ply;

STUDIO_API int studio_ply_type(const char *name) {
    static const char *names[] = {"char",  "int8",  "uchar", "uint8",  "short", "int16",   "ushort", "uint16",
                                  "int",   "int32", "uint",  "uint32", "float", "float32", "double", "float64"};
    int i;
    for (i = 0; i < 16; ++i)
        if (strcmp(name, names[i]) == 0) return 1 + i / 2;
    return 0;
}

/* Reads the next number; 1 at the end of the data or when it is not a number. */
STUDIO_API int studio_ply_number(studio_ply *p, int type, double *out) {
    static const int sizes[] = {0, 1, 1, 2, 2, 4, 4, 4, 8};
    uint64_t bits = 0;
    int i;
    if (p->ascii) {
        char *end;
        *out = strtod(p->at, &end);
        if (end == p->at || end > p->end) return 1;
        p->at = end;
        return 0;
    }
    if (p->end - p->at < sizes[type]) return 1;
    for (i = 0; i < sizes[type]; ++i) bits |= (uint64_t)(unsigned char)p->at[i] << (8 * i);
    p->at += sizes[type];
    if (type == STUDIO_F32) {
        uint32_t low = (uint32_t)bits;
        float f;
        memcpy(&f, &low, 4);
        *out = (double)f;
    } else if (type == STUDIO_F64) memcpy(out, &bits, 8);
    else if (type == STUDIO_I8) *out = (double)(bits < 128u ? (int)bits : (int)bits - 256);
    else if (type == STUDIO_I16) *out = (double)(bits < 32768u ? (int)bits : (int)bits - 65536);
    else if (type == STUDIO_I32) *out = bits < 2147483648u ? (double)bits : (double)bits - 4294967296.0;
    else *out = (double)bits;
    return 0;
}

/* One "property ..." line of the header. */
STUDIO_API int studio_ply_property(studio_element *e, const char *line) {
    static const char *roles[] = {"x", "y", "z", "nx", "ny", "nz"};
    char a[32], b[32], name[32];
    studio_property *q = e->property + e->properties;
    int i;
    if (e->properties >= 32) return -1;
    memset(q, 0, sizeof *q);
    q->role = -1;
    if (sscanf(line, "property list %31s %31s %31s", a, b, name) == 3) {
        q->count_type = studio_ply_type(a);
        q->type = studio_ply_type(b);
        if (!q->count_type || q->count_type >= STUDIO_F32) return -1;
        if (strncmp(name, "vertex_ind", 10) == 0 && e->kind == 'f') q->role = 6;
    } else if (sscanf(line, "property %31s %31s", a, name) == 2) {
        q->type = studio_ply_type(a);
        for (i = 0; i < 6; ++i)
            if (strcmp(name, roles[i]) == 0 && e->kind == 'v') q->role = i;
    }
    if (!q->type) return -1;
    ++e->properties;
    return 0;
}

/* Reads the header lines, up to and with "end_header"; p->at is left at the first byte of data. */
STUDIO_API int studio_ply_header(studio_builder *b, studio_ply *p) {
    char line[256], word[32], format[32] = "";
    studio_element *e = NULL;
    for (b->line = 1;; ++b->line) {
        const char *stop = (const char *)memchr(p->at, '\n', (size_t)(p->end - p->at));
        size_t n = stop ? (size_t)(stop - p->at) : 0;
        if (!stop) return studio_error("%s: the PLY header has no end_header line", b->path);
        if (n >= sizeof line) return studio_error("%s:%ld: header line too long", b->path, b->line);
        memcpy(line, p->at, n);
        line[n > 0 && line[n - 1] == '\r' ? n - 1 : n] = 0;
        p->at = stop + 1;
        if (strcmp(line, "end_header") == 0) break;
        if (strncmp(line, "format ", 7) == 0) snprintf(format, sizeof format, "%.31s", line + 7);
        if (strncmp(line, "element ", 8) == 0) {
            if (p->elements >= 8) return studio_error("%s:%ld: more than 8 elements", b->path, b->line);
            e = p->element + p->elements++;
            if (sscanf(line, "element %31s %lu", word, &e->count) != 2 || strchr(line, '-'))
                return studio_error("%s:%ld: write 'element NAME COUNT', not '%s'", b->path, b->line, line);
            e->kind = strcmp(word, "vertex") == 0 ? 'v' : strcmp(word, "face") == 0 ? 'f' : 0;
        }
        if (strncmp(line, "property ", 9) == 0 && (!e || studio_ply_property(e, line)))
            return studio_error("%s:%ld: cannot use '%s'", b->path, b->line, line);
    }
    p->ascii = strcmp(format, "ascii 1.0") == 0;
    if (!p->ascii && strcmp(format, "binary_little_endian 1.0") != 0)
        return studio_error("%s: the format is '%s'; save as ascii or binary_little_endian 1.0", b->path, format);
    return 0;
}

/* One list property: skipped, or for the corners of a face turned into triangles.  Returns 0, 1 for damaged
 * data or -1 when the error is printed already. */
STUDIO_API int studio_ply_list(studio_builder *b, studio_ply *p, const studio_property *q) {
    double count, x;
    int first = 0, last = 0;
    long i;
    if (studio_ply_number(p, q->count_type, &count) || !(count >= 0.0 && count <= 1e6)) return 1;
    for (i = 0; i < (long)count; ++i) {
        if (studio_ply_number(p, q->type, &x)) return 1;
        if (q->role != 6) continue;
        if (!(x >= 0.0 && x < (double)b->vertices)) {
            return studio_error("%s: face corner %.0f is out of range; there are %lu vertices", b->path, x,
                                (unsigned long)b->vertices);
        }
        if (i == 0) first = (int)x;
        if (i >= 2 && studio_add_triangle(b, first, last, (int)x)) return -1;
        last = (int)x;
    }
    return 0;
}

/* All rows of one element; returns as studio_ply_list does and leaves the row number in b->line. */
STUDIO_API int studio_ply_rows(studio_builder *b, studio_ply *p, const studio_element *e) {
    unsigned long i;
    int k, seen = 0;
    b->line = 1;
    for (k = 0; k < e->properties; ++k)
        if (e->property[k].role >= 0) seen |= 1 << e->property[k].role;
    if (e->count > 0 && e->properties == 0) return 1;
    if (e->kind == 'v' && b->vertices > 0) return studio_error("%s: more than one vertex element", b->path);
    if (e->kind == 'v' && (seen & 7) != 7) return studio_error("%s: vertices need x, y and z", b->path);
    for (i = 0; i < e->count; ++i, ++b->line) {
        float p6[6] = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 1.0f};
        for (k = 0; k < e->properties; ++k) {
            const studio_property *q = e->property + k;
            double x;
            if (q->count_type) {
                int bad = studio_ply_list(b, p, q);
                if (bad) return bad;
                continue;
            }
            if (studio_ply_number(p, q->type, &x)) return 1;
            if (q->role < 0) continue;
            if (!(fabs(x) < 1e30)) return 1;
            p6[q->role] = (float)x;
        }
        if (e->kind != 'v') continue;
        if (studio_add_vertex(b, p6)) return -1;
        if ((seen & 56) != 56) continue;
        studio_unit(p6 + 3);
        if (studio_reserve(&b->n, &b->ncap, 3 * b->vertices, sizeof(float))) return -1;
        memcpy(b->n + 3 * (b->vertices - 1), p6 + 3, 3 * sizeof(float));
    }
    return 0;
}

STUDIO_API int studio_ply_read(studio_builder *b, const char *text, size_t size) {
    studio_ply p;
    int i;
    memset(&p, 0, sizeof p);
    p.at = text;
    p.end = text + size;
    if (studio_ply_header(b, &p)) return -1;
    for (i = 0; i < p.elements; ++i) {
        int bad = studio_ply_rows(b, &p, p.element + i);
        if (bad > 0)
            studio_error("%s: row %ld of element %d is damaged or cut short", b->path, b->line, i + 1);
        if (bad) return -1;
    }
    return 0;
}

/* Makes a mesh of the bytes of an OBJ or PLY file, and frees them; `path` is for messages. */
STUDIO_API int studio_mesh_parse(const char *path, studio_bytes *file, studio_mesh *m) {
    studio_builder b;
    int bad;
    memset(m, 0, sizeof *m);
    memset(&b, 0, sizeof b);
    b.path = path;
    if (file->size >= 4 && memcmp(file->data, "ply", 3) == 0)
        bad = studio_ply_read(&b, (const char *)file->data, file->size);
    else bad = studio_obj(&b, (char *)file->data, file->size);
    free(file->data);
    memset(file, 0, sizeof *file);
    if (!bad && b.vertices == 0) bad = studio_error("%s: no vertices; is it an OBJ or PLY file?", path);
    m->v = b.v;
    m->n = b.n;
    m->t = b.t;
    m->vertices = (int)b.vertices;
    m->triangles = (int)b.triangles;
    if (!bad && !m->n) bad = studio_mesh_normals(m);
    if (bad) studio_mesh_free(m);
    return bad ? -1 : 0;
}

/* Reads an OBJ or PLY file (ascii or binary little endian; recognised by its first bytes).  Polygons
 * become triangles; vertex normals are taken from a PLY that has them, else computed.  Vertices without
 * faces are accepted (a PLY of points).  On failure prints why, returns non-zero and leaves *m empty. */
STUDIO_API int studio_mesh_load(const char *path, studio_mesh *m) {
    studio_bytes file;
    memset(m, 0, sizeof *m);
    return studio_read(path, &file) ? -1 : studio_mesh_parse(path, &file, m);
}

/* ========================================================= 6  Data output ======================= */

/* Appends formatted text. */
STUDIO_API STUDIO_PRINTF(2, 3) void studio_put_text(studio_bytes *b, const char *format, ...) {
    char text[512];
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof text, format, args);
    va_end(args);
    studio_put(b, text, strlen(text));
}

/* Writes `count` points (3*count floats) as binary PLY, with one number per point when scalar is not
 * NULL, under the property name `label` (a single word). */
STUDIO_API int studio_ply_points(const char *path, int count, const float *xyz, const float *scalar,
                                 const char *label) {
    studio_bytes b;
    size_t i;
    memset(&b, 0, sizeof b);
    studio_put_text(&b, "ply\nformat binary_little_endian 1.0\nelement vertex %d\n", count);
    studio_put_text(&b, "property float x\nproperty float y\nproperty float z\n");
    if (scalar) studio_put_text(&b, "property float %s\n", label ? label : "value");
    studio_put_text(&b, "end_header\n");
    for (i = 0; i < (size_t)count; ++i) {
        studio_put_float(&b, xyz[3 * i]);
        studio_put_float(&b, xyz[3 * i + 1]);
        studio_put_float(&b, xyz[3 * i + 2]);
        if (scalar) studio_put_float(&b, scalar[i]);
    }
    return studio_save(path, &b);
}

/* Writes a mesh as binary PLY, with its normals when it has them. */
STUDIO_API int studio_ply_mesh(const char *path, const studio_mesh *m) {
    studio_bytes b;
    size_t i, k;
    memset(&b, 0, sizeof b);
    studio_put_text(&b, "ply\nformat binary_little_endian 1.0\nelement vertex %d\n", m->vertices);
    studio_put_text(&b, "property float x\nproperty float y\nproperty float z\n");
    if (m->n) studio_put_text(&b, "property float nx\nproperty float ny\nproperty float nz\n");
    studio_put_text(&b, "element face %d\nproperty list uchar int vertex_indices\nend_header\n", m->triangles);
    for (i = 0; i < (size_t)m->vertices; ++i) {
        for (k = 0; k < 3; ++k) studio_put_float(&b, m->v[3 * i + k]);
        for (k = 0; k < 3 && m->n; ++k) studio_put_float(&b, m->n[3 * i + k]);
    }
    for (i = 0; i < (size_t)m->triangles; ++i) {
        studio_put_le(&b, 3, 1);
        for (k = 0; k < 3; ++k) studio_put_le(&b, (unsigned long)m->t[3 * i + k], 4);
    }
    return studio_save(path, &b);
}

/* Opens dir/name for a table and writes the header line; fprintf the rows and fclose it.  NULL with a
 * message on failure. */
STUDIO_API FILE *studio_csv(const char *dir, const char *name, const char *header) {
    const char *path = studio_path(dir, name);
    FILE *f = studio_create(path);
    if (!f) return NULL;
    fprintf(f, "%s\n", header);
    studio_written(path);
    return f;
}

/* ===================================================== 7  Images, drawing ======================= */

typedef struct studio_image {
    int width, height;
    unsigned char *rgb; /* 3*width*height, rows from the top */
} studio_image;

/* Fills the image with one colour. */
STUDIO_API void studio_image_fill(studio_image *im, float r, float g, float b) {
    size_t i, count = (size_t)im->width * (size_t)im->height;
    float c[3];
    studio_set(c, r, g, b);
    for (i = 0; i < 3 * count; ++i)
        im->rgb[i] = (unsigned char)(studio_clamp(c[i % 3], 0.0f, 1.0f) * 255.0f + 0.5f);
}

/* Makes a white image; sides from 1 to 16384.  Non-zero with a message on failure. */
STUDIO_API int studio_image_make(studio_image *im, int width, int height) {
    memset(im, 0, sizeof *im);
    if (width < 1 || height < 1 || width > 16384 || height > 16384)
        return studio_error("a picture of %d x %d pixels is not possible: use sides from 1 to 16384", width, height);
    im->rgb = (unsigned char *)studio_alloc((size_t)width * (size_t)height, 3);
    if (!im->rgb) return -1;
    im->width = width;
    im->height = height;
    studio_image_fill(im, 1.0f, 1.0f, 1.0f);
    return 0;
}

/* Copies a picture into another one with its upper left corner at (x, y); what does not fit is cut off. */
STUDIO_API void studio_image_paste(studio_image *to, const studio_image *from, int x, int y) {
    int left = x < 0 ? -x : 0, width = from->width < to->width - x ? from->width : to->width - x, row;
    for (row = y < 0 ? -y : 0; row < from->height && y + row < to->height && width > left; row++)
        memcpy(to->rgb + 3 * ((size_t)(y + row) * (size_t)to->width + (size_t)(x + left)),
               from->rgb + 3 * ((size_t)row * (size_t)from->width + (size_t)left), 3 * (size_t)(width - left));
}

STUDIO_API void studio_image_free(studio_image *im) {
    free(im->rgb);
    memset(im, 0, sizeof *im);
}

/* Mixes a colour into one pixel; pixels outside are ignored. */
STUDIO_API void studio_blend(studio_image *im, int x, int y, const float rgb[3], float alpha) {
    int k;
    unsigned char *p;
    if (x < 0 || y < 0 || x >= im->width || y >= im->height || !(alpha > 0.0f)) return;
    p = im->rgb + 3 * ((size_t)y * (size_t)im->width + (size_t)x);
    if (alpha > 1.0f) alpha = 1.0f;
    for (k = 0; k < 3; ++k) {
        float old = (float)p[k], now = 255.0f * studio_clamp(rgb[k], 0.0f, 1.0f);
        p[k] = (unsigned char)(old + alpha * (now - old) + 0.5f);
    }
}

/* Fills a rectangle of whole pixels. */
STUDIO_API void studio_rectangle(studio_image *im, int x, int y, int w, int h, const float rgb[3], float alpha) {
    int i, j;
    for (j = y > 0 ? y : 0; j < y + h && j < im->height; ++j)
        for (i = x > 0 ? x : 0; i < x + w && i < im->width; ++i) studio_blend(im, i, j, rgb, alpha);
}

/* Line pieces to be drawn together, so that joints and crossings get no second coat of paint.  A piece
 * without length is a round dot.  Positions in pixels, (0, 0) is the corner of the first pixel. */
typedef struct studio_pen {
    float *piece; /* x0 y0 x1 y1 */
    size_t count, cap;
    int clip[4]; /* x0 y0 x1 y1; all zero for the whole image */
} studio_pen;

STUDIO_API void studio_pen_line(studio_pen *pen, float x0, float y0, float x1, float y1) {
    float *p;
    if (!(fabsf(x0) + fabsf(y0) + fabsf(x1) + fabsf(y1) < 1e6f)) return;
    if (studio_reserve(&pen->piece, &pen->cap, 4 * pen->count + 4, sizeof(float))) return;
    p = pen->piece + 4 * pen->count++;
    studio_set(p, x0, y0, x1);
    p[3] = y1;
}

/* Distance from (x, y) to a line piece. */
STUDIO_API float studio_distance(const float *p, float x, float y) {
    float dx = p[2] - p[0], dy = p[3] - p[1], ax = x - p[0], ay = y - p[1], q = dx * dx + dy * dy;
    float t = q > 0.0f ? studio_clamp((ax * dx + ay * dy) / q, 0.0f, 1.0f) : 0.0f;
    ax -= t * dx;
    ay -= t * dy;
    return sqrtf(ax * ax + ay * ay);
}

/* The pixels that a piece of half width r can touch, cut to `inside`; 0 when there are none. */
STUDIO_API int studio_touched(const float *p, float r, const int inside[4], int box[4]) {
    int k;
    for (k = 0; k < 2; ++k) {
        float lo = p[k] < p[k + 2] ? p[k] : p[k + 2], hi = p[k] < p[k + 2] ? p[k + 2] : p[k];
        box[k] = (int)floorf(lo - r - 1.0f);
        box[k + 2] = (int)ceilf(hi + r + 1.0f);
        if (box[k] < inside[k]) box[k] = inside[k];
        if (box[k + 2] > inside[k + 2]) box[k + 2] = inside[k + 2];
    }
    return box[0] < box[2] && box[1] < box[3];
}

/* Paints the pieces with round ends and soft edges, and empties the pen. */
STUDIO_API void studio_pen_paint(studio_image *im, studio_pen *pen, float width, const float rgb[3], float alpha) {
    int inside[4] = {0, 0, 0, 0}, all[4], box[4], x, y;
    float *cover, r = 0.5f * width;
    size_t i, span;
    inside[2] = im->width;
    inside[3] = im->height;
    if (pen->clip[2] > pen->clip[0]) memcpy(inside, pen->clip, sizeof inside);
    all[0] = inside[2];
    all[1] = inside[3];
    all[2] = all[3] = 0;
    for (i = 0; i < pen->count; ++i) {
        if (!studio_touched(pen->piece + 4 * i, 1.5f * r, inside, box)) continue;
        for (x = 0; x < 2; ++x) {
            if (box[x] < all[x]) all[x] = box[x];
            if (box[x + 2] > all[x + 2]) all[x + 2] = box[x + 2];
        }
    }
    span = all[2] > all[0] ? (size_t)(all[2] - all[0]) : 0;
    cover = span ? (float *)studio_alloc(span * (size_t)(all[3] - all[1]), sizeof(float)) : NULL;
    for (i = 0; i < pen->count && cover; ++i) {
        const float *p = pen->piece + 4 * i;
        float radius = p[0] == p[2] && p[1] == p[3] ? 1.5f * r : r;
        if (!studio_touched(p, radius, inside, box)) continue;
        for (y = box[1]; y < box[3]; ++y)
            for (x = box[0]; x < box[2]; ++x) {
                float *c = cover + (size_t)(y - all[1]) * span + (size_t)(x - all[0]);
                float a = radius + 0.5f - studio_distance(p, (float)x + 0.5f, (float)y + 0.5f);
                if (a > *c) *c = a < 1.0f ? a : 1.0f;
            }
    }
    for (y = all[1]; y < all[3] && cover; ++y)
        for (x = all[0]; x < all[2]; ++x)
            studio_blend(im, x, y, rgb, alpha * cover[(size_t)(y - all[1]) * span + (size_t)(x - all[0])]);
    free(cover);
    pen->count = 0;
}

/* One straight line, widths and positions in pixels. */
STUDIO_API void studio_line(studio_image *im, float x0, float y0, float x1, float y1, float width,
                            const float rgb[3], float alpha) {
    studio_pen pen;
    memset(&pen, 0, sizeof pen);
    studio_pen_line(&pen, x0, y0, x1, y1);
    studio_pen_paint(im, &pen, width, rgb, alpha);
    free(pen.piece);
}

/* The font: one glyph per character 32..126, drawn with strokes.  The first digit is the width; then come
 * strokes, separated by blanks, of points: a digit x and a letter y (d = base line, k = height of small
 * letters, n = height of capitals).  A capital letter makes the point the control of a curve; between two
 * controls lies an unwritten point halfway. */
STUDIO_API const char *studio_glyph(int c) {
    static const char *glyphs[95] = {
        "3", "0 0n0g 0d0d", "2 0n0k 2n2k", "6 1d2n 4d5n 0g6g 0k6k", "6 6l6N0N0I6I6D0D0f 3o3c",
        "8 1d7n 0N3N3K0K0N3N 5G8G8D5D5G8G", "7 7d2j1L1N3n5N5L5J0J0D3d6D7h", "0 0n0k", "2 2o0L0F2b", "2 0o2L2F0b",
        "4 2n2h 0m4i 4m0i", "6 3f3l 0i6i", "1 1d0b", "4 0h4h", "0 0d0d", "5 0c5o", "6 0N6N6D0D0N6N",
        "6 1l3n3d 1d5d", "6 0k0N6N6J0d6d", "6 0l0N6N6I2i6I6D0D0f", "6 5d5n0g6g", "6 6n1n0i1J6J6D0D0f",
        "6 6l6N0N0D6D6J0J0g", "6 0n6n2d", "6 0N6N6I0I0N6N 0I6I6D0D0I6I", "6 0f0D6D6N0N0H6H6k", "0 0d0d 0j0j",
        "1 1d0b 1j1j", "5 5m0i5e", "6 0g6g 0k6k", "5 0m5i0e", "5 0l0N5N5J2i2g 2d2d", "8 6j6G8G8N0N0C6C 2K6K6G2G2K6K",
        "6 0d3n6d 1g5g", "6 0d0n3n6N6I2i0i 2i6I6D3d0d", "6 6l6N0N0D6D6f", "7 0d0n2n7N7D2d0d", "5 5n0n0d5d 0i4i",
        "5 5n0n0d 0i4i", "7 7l7N0N0D7D7h4h", "6 0d0n 6d6n 0i6i", "0 0d0n", "4 4n4g4D0D0f", "6 0d0n 6n0g 2i6d",
        "5 0n0d5d", "8 0d0n4f8n8d", "6 0d0n6d6n", "7 0N7N7D0D0N7N", "6 0d0n3n6N6H3h0h", "7 0N7N7D0D0N7N 4g7c",
        "6 0d0n3n6N6H3h0h 3h6d", "6 6l6N0N0I6I6D0D0f", "6 0n6n 3n3d", "6 0n0g0D6D6g6n", "6 0n3d6n", "8 0n2d4m6d8n",
        "6 0n6d 6n0d", "6 0n3i6n 3i3d", "6 0n6n0d6d", "2 2o0o0b2b", "5 0o5c", "2 0o2o2b0b", "6 0j3n6j", "6 0c6c",
        "2 0n2l", "5 5k5d 0K5K5D0D0K5K", "5 0n0d 0K5K5D0D0K5K", "5 5j5K0K0D5D5e", "5 5n5d 0K5K5D0D0K5K",
        "5 0h5h5K0K0D5D5e", "3 3n1N1k1d 0k3k", "5 5k5c5A0A0b 0K5K5D0D0K5K", "5 0n0d 0h0K5K5h5d", "0 0d0k 0n0n",
        "2 2k2c2A0a 2n2n", "5 0n0d 5k0g 1h5d", "0 0n0d", "8 0k0d 0h0K4K4h4d 4h4K8K8h8d", "5 0k0d 0h0K5K5h5d",
        "5 0K5K5D0D0K5K", "5 0k0a 0K5K5D0D0K5K", "5 5k5a 0K5K5D0D0K5K", "3 0k0d 0h0K3k", "4 4j4K0K0H4G4D0D0e",
        "3 1n1f1D3d 0k3k", "5 0k0g0D5D5g 5k5d", "4 0k2d4k", "6 0k2d3j4d6k", "5 0k5d 5k0d", "4 0k2d 4k1a",
        "5 0k5k0d5d", "3 3o1O1k0i1f1B3b", "0 0o0b", "3 0o2O2k3i2f2B0b", "6 0h1K3i5F6j"};
    return glyphs[c >= 32 && c < 127 ? c - 32 : '?' - 32];
}

/* The width of a text in pixels; `size` is the height of a capital letter. */
STUDIO_API float studio_text_width(const char *text, float size) {
    float units = 0.0f;
    for (; *text; ++text) units += (float)(studio_glyph((unsigned char)*text)[0] - '0') + 2.75f;
    return units > 0.0f ? (units - 2.75f) * 0.1f * size : 0.0f;
}

/* A curve of eight pieces from a, with control b, to c. */
STUDIO_API void studio_pen_curve(studio_pen *pen, const float *a, const float *b, const float *c) {
    float x = a[0], y = a[1];
    int i;
    for (i = 1; i <= 8; ++i) {
        float t = (float)i / 8.0f, s = 1.0f - t;
        float nx = s * s * a[0] + 2.0f * s * t * b[0] + t * t * c[0];
        float ny = s * s * a[1] + 2.0f * s * t * b[1] + t * t * c[1];
        studio_pen_line(pen, x, y, nx, ny);
        x = nx;
        y = ny;
    }
}

/* Adds one stroke of a glyph; returns the text after it.  (ox, oy) is the left end of the base line, `scale`
 * pixels per unit, turned by a quarter when `upward`. */
STUDIO_API const char *studio_pen_stroke(studio_pen *pen, const char *s, float ox, float oy, float scale,
                                         int upward) {
    float at[2] = {0.0f, 0.0f}, control[2] = {0.0f, 0.0f}, point[2], middle[2];
    int first = 1, bent = 0;
    for (; *s && *s != ' '; s += 2) {
        int curve = s[1] < 'a';
        float x = (float)(s[0] - '0') * scale, y = (float)(s[1] - (curve ? 'D' : 'd')) * scale;
        point[0] = upward ? ox - y : ox + x;
        point[1] = upward ? oy - x : oy - y;
        middle[0] = 0.5f * (control[0] + point[0]);
        middle[1] = 0.5f * (control[1] + point[1]);
        if (bent && first) memcpy(at, middle, sizeof at);
        if (bent && !first) {
            const float *to = curve ? middle : point;
            studio_pen_curve(pen, at, control, to);
            memcpy(at, to, sizeof at);
        } else if (!bent && !curve) {
            if (!first) studio_pen_line(pen, at[0], at[1], point[0], point[1]);
            memcpy(at, point, sizeof at);
        }
        if (bent || !curve) first = 0;
        bent = curve;
        if (curve) memcpy(control, point, sizeof control);
    }
    return *s ? s + 1 : s;
}

/* Writes text with its base line at (x, y); size = height of capitals in pixels; align 0 left, 0.5 centred,
 * 1 right; upward turns it to read from bottom to top. */
STUDIO_API void studio_text_at(studio_image *im, float x, float y, float size, const float rgb[3], float align,
                               int upward, const char *text) {
    studio_pen pen;
    float shift = align * studio_text_width(text, size), scale = 0.1f * size;
    memset(&pen, 0, sizeof pen);
    if (upward) y += shift;
    else x -= shift;
    for (; *text; ++text) {
        const char *g = studio_glyph((unsigned char)*text), *s = g[1] ? g + 2 : g + 1;
        float step = ((float)(g[0] - '0') + 2.75f) * scale;
        while (*s) s = studio_pen_stroke(&pen, s, x, y, scale, upward);
        if (upward) y -= step;
        else x += step;
    }
    studio_pen_paint(im, &pen, size * 0.09f + 0.45f, rgb, 1.0f);
    free(pen.piece);
}

STUDIO_API void studio_text(studio_image *im, float x, float y, float size, const float rgb[3], const char *text) {
    studio_text_at(im, x, y, size, rgb, 0.0f, 0, text);
}

/* Puts a panel with a caption into place `column`, `row` of a sheet of panels of this size. */
STUDIO_API void studio_panel(studio_image *sheet, studio_image *panel, int column, int row, const char *caption) {
    static const float ink[3] = {0.2f, 0.22f, 0.26f};
    float size = studio_clamp((float)panel->height / 30.0f, 9.0f, 16.0f);
    if (caption) studio_text(panel, 1.3f * size, 2.4f * size, size, ink, caption);
    studio_image_paste(sheet, panel, column * panel->width, row * panel->height);
}

/* Colour number k of a row in which neighbours differ well: hues by the golden ratio, two lightnesses. */
STUDIO_API void studio_distinct(int k, float rgb[3]) {
    float hue = 0.06f + 0.618034f * (float)k, light = k % 2 ? 0.62f : 0.74f;
    int c;
    for (c = 0; c < 3; ++c) {
        float h = hue + (float)c / 3.0f, t = fabsf(2.0f * (h - floorf(h)) - 1.0f); /* 0 .. 1 .. 0 around the circle */
        rgb[c] = light * (0.36f + 0.64f * studio_smooth(0.25f, 0.8f, t));
    }
}

/* The colour for t in 0..1: dark violet, blue, green, yellow, steadily lighter. */
STUDIO_API void studio_colormap(float t, float rgb[3]) {
    static const float table[9][3] = {
        {0.23f, 0.09f, 0.36f}, {0.25f, 0.22f, 0.51f}, {0.22f, 0.34f, 0.57f}, {0.17f, 0.46f, 0.59f},
        {0.15f, 0.57f, 0.57f}, {0.25f, 0.68f, 0.50f}, {0.48f, 0.78f, 0.39f}, {0.75f, 0.85f, 0.29f},
        {0.98f, 0.90f, 0.33f}};
    float s = 8.0f * (t > 0.0f ? t < 1.0f ? t : 1.0f : 0.0f), f;
    int i = s < 7.0f ? (int)s : 7, k;
    f = s - (float)i;
    for (k = 0; k < 3; ++k) rgb[k] = table[i][k] + f * (table[i + 1][k] - table[i][k]);
}

/* A step of 1, 2 or 5 times a power of ten that divides `range` into at most about `parts`. */
STUDIO_API double studio_step(double range, int parts) {
    double raw = range / (parts > 0 ? parts : 1), power, m;
    if (!(raw > 1e-300) || raw > 1e300) return 1.0;
    power = pow(10.0, floor(log10(raw)));
    m = raw / power;
    return power * (m <= 1.001 ? 1.0 : m <= 2.001 ? 2.0 : m <= 5.001 ? 5.0 : 10.0);
}

/* Writes the number of a tick: as many digits as the step asks for. */
STUDIO_API void studio_tick(double value, double step, char *out, size_t room) {
    int digits = (int)ceil(-log10(step) - 1e-9);
    double big = fabs(value);
    if (big < 1e-6 * step) snprintf(out, room, "0");
    else if (big >= 1e6 || step < 9.9e-5) snprintf(out, room, "%.4g", value);
    else snprintf(out, room, "%.*f", digits > 0 ? digits : 0, value);
}

/* A vertical colour bar with numbers on its right and a title above; (x, y) is the top left corner of the
 * bar itself, w x h its size, lo and hi the values at its ends. */
STUDIO_API void studio_colorbar(studio_image *im, int x, int y, int w, int h, double lo, double hi,
                                const char *title) {
    static const float ink[3] = {0.16f, 0.18f, 0.22f};
    float rgb[3], right, size = studio_clamp((float)h / 22.0f, 7.0f, 14.0f);
    double step = studio_step(hi - lo, (int)((float)h / (3.2f * size))), v;
    char label[64];
    int j;
    for (j = 0; j < h; ++j) {
        studio_colormap(1.0f - ((float)j + 0.5f) / (float)h, rgb);
        studio_rectangle(im, x, y + j, w, 1, rgb, 1.0f);
    }
    if (!(hi - lo > 1e-9 * (fabs(lo) + fabs(hi))) || hi - lo > 1e300) hi = lo; /* no numbers */
    for (v = ceil(lo / step - 1e-6) * step; v <= hi + 1e-6 * step; v += step) {
        float ty = (float)y + (float)h * (float)((hi - v) / (hi - lo));
        if (!(hi > lo)) break;
        studio_line(im, (float)(x + w), ty, (float)(x + w) + 0.4f * size, ty, 1.0f, ink, 1.0f);
        studio_tick(v, step, label, sizeof label);
        studio_text(im, (float)(x + w) + 0.8f * size, ty + 0.5f * size, size, ink, label);
    }
    if (!title) return;
    right = (float)im->width - 0.5f * size - studio_text_width(title, size); /* stay inside the picture */
    /* above the number of the topmost tick, which reaches half a letter over the bar */
    studio_text(im, fmaxf(fminf((float)x, right), 0.5f * size), (float)y - 1.5f * size, size, ink, title);
}

/* ================================================================= 8  PNG ======================= */

STUDIO_API uint32_t studio_crc(uint32_t crc, const unsigned char *p, size_t n) {
    static uint32_t table[256];
    uint32_t i, k, c;
    if (!table[1])
        for (i = 0; i < 256; ++i) {
            for (c = i, k = 0; k < 8; ++k) c = c & 1u ? 0xedb88320u ^ (c >> 1) : c >> 1;
            table[i] = c;
        }
    crc = ~crc;
    while (n--) crc = table[(crc ^ *p++) & 255u] ^ (crc >> 8);
    return ~crc;
}

/* Bits are written least significant first. */
typedef struct studio_bits {
    studio_bytes *out;
    uint32_t hold;
    int count;
} studio_bits;

STUDIO_API void studio_put_bits(studio_bits *b, uint32_t value, int count) {
    b->hold |= value << b->count;
    b->count += count;
    while (b->count >= 8) {
        unsigned char byte = (unsigned char)(b->hold & 255u);
        studio_put(b->out, &byte, 1);
        b->hold >>= 8;
        b->count -= 8;
    }
}

/* Depths of the leaves of a Huffman tree over the n <= 286 symbols with a count; returns the largest. */
STUDIO_API int studio_depths(const unsigned *freq, int n, int shift, unsigned char *length) {
    unsigned weight[576];
    int parent[576], node[288], live = 0, total = n, deepest = 0, i, k;
    for (i = 0; i < n; ++i)
        if (freq[i]) {
            weight[i] = (freq[i] >> shift) + 1u;
            node[live++] = i;
        }
    while (live < 2) { /* a tree needs two leaves */
        k = live == 1 && node[0] == 0 ? 1 : 0;
        weight[k] = 1;
        node[live++] = k;
    }
    for (i = 0; i < 576; ++i) parent[i] = -1;
    while (live > 1) { /* join the two lightest */
        int a = 0, b = 0;
        for (i = 1; i < live; ++i)
            if (weight[node[i]] < weight[node[a]]) a = i;
        k = node[a];
        node[a] = node[--live];
        for (i = 1; i < live; ++i)
            if (weight[node[i]] < weight[node[b]]) b = i;
        weight[total] = weight[k] + weight[node[b]];
        parent[k] = parent[node[b]] = total;
        node[b] = total++;
    }
    for (i = 0; i < n; ++i) {
        int depth = 0;
        for (k = parent[i]; k >= 0; k = parent[k]) ++depth;
        length[i] = (unsigned char)depth;
        if (depth > deepest) deepest = depth;
    }
    return deepest;
}

/* Huffman code lengths (at most `limit`) and bit-reversed codes for n symbols with the given counts. */
STUDIO_API void studio_huffman(const unsigned *freq, int n, int limit, unsigned char *length, uint16_t *code) {
    unsigned next[17], count[17], c = 0;
    int shift = 0, i, k;
    while (studio_depths(freq, n, shift, length) > limit) ++shift; /* flatter counts, flatter tree */
    memset(count, 0, sizeof count);
    for (i = 0; i < n; ++i) ++count[length[i]];
    count[0] = 0;
    for (i = 1; i <= limit; ++i) next[i] = c = (c + count[i - 1]) << 1;
    for (i = 0; i < n; ++i) {
        unsigned v = length[i] ? next[length[i]]++ : 0, r = 0;
        for (k = 0; k < length[i]; ++k) r |= ((v >> k) & 1u) << (length[i] - 1 - k);
        code[i] = (uint16_t)r;
    }
}

/* The deflate symbol of a match length 3..258 (or, with distance set, of a distance 1..32768), the number
 * of extra bits and their value. */
STUDIO_API int studio_bucket(unsigned value, int distance, int *extra_bits, unsigned *extra) {
    unsigned v = value - (distance ? 1u : 3u), keep = distance ? 1u : 2u, top = 0;
    *extra_bits = 0;
    *extra = 0;
    if (!distance && value == 258) return 28;
    while (v >> (top + 1)) ++top;
    if (top <= keep) return (int)v;
    *extra_bits = (int)(top - keep);
    *extra = v & ((1u << *extra_bits) - 1u);
    return (int)(((top - keep) << keep) + (v >> *extra_bits));
}

/* Writes the two code-length tables of a block, run-length coded. */
STUDIO_API void studio_deflate_tables(studio_bits *b, const unsigned char *length, int literals, int distances) {
    static const unsigned char order[19] = {16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15};
    unsigned char run[320], extra[320], size[19];
    unsigned freq[19];
    uint16_t code[19];
    int n = 0, total = literals + distances, sent = 19, i, j;
    memset(freq, 0, sizeof freq);
    for (i = 0; i < total; i += j) {
        for (j = 1; i + j < total && length[i + j] == length[i] && j < 138; ++j) continue;
        run[n] = length[i];
        extra[n] = 0;
        if (length[i] == 0 && j >= 3) {
            run[n] = j < 11 ? 17 : 18;
            extra[n] = (unsigned char)(j < 11 ? j - 3 : j - 11);
        } else if (length[i] == length[i > 0 ? i - 1 : total] && i > 0 && j >= 3) {
            j = j < 6 ? j : 6;
            run[n] = 16;
            extra[n] = (unsigned char)(j - 3);
        } else j = 1;
        ++freq[run[n++]];
    }
    studio_huffman(freq, 19, 7, size, code);
    while (sent > 4 && size[order[sent - 1]] == 0) --sent;
    studio_put_bits(b, (uint32_t)literals - 257u, 5);
    studio_put_bits(b, (uint32_t)distances - 1u, 5);
    studio_put_bits(b, (uint32_t)sent - 4u, 4);
    for (i = 0; i < sent; ++i) studio_put_bits(b, size[order[i]], 3);
    for (i = 0; i < n; ++i) {
        studio_put_bits(b, code[run[i]], size[run[i]]);
        if (run[i] >= 16) studio_put_bits(b, extra[i], run[i] == 16 ? 2 : run[i] == 17 ? 3 : 7);
    }
}

/* Writes one dynamic block of tokens (literal, or length << 16 | distance). */
STUDIO_API void studio_deflate_block(studio_bits *b, const uint32_t *token, size_t count, int last) {
    unsigned freq[316], extra;
    unsigned char length[321];
    uint16_t code[316];
    int bits, k;
    size_t i;
    memset(freq, 0, sizeof freq);
    freq[256] = 1;
    for (i = 0; i < count; ++i) {
        if (token[i] < 65536u) ++freq[token[i]];
        else {
            ++freq[257 + studio_bucket(token[i] >> 16, 0, &bits, &extra)];
            ++freq[286 + studio_bucket(token[i] & 65535u, 1, &bits, &extra)];
        }
    }
    memset(length, 0, sizeof length);
    studio_huffman(freq, 286, 15, length, code);
    studio_huffman(freq + 286, 30, 15, length + 286, code + 286);
    studio_put_bits(b, (last ? 1u : 0u) + 4u, 3);
    studio_deflate_tables(b, length, 286, 30);
    for (i = 0; i < count; ++i) {
        if (token[i] < 65536u) {
            studio_put_bits(b, code[token[i]], length[token[i]]);
            continue;
        }
        k = 257 + studio_bucket(token[i] >> 16, 0, &bits, &extra);
        studio_put_bits(b, code[k], length[k]);
        studio_put_bits(b, extra, bits);
        k = 286 + studio_bucket(token[i] & 65535u, 1, &bits, &extra);
        studio_put_bits(b, code[k], length[k]);
        studio_put_bits(b, extra, bits);
    }
    studio_put_bits(b, code[256], length[256]);
}

/* The longest earlier copy of the bytes at i, searched along the hash chain: length << 16 | distance, or 0. */
STUDIO_API uint32_t studio_longest(const unsigned char *p, size_t n, size_t i, long at, const long *prev) {
    size_t best = 2, limit = n - i < 258 ? n - i : 258, distance = 0, k;
    int tries = 40;
    while (at >= 0 && i - (size_t)at <= 32768 && tries-- > 0 && best < limit) {
        const unsigned char *q = p + at;
        if (q[best] == p[i + best]) {
            for (k = 0; k < limit && q[k] == p[i + k]; ++k) continue;
            if (k > best) {
                best = k;
                distance = i - (size_t)at;
            }
        }
        at = prev[at & 32767];
    }
    return distance ? (uint32_t)(best << 16 | (distance & 65535u)) : 0;
}

/* Appends the zlib stream of n bytes to out. */
STUDIO_API void studio_deflate(const unsigned char *p, size_t n, studio_bytes *out) {
    const size_t block = 32768;
    long *head = (long *)studio_alloc(32768, sizeof(long)), *prev = (long *)studio_alloc(32768, sizeof(long));
    uint32_t *token = (uint32_t *)studio_alloc(block, sizeof(uint32_t)), a = 1, b = 0, found;
    studio_bits bits;
    size_t i, k, step, count = 0;
    if (!head || !prev || !token) out->failed = 1;
    for (i = 0; i < 32768 && !out->failed; ++i) head[i] = -1;
    memset(&bits, 0, sizeof bits);
    bits.out = out;
    studio_put(out, "\x78\x9c", 2);
    for (i = 0; i < n && !out->failed; i += step) {
        found = 0;
        step = 1;
        for (k = 0; k < step && i + k + 3 <= n; ++k) {
            const unsigned char *s = p + i + k;
            uint32_t h = ((uint32_t)s[0] | (uint32_t)s[1] << 8 | (uint32_t)s[2] << 16) * 2654435761u >> 17;
            if (k == 0) found = studio_longest(p, n, i, head[h], prev);
            if (k == 0 && found) step = found >> 16;
            prev[(i + k) & 32767] = head[h];
            head[h] = (long)(i + k);
        }
        token[count++] = found ? found : p[i];
        if (count < block) continue;
        studio_deflate_block(&bits, token, count, 0);
        count = 0;
    }
    if (!out->failed) studio_deflate_block(&bits, token, count, 1);
    studio_put_bits(&bits, 0, (8 - bits.count) & 7);
    for (i = 0; i < n; ++i) {
        a = (a + p[i]) % 65521u;
        b = (b + a) % 65521u;
    }
    for (i = 4; i-- > 0;) {
        unsigned char byte = (unsigned char)(((b << 16 | a) >> (8 * i)) & 255u);
        studio_put(out, &byte, 1);
    }
    free(head);
    free(prev);
    free(token);
}

STUDIO_API void studio_put_be(studio_bytes *b, uint32_t value) {
    unsigned char bytes[4];
    int i;
    for (i = 0; i < 4; ++i) bytes[i] = (unsigned char)((value >> (24 - 8 * i)) & 255u);
    studio_put(b, bytes, 4);
}

STUDIO_API void studio_png_chunk(studio_bytes *b, const char *type, const unsigned char *data, size_t n) {
    size_t start;
    studio_put_be(b, (uint32_t)n);
    start = b->size;
    studio_put(b, type, 4);
    studio_put(b, data, n);
    if (!b->failed) studio_put_be(b, studio_crc(0, b->data + start, n + 4));
}

/* Filters one row of n bytes with PNG filter `kind` 0..4 (none, left, up, average, Paeth) into out; returns
 * the sum of the sizes of the differences. */
STUDIO_API unsigned long studio_png_filter(int kind, const unsigned char *row, const unsigned char *up, size_t n,
                                           unsigned char *out) {
    unsigned long sum = 0;
    size_t i;
    for (i = 0; i < n; ++i) {
        int a = i < 3 ? 0 : row[i - 3], b = up ? up[i] : 0, c = i < 3 || !up ? 0 : up[i - 3], guess = 0, d;
        if (kind == 1) guess = a;
        if (kind == 2) guess = b;
        if (kind == 3) guess = (a + b) / 2;
        if (kind == 4) {
            int pa = abs(b - c), pb = abs(a - c), pc = abs(a + b - 2 * c);
            guess = pa <= pb && pa <= pc ? a : pb <= pc ? b : c;
        }
        d = (row[i] - guess) & 255;
        out[i] = (unsigned char)d;
        sum += (unsigned long)(d < 128 ? d : 256 - d);
    }
    return sum;
}

/* Writes the image as an 8-bit RGB PNG.  Non-zero with a message on failure. */
STUDIO_API int studio_png(const char *path, const studio_image *im) {
    size_t row = 3 * (size_t)im->width, packed = (row + 1) * (size_t)im->height;
    unsigned char *raw = (unsigned char *)studio_alloc(packed, 1), *trial = (unsigned char *)studio_alloc(row, 1);
    studio_bytes head, data, file;
    int y, kind;
    memset(&head, 0, sizeof head);
    memset(&data, 0, sizeof data);
    memset(&file, 0, sizeof file);
    for (y = 0; y < im->height && raw && trial; ++y) {
        const unsigned char *at = im->rgb + row * (size_t)y, *up = y ? at - row : NULL;
        unsigned char *out = raw + (row + 1) * (size_t)y;
        unsigned long best = ULONG_MAX;
        for (kind = 0; kind < 5; ++kind) {
            unsigned long sum = studio_png_filter(kind, at, up, row, trial);
            if (sum >= best) continue;
            best = sum;
            out[0] = (unsigned char)kind;
            memcpy(out + 1, trial, row);
        }
    }
    file.failed = !raw || !trial;
    if (!file.failed) studio_deflate(raw, packed, &data);
    studio_put_be(&head, (uint32_t)im->width);
    studio_put_be(&head, (uint32_t)im->height);
    studio_put(&head, "\x08\x02\x00\x00\x00", 5);
    file.failed |= head.failed | data.failed;
    studio_put(&file, "\x89PNG\r\n\x1a\n", 8);
    studio_png_chunk(&file, "IHDR", head.data, head.size);
    studio_png_chunk(&file, "IDAT", data.data, data.size);
    studio_png_chunk(&file, "IEND", NULL, 0);
    free(head.data);
    free(data.data);
    free(raw);
    free(trial);
    return studio_save(path, &file);
}

/* ================================================================= 9  GIF ======================= */

/* An animated GIF that is being written.  One palette of 255 colours serves as long as it fits the frames; a
 * frame it no longer fits brings its own.  Only pixels that changed visibly are stored again, and the
 * dither pattern is fixed to the screen, so that what stands still does not flicker. */
typedef struct studio_gif {
    FILE *f;
    char path[STUDIO_PATH];
    int width, height, delay, frames, failed;
    int own; /* the palette is no longer that of the file head: every frame carries it */
    unsigned char palette[768];
    double fit;             /* mean squared error of the palette when it was made */
    unsigned char *shown;   /* the true colours of the pixels as they were last stored */
    unsigned char *index;   /* of the frame being written */
    unsigned short *lookup; /* 7 bits per channel -> 1 + nearest palette entry, 0 unknown */
} studio_gif;

enum { STUDIO_CELLS = 32768, STUDIO_COLORS = 255, STUDIO_LOOKUP = 1 << 21 };

typedef struct studio_swatch {
    float mean[3], weight;
} studio_swatch;

typedef struct studio_box {
    int first, count, axis;
    float mean, gain; /* split value and spread along the axis times weight */
} studio_box;

/* Gathers the colours of an image into cells of 5 bits per channel; returns how many are in use.  Rare
 * colours weigh more than their share. */
STUDIO_API int studio_histogram(const unsigned char *rgb, size_t pixels, studio_swatch *cell) {
    size_t i;
    int n = 0, j, k;
    memset(cell, 0, STUDIO_CELLS * sizeof *cell);
    for (i = 0; i < pixels; ++i) {
        const unsigned char *p = rgb + 3 * i;
        studio_swatch *s = cell + ((p[0] >> 3) << 10 | (p[1] >> 3) << 5 | p[2] >> 3);
        for (k = 0; k < 3; ++k) s->mean[k] += (float)p[k];
        s->weight += 1.0f;
    }
    for (j = 0; j < STUDIO_CELLS; ++j)
        if (cell[j].weight > 0.0f) {
            studio_swatch s = cell[j];
            for (k = 0; k < 3; ++k) s.mean[k] /= s.weight;
            s.weight = powf(s.weight, 0.6f);
            cell[n++] = s;
        }
    return n;
}

/* Finds the axis along which a box of swatches spreads most. */
STUDIO_API void studio_box_measure(studio_box *b, const studio_swatch *cell) {
    float sum[3] = {0, 0, 0}, square[3] = {0, 0, 0}, weight = 0.0f;
    int i, k;
    for (i = b->first; i < b->first + b->count; ++i) {
        weight += cell[i].weight;
        for (k = 0; k < 3; ++k) sum[k] += cell[i].weight * cell[i].mean[k];
    }
    for (i = b->first; i < b->first + b->count; ++i)
        for (k = 0; k < 3; ++k) {
            float d = cell[i].mean[k] - sum[k] / weight;
            square[k] += cell[i].weight * d * d;
        }
    b->axis = square[1] >= square[0] && square[1] >= square[2] ? 1 : square[0] >= square[2] ? 0 : 2;
    b->mean = sum[b->axis] / weight;
    b->gain = b->count > 1 ? square[b->axis] : 0.0f;
}

/* The palette entry nearest to a colour. */
STUDIO_API int studio_nearest(const unsigned char *palette, int r, int g, int b) {
    int best = 0, least = INT_MAX, i;
    for (i = 0; i < STUDIO_COLORS; ++i) {
        int dr = palette[3 * i] - r, dg = palette[3 * i + 1] - g, db = palette[3 * i + 2] - b;
        int d = 2 * dr * dr + 4 * dg * dg + db * db;
        if (d < least) {
            least = d;
            best = i;
        }
    }
    return best;
}

/* Moves every palette colour to the mean of the swatches nearest to it. */
STUDIO_API void studio_palette_settle(unsigned char *palette, const studio_swatch *cell, int n) {
    float sum[STUDIO_COLORS][4];
    int i, k;
    memset(sum, 0, sizeof sum);
    for (i = 0; i < n; ++i) {
        const float *m = cell[i].mean;
        float *s = sum[studio_nearest(palette, (int)(m[0] + 0.5f), (int)(m[1] + 0.5f), (int)(m[2] + 0.5f))];
        for (k = 0; k < 3; ++k) s[k] += cell[i].weight * m[k];
        s[3] += cell[i].weight;
    }
    for (i = 0; i < STUDIO_COLORS; ++i)
        for (k = 0; k < 3 && sum[i][3] > 0.0f; ++k)
            palette[3 * i + k] = (unsigned char)(sum[i][k] / sum[i][3] + 0.5f);
}

/* Chooses 255 colours for an image: boxes of colours are halved where they spread most, then settled. */
STUDIO_API int studio_palette(const studio_image *im, unsigned char *palette) {
    studio_swatch *cell = (studio_swatch *)studio_alloc(STUDIO_CELLS, sizeof *cell), swap;
    studio_box box[STUDIO_COLORS];
    int n, boxes = 1, i, j, k;
    if (!cell) return -1;
    n = studio_histogram(im->rgb, (size_t)im->width * (size_t)im->height, cell);
    box[0].first = 0;
    box[0].count = n;
    studio_box_measure(box, cell);
    while (boxes < STUDIO_COLORS) {
        studio_box *b = box, *half = box + boxes;
        for (i = 1; i < boxes; ++i)
            if (box[i].gain > b->gain) b = box + i;
        if (!(b->gain > 0.0f)) break;
        for (i = j = b->first; i < b->first + b->count; ++i)
            if (cell[i].mean[b->axis] < b->mean) {
                swap = cell[i];
                cell[i] = cell[j];
                cell[j++] = swap;
            }
        if (j == b->first || j == b->first + b->count) {
            b->gain = 0.0f;
            continue;
        }
        half->first = j;
        half->count = b->first + b->count - j;
        b->count = j - b->first;
        studio_box_measure(b, cell);
        studio_box_measure(half, cell);
        ++boxes;
    }
    memset(palette, 0, 768);
    for (i = 0; i < boxes; ++i)
        for (k = 0; k < 3; ++k) {
            float sum = 0.0f, weight = 0.0f;
            for (j = box[i].first; j < box[i].first + box[i].count; ++j) {
                sum += cell[j].weight * cell[j].mean[k];
                weight += cell[j].weight;
            }
            palette[3 * i + k] = (unsigned char)(sum / weight + 0.5f);
        }
    for (i = 0; i < 2; ++i) studio_palette_settle(palette, cell, n);
    free(cell);
    return 0;
}

/* Begins an animation; delay in 1/100 s between frames.  NULL with a message on failure. */
STUDIO_API studio_gif *studio_gif_begin(const char *path, int width, int height, int delay) {
    studio_gif *g;
    if (width < 1 || height < 1 || width > 8192 || height > 8192 || delay < 0 || delay > 65535 ||
        strlen(path) >= STUDIO_PATH) {
        studio_error("%.60s: a GIF needs sides from 1 to 8192 and a delay from 0 to 65535", path);
        return NULL;
    }
    g = (studio_gif *)studio_alloc(1, sizeof *g);
    if (!g) return NULL;
    strcpy(g->path, path);
    g->width = width;
    g->height = height;
    g->delay = delay;
    g->shown = (unsigned char *)studio_alloc((size_t)width * (size_t)height, 3);
    g->index = (unsigned char *)studio_alloc((size_t)width * (size_t)height, 1);
    g->lookup = (unsigned short *)studio_alloc(STUDIO_LOOKUP, sizeof(unsigned short));
    g->f = g->shown && g->index && g->lookup ? studio_create(path) : NULL;
    g->failed = !g->f;
    if (!g->failed) return g;
    free(g->shown);
    free(g->index);
    free(g->lookup);
    free(g);
    return NULL;
}

/* Turns one colour into a palette entry, remembering the answer. */
STUDIO_API int studio_gif_pick(studio_gif *g, int r, int gr, int b) {
    unsigned short *seen = g->lookup + ((r >> 1) << 14 | (gr >> 1) << 7 | b >> 1);
    if (!*seen) *seen = (unsigned short)(1 + studio_nearest(g->palette, r | 1, gr | 1, b | 1));
    return *seen - 1;
}

/* The mean squared error of the palette over a sample of the image. */
STUDIO_API double studio_gif_misfit(studio_gif *g, const studio_image *im) {
    size_t i, n = (size_t)im->width * (size_t)im->height, count = 0;
    double sum = 0.0;
    for (i = 0; i < n; i += 7, ++count) {
        const unsigned char *p = im->rgb + 3 * i, *q = g->palette + 3 * studio_gif_pick(g, p[0], p[1], p[2]);
        int a = p[0] - q[0], b = p[1] - q[1], c = p[2] - q[2];
        sum += (double)(a * a + b * b + c * c);
    }
    return sum / (double)count;
}

/* Dithers the pixels that changed into g->index (255 = keep what is there) and finds the box around them:
 * x0 y0 x1 y1.  Returns how many changed. */
STUDIO_API size_t studio_gif_change(studio_gif *g, const studio_image *im, int box[4]) {
    static const unsigned char bayer[64] = {
        0,  32, 8,  40, 2,  34, 10, 42, 48, 16, 56, 24, 50, 18, 58, 26, 12, 44, 4,  36, 14, 46,
        6,  38, 60, 28, 52, 20, 62, 30, 54, 22, 3,  35, 11, 43, 1,  33, 9,  41, 51, 19, 59, 27,
        49, 17, 57, 25, 15, 47, 7,  39, 13, 45, 5,  37, 63, 31, 55, 23, 61, 29, 53, 21};
    const int slack = 3;
    size_t changed = 0, i = 0;
    int x, y, k, c[3];
    box[0] = g->width;
    box[1] = g->height;
    box[2] = box[3] = 0;
    for (y = 0; y < g->height; ++y)
        for (x = 0; x < g->width; ++x, ++i) {
            const unsigned char *p = im->rgb + 3 * i;
            unsigned char *old = g->shown + 3 * i;
            int shift = (bayer[(y & 7) * 8 + (x & 7)] * 2 - 63) * 5 / 63;
            g->index[i] = 255;
            for (k = 0; k < 3; ++k)
                if (abs(p[k] - old[k]) > slack) break;
            if (g->frames > 0 && k == 3) continue;
            for (k = 0; k < 3; ++k) {
                c[k] = p[k] + shift;
                c[k] = c[k] < 0 ? 0 : c[k] > 255 ? 255 : c[k];
            }
            memcpy(old, p, 3);
            g->index[i] = (unsigned char)studio_gif_pick(g, c[0], c[1], c[2]);
            if (x < box[0]) box[0] = x;
            if (y < box[1]) box[1] = y;
            if (x >= box[2]) box[2] = x + 1;
            if (y >= box[3]) box[3] = y + 1;
            ++changed;
        }
    return changed;
}

/* Appends the LZW code of the box of g->index, in blocks of up to 255 bytes. */
STUDIO_API void studio_gif_lzw(const studio_gif *g, const int box[4], studio_bytes *out) {
    const uint32_t slots = 16384;
    uint32_t *key = (uint32_t *)studio_alloc(slots, sizeof(uint32_t));
    unsigned short *code = (unsigned short *)studio_alloc(slots, sizeof(unsigned short));
    studio_bytes raw;
    studio_bits bits;
    uint32_t prefix = 0, next = 258;
    int x, y, size = 9, begun = 0;
    size_t i;
    memset(&raw, 0, sizeof raw);
    memset(&bits, 0, sizeof bits);
    bits.out = &raw;
    if (!key || !code) out->failed = 1;
    studio_put_bits(&bits, 256, 9);
    for (y = box[1]; y < box[3] && !out->failed; ++y)
        for (x = box[0]; x < box[2]; ++x) {
            uint32_t c = g->index[(size_t)y * (size_t)g->width + (size_t)x], k = prefix << 8 | c, h;
            if (!begun) {
                begun = 1;
                prefix = c;
                continue;
            }
            for (h = k * 2654435761u >> 18; key[h] && key[h] != k + 1u; h = (h + 1u) & (slots - 1u)) continue;
            if (key[h]) {
                prefix = code[h];
                continue;
            }
            studio_put_bits(&bits, prefix, size);
            prefix = c;
            key[h] = k + 1u;
            code[h] = (unsigned short)next;
            if (next == 1u << size) ++size;
            if (++next < 4096) continue;
            studio_put_bits(&bits, 256, size);
            memset(key, 0, slots * sizeof *key);
            next = 258;
            size = 9;
        }
    studio_put_bits(&bits, prefix, size);
    if (next == 1u << size) ++size;
    studio_put_bits(&bits, 257, size);
    studio_put_bits(&bits, 0, (8 - bits.count) & 7);
    studio_put_le(out, 8, 1);
    for (i = 0; i < raw.size; i += 255) {
        size_t n = raw.size - i < 255 ? raw.size - i : 255;
        studio_put_le(out, (unsigned long)n, 1);
        studio_put(out, raw.data + i, n);
    }
    studio_put_le(out, 0, 1);
    out->failed |= raw.failed;
    free(raw.data);
    free(key);
    free(code);
}

/* Makes a new palette for the frame when there is none yet or the present one fits badly; returns 1 then,
 * 0 when the present one stays, -1 when out of memory. */
STUDIO_API int studio_gif_refit(studio_gif *g, const studio_image *im) {
    if (g->frames > 0 && studio_gif_misfit(g, im) < 2.0 * g->fit + 4.0) return 0;
    if (studio_palette(im, g->palette)) return -1;
    memset(g->lookup, 0, STUDIO_LOOKUP * sizeof *g->lookup);
    g->fit = studio_gif_misfit(g, im);
    return 1;
}

/* Adds a frame; the image must have the size given to studio_gif_begin.  Non-zero with a message on failure
 * (also for g = NULL, quietly). */
STUDIO_API int studio_gif_frame(studio_gif *g, const studio_image *im) {
    static const char loop[] = "!\xff\x0bNETSCAPE2.0\x03\x01\0\0";
    studio_bytes b;
    int box[4], fresh;
    if (!g || g->failed) return -1;
    if (im->width != g->width || im->height != g->height)
        return studio_error("%s: the frame is %d x %d, not %d x %d", g->path, im->width, im->height,
                            g->width, g->height);
    memset(&b, 0, sizeof b);
    fresh = studio_gif_refit(g, im);
    if (fresh < 0) return g->failed = -1;
    if (fresh && g->frames > 0) g->own = 1;
    if (g->frames == 0) {
        studio_put(&b, "GIF89a", 6);
        studio_put_le(&b, (unsigned long)g->width, 2);
        studio_put_le(&b, (unsigned long)g->height, 2);
        studio_put(&b, "\xf7\0\0", 3);
        studio_put(&b, g->palette, 768);
        studio_put(&b, loop, sizeof loop);
    }
    if (studio_gif_change(g, im, box) == 0) {
        box[0] = box[1] = 0;
        box[2] = box[3] = 1;
    }
    studio_put(&b, "!\xf9\x04\x05", 4);
    studio_put_le(&b, (unsigned long)g->delay, 2);
    studio_put(&b, "\xff\0,", 3);
    studio_put_le(&b, (unsigned long)box[0], 2);
    studio_put_le(&b, (unsigned long)box[1], 2);
    studio_put_le(&b, (unsigned long)(box[2] - box[0]), 2);
    studio_put_le(&b, (unsigned long)(box[3] - box[1]), 2);
    studio_put_le(&b, g->own ? 0x87 : 0, 1);
    if (g->own) studio_put(&b, g->palette, 768);
    studio_gif_lzw(g, box, &b);
    if (b.failed || fwrite(b.data, 1, b.size, g->f) != b.size) g->failed = 1;
    free(b.data);
    ++g->frames;
    return g->failed ? studio_error("%s: could not write frame %d: is the disk full?", g->path, g->frames) : 0;
}

/* Ends the animation and frees it.  Non-zero with a message on failure. */
STUDIO_API int studio_gif_end(studio_gif *g) {
    int bad;
    if (!g) return -1;
    bad = g->failed;
    if (g->frames == 0) bad = studio_error("%s: an animation needs at least one frame", g->path);
    fputc(';', g->f);
    bad |= studio_finish(g->f, g->path);
    free(g->shown);
    free(g->index);
    free(g->lookup);
    free(g);
    return bad;
}

/* ===================================================== 10  Scene, renderer ======================= */

typedef struct studio_camera {
    float eye[3], target[3], up[3];
    float fov; /* vertical opening in degrees */
} studio_camera;

/* Light, backdrop and ground; studio_scene_begin fills in a look that works for most pictures. */
typedef struct studio_look {
    float light[3];                  /* direction towards the light, any length */
    float key[3], sky[3], earth[3];  /* linear: direct light, light from above and from below */
    float top[3], bottom[3];         /* backdrop at the upper and lower edge */
    float floor[3];                  /* colour of the ground */
    float up[3], height;             /* the ground is where up . p = height; up has length 1 */
    int ground;                      /* 0 for no ground */
    float cell;                      /* side of a ground square; 0 chooses one */
    float gloss;                     /* strength of highlights, 0..1 */
    float centre[3], radius;         /* the lit stage; radius 0 takes the contents, frame by frame */
} studio_look;

typedef struct studio_triangle {
    float p[9], n[9], c[9]; /* corners, normals, linear colours */
    float back[3];          /* linear: the colours times this are seen from behind; 1 1 1 for solids */
} studio_triangle;

typedef struct studio_ball {
    float p[3], r, c[3];
} studio_ball;

typedef struct studio_segment {
    float a[3], b[3], c[3], width;
} studio_segment;

/* A depth picture: the primitive seen at each sample (0 none) and a key that is larger for what is nearer. */
typedef struct studio_buffer {
    int width, height;
    float *key;
    int *id; /* NULL when not wanted */
    size_t cap_key, cap_id;
} studio_buffer;

/* Things to draw.  Begin once, then per frame: clear, add, render; end frees the memory. */
typedef struct studio_scene {
    studio_look look;
    studio_triangle *triangle;
    studio_ball *ball;
    studio_segment *segment;
    size_t triangles, balls, segments, triangle_cap, ball_cap, segment_cap;
    studio_buffer view, shadow, floor;
    float centre[3], radius;              /* the lit stage in use */
    float right[3], up[3], forward[3];    /* camera frame */
    float zoom;                           /* samples per unit of x/z */
    float eye[3], nearest;
    float la[3], lb[3], ln[3];            /* light frame */
    float ga[3], gb[3];                   /* ground frame */
    float paint[3], sky[2][3];            /* linear ground and backdrop colours */
    float cell;
    unsigned char tone[4096];             /* linear light to sRGB */
    float *contact;                       /* how covered the ground is, from the floor buffer */
    size_t contact_cap;
} studio_scene;

enum { STUDIO_SHADOW = 1024, STUDIO_FLOOR = 160 };

/* sRGB to linear light, close enough for pictures. */
STUDIO_API void studio_linear(const float *rgb, float *out) {
    int k;
    for (k = 0; k < 3; ++k) out[k] = powf(studio_clamp(rgb[k], 0.0f, 1.0f), 2.2f);
}

STUDIO_API void studio_scene_begin(studio_scene *s) {
    studio_look *l = &s->look;
    memset(s, 0, sizeof *s);
    studio_set(l->light, -0.75f, -0.45f, 1.0f);
    studio_set(l->key, 1.12f, 1.02f, 0.88f);
    studio_set(l->sky, 0.46f, 0.51f, 0.60f);
    studio_set(l->earth, 0.27f, 0.24f, 0.22f);
    studio_set(l->top, 0.78f, 0.84f, 0.90f);
    studio_set(l->bottom, 0.95f, 0.945f, 0.93f);
    studio_set(l->floor, 0.90f, 0.895f, 0.88f);
    studio_set(l->up, 0.0f, 0.0f, 1.0f);
    l->ground = 1;
    l->gloss = 0.35f;
}

/* Removes the things, keeps the look and the memory. */
STUDIO_API void studio_scene_clear(studio_scene *s) { s->triangles = s->balls = s->segments = 0; }

STUDIO_API void studio_scene_end(studio_scene *s) {
    free(s->triangle);
    free(s->ball);
    free(s->segment);
    free(s->view.key);
    free(s->view.id);
    free(s->shadow.key);
    free(s->floor.key);
    free(s->contact);
    memset(s, 0, sizeof *s);
}

/* Adds a mesh in one colour, or with colours = 3*vertices sRGB floats.  Uses m->n when it is there, else flat
 * normals.  Non-zero with a message when out of memory. */
STUDIO_API int studio_scene_mesh(studio_scene *s, const studio_mesh *m, const float rgb[3], const float *colours) {
    float flat[3] = {0.7f, 0.7f, 0.7f}, a[3], b[3], n[3];
    int i, k;
    if (rgb) studio_linear(rgb, flat);
    if (studio_reserve(&s->triangle, &s->triangle_cap, s->triangles + (size_t)m->triangles, sizeof *s->triangle))
        return -1;
    for (i = 0; i < m->triangles; ++i) {
        studio_triangle *t = s->triangle + s->triangles++;
        studio_set(t->back, 1.0f, 1.0f, 1.0f);
        for (k = 0; k < 3; ++k) {
            size_t at = 3 * (size_t)m->t[3 * (size_t)i + (size_t)k];
            memcpy(t->p + 3 * k, m->v + at, sizeof flat);
            if (m->n) memcpy(t->n + 3 * k, m->n + at, sizeof flat);
            if (colours) studio_linear(colours + at, t->c + 3 * k);
            else memcpy(t->c + 3 * k, flat, sizeof flat);
        }
        if (m->n) continue;
        studio_along(t->p + 3, -1.0f, t->p, a);
        studio_along(t->p + 6, -1.0f, t->p, b);
        studio_cross(a, b, n);
        studio_unit(n);
        for (k = 0; k < 3; ++k) memcpy(t->n + 3 * k, n, sizeof n);
    }
    return 0;
}

/* Adds an open surface that shows two sides: as studio_scene_mesh, and from behind (where its triangles run
 * clockwise) with its colours times `back`, channel by channel; NULL: darker by a third. */
STUDIO_API int studio_scene_sheet(studio_scene *s, const studio_mesh *m, const float rgb[3], const float *colours,
                                  const float back[3]) {
    float dark[3] = {0.66f, 0.66f, 0.66f}, tint[3];
    size_t i = s->triangles;
    if (studio_scene_mesh(s, m, rgb, colours)) return -1;
    studio_linear(back ? back : dark, tint);
    for (; i < s->triangles; ++i) memcpy(s->triangle[i].back, tint, sizeof tint);
    return 0;
}

/* Carries the vector v, kept at length 1, from one piece of a line to the next (unit directions a and b) without twist:
 * by the smallest turn that takes a to b. */
STUDIO_API void studio_carry(const float *a, const float *b, float *v) {
    float axis[3], turn[3], c = studio_dot(a, b), rest;
    studio_cross(a, b, axis);
    studio_cross(axis, v, turn);
    rest = studio_dot(axis, v) / fmaxf(1.0f + c, 1e-3f);
    studio_set(v, c * v[0] + turn[0], c * v[1] + turn[1], c * v[2] + turn[2]);
    studio_along(v, rest, axis, v);
    studio_along(v, -studio_dot(b, v), b, v);
    studio_unit(v);
}

/* The direction of a polyline at point i: along the pieces on both its sides. */
STUDIO_API void studio_direction(const float *points, int count, int i, float *out) {
    int a = i > 0 ? i - 1 : 0, b = i < count - 1 ? i + 1 : count - 1;
    studio_along(points + 3 * (size_t)b, -1.0f, points + 3 * (size_t)a, out);
    studio_unit(out);
}

/* A round tube along a polyline, with flat ends, as a mesh of `sides` quads around.  mark: 3 count, a direction across
 * the tube at every point, or NULL for one that is carried along without twist.  Vertex i sides + k stands at angle
 * 2 pi k / sides from the mark, so that colours by k make stripes which show the twist. */
STUDIO_API int studio_mesh_tube(studio_mesh *m, const float *points, int count, float radius, const float *mark,
                                int sides) {
    float along[3], last[3] = {0, 0, 1}, across[3] = {1, 0, 0}, other[3];
    int i, k, *t;
    memset(m, 0, sizeof *m);
    if (count < 2 || sides < 3) return studio_error("a tube needs 2 points and 3 sides, not %d and %d", count, sides);
    m->vertices = count * sides + 2;
    m->triangles = 2 * (count - 1) * sides + 2 * sides;
    m->v = (float *)studio_alloc(3 * (size_t)m->vertices, sizeof(float));
    m->t = t = (int *)studio_alloc(3 * (size_t)m->triangles, sizeof(int));
    if (!m->v || !t) return studio_mesh_free(m), -1;
    for (i = 0; i < count; ++i) {
        studio_direction(points, count, i, along);
        if (i == 0) studio_frame(along, across, other);
        else studio_carry(last, along, across);
        memcpy(last, along, sizeof last);
        if (mark) {
            memcpy(across, mark + 3 * (size_t)i, sizeof across);
            studio_along(across, -studio_dot(across, along), along, across);
            studio_unit(across);
        }
        studio_cross(along, across, other);
        for (k = 0; k < sides; ++k) {
            float a = 2.0f * (float)STUDIO_PI * (float)k / (float)sides;
            float *v = m->v + 3 * ((size_t)i * (size_t)sides + (size_t)k);
            studio_along(points + 3 * (size_t)i, radius * cosf(a), across, v);
            studio_along(v, radius * sinf(a), other, v);
        }
    }
    memcpy(m->v + 3 * ((size_t)m->vertices - 2), points, sizeof along);
    memcpy(m->v + 3 * ((size_t)m->vertices - 1), points + 3 * ((size_t)count - 1), sizeof along);
    for (i = 0; i < count - 1; ++i)
        for (k = 0; k < sides; ++k, t += 6) {
            int a = i * sides + k, b = i * sides + (k + 1) % sides;
            t[0] = t[3] = a;
            t[1] = b;
            t[2] = t[4] = b + sides;
            t[5] = a + sides;
        }
    for (k = 0; k < sides; ++k, t += 6) {
        t[0] = m->vertices - 2;
        t[1] = (k + 1) % sides;
        t[2] = k;
        t[3] = m->vertices - 1;
        t[4] = (count - 1) * sides + k;
        t[5] = (count - 1) * sides + (k + 1) % sides;
    }
    return 0;
}

/* Adds a tube along a polyline, with two stripes in another colour along the mark (see studio_mesh_tube) and opposite
 * to it. */
STUDIO_API int studio_scene_tube(studio_scene *s, const float *points, int count, float radius, const float *mark,
                                 const float rgb[3], const float stripe[3]) {
    enum { SIDES = 24 };
    studio_mesh m;
    float *colour;
    int i, bad;
    if (studio_mesh_tube(&m, points, count, radius, mark, SIDES)) return -1;
    colour = (float *)studio_alloc(3 * (size_t)m.vertices, sizeof(float));
    bad = !colour || studio_mesh_normals(&m);
    for (i = 0; i < m.vertices && !bad; ++i) {
        int k = i % SIDES % (SIDES / 2);
        memcpy(colour + 3 * (size_t)i, i < m.vertices - 2 && (k <= 2 || k >= SIDES / 2 - 2) ? stripe : rgb,
               3 * sizeof(float));
    }
    bad = bad || studio_scene_mesh(s, &m, NULL, colour);
    free(colour);
    studio_mesh_free(&m);
    return bad ? -1 : 0;
}

/* Adds a solid box. */
STUDIO_API int studio_scene_block(studio_scene *s, const float lo[3], const float hi[3], const float rgb[3]) {
    /* corner c is at hi along x, y, z where its bits 1, 2, 4 are set; faces counter-clockwise from outside */
    static const int face[36] = {0, 4, 6, 0, 6, 2, 1, 3, 7, 1, 7, 5, 0, 1, 5, 0, 5, 4,
                                 2, 6, 7, 2, 7, 3, 0, 2, 3, 0, 3, 1, 4, 5, 7, 4, 7, 6};
    float v[24];
    int t[36], k;
    studio_mesh m;
    for (k = 0; k < 8; ++k) studio_set(v + 3 * k, k & 1 ? hi[0] : lo[0], k & 2 ? hi[1] : lo[1], k & 4 ? hi[2] : lo[2]);
    memcpy(t, face, sizeof t);
    m.vertices = 8;
    m.triangles = 12;
    m.v = v;
    m.n = NULL;
    m.t = t;
    return studio_scene_mesh(s, &m, rgb, NULL);
}

/* Adds a shaded ball. */
STUDIO_API int studio_scene_ball(studio_scene *s, const float p[3], float radius, const float rgb[3]) {
    studio_ball *b;
    if (studio_reserve(&s->ball, &s->ball_cap, s->balls + 1, sizeof *s->ball)) return -1;
    b = s->ball + s->balls++;
    memcpy(b->p, p, sizeof b->p);
    b->r = radius;
    studio_linear(rgb, b->c);
    return 0;
}

/* Adds an unshaded line, its width in pixels of the final image; it casts no shadow. */
STUDIO_API int studio_scene_line(studio_scene *s, const float a[3], const float b[3], float width,
                                 const float rgb[3]) {
    studio_segment *l;
    if (studio_reserve(&s->segment, &s->segment_cap, s->segments + 1, sizeof *s->segment)) return -1;
    l = s->segment + s->segments++;
    memcpy(l->a, a, sizeof l->a);
    memcpy(l->b, b, sizeof l->b);
    l->width = width;
    studio_linear(rgb, l->c);
    return 0;
}

/* Adds the twelve edges of a box. */
STUDIO_API int studio_scene_box(studio_scene *s, const float lo[3], const float hi[3], float width,
                                const float rgb[3]) {
    int i, k, bad = 0;
    for (i = 0; i < 8; ++i)
        for (k = 0; k < 3; ++k) {
            float a[3], b[3];
            if (i >> k & 1) continue;
            studio_set(a, i & 1 ? hi[0] : lo[0], i & 2 ? hi[1] : lo[1], i & 4 ? hi[2] : lo[2]);
            memcpy(b, a, sizeof b);
            b[k] = hi[k];
            bad |= studio_scene_line(s, a, b, width, rgb);
        }
    return bad;
}

/* Sizes a buffer and empties it. */
STUDIO_API int studio_buffer_clear(studio_buffer *b, int width, int height, int ids, float empty) {
    size_t n = (size_t)width * (size_t)height, i;
    if (studio_reserve(&b->key, &b->cap_key, n, sizeof(float))) return -1;
    if (ids && studio_reserve(&b->id, &b->cap_id, n, sizeof(int))) return -1;
    b->width = width;
    b->height = height;
    for (i = 0; i < n; ++i) b->key[i] = empty;
    if (ids) memset(b->id, 0, n * sizeof(int));
    return 0;
}

/* Fills a triangle given as x, y in samples and key; the key varies linearly over it. */
STUDIO_API void studio_fill(studio_buffer *b, const float *p, const float *q, const float *r, int id) {
    float area = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]), top, low, left, right, kx, ky;
    const float *v[3];
    int x, y, y0, y1, x0, x1, i;
    if (!(fabsf(area) > 1e-6f) || !(fabsf(area) < 1e12f)) return;
    kx = ((q[2] - p[2]) * (r[1] - p[1]) - (r[2] - p[2]) * (q[1] - p[1])) / area;
    ky = ((r[2] - p[2]) * (q[0] - p[0]) - (q[2] - p[2]) * (r[0] - p[0])) / area;
    v[0] = p;
    v[1] = area > 0.0f ? q : r;
    v[2] = area > 0.0f ? r : q;
    top = fminf(p[1], fminf(q[1], r[1]));
    low = fmaxf(p[1], fmaxf(q[1], r[1]));
    if (low < 0.0f || top > (float)b->height) return;
    y0 = (int)ceilf(fmaxf(top, 0.0f) - 0.501f);
    y1 = (int)floorf(fminf(low, (float)b->height) - 0.499f);
    for (y = y0 < 0 ? 0 : y0; y <= y1 && y < b->height; ++y) {
        float fy = (float)y + 0.5f, *key, k;
        left = 0.0f;
        right = (float)b->width;
        for (i = 0; i < 3; ++i) { /* inside is where a x + c >= 0 */
            const float *s = v[i], *e = v[i == 2 ? 0 : i + 1];
            float a = s[1] - e[1], c = (e[0] - s[0]) * (fy - s[1]) - a * s[0];
            if (a > 1e-9f) left = fmaxf(left, -c / a);
            else if (a < -1e-9f) right = fminf(right, -c / a);
        }
        x0 = (int)ceilf(studio_clamp(left - 0.501f, 0.0f, (float)b->width));
        x1 = (int)floorf(studio_clamp(right - 0.499f, -1.0f, (float)(b->width - 1)));
        key = b->key + (size_t)y * (size_t)b->width;
        k = p[2] + ky * (fy - p[1]) + kx * ((float)x0 + 0.5f - p[0]);
        for (x = x0; x <= x1; ++x, k += kx)
            if (k > key[x]) {
                key[x] = k;
                if (b->id) b->id[(size_t)y * (size_t)b->width + (size_t)x] = id;
            }
    }
}

/* Camera coordinates: right, down, forward. */
STUDIO_API void studio_to_view(const studio_scene *s, const float *p, float *o) {
    float d[3];
    studio_along(p, -1.0f, s->eye, d);
    studio_set(o, studio_dot(d, s->right), -studio_dot(d, s->up), studio_dot(d, s->forward));
}

/* Camera coordinates to x, y in samples and key = 1 / depth. */
STUDIO_API void studio_project(const studio_scene *s, const float *v, float *o) {
    float k = 1.0f / v[2], zoom = s->zoom * k;
    studio_set(o, 0.5f * (float)s->view.width + zoom * v[0], 0.5f * (float)s->view.height + zoom * v[1], k);
}

/* Draws a triangle, cut at the near plane, into the view. */
STUDIO_API void studio_view_triangle(studio_scene *s, const float *p, int id) {
    float v[3][3], cut[4][3], at[4][3];
    int i, k, n = 0;
    for (i = 0; i < 3; ++i) studio_to_view(s, p + 3 * i, v[i]);
    for (i = 0; i < 3; ++i) {
        const float *a = v[i], *b = v[i == 2 ? 0 : i + 1];
        if (a[2] >= s->nearest) memcpy(cut[n++], a, sizeof v[0]);
        if ((a[2] >= s->nearest) != (b[2] >= s->nearest)) {
            float t = (s->nearest - a[2]) / (b[2] - a[2]);
            for (k = 0; k < 3; ++k) cut[n][k] = a[k] + t * (b[k] - a[k]);
            cut[n++][2] = s->nearest;
        }
    }
    for (i = 0; i < n; ++i) studio_project(s, cut[i], at[i]);
    for (i = 2; i < n; ++i) studio_fill(&s->view, at[0], at[i - 1], at[i], id);
}

/* The range of x/z of a ball at (x, z) with radius r, in front of the camera. */
STUDIO_API void studio_ball_range(float x, float z, float r, float *lo, float *hi) {
    float d = z * z - r * r, q = sqrtf(fmaxf(x * x + d, 0.0f));
    *lo = (x * z - r * q) / d;
    *hi = (x * z + r * q) / d;
}

/* Draws a ball into the view: every sample is an exact ray-ball hit.  Balls around or behind the eye are left
 * out. */
STUDIO_API void studio_view_ball(studio_scene *s, const studio_ball *b, int id) {
    float c[3], x0, x1, y0, y1, cc, rr = b->r * b->r, mx = 0.5f * (float)s->view.width;
    float my = 0.5f * (float)s->view.height;
    int x, y, left, right, top, low;
    studio_to_view(s, b->p, c);
    if (!(c[2] - b->r > s->nearest) || !(b->r > 0.0f)) return;
    studio_ball_range(c[0], c[2], b->r, &x0, &x1);
    studio_ball_range(c[1], c[2], b->r, &y0, &y1);
    left = (int)studio_clamp(mx + s->zoom * x0 - 0.5f, 0.0f, 2.0f * mx);
    right = (int)studio_clamp(mx + s->zoom * x1 + 0.5f, -1.0f, 2.0f * mx - 1.0f);
    top = (int)studio_clamp(my + s->zoom * y0 - 0.5f, 0.0f, 2.0f * my);
    low = (int)studio_clamp(my + s->zoom * y1 + 0.5f, -1.0f, 2.0f * my - 1.0f);
    cc = studio_dot(c, c) - rr;
    for (y = top; y <= low; ++y) {
        float dy = ((float)y + 0.5f - my) / s->zoom, e = c[1] * dy + c[2], dd = dy * dy + 1.0f;
        float ox = c[1] - c[2] * dy; /* components of c x ray: the distance from the axis, without h^2 - d^2 c^2, */
        size_t row = (size_t)y * (size_t)s->view.width; /* whose rounding would be larger than a distant ball */
        for (x = left; x <= right; ++x) {
            float dx = ((float)x + 0.5f - mx) / s->zoom, h = c[0] * dx + e, oy = c[2] * dx - c[0];
            float oz = c[0] * dy - c[1] * dx, root = (dd + dx * dx) * rr - ox * ox - oy * oy - oz * oz, k;
            if (root < 0.0f) continue;
            k = (h + sqrtf(root)) / cc; /* 1 / depth of the near hit */
            if (k <= s->view.key[row + (size_t)x]) continue;
            s->view.key[row + (size_t)x] = k;
            s->view.id[row + (size_t)x] = id;
        }
    }
}

/* Draws a line into the view as a thin strip turned to the camera. */
STUDIO_API void studio_view_line(studio_scene *s, const studio_segment *l, int id) {
    float v[2][3], p[2][3], corner[4][3], nx, ny, length;
    int i, k;
    studio_to_view(s, l->a, v[0]);
    studio_to_view(s, l->b, v[1]);
    if (v[0][2] < s->nearest && v[1][2] < s->nearest) return;
    for (i = 0; i < 2; ++i)
        if (v[i][2] < s->nearest) {
            float t = (s->nearest - v[i][2]) / (v[1 - i][2] - v[i][2]);
            for (k = 0; k < 3; ++k) v[i][k] += t * (v[1 - i][k] - v[i][k]);
            v[i][2] = s->nearest;
        }
    for (i = 0; i < 2; ++i) {
        studio_project(s, v[i], p[i]);
        p[i][2] *= 1.002f; /* in front of the surface it lies on */
    }
    nx = p[0][1] - p[1][1];
    ny = p[1][0] - p[0][0];
    length = sqrtf(nx * nx + ny * ny);
    if (!(length > 1e-6f)) return;
    nx *= l->width / length; /* half the width, two samples per pixel */
    ny *= l->width / length;
    for (i = 0; i < 4; ++i) {
        const float *e = p[i >> 1];
        studio_set(corner[i], e[0] + (i & 1 ? nx : -nx), e[1] + (i & 1 ? ny : -ny), e[2]);
    }
    studio_fill(&s->view, corner[0], corner[1], corner[2], id);
    studio_fill(&s->view, corner[2], corner[1], corner[3], id);
}

/* Places a point in a flat map of the stage: x, y in samples, key = height along n. */
STUDIO_API void studio_to_map(const studio_scene *s, const float *p, const float *a, const float *b, const float *n,
                              int size, float *o) {
    float d[3], scale = 0.5f * (float)size / s->radius;
    studio_along(p, -1.0f, s->centre, d);
    studio_set(o, (studio_dot(d, a) / s->radius + 1.0f) * 0.5f * (float)size,
               (studio_dot(d, b) / s->radius + 1.0f) * 0.5f * (float)size, studio_dot(d, n) * scale);
}

/* Draws everything that casts a shadow into a flat map seen from direction n, side `size`. */
STUDIO_API int studio_map(studio_scene *s, studio_buffer *m, const float *a, const float *b, const float *n,
                          int size) {
    float scale = 0.5f * (float)size / s->radius, p[3][3];
    size_t i;
    int k, x, y;
    if (studio_buffer_clear(m, size, size, 0, -1e30f)) return -1;
    for (i = 0; i < s->triangles; ++i) {
        for (k = 0; k < 3; ++k) studio_to_map(s, s->triangle[i].p + 3 * k, a, b, n, size, p[k]);
        studio_fill(m, p[0], p[1], p[2], 0);
    }
    for (i = 0; i < s->balls; ++i) {
        float r = s->ball[i].r * scale, reach = (float)size;
        studio_to_map(s, s->ball[i].p, a, b, n, size, p[0]);
        if (!(r > 0.0f) || !(fabsf(p[0][0]) + fabsf(p[0][1]) < 1e6f)) continue;
        for (y = (int)studio_clamp(p[0][1] - r, 0.0f, reach); y < m->height && (float)y + 0.5f <= p[0][1] + r; ++y)
            for (x = (int)studio_clamp(p[0][0] - r, 0.0f, reach); x < size && (float)x + 0.5f <= p[0][0] + r; ++x) {
                float dx = (float)x + 0.5f - p[0][0], dy = (float)y + 0.5f - p[0][1], q = r * r - dx * dx - dy * dy;
                float *key = m->key + (size_t)y * (size_t)size + (size_t)x;
                if (q >= 0.0f && p[0][2] + sqrtf(q) > *key) *key = p[0][2] + sqrtf(q);
            }
    }
    return 0;
}

/* Takes the stage from the contents: centre and radius, in coarse steps so that shadows do not shiver. */
STUDIO_API void studio_stage(studio_scene *s) {
    float lo[3] = {1e30f, 1e30f, 1e30f}, hi[3] = {-1e30f, -1e30f, -1e30f}, half[3], grid;
    size_t i;
    int k, j;
    memcpy(s->centre, s->look.centre, sizeof s->centre);
    s->radius = s->look.radius;
    if (s->radius > 0.0f) return;
    for (i = 0; i < s->triangles; ++i)
        for (j = 0; j < 9; ++j) {
            lo[j % 3] = fminf(lo[j % 3], s->triangle[i].p[j]);
            hi[j % 3] = fmaxf(hi[j % 3], s->triangle[i].p[j]);
        }
    for (i = 0; i < s->balls; ++i)
        for (k = 0; k < 3; ++k) {
            lo[k] = fminf(lo[k], s->ball[i].p[k] - s->ball[i].r);
            hi[k] = fmaxf(hi[k], s->ball[i].p[k] + s->ball[i].r);
        }
    if (lo[0] > hi[0]) studio_set(lo, 0.0f, 0.0f, 0.0f), studio_set(hi, 1.0f, 1.0f, 1.0f);
    for (k = 0; k < 3; ++k) half[k] = 0.5f * (hi[k] - lo[k]);
    s->radius = powf(1.2f, ceilf(logf(fmaxf(sqrtf(studio_dot(half, half)), 1e-6f) * 1.1f) / logf(1.2f)));
    grid = s->radius / 16.0f;
    for (k = 0; k < 3; ++k) s->centre[k] = floorf(0.5f * (lo[k] + hi[k]) / grid + 0.5f) * grid;
}

/* How much the things above a ground point cover it, smoothed: a soft dark stain where something stands. */
STUDIO_API int studio_contact(studio_scene *s) {
    const int n = STUDIO_FLOOR;
    float down[3], scale = 0.5f * (float)n / s->radius, ground, *c, *line;
    int i, j, k, pass;
    if (studio_reserve(&s->contact, &s->contact_cap, (size_t)(n * n + n), sizeof(float))) return -1;
    c = s->contact;
    line = c + n * n;
    studio_set(down, -s->look.up[0], -s->look.up[1], -s->look.up[2]);
    if (studio_map(s, &s->floor, s->ga, s->gb, down, n)) return -1;
    ground = (studio_dot(s->centre, s->look.up) - s->look.height) * scale; /* key of the ground itself */
    for (i = 0; i < n * n; ++i) {
        float height = fmaxf(ground - s->floor.key[i], 0.0f) / (0.10f * (float)n);
        c[i] = s->floor.key[i] < -1e29f ? 0.0f : expf(-height * height * 2.0f - 0.7f * height);
    }
    for (pass = 0; pass < 6; ++pass) /* boxes, alternately along x and y */
        for (i = 0; i < n; ++i) {
            int step = pass & 1 ? n : 1, r = pass < 4 ? 3 : 2;
            float *row = c + (pass & 1 ? i : i * n), sum = 0.0f;
            for (j = 0; j < n; ++j) line[j] = row[j * step];
            for (j = -r; j < n; ++j) {
                sum += (j + r < n ? line[j + r] : 0.0f) - (j - r - 1 >= 0 ? line[j - r - 1] : 0.0f);
                if (j >= 0) row[j * step] = sum / (float)(2 * r + 1);
            }
        }
    for (k = 0; k < n * n; ++k) c[k] = studio_clamp(c[k], 0.0f, 1.0f);
    return 0;
}

/* Cover of the ground at p, 0 outside of the stage. */
STUDIO_API float studio_cover(const studio_scene *s, const float *p) {
    const int n = STUDIO_FLOOR;
    float m[3], fx, fy;
    const float *c;
    int x, y;
    studio_to_map(s, p, s->ga, s->gb, s->look.up, n, m);
    m[0] -= 0.5f;
    m[1] -= 0.5f;
    if (!(m[0] >= 0.0f && m[1] >= 0.0f && m[0] < (float)(n - 1) && m[1] < (float)(n - 1))) return 0.0f;
    x = (int)m[0];
    y = (int)m[1];
    fx = m[0] - (float)x;
    fy = m[1] - (float)y;
    c = s->contact + y * n + x;
    return (1.0f - fy) * (c[0] + fx * (c[1] - c[0])) + fy * (c[n] + fx * (c[n + 1] - c[n]));
}

/* The part of the direct light that reaches p (with normal n): 5 x 5 texels with soft borders. */
STUDIO_API float studio_lit(const studio_scene *s, const float *p, const float *n) {
    const int size = STUDIO_SHADOW;
    float q[3], m[3], texel = 2.0f * s->radius / (float)size, fx, fy, sum = 0.0f, slope;
    const float *key;
    int x, y, i, j;
    slope = 1.0f - fmaxf(studio_dot(n, s->ln), 0.0f);
    studio_along(p, (1.2f + 3.0f * slope) * texel, n, q);
    studio_to_map(s, q, s->la, s->lb, s->ln, size, m);
    m[0] -= 0.5f;
    m[1] -= 0.5f;
    if (!(m[0] > 3.0f && m[1] > 3.0f && m[0] < (float)(size - 4) && m[1] < (float)(size - 4))) return 1.0f;
    x = (int)m[0];
    y = (int)m[1];
    fx = m[0] - (float)x;
    fy = m[1] - (float)y;
    m[2] += 1.0f;
    for (j = -2; j <= 3; ++j) {
        float row = 0.0f;
        key = s->shadow.key + (size_t)(y + j) * (size_t)size + (size_t)x;
        row += key[-2] <= m[2] ? 1.0f - fx : 0.0f;
        for (i = -1; i <= 2; ++i) row += key[i] <= m[2] ? 1.0f : 0.0f;
        row += key[3] <= m[2] ? fx : 0.0f;
        sum += row * (j == -2 ? 1.0f - fy : j == 3 ? fy : 1.0f);
    }
    return sum / 25.0f;
}

/* Light that comes back from a point: p, unit normal n (towards the viewer), linear colour c, unit direction d
 * of the ray; o gets linear light. */
STUDIO_API void studio_shade(const studio_scene *s, const float *p, const float *n, const float *c, const float *d,
                             float *o) {
    const studio_look *l = &s->look;
    float face = studio_dot(n, s->ln), upness = 0.5f + 0.5f * studio_dot(n, l->up);
    float half[3], open = 1.0f, shine, fill, edge;
    float direct = face > -0.02f ? studio_clamp((face + 0.06f) / 1.06f, 0.0f, 1.0f) : 0.0f;
    int k;
    if (direct > 0.0f) direct *= studio_lit(s, p, n);
    if (l->ground) { /* low and downward faces see less of the sky */
        float above = (studio_dot(p, l->up) - l->height) / (0.35f * s->radius);
        open = 1.0f - (1.0f - upness) * 0.55f * (1.0f - studio_smooth(0.0f, 1.0f, above));
    }
    studio_along(s->ln, -1.0f, d, half);
    studio_unit(half);
    shine = fmaxf(studio_dot(n, half), 0.0f);
    shine *= shine;
    shine *= shine;
    shine *= shine;
    shine = l->gloss * 0.35f * direct * shine * shine * shine;
    fill = 0.20f * fmaxf(-studio_dot(n, d), 0.0f) * open; /* a weak lamp at the camera */
    edge = 1.0f - fmaxf(-studio_dot(n, d), 0.0f);
    edge = 0.16f * l->gloss * edge * edge * edge * open;
    for (k = 0; k < 3; ++k) {
        float ambient = (l->earth[k] + upness * (l->sky[k] - l->earth[k])) * open;
        o[k] = c[k] * (0.92f * l->key[k] * direct + 0.85f * ambient + fill) + shine * l->key[k] + edge * l->sky[k];
    }
}

/* A smooth square wave with values -1..1, softened over `blur`. */
STUDIO_API float studio_wave(float x, float blur) {
    float f = fabsf(x * 0.5f - floorf(x * 0.5f) - 0.5f) * 2.0f - 0.5f; /* a triangle wave */
    float contrast = blur > 0.25f ? 0.25f / blur : 1.0f;
    return studio_clamp(2.0f * f / fmaxf(2.0f * blur, 1e-4f), -1.0f, 1.0f) * contrast * (blur > 1.0f ? 0.0f : 1.0f);
}

/* Adds the ground, seen along unit direction d at distance t, over the backdrop in o (linear). */
STUDIO_API void studio_ground(const studio_scene *s, const float *d, float t, float *o) {
    const studio_look *l = &s->look;
    float p[3], q[3], base[3], light[3], away, fade, steep, blur, u, v, check, cover;
    int k;
    studio_along(s->eye, t, d, p);
    studio_along(p, -1.0f, s->centre, q);
    u = studio_dot(q, s->ga);
    v = studio_dot(q, s->gb);
    away = sqrtf(u * u + v * v) / s->radius;
    fade = 1.0f - studio_smooth(1.2f, 4.2f, away);
    if (fade <= 0.0f) return;
    u = studio_dot(p, s->ga) / s->cell;
    v = studio_dot(p, s->gb) / s->cell;
    steep = fmaxf(fabsf(studio_dot(d, l->up)), 0.02f);
    blur = 1.5f * t / (s->zoom * s->cell);
    check = studio_wave(u, blur / sqrtf(steep)) * studio_wave(v, blur / sqrtf(steep));
    memcpy(base, s->paint, sizeof base);
    cover = studio_cover(s, p);
    for (k = 0; k < 3; ++k) base[k] *= 0.975f + 0.025f * check;
    away = studio_lit(s, p, l->up);
    for (k = 0; k < 3; ++k) {
        light[k] = (0.62f * l->key[k] * away + 0.72f * l->sky[k] * (1.0f - 0.75f * cover)) * (1.0f - 0.35f * cover);
        o[k] += fade * (base[k] * light[k] - o[k]);
    }
}

/* Where the ray along d (unit) meets triangle t: point p, normal n towards the viewer, colour c; returns the
 * distance.  Points just outside are pulled to the edge. */
STUDIO_API float studio_hit_triangle(const studio_scene *s, const studio_triangle *t, const float *d, float *p,
                                     float *n, float *c) {
    float e1[3], e2[3], o[3], g[3], x[3], slope, dist, u, v, w, sum;
    int k;
    studio_along(t->p + 3, -1.0f, t->p, e1);
    studio_along(t->p + 6, -1.0f, t->p, e2);
    studio_along(s->eye, -1.0f, t->p, o);
    studio_cross(e1, e2, g);
    slope = studio_dot(g, d);
    if (fabsf(slope) < 1e-20f) slope = 1e-20f;
    dist = -studio_dot(g, o) / slope;
    studio_cross(o, d, x);
    u = studio_clamp(-studio_dot(e2, x) / slope, 0.0f, 1.0f);
    v = studio_clamp(studio_dot(e1, x) / slope, 0.0f, 1.0f);
    sum = u + v > 1.0f ? u + v : 1.0f;
    u /= sum;
    v /= sum;
    w = 1.0f - u - v;
    for (k = 0; k < 3; ++k) {
        p[k] = w * t->p[k] + u * t->p[3 + k] + v * t->p[6 + k];
        n[k] = w * t->n[k] + u * t->n[3 + k] + v * t->n[6 + k];
        c[k] = (w * t->c[k] + u * t->c[3 + k] + v * t->c[6 + k]) * (slope > 0.0f ? t->back[k] : 1.0f);
    }
    studio_unit(n);
    if (slope > 0.0f) studio_set(n, -n[0], -n[1], -n[2]);
    return dist;
}

/* The same for a ball; a ray that just misses takes the nearest point of the rim. */
STUDIO_API float studio_hit_ball(const studio_scene *s, const studio_ball *b, const float *d, float *p, float *n,
                                 float *c) {
    float o[3], q[3], h, depth;
    studio_along(b->p, -1.0f, s->eye, o);
    h = studio_dot(o, d);
    studio_along(o, -h, d, q); /* from the ray to the centre */
    depth = sqrtf(fmaxf(b->r * b->r - studio_dot(q, q), 0.0f));
    studio_set(n, -q[0] - depth * d[0], -q[1] - depth * d[1], -q[2] - depth * d[2]);
    studio_unit(n);
    studio_along(b->p, b->r, n, p);
    memcpy(c, b->c, sizeof b->c);
    return h - depth;
}

/* The linear light seen at view position (x, y) in samples, where primitive id covers it. */
STUDIO_API void studio_see(const studio_scene *s, float x, float y, int id, float *o) {
    float d[3], p[3], n[3], c[3], slope, floor_at = 1e30f, at = 1e30f, f;
    size_t i = (size_t)(id - 1);
    int k;
    studio_along(s->forward, (x - 0.5f * (float)s->view.width) / s->zoom, s->right, d);
    studio_along(d, -(y - 0.5f * (float)s->view.height) / s->zoom, s->up, d);
    studio_unit(d);
    slope = studio_dot(d, s->look.up);
    if (s->look.ground && slope < -1e-4f) floor_at = (s->look.height - studio_dot(s->eye, s->look.up)) / slope;
    if (!(floor_at > 0.0f)) floor_at = 1e30f;
    if (id > 0 && i < s->triangles) at = studio_hit_triangle(s, s->triangle + i, d, p, n, c);
    else if (id > 0 && i < s->triangles + s->balls) at = studio_hit_ball(s, s->ball + (i - s->triangles), d, p, n, c);
    else if (id > 0) {
        memcpy(o, s->segment[i - s->triangles - s->balls].c, sizeof p);
        return;
    }
    if (at < floor_at) {
        studio_shade(s, p, n, c, d, o);
        return;
    }
    f = studio_clamp(y / (float)s->view.height, 0.0f, 1.0f);
    for (k = 0; k < 3; ++k) o[k] = s->sky[0][k] + f * (s->sky[1][k] - s->sky[0][k]);
    if (floor_at < 1e30f) studio_ground(s, d, floor_at, o);
}

/* Mixes one pixel from its four samples; each primitive among them is looked at once. */
STUDIO_API void studio_pixel(const studio_scene *s, int px, int py, unsigned char *out) {
    int id[4], done[4] = {0, 0, 0, 0}, i, j, k;
    float sum[3] = {0.0f, 0.0f, 0.0f}, light[3];
    for (i = 0; i < 4; ++i)
        id[i] = s->view.id[(size_t)(2 * py + (i >> 1)) * (size_t)s->view.width + (size_t)(2 * px + (i & 1))];
    for (i = 0; i < 4; ++i) {
        float x = 0.0f, y = 0.0f, count = 0.0f;
        if (done[i]) continue;
        for (j = i; j < 4; ++j) {
            if (id[j] != id[i]) continue;
            done[j] = 1;
            x += (float)(2 * px + (j & 1)) + 0.5f;
            y += (float)(2 * py + (j >> 1)) + 0.5f;
            count += 1.0f;
        }
        studio_see(s, x / count, y / count, id[i], light);
        for (k = 0; k < 3; ++k) sum[k] += count * 0.25f * studio_clamp(light[k], 0.0f, 1.25f);
    }
    for (k = 0; k < 3; ++k) out[k] = s->tone[(int)(studio_clamp(sum[k], 0.0f, 1.0f) * 4095.0f)];
}

/* Sets up camera, light and ground frames and the tone table. */
STUDIO_API void studio_prepare(studio_scene *s, const studio_camera *camera, const studio_image *im) {
    float length;
    int i;
    memcpy(s->eye, camera->eye, sizeof s->eye);
    studio_along(camera->target, -1.0f, camera->eye, s->forward);
    length = studio_unit(s->forward);
    s->nearest = fmaxf(1e-3f * length, 1e-6f);
    studio_cross(s->forward, camera->up, s->right);
    if (studio_unit(s->right) < 1e-6f) studio_frame(s->forward, s->right, s->up);
    studio_cross(s->right, s->forward, s->up);
    s->zoom = (float)im->height / tanf(studio_clamp(camera->fov, 1.0f, 170.0f) * (float)(STUDIO_PI / 360.0));
    memcpy(s->ln, s->look.light, sizeof s->ln);
    studio_unit(s->ln);
    studio_frame(s->ln, s->la, s->lb);
    studio_frame(s->look.up, s->ga, s->gb);
    studio_linear(s->look.floor, s->paint);
    studio_linear(s->look.top, s->sky[0]);
    studio_linear(s->look.bottom, s->sky[1]);
    s->cell = s->look.cell > 0.0f ? s->look.cell : (float)studio_step((double)s->radius, 3);
    for (i = 0; i < 4096; ++i) s->tone[i] = (unsigned char)(255.0f * powf((float)i / 4095.0f, 1.0f / 2.2f) + 0.5f);
}

/* Draws the scene over the whole image: 2 x 2 samples per pixel, one light with soft shadows.  With OpenMP
 * the rows are shared among threads.  Non-zero with a message when out of memory. */
STUDIO_API int studio_render(studio_scene *s, const studio_camera *camera, studio_image *im) {
    size_t i, first;
    int y;
    studio_stage(s);
    studio_prepare(s, camera, im);
    if (studio_map(s, &s->shadow, s->la, s->lb, s->ln, STUDIO_SHADOW) || studio_contact(s)) return -1;
    if (studio_buffer_clear(&s->view, 2 * im->width, 2 * im->height, 1, 0.0f)) return -1;
    for (i = 0; i < s->triangles; ++i) studio_view_triangle(s, s->triangle[i].p, (int)i + 1);
    first = s->triangles + 1;
    for (i = 0; i < s->balls; ++i) studio_view_ball(s, s->ball + i, (int)(first + i));
    first += s->balls;
    for (i = 0; i < s->segments; ++i) studio_view_line(s, s->segment + i, (int)(first + i));
#ifdef _OPENMP
#pragma omp parallel for schedule(dynamic, 8)
#endif
    for (y = 0; y < im->height; ++y) {
        int x;
        unsigned char *row = im->rgb + 3 * (size_t)y * (size_t)im->width;
        for (x = 0; x < im->width; ++x) studio_pixel(s, x, y, row + 3 * (size_t)x);
    }
    return 0;
}

/* Where a point of the scene appears in the image of the last render, in pixels; 0 when it is behind the
 * camera. */
STUDIO_API int studio_where(const studio_scene *s, const float p[3], float *x, float *y) {
    float v[3], o[3];
    studio_to_view(s, p, v);
    if (v[2] < s->nearest) return 0;
    studio_project(s, v, o);
    *x = 0.5f * o[0];
    *y = 0.5f * o[1];
    return 1;
}

/* A camera that looks at `target` from `distance`, turned by `turn` degrees around z (0 looks along +y, 90 from
 * +x) and raised by `rise` degrees. */
STUDIO_API void studio_orbit(studio_camera *c, const float target[3], float distance, float turn, float rise,
                             float fov) {
    float a = turn * (float)(STUDIO_PI / 180.0), b = rise * (float)(STUDIO_PI / 180.0);
    memcpy(c->target, target, sizeof c->target);
    studio_set(c->up, 0.0f, 0.0f, 1.0f);
    studio_set(c->eye, target[0] + distance * sinf(a) * cosf(b), target[1] - distance * cosf(a) * cosf(b),
               target[2] + distance * sinf(b));
    c->fov = fov;
}

/* =============================================================== 11  Plots ======================= */

enum { STUDIO_LINE, STUDIO_DASHED, STUDIO_POINTS, STUDIO_SERIES = 12 };

typedef struct studio_series {
    char name[64];
    int style;
    float rgb[3];
    double *xy;
    size_t count, cap; /* cap in numbers */
} studio_series;

/* A chart: begin, add series and points, set log_x, log_y or fixed ranges (lo < hi), draw or write, end. */
typedef struct studio_plot {
    char title[128], x_label[96], y_label[96];
    int log_x, log_y, series_count;
    int legend_left, legend_low; /* corner of the legend, right and top by default */
    double x_lo, x_hi, y_lo, y_hi; /* equal: taken from the data */
    studio_series series[STUDIO_SERIES];
    double lo[2], hi[2]; /* ranges in use, as logarithms on logarithmic axes */
    int left, top, wide, high; /* the frame in pixels */
    float size;                /* height of capitals */
} studio_plot;

STUDIO_API void studio_plot_begin(studio_plot *p, const char *title, const char *x_label, const char *y_label) {
    memset(p, 0, sizeof *p);
    snprintf(p->title, sizeof p->title, "%s", title ? title : "");
    snprintf(p->x_label, sizeof p->x_label, "%s", x_label ? x_label : "");
    snprintf(p->y_label, sizeof p->y_label, "%s", y_label ? y_label : "");
}

STUDIO_API void studio_plot_end(studio_plot *p) {
    int i;
    for (i = 0; i < p->series_count; ++i) free(p->series[i].xy);
    memset(p, 0, sizeof *p);
}

/* Starts a series (style STUDIO_LINE, STUDIO_DASHED or STUDIO_POINTS; rgb NULL takes the next of eight
 * colours; name NULL or "" leaves it out of the legend).  Returns its number, -1 when there are 12 already. */
STUDIO_API int studio_plot_series(studio_plot *p, const char *name, int style, const float *rgb) {
    static const float colours[8][3] = {{0.15f, 0.39f, 0.65f}, {0.85f, 0.40f, 0.20f}, {0.18f, 0.56f, 0.38f},
                                        {0.62f, 0.28f, 0.56f}, {0.80f, 0.60f, 0.12f}, {0.20f, 0.62f, 0.68f},
                                        {0.72f, 0.20f, 0.26f}, {0.42f, 0.44f, 0.48f}};
    studio_series *s = p->series + p->series_count;
    if (p->series_count >= STUDIO_SERIES) return studio_error("a plot holds at most %d series", (int)STUDIO_SERIES);
    snprintf(s->name, sizeof s->name, "%s", name ? name : "");
    s->style = style;
    memcpy(s->rgb, rgb ? rgb : colours[p->series_count & 7], sizeof s->rgb);
    return p->series_count++;
}

/* Adds a point to series number `series`. */
STUDIO_API int studio_plot_point(studio_plot *p, int series, double x, double y) {
    studio_series *s = p->series + series;
    if (series < 0 || series >= p->series_count)
        return studio_error("series %d does not exist: there are %d", series, p->series_count);
    if (studio_reserve(&s->xy, &s->cap, 2 * s->count + 2, sizeof(double))) return -1;
    s->xy[2 * s->count] = x;
    s->xy[2 * s->count++ + 1] = y;
    return 0;
}

/* A number on an axis: its logarithm on a logarithmic one; not a number when it cannot be shown. */
STUDIO_API double studio_plot_value(const studio_plot *p, int axis, double v) {
    if (!(axis ? p->log_y : p->log_x)) return v;
    return v > 0.0 ? log10(v) : sqrt(-1.0);
}

STUDIO_API double studio_tick_step(const studio_plot *p, int axis) {
    double range = p->hi[axis] - p->lo[axis];
    int parts = (int)(axis ? (float)p->high / (4.2f * p->size) : (float)p->wide / (7.5f * p->size));
    int logarithm = axis ? p->log_y : p->log_x;
    double step = studio_step(range, parts < 2 ? 2 : parts > 8 ? 8 : parts);
    return logarithm && step < 1.0 ? 1.0 : step;
}

/* Sets the range of one axis from the data or the fixed limits, rounded to whole ticks. */
STUDIO_API void studio_plot_range(studio_plot *p, int axis) {
    double fixed_lo = axis ? p->y_lo : p->x_lo, fixed_hi = axis ? p->y_hi : p->x_hi;
    double lo = HUGE_VAL, hi = -HUGE_VAL, step;
    int i, logarithm = axis ? p->log_y : p->log_x;
    size_t k;
    for (i = 0; i < p->series_count; ++i)
        for (k = 0; k < p->series[i].count; ++k) {
            double v = studio_plot_value(p, axis, p->series[i].xy[2 * k + (size_t)axis]);
            if (!(fabs(v) < 1e200)) continue;
            if (v < lo) lo = v;
            if (v > hi) hi = v;
        }
    if (fixed_lo < fixed_hi) {
        lo = studio_plot_value(p, axis, fixed_lo);
        hi = studio_plot_value(p, axis, fixed_hi);
    }
    if (!(lo <= hi && fabs(lo) < 1e200 && fabs(hi) < 1e200)) {
        lo = 0.0;
        hi = 1.0;
    }
    if (!(hi - lo > 1e-9 * fmax(fabs(lo), fabs(hi)))) {
        double more = logarithm ? 0.5 : lo != 0.0 ? 0.5 * fabs(lo) : 0.5;
        lo -= more;
        hi += more;
    }
    p->lo[axis] = lo;
    p->hi[axis] = hi;
    if (fixed_lo < fixed_hi) return;
    step = studio_tick_step(p, axis);
    if (!axis && !logarithm) { /* x: tight when the data come near to a tick */
        if (lo - floor(lo / step) * step < 0.5 * step) p->lo[axis] = floor(lo / step + 1e-9) * step;
        if (ceil(hi / step) * step - hi < 0.3 * step) p->hi[axis] = ceil(hi / step - 1e-9) * step;
        return;
    }
    p->lo[axis] = floor(lo / step + 1e-9) * step;
    p->hi[axis] = ceil(hi / step - 1e-9) * step;
}

/* Pixel position of a value (already a logarithm where that applies). */
STUDIO_API float studio_plot_at(const studio_plot *p, int axis, double v) {
    double t = (v - p->lo[axis]) / (p->hi[axis] - p->lo[axis]);
    t = t < -50.0 ? -50.0 : t > 50.0 ? 50.0 : t;
    return axis ? (float)(p->top + p->high) - (float)t * (float)p->high : (float)p->left + (float)t * (float)p->wide;
}

/* The text of a tick; 1, 10, 100 or 1e5 on logarithmic axes. */
STUDIO_API void studio_plot_tick(const studio_plot *p, int axis, double v, double step, char *out, size_t room) {
    if (axis ? p->log_y : p->log_x) {
        if (fabs(v) < 3.5) snprintf(out, room, "%g", pow(10.0, floor(v + 0.5)));
        else snprintf(out, room, "1e%d", (int)floor(v + 0.5));
    } else studio_tick(v, step, out, room);
}

/* Grid lines and numbers of one axis; with `im` NULL only measures the longest number, in pixels. */
STUDIO_API float studio_plot_axis(const studio_plot *p, int axis, studio_image *im) {
    static const float ink[3] = {0.25f, 0.27f, 0.31f}, grid[3] = {0.82f, 0.84f, 0.87f};
    double step = studio_tick_step(p, axis), v;
    float longest = 0.0f, x0 = (float)p->left, x1 = (float)(p->left + p->wide), y1 = (float)(p->top + p->high);
    char text[64];
    int m, logarithm = axis ? p->log_y : p->log_x;
    for (v = ceil(p->lo[axis] / step - 1e-6) * step; v <= p->hi[axis] + 1e-6 * step; v += step) {
        float at = floorf(studio_plot_at(p, axis, v)) + 0.5f;
        studio_plot_tick(p, axis, v, step, text, sizeof text);
        longest = fmaxf(longest, studio_text_width(text, p->size));
        if (!im) continue;
        if (axis) {
            studio_line(im, x0, at, x1, at, 1.0f, grid, 1.0f);
            studio_text_at(im, x0 - 0.8f * p->size, at + 0.5f * p->size, p->size, ink, 1.0f, 0, text);
        } else {
            studio_line(im, at, (float)p->top, at, y1, 1.0f, grid, 1.0f);
            studio_text_at(im, at, y1 + 2.0f * p->size, p->size, ink, 0.5f, 0, text);
        }
        for (m = 2; m < 10 && logarithm && step < 1.5; ++m) {
            double w = v + log10((double)m);
            if (w >= p->hi[axis]) break;
            at = floorf(studio_plot_at(p, axis, w)) + 0.5f;
            if (axis) studio_line(im, x0, at, x1, at, 1.0f, grid, 0.4f);
            else studio_line(im, at, (float)p->top, at, y1, 1.0f, grid, 0.4f);
        }
    }
    return longest;
}

/* Adds the line from a to b to the pen as dashes; *phase runs on from piece to piece. */
STUDIO_API void studio_pen_dash(studio_pen *pen, const float *a, const float *b, float dash, float *phase) {
    float dx = b[0] - a[0], dy = b[1] - a[1], length = sqrtf(dx * dx + dy * dy), at = 0.0f;
    if (!(length > 0.0f) || length > 1e5f) return;
    while (at < length) {
        float in = fmodf(*phase, 2.0f * dash);
        float step = fminf((in < dash ? dash : 2.0f * dash) - in + 1e-3f, length - at);
        if (in < dash)
            studio_pen_line(pen, a[0] + dx * at / length, a[1] + dy * at / length, a[0] + dx * (at + step) / length,
                            a[1] + dy * (at + step) / length);
        at += step;
        *phase += step;
    }
}

/* Paints one series inside the frame. */
STUDIO_API void studio_plot_paint(const studio_plot *p, const studio_series *s, studio_image *im) {
    float last[2] = {0.0f, 0.0f}, phase = 0.0f;
    studio_pen pen;
    int open = 0;
    size_t k;
    memset(&pen, 0, sizeof pen);
    pen.clip[0] = p->left > 0 ? p->left : 0;
    pen.clip[1] = p->top > 0 ? p->top : 0;
    pen.clip[2] = p->left + p->wide < im->width ? p->left + p->wide : im->width;
    pen.clip[3] = p->top + p->high < im->height ? p->top + p->high : im->height;
    for (k = 0; k < s->count; ++k) {
        double x = studio_plot_value(p, 0, s->xy[2 * k]), y = studio_plot_value(p, 1, s->xy[2 * k + 1]);
        float now[2];
        if (!(fabs(x) < 1e200) || !(fabs(y) < 1e200)) {
            open = 0;
            continue;
        }
        now[0] = studio_plot_at(p, 0, x);
        now[1] = studio_plot_at(p, 1, y);
        if (s->style == STUDIO_POINTS) studio_pen_line(&pen, now[0], now[1], now[0], now[1]);
        else if (open && s->style == STUDIO_DASHED) studio_pen_dash(&pen, last, now, 0.7f * p->size, &phase);
        else if (open) studio_pen_line(&pen, last[0], last[1], now[0], now[1]);
        open = 1;
        memcpy(last, now, sizeof last);
    }
    studio_pen_paint(im, &pen, s->style == STUDIO_POINTS ? 0.42f * p->size : 0.20f * p->size, s->rgb, 1.0f);
    free(pen.piece);
}

/* Names and samples of the series, in a corner of the frame. */
STUDIO_API void studio_plot_legend(const studio_plot *p, studio_image *im) {
    static const float ink[3] = {0.2f, 0.22f, 0.26f}, paper[3] = {1.0f, 1.0f, 1.0f}, edge[3] = {0.78f, 0.8f, 0.83f};
    float widest = 0.0f, e = p->size, w, h, x, y, from[2], to[2], phase = 0.0f;
    int i, rows = 0;
    studio_pen pen;
    memset(&pen, 0, sizeof pen);
    for (i = 0; i < p->series_count; ++i) {
        if (!p->series[i].name[0]) continue;
        widest = fmaxf(widest, studio_text_width(p->series[i].name, e));
        ++rows;
    }
    if (rows == 0) return;
    w = floorf(widest + 5.2f * e);
    h = floorf((float)rows * 1.9f * e + 0.9f * e);
    x = (float)(int)(p->legend_left ? (float)p->left + 0.8f * e : (float)(p->left + p->wide) - w - 0.8f * e);
    y = (float)(int)(p->legend_low ? (float)(p->top + p->high) - h - 0.8f * e : (float)p->top + 0.8f * e);
    studio_rectangle(im, (int)x, (int)y, (int)w, (int)h, edge, 1.0f);
    studio_rectangle(im, (int)x + 1, (int)y + 1, (int)w - 2, (int)h - 2, paper, 1.0f);
    y += 1.85f * e;
    for (i = 0; i < p->series_count; ++i) {
        const studio_series *s = p->series + i;
        if (!s->name[0]) continue;
        from[0] = x + 0.9f * e;
        to[0] = x + 3.5f * e;
        from[1] = to[1] = y - 0.5f * e;
        if (s->style == STUDIO_POINTS) studio_pen_line(&pen, x + 2.2f * e, from[1], x + 2.2f * e, from[1]);
        else if (s->style == STUDIO_DASHED) studio_pen_dash(&pen, from, to, 0.6f * e, &phase);
        else studio_pen_line(&pen, from[0], from[1], to[0], to[1]);
        studio_pen_paint(im, &pen, s->style == STUDIO_POINTS ? 0.42f * e : 0.20f * e, s->rgb, 1.0f);
        studio_text(im, x + 4.3f * e, y, e, ink, s->name);
        y += 1.9f * e;
        phase = 0.0f;
    }
    free(pen.piece);
}

/* Draws the chart over the whole image. */
STUDIO_API void studio_plot_draw(studio_plot *p, studio_image *im) {
    static const float ink[3] = {0.13f, 0.15f, 0.19f}, frame[3] = {0.45f, 0.48f, 0.53f};
    static const float inside[3] = {0.985f, 0.987f, 0.99f};
    float e = p->size = studio_clamp((float)im->height / 48.0f, 6.5f, 24.0f), l, t, r, b;
    int i;
    studio_image_fill(im, 1.0f, 1.0f, 1.0f);
    p->top = (int)(p->title[0] ? 3.8f * e : 1.5f * e);
    p->high = im->height - p->top - (int)(p->x_label[0] ? 5.4f * e : 3.4f * e);
    p->wide = im->width - (int)(8.0f * e);
    if (p->wide < 8 || p->high < 8) return;
    studio_plot_range(p, 0);
    studio_plot_range(p, 1);
    p->left = (int)(studio_plot_axis(p, 1, NULL) + 1.6f * e + (p->y_label[0] ? 2.4f * e : 0.0f));
    p->wide = im->width - p->left - (int)(2.0f * e);
    if (p->wide < 8) return;
    studio_rectangle(im, p->left, p->top, p->wide, p->high, inside, 1.0f);
    studio_plot_axis(p, 0, im);
    studio_plot_axis(p, 1, im);
    for (i = 0; i < p->series_count; ++i) studio_plot_paint(p, p->series + i, im);
    l = (float)p->left + 0.5f;
    t = (float)p->top + 0.5f;
    r = l + (float)p->wide;
    b = t + (float)p->high;
    studio_line(im, l, t, l, b, 1.0f, frame, 1.0f);
    studio_line(im, l, b, r, b, 1.0f, frame, 1.0f);
    studio_text_at(im, 0.5f * (l + r), 2.4f * e, 1.2f * e, ink, 0.5f, 0, p->title);
    studio_text_at(im, 0.5f * (l + r), b + 4.4f * e, e, ink, 0.5f, 0, p->x_label);
    studio_text_at(im, 2.1f * e, 0.5f * (t + b), e, ink, 0.5f, 1, p->y_label);
    studio_plot_legend(p, im);
}

/* Draws the chart into a new picture and writes it as PNG. */
STUDIO_API int studio_plot_write(studio_plot *p, const char *path, int width, int height) {
    studio_image im;
    int bad = studio_image_make(&im, width, height);
    if (bad) return bad;
    studio_plot_draw(p, &im);
    bad = studio_png(path, &im);
    studio_image_free(&im);
    return bad;
}

#endif /* STUDIO_H */
