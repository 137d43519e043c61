/* SPDX-License-Identifier: Apache-2.0 */
/* Noise estimates against noise that was put in, the blend, and the parts of an image that need work. */
#include "cmocka_all.h"
#include "filter/blend.h"
#include "plan/cells.h"

#include <math.h>
#include <string.h>

enum { W = 72, H = 56, BLOCKS = (W / 8) * (H / 8) };

/* Deterministic, near enough to normal: the sum of four uniform values. */
static float noise_at(uint32_t x, uint32_t y)
{
    uint32_t state = x * 2654435761u ^ (y + 1) * 2246822519u;
    float sum = 0.0f;
    for (int i = 0; i < 4; ++i) {
        state = state * 1664525u + 1013904223u;
        sum += (float)(state >> 8) / 16777216.0f - 0.5f;
    }
    return sum * sqrtf(3.0f);
}

typedef float pattern_fn(uint32_t x, uint32_t y);

static float flat(uint32_t x, uint32_t y)
{
    (void)x;
    (void)y;
    return 1.0f;
}
static float gradient(uint32_t x, uint32_t y)
{
    return 0.2f + 0.01f * (float)x + 0.02f * (float)y;
}
static float stripes(uint32_t x, uint32_t y)
{
    (void)y;
    return x % 2 ? 1.5f : 0.5f;
}
static float diagonal_stripes(uint32_t x, uint32_t y)
{
    return (x + y) % 4 < 2 ? 1.5f : 0.5f;
}
static float checker(uint32_t x, uint32_t y)
{
    return (x + y) % 2 ? 1.5f : 0.5f;
}
static float edge(uint32_t x, uint32_t y)
{
    (void)x;
    return y < H / 2 ? 0.1f : 4.0f;
}

/* A frame of one layer in memory, its scan and its noise. */
typedef struct fixture {
    ql_memory memory;
    ql_pool *pool;
    ql_env env;
    float pixels[W * H * 3];
    ql_layer layer;
    ql_scan scan;
    ql_noise noise;
} fixture;

static void fill(fixture *f, pattern_fn *pattern, float deviation, float scale)
{
    for (uint32_t y = 0; y < H; ++y)
        for (uint32_t x = 0; x < W; ++x)
            for (uint32_t c = 0; c < 3; ++c)
                f->pixels[(y * W + x) * 3 + c] = scale * pattern(x, y) * (1.0f + deviation * noise_at(x, y));
}

static void measure(fixture *f, uint32_t width, uint32_t height, uint32_t num_threads)
{
    ql_error err;
    ql_memory_init(&f->memory, 0);
    assert_int_equal(ql_pool_create(num_threads, &f->memory, &f->pool, &err), QUELL_OK);
    f->env = (ql_env){.memory = &f->memory, .pool = f->pool, .progress_to = 1.0};
    f->layer = (ql_layer){.full_name = (char *)"layer", .role = QUELL_ROLE_COMBINED, .num_channels = 3};
    f->layer.pixels = (ql_view){(uint8_t *)f->pixels, QUELL_FORMAT_FLOAT, 3, 4, 12, 12 * (int64_t)width};
    assert_int_equal(
        ql_scan_layer(&f->env, &f->layer, NULL, 3, width, height, QL_SCAN_BINS,
                      ql_firefly_factor(4), &f->scan, &err),
        QUELL_OK);
    assert_int_equal(ql_noise_measure(&f->env, &f->layer, &f->scan, 3, width, height, &f->noise, &err), QUELL_OK);
}

static void release(fixture *f)
{
    ql_noise_free(&f->noise, &f->memory);
    ql_scan_free(&f->scan, &f->memory);
    ql_pool_destroy(f->pool);
    assert_int_equal(f->memory.used_bytes, 0);
}

/* Deviation of what was measured, over the image. */
static float level_of(pattern_fn *pattern, float deviation)
{
    fixture f;
    fill(&f, pattern, deviation, 1.0f);
    measure(&f, W, H, 2);
    const float level = (float)f.noise.level;
    release(&f);
    return level;
}

static void test_noise_is_found(void **state)
{
    (void)state;
    /* Relative to the block's mean plus a floor of a quarter to a half of the median: 1 / 1.25 to 1 / 1.5 for a mean of 1. */
    const float small = level_of(flat, 0.02f), large = level_of(flat, 0.2f);
    assert_true(small > 0.5f * 0.02f && small < 0.02f);
    assert_true(large > 0.5f * 0.2f && large < 0.2f);
    assert_true(fabsf(large / small - 10.0f) < 0.2f);
}

