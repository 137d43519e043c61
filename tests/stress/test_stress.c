/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Numerical stability over a grid of sizes, bad values, exposures, missing passes, threads, tiles and memory limits. What
 * must hold everywhere: finite output within the range of the valid input, the same bits for any threads and tiles, exact
 * scaling by powers of two, and means that stay.
 *
 * A short grid runs by default, the whole one with QUELL_STRESS=all (`make stress`), which prints a row for each case.
 */
#include "cmocka_all.h"
#include "frames.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static int is_whole_grid;

typedef void corrupt_fn(stress_frame *f);

/* ---- What goes wrong in a frame ------------------------------------------------------------------------------------- */

static void put(stress_frame *f, uint32_t layer, size_t pixel, float value)
{
    const uint32_t n = layer_channels(layer);
    for (uint32_t c = 0; c < n && c < 3; ++c) f->layers[layer][pixel * n + c] = value;
}

/* Puts the value into every step-th pixel of all radiance. */
static void sprinkle(stress_frame *f, size_t step, float value)
{
    for (uint32_t l = 0; l < NUM_LAYERS; ++l)
        for (size_t i = l % step; f->layers[l] && layer_is_radiance(l) && i < (size_t)f->width * f->height; i += step)
            put(f, l, i, value);
}

static void fill_radiance(stress_frame *f, float (*value)(size_t x, size_t y))
{
    for (uint32_t l = 0; l < NUM_LAYERS; ++l)
        for (size_t i = 0; f->layers[l] && layer_is_radiance(l) && i < (size_t)f->width * f->height; ++i)
            put(f, l, i, value(i % f->width, i / f->width));
}

static float black(size_t x, size_t y)
{
    (void)x;
    (void)y;
    return 0.0f;
}
static float one(size_t x, size_t y)
{
    (void)x;
    (void)y;
    return 1.0f;
}
static float checker(size_t x, size_t y)
{
    return (float)((x + y) % 2);
}
static float single(size_t x, size_t y)
{
    return x == 5 && y == 3 ? 1000.0f : 0.0f;
}
static float least(size_t x, size_t y)
{
    return (x + y) % 3 ? FLT_MIN / 64.0f : 0.0f;
}

static void nothing(stress_frame *f)
{
    (void)f;
}
static void one_nan(stress_frame *f)
{
    put(f, LAYER_COMBINED, (size_t)f->width * f->height / 2, NAN);
}
static void some_nan(stress_frame *f)
{
    sprinkle(f, 10, NAN);
}
static void many_nan(stress_frame *f)
{
    for (size_t i = 0; i < (size_t)f->width * f->height; ++i)
        for (uint32_t l = 0; l < NUM_LAYERS && i % 10; ++l)
            if (f->layers[l] && layer_is_radiance(l)) put(f, l, i, NAN);
}
static void all_nan(stress_frame *f)
{
    sprinkle(f, 1, NAN);
}
static void positive_infinity(stress_frame *f)
{
    sprinkle(f, 17, INFINITY);
}
static void negative_infinity(stress_frame *f)
{
    sprinkle(f, 17, -INFINITY);
}
static void negative(stress_frame *f)
{
    sprinkle(f, 7, -0.5f);
}
static void half_extremes(stress_frame *f)
{
    sprinkle(f, 13, 65504.0f);
    f->is_half = 1;
}
static void half_denormals(stress_frame *f)
{
    sprinkle(f, 2, 0x1p-24f);
    f->is_half = 1;
}
static void denormals(stress_frame *f)
{
    fill_radiance(f, least);
}
static void firefly_100(stress_frame *f)
{
    sprinkle(f, 97, 1e2f);
}
static void firefly_1e6(stress_frame *f)
{
    sprinkle(f, 97, 1e6f);
}
static void firefly_1e30(stress_frame *f)
{
    sprinkle(f, 97, 1e30f);
}
static void absurd(stress_frame *f)
{
    sprinkle(f, 97, FLT_MAX);
}
static void all_1e25(stress_frame *f)
{
    sprinkle(f, 2, 1e25f);
}
static void all_black(stress_frame *f)
{
    fill_radiance(f, black);
}
static void all_white(stress_frame *f)
{
    fill_radiance(f, one);
}
static void checkered(stress_frame *f)
{
    fill_radiance(f, checker);
}
static void one_bright_pixel(stress_frame *f)
{
    fill_radiance(f, single);
}