static void test_detail_is_no_noise(void **state)
{
    (void)state;
    pattern_fn *const patterns[] = {flat, gradient, stripes, diagonal_stripes, checker, edge};
    for (size_t i = 0; i < sizeof patterns / sizeof *patterns; ++i) {
        const float clean = level_of(patterns[i], 0.0f), noisy = level_of(patterns[i], 0.1f);
        if (clean > 1e-3f) fail_msg("pattern %zu without noise measures %g", i, (double)clean);
        if (noisy < 0.04f || noisy > 0.14f) fail_msg("pattern %zu with noise of 0.1 measures %g", i, (double)noisy);
    }
}

static void test_exposure_and_threads_change_no_bit(void **state)
{
    (void)state;
    fixture a, b;
    fill(&a, gradient, 0.1f, 1.0f);
    fill(&b, gradient, 0.1f, 0x1p-30f);
    measure(&a, W, H, 1);
    measure(&b, W, H, 3);
    assert_memory_equal(a.noise.variance, b.noise.variance, BLOCKS * sizeof(float));
    release(&a);
    release(&b);
}

static void test_thin_images(void **state)
{
    (void)state;
    const uint32_t sizes[][2] = {{1, 1}, {2, 2}, {1, 40}, {40, 1}, {2, 9}, {3, 3}};
    for (size_t i = 0; i < sizeof sizes / sizeof *sizes; ++i) {
        fixture f;
        fill(&f, flat, 0.1f, 1.0f);
        measure(&f, sizes[i][0], sizes[i][1], 2);
        const int is_known = sizes[i][0] > 2 || sizes[i][1] > 2;
        assert_true(is_known == (isfinite(f.noise.variance[0]) != 0));
        release(&f);
    }
}

static void test_bad_pixels_are_no_noise(void **state)
{
    (void)state;
    fixture f;
    fill(&f, flat, 0.0f, 1.0f);
    f.pixels[(20 * W + 20) * 3] = NAN;
    f.pixels[(30 * W + 33) * 3 + 1] = INFINITY;
    measure(&f, W, H, 2);
    assert_true(f.noise.level < 1e-3);
    release(&f);
}

/* Fireflies in most blocks once raised the floor so far that all else looked clean. */
static void test_fireflies_hide_no_noise(void **state)
{
    (void)state;
    fixture f;
    fill(&f, flat, 0.2f, 1.0f);
    for (size_t i = 0; i < (size_t)W * H; i += 97) f.pixels[i * 3] = f.pixels[i * 3 + 1] = f.pixels[i * 3 + 2] = 1e6f;
    measure(&f, W, H, 2);
    assert_true(f.scan.num_limited > 0);
    for (size_t i = 0; i < BLOCKS; ++i) assert_true(f.noise.variance[i] > 0.01f);
    release(&f);
}

/* Blends `result` with the fixture's layer; returns the mean weight. */
static float blend(fixture *f, float limit, float *result)
{
    static float limits[BLOCKS], weights[BLOCKS], changed[BLOCKS], residual[BLOCKS];
    ql_error err;
    for (size_t i = 0; i < BLOCKS; ++i) limits[i] = limit;
    assert_int_equal(
        ql_noise_measure_change(&f->env, &f->layer, &f->scan, &f->noise, 3, W, H, result, changed, residual, &err),
        QUELL_OK);
    const ql_blend b = {f->noise.variance, changed, residual, limits, weights, f->noise.across, f->noise.down};
    assert_int_equal(ql_blend_layer(&f->env, &f->layer, &f->scan, &b, 3, 3, W, H, result, &err), QUELL_OK);
    float sum = 0.0f;
    for (size_t i = 0; i < BLOCKS; ++i) sum += weights[i];
    return sum / (float)BLOCKS;
}

static void set_result(float *result, pattern_fn *pattern)
{
    for (uint32_t c = 0; c < 3; ++c)
        for (uint32_t y = 0; y < H; ++y)
            for (uint32_t x = 0; x < W; ++x) result[(c * H + y) * W + x] = pattern(x, y);
}

static void test_blend(void **state)
{
    (void)state;
    static float result[3 * W * H];
    fixture f;
    fill(&f, stripes, 0.2f, 1.0f);
    measure(&f, W, H, 2);

    /* What removed nothing but noise is taken whole. */
    set_result(result, stripes);
    assert_true(blend(&f, 1.0f, result) > 0.97f);
    assert_true(fabsf(result[10 * W + 11] - stripes(11, 10)) < 0.05f);

    /* What blurred the stripes away, hardly: most of the change is no noise. */
    set_result(result, flat);
    const float weight = blend(&f, 1.0f, result);
    assert_true(weight < 0.1f);

    /* A limit of 0 gives the render bit for bit. */
    set_result(result, flat);
    assert_true(blend(&f, 0.0f, result) == 0.0f);
    for (uint32_t c = 0; c < 3; ++c)
        for (uint32_t i = 0; i < W * H; ++i) assert_true(result[c * W * H + i] == f.pixels[i * 3 + c]);
    release(&f);
}