static void set_guide(stress_frame *f, uint32_t layer, float value)
{
    for (size_t i = 0; f->layers[layer] && i < (size_t)f->width * f->height; ++i) put(f, layer, i, value);
}
static void albedo_zero(stress_frame *f)
{
    set_guide(f, LAYER_ALBEDO, 0.0f);
}
static void albedo_large(stress_frame *f)
{
    set_guide(f, LAYER_ALBEDO, 1e20f);
}
static void normal_nan(stress_frame *f)
{
    set_guide(f, LAYER_NORMAL, NAN);
}
static void normal_long(stress_frame *f)
{
    set_guide(f, LAYER_NORMAL, 300.0f);
}
static void depth_infinite(stress_frame *f)
{
    set_guide(f, LAYER_DEPTH, INFINITY);
}
static void depth_background(stress_frame *f)
{
    set_guide(f, LAYER_DEPTH, 1e10f);
}
static void colors_black(stress_frame *f)
{
    for (uint32_t l = LAYER_FIRST_LIGHT + 2; l < LAYER_VOLUME_DIRECT; l += 3) set_guide(f, l, 0.0f);
}
static void colors_large(stress_frame *f)
{
    for (uint32_t l = LAYER_FIRST_LIGHT; l < LAYER_VOLUME_DIRECT; ++l) set_guide(f, l, 1e20f);
}
static void samples_unknown(stress_frame *f)
{
    f->samples = 0;
}
static void samples_wrong(stress_frame *f)
{
    f->samples = 1u << 31;
}

static const struct {
    const char *name;
    corrupt_fn *corrupt;
    int in_short_grid;
} cases[] = {
    {"noise", nothing, 1},
    {"one NaN", one_nan, 1},
    {"10 % NaN", some_nan, 1},
    {"90 % NaN", many_nan, 0},
    {"all NaN", all_nan, 1},
    {"+Inf", positive_infinity, 1},
    {"-Inf", negative_infinity, 0},
    {"negative radiance", negative, 1},
    {"half floats, 65504", half_extremes, 1},
    {"half floats, denormal", half_denormals, 0},
    {"denormal radiance", denormals, 1},
    {"fireflies of 1e2", firefly_100, 0},
    {"fireflies of 1e6", firefly_1e6, 1},
    {"fireflies of 1e30", firefly_1e30, 1},
    {"fireflies of 3e38", absurd, 0},
    {"half of all 1e25", all_1e25, 1},
    {"black", all_black, 1},
    {"white", all_white, 1},
    {"checker", checkered, 1},
    {"one bright pixel", one_bright_pixel, 1},
    {"albedo 0", albedo_zero, 0},
    {"albedo 1e20", albedo_large, 0},
    {"normals NaN", normal_nan, 1},
    {"normals of length 500", normal_long, 0},
    {"depth infinite", depth_infinite, 1},
    {"depth of the background", depth_background, 0},
    {"colours black", colors_black, 0},
    {"light and colours of 1e20", colors_large, 1},
    {"samples unknown", samples_unknown, 1},
    {"samples 2^31", samples_wrong, 1},
};
enum { NUM_CASES = sizeof cases / sizeof *cases };

/* ---- The grid ------------------------------------------------------------------------------------------------------ */

static void print_row(const char *name, const stress_frame *f, const stress_report *report, quell_status status)
{
    if (!is_whole_grid) return;
    const double drift = report->mean_before != 0.0 ? 100.0 * (report->mean_after / report->mean_before - 1.0) : 0.0;
    printf("| %s | %ux%u | %05x | %s | %llu | %llu | %+.2f |\n", name, f->width, f->height, f->mask,
           status == QUELL_OK ? "done" : quell_status_name(status), (unsigned long long)report->num_bad,
           (unsigned long long)report->num_limited, drift);
}

/* Denoises, checks the promises, and returns the result; NULL when there was nothing to do. */
static stress_frame *checked(const char *name, const stress_frame *f, const stress_run *run, stress_report *report)
{
    stress_frame *out;
    memset(report, 0, sizeof *report);
    const quell_status status = frame_denoise(f, run, &out, report);
    print_row(name, f, report, status);
    if (status == QUELL_ERR_NO_LAYER && !(f->mask & MASK(LAYER_COMBINED))) return NULL;
    if (status != QUELL_OK) fail_msg("%s, %ux%u, layers %x: status %d", name, f->width, f->height, f->mask, status);
    const char *const fault = frame_check(f, out, report);
    if (fault) fail_msg("%s, %ux%u, layers %x: %s", name, f->width, f->height, f->mask, fault);
    return out;
}

/* Two threads against three, whole against tiles, everything computed against what needs it. */
static void same_bits(const char *name, const stress_frame *f)
{
    static const stress_run one = {.num_threads = 1}, other = {.num_threads = 3, .tile_size = 64};
    stress_report a_report, b_report;
    stress_frame *const a = checked(name, f, &one, &a_report), *const b = checked(name, f, &other, &b_report);
    if (a && !frame_equal(a, b)) fail_msg("%s, %ux%u: threads or tiles show", name, f->width, f->height);
    frame_destroy(a);
    frame_destroy(b);
}

static void test_bad_values(void **state)
{
    (void)state;
    const uint32_t masks[] = {MASK_ALL, MASK(LAYER_COMBINED) | MASK_GUIDES, MASK(LAYER_COMBINED)};
    for (size_t m = 0; m < (is_whole_grid ? 3 : 1); ++m)
        for (size_t i = 0; i < NUM_CASES; ++i) {
            if (!is_whole_grid && !cases[i].in_short_grid) continue;
            stress_frame *const f = frame_create(71, 45, masks[m]);
            cases[i].corrupt(f);
            same_bits(cases[i].name, f);
            frame_destroy(f);
        }
}

static void test_sizes(void **state)
{
    (void)state;
    static const uint32_t sizes[][2] = {{1, 1},    {1, 2},   {2, 1},     {3, 3},     {1, 67},    {67, 1},   {31, 17},
                                        {131, 97}, {2, 509}, {1031, 3},  {127, 131}, {257, 255}, {641, 7},  {5, 769},
                                        {333, 65}, {33, 32}, {16384, 2}, {2, 16384}, {512, 384}, {640, 321}};
    const size_t num = is_whole_grid ? sizeof sizes / sizeof *sizes : 8;
    for (size_t i = 0; i < num; ++i) {
        stress_frame *const f = frame_create(sizes[i][0], sizes[i][1], MASK_ALL);
        same_bits("size", f);
        frame_destroy(f);
    }
}

/* Without each layer; in the whole grid also every choice of guides with every choice of what is added. */
static void test_missing_passes(void **state)
{
    (void)state;
    static const stress_run run = {.num_threads = 2};
    stress_report report;
    for (uint32_t l = 0; l < NUM_LAYERS; ++l) {
        stress_frame *const f = frame_create(37, 29, MASK_ALL & ~MASK(l));
        frame_destroy(checked("without a pass", f, &run, &report));
        frame_destroy(f);
    }
    for (uint32_t guides = 0; guides < 8 && is_whole_grid; ++guides)
        for (uint32_t rest = 0; rest < 32; ++rest) {
            const uint32_t light = rest & 1 ? MASK_LIGHT : 0, added = rest >> 1 << LAYER_VOLUME_DIRECT;
            stress_frame *const f = frame_create(37, 29, MASK(LAYER_COMBINED) | guides << LAYER_ALBEDO | light | added);
            frame_destroy(checked("without passes", f, &run, &report));
            frame_destroy(f);
        }
}

static void scale_radiance(stress_frame *f, int exponent)
{
    for (uint32_t l = 0; l < NUM_LAYERS; ++l) {
        const size_t n = layer_channels(l);
        for (size_t i = 0; f->layers[l] && layer_is_radiance(l) && i < n * f->width * f->height; ++i)
            if (n < 4 || i % n != 3) f->layers[l][i] = ldexpf(f->layers[l][i], exponent);
    }
}