/* ---- Parts of the image ------------------------------------------------------------------------------------------- */

static void test_shares(void **state)
{
    (void)state;
    assert_true(ql_plan_share(0.0f, 4.0f) == 0.0f);
    assert_true(ql_plan_share(0.25f, 4.0f) == 1.0f);
    assert_true(ql_plan_share(INFINITY, 4096.0f) == 1.0f);
    float before = 0.0f;
    for (float deviation = 0.0f; deviation < 0.1f; deviation += 0.001f) {
        const float share = ql_plan_share(deviation * deviation, 16.0f);
        assert_true(share >= before && share <= 1.0f);
        before = share;
    }
    /* Many samples are believed while the noise agrees. */
    assert_true(ql_plan_trust(0.0f, 0.01f) == 1.0f && ql_plan_trust(64.0f, 0.0f) == 1.0f);
    assert_true(ql_plan_trust(1024.0f, 1e-4f) == 0.0f);
    assert_true(ql_plan_trust(4096.0f, 0.04f) == 1.0f);
    assert_true(ql_plan_trust(128.0f, 1e-4f) > ql_plan_trust(256.0f, 1e-4f));
}

/* Marks blocks and checks that the rectangles hold every active cell. Returns their number. */
static uint32_t cover(uint32_t width, uint32_t height, uint32_t halo, const uint32_t (*blocks)[2], size_t num,
                      ql_plan_rect rects[QL_PLAN_MAX_RECTS])
{
    ql_memory memory;
    ql_memory_init(&memory, 0);
    ql_plan_cells cells;
    const uint32_t across = (width + 7) / 8, down = (height + 7) / 8;
    float *const share = ql_alloc_zero(&memory, (size_t)across * down, sizeof *share);
    assert_int_equal(ql_plan_cells_create(&cells, width, height, &memory, NULL), QUELL_OK);
    for (size_t i = 0; i < num; ++i) share[blocks[i][1] * across + blocks[i][0]] = 0.5f;
    ql_plan_cells_add(&cells, share);
    const uint32_t count = ql_plan_cells_cover(&cells, halo, rects, QL_PLAN_MAX_RECTS);
    for (uint32_t y = 0; y < cells.down; ++y)
        for (uint32_t x = 0; x < cells.across; ++x) {
            int inside = 0;
            for (uint32_t i = 0; i < count; ++i)
                inside |=
                    x * 32 >= rects[i].x0 && x * 32 < rects[i].x1 && y * 32 >= rects[i].y0 && y * 32 < rects[i].y1;
            assert_true(inside || !cells.active[y * cells.across + x]);
        }
    for (uint32_t i = 0; i < count; ++i)
        assert_true(rects[i].x0 % 32 == 0 && rects[i].y0 % 32 == 0 && rects[i].x1 <= width && rects[i].y1 <= height);
    ql_plan_cells_free(&cells, &memory);
    ql_free(&memory, share);
    assert_int_equal(memory.used_bytes, 0);
    return count;
}

static void test_rectangles(void **state)
{
    (void)state;
    ql_plan_rect rects[QL_PLAN_MAX_RECTS];
    assert_int_equal(cover(1000, 700, 64, NULL, 0, rects), 0);
    /* A block at a cell's corner takes the cells beside it along. */
    const uint32_t corner[][2] = {{4, 4}};
    assert_int_equal(cover(1000, 700, 64, corner, 1, rects), 1);
    assert_true(rects[0].x0 == 0 && rects[0].y0 == 0 && rects[0].x1 == 64 && rects[0].y1 == 64);
    /* Far apart: two rectangles; near each other: one. */
    const uint32_t far_apart[][2] = {{1, 1}, {120, 80}}, near[][2] = {{1, 1}, {6, 6}};
    assert_int_equal(cover(1000, 700, 64, far_apart, 2, rects), 2);
    assert_int_equal(cover(1000, 700, 64, near, 2, rects), 1);
    /* The last block of an image that is no multiple of anything. */
    const uint32_t last[][2] = {{4, 2}};
    assert_int_equal(cover(37, 19, 64, last, 1, rects), 1);
    assert_true(rects[0].x1 == 37 && rects[0].y1 == 19);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_noise_is_found),
        cmocka_unit_test(test_detail_is_no_noise),
        cmocka_unit_test(test_exposure_and_threads_change_no_bit),
        cmocka_unit_test(test_thin_images),
        cmocka_unit_test(test_bad_pixels_are_no_noise),
        cmocka_unit_test(test_fireflies_hide_no_noise),
        cmocka_unit_test(test_blend),
        cmocka_unit_test(test_shares),
        cmocka_unit_test(test_rectangles),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