static void test_exposure(void **state)
{
    (void)state;
    static const stress_run run = {.num_threads = 2};
    const int step = is_whole_grid ? 5 : 20;
    stress_report report;
    stress_frame *const f = frame_create(71, 45, MASK_ALL);
    stress_frame *const want = checked("exposure 2^0", f, &run, &report);
    for (int exponent = -30; exponent <= 30; exponent += step) {
        stress_frame *const scaled = frame_copy(f), *const expected = frame_copy(want);
        char name[32];
        snprintf(name, sizeof name, "exposure 2^%d", exponent);
        scale_radiance(scaled, exponent);
        scale_radiance(expected, exponent);
        stress_frame *const got = checked(name, scaled, &run, &report);
        if (!frame_equal(got, expected)) fail_msg("%s does not scale exactly", name);
        frame_destroy(scaled);
        frame_destroy(expected);
        frame_destroy(got);
    }
    frame_destroy(f);
    frame_destroy(want);
}

/* One bad pixel changes nothing further away than what is computed from it: the halo of network and kernels, then the
 * noise windows that the blend goes by (3x3 blocks of 8 pixels, linear between block centres) and the firefly test's
 * reach, which come before the network and behind the filters. Exposure and the noise's quiet quarter are taken from the
 * whole image, but in steps of 2 and of a quarter: one pixel in thousands does not move them. Left out here are layers
 * that are clean (a bad pixel makes them filtered, and Combined takes them up as the kernels leave them) and emission,
 * which is never a firefly and so moves the exposure if it is of 1e30. */
static void test_one_pixel_stays_local(void **state)
{
    (void)state;
    enum { WIDTH = 704, HEIGHT = 56, X = 20, Y = 25, NOISE_REACH = 24 + 8, FIREFLY_REACH = 2 };
    static const float values[] = {NAN, INFINITY, -INFINITY, -1.0f, 1e4f, 1e30f, FLT_MAX};
    static const stress_run run = {.num_threads = 2, .tile_size = 352};
    stress_report report;
    stress_frame *const f = frame_create(WIDTH, HEIGHT, MASK_ALL);
    stress_frame *const want = checked("locality: as it was", f, &run, &report);
    const stress_report noisy = report;
    const uint32_t reach = report.halo + 2 * NOISE_REACH + FIREFLY_REACH;
    assert_true(report.halo > 0 && X + reach + 100 < WIDTH);
    for (size_t i = 0; i < sizeof values / sizeof *values; ++i) {
        char name[40];
        snprintf(name, sizeof name, "locality: %g", (double)values[i]);
        stress_frame *const bad = frame_copy(f);
        for (uint32_t l = 0; l < NUM_LAYERS; ++l)
            if (noisy.is_denoised[l] && l != LAYER_EMISSION && l != LAYER_ENVIRONMENT)
                put(bad, l, (size_t)Y * WIDTH + X, values[i]);
        stress_frame *const got = checked(name, bad, &run, &report);
        uint32_t furthest = 0;
        for (uint32_t l = 0; l < NUM_LAYERS; ++l) {
            const size_t n = layer_channels(l);
            for (size_t k = 0; k < n * WIDTH * HEIGHT; ++k) {
                const uint32_t x = (uint32_t)(k / n % WIDTH), distance = x > X ? x - X : X - x;
                if (distance > furthest && memcmp(&got->layers[l][k], &want->layers[l][k], sizeof(float)) != 0)
                    furthest = distance;
            }
        }
        if (is_whole_grid)
            printf("| %s: changes end %u pixels away, %u allowed | | | | | | |\n", name, furthest, reach);
        if (furthest > reach) fail_msg("%s: a pixel %u away has changed, %u are allowed", name, furthest, reach);
        frame_destroy(bad);
        frame_destroy(got);
    }
    frame_destroy(f);
    frame_destroy(want);
}

/* Constants stay, to rounding, whatever the exposure; nothing is limited there, so nothing may get lost. */
static void test_energy(void **state)
{
    (void)state;
    static const stress_run run = {.num_threads = 2, .flags = QUELL_DENOISE_NO_SKIP};
    stress_report report;
    for (int exponent = -20; exponent <= 20; exponent += 20) {
        stress_frame *const f = frame_create(71, 45, MASK(LAYER_COMBINED) | MASK_GUIDES);
        fill_radiance(f, one);
        scale_radiance(f, exponent);
        frame_destroy(checked("constant", f, &run, &report));
        assert_int_equal(report.num_limited, 0);
        if (fabs(report.mean_after / report.mean_before - 1.0) > 1e-5) fail_msg("constant, 2^%d: drifts", exponent);
        frame_destroy(f);
    }
}

/* The smallest tiles that a memory limit leads to give the same bits as the whole image; less is refused. */
static void test_memory_limits(void **state)
{
    (void)state;
    stress_frame *const f =
        frame_create(is_whole_grid ? 1200 : 400, is_whole_grid ? 700 : 300, MASK(LAYER_COMBINED) | MASK_GUIDES);
    const stress_run free_run = {.num_threads = 2};
    stress_report report;
    stress_frame *const want = checked("memory: any", f, &free_run, &report);
    int refused = 0, done = 0;
    for (uint64_t mb = 4; mb <= 64; mb *= is_whole_grid ? 2 : 4) {
        const stress_run run = {.num_threads = 2, .max_memory_bytes = mb << 20};
        stress_frame *out;
        const quell_status status = frame_denoise(f, &run, &out, &report);
        if (status != QUELL_OK) {
            assert_int_equal(status, QUELL_ERR_OUT_OF_MEMORY);
            assert_false(done); /* more memory never is too little */
            ++refused;
            continue;
        }
        ++done;
        if (!frame_equal(out, want)) fail_msg("%llu MB give other bits", (unsigned long long)mb);
        frame_destroy(out);
    }
    assert_true(refused > 0 && done > 0);
    frame_destroy(f);
    frame_destroy(want);
}

/* ---- Skipping ------------------------------------------------------------------------------------------------------ */

/* A frame that is noise inside a box and a clean gradient outside. */
static stress_frame *noise_in_a_box(uint32_t width, uint32_t height)
{
    stress_frame *const f = frame_create(width, height, MASK(LAYER_COMBINED) | MASK_GUIDES);
    for (uint32_t y = 0; y < height; ++y)
        for (uint32_t x = 0; x < width; ++x)
            if (x < width / 2 || y < height / 2)
                put(f, LAYER_COMBINED, (size_t)y * width + x, 0.2f + 0.001f * (float)x + 0.0005f * (float)y);
    return f;
}

/* What is skipped is bit for bit what would have come out, whatever tiles and threads. */
static void test_skipping_changes_nothing(void **state)
{
    (void)state;
    static const stress_run plain = {.num_threads = 2}, whole = {.num_threads = 2, .flags = QUELL_DENOISE_NO_SKIP},
                            tiled = {.num_threads = 3, .tile_size = 64};
    stress_frame *const f = noise_in_a_box(700, 500);
    stress_report report;
    stress_frame *const a = checked("skipping", f, &plain, &report), *const b = checked("no skip", f, &whole, &report),
                        *const c = checked("skipping, tiled", f, &tiled, &report);
    assert_true(frame_equal(a, b) && frame_equal(a, c));
    assert_memory_equal(a->layers[0], f->layers[0], 700 * 200 * 4 * sizeof(float)); /* the clean part is untouched */
    frame_destroy(a);
    frame_destroy(b);
    frame_destroy(c);
    frame_destroy(f);
}

int main(void)
{
    const char *const grid = getenv("QUELL_STRESS");
    is_whole_grid = grid && strcmp(grid, "all") == 0;
    if (is_whole_grid)
        puts("| case | size | layers | result | bad | limited | mean % |\n| --- | --- | --- | --- | --- | --- | --- |");
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_bad_values),
        cmocka_unit_test(test_sizes),
        cmocka_unit_test(test_missing_passes),
        cmocka_unit_test(test_exposure),
        cmocka_unit_test(test_one_pixel_stays_local),
        cmocka_unit_test(test_energy),
        cmocka_unit_test(test_memory_limits),
        cmocka_unit_test(test_skipping_changes_nothing),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
