/* SPDX-License-Identifier: Apache-2.0 */
/* Values worked out by hand; tests/metrics compares whole images with numpy. */
#include "metrics/metrics.h"

#include "cmocka_all.h"

#include <math.h>
#include <string.h>

static ql_view view_of(float *data, uint32_t width, uint32_t num_channels)
{
    const ql_view view = {
        .data = (uint8_t *)data,
        .format = QUELL_FORMAT_FLOAT,
        .num_channels = num_channels,
        .channel_stride = 4,
        .pixel_stride = 4 * (int64_t)num_channels,
        .row_stride = 4 * (int64_t)num_channels * (int64_t)width,
    };
    return view;
}

static quell_metrics compare(uint32_t width, uint32_t height, uint32_t num_channels, float *x, float *a, float *b,
                             uint32_t num_threads)
{
    ql_memory memory;
    ql_memory_init(&memory, 0);
    ql_pool *pool;
    assert_int_equal(ql_pool_create(num_threads, &memory, &pool, NULL), QUELL_OK);
    ql_env env = {.memory = &memory, .pool = pool};
    const ql_view vx = view_of(x, width, num_channels), va = view_of(a, width, num_channels);
    quell_metrics out;
    memset(&out, 0, sizeof out);
    if (b) {
        const ql_view vb = view_of(b, width, num_channels);
        assert_int_equal(ql_metrics_compare(&env, width, height, &vx, &va, &vb, &out, NULL), QUELL_OK);
    } else {
        assert_int_equal(ql_metrics_compare(&env, width, height, &vx, &va, NULL, &out, NULL), QUELL_OK);
    }
    ql_pool_destroy(pool);
    assert_int_equal(memory.used_bytes, 0);
    return out;
}

static void assert_near(double value, double expected, double tolerance)
{
    if (!(fabs(value - expected) <= tolerance)) fail_msg("%.12g is not %.12g +- %g", value, expected, tolerance);
}

static void one_pixel_with_one_reference(void **state)
{
    (void)state;
    float x[] = {1.0f}, a[] = {3.0f};
    const quell_metrics m = compare(1, 1, 1, x, a, NULL, 1);
    assert_near(m.mse, 4.0, 0.0);
    assert_near(m.rel_mse, 4.0 / 9.01, 1e-15);
    assert_near(m.psnr, -10.0 * log10(0.0625), 1e-12); /* 1/2 against 3/4 */
    /* One pixel has no variance: luminance term alone, (2 * 0.375 + c1) / (0.25 + 0.5625 + c1). */
    assert_near(m.ssim, 0.7501 / 0.8126, 1e-7);
    assert_near(m.gmsd, 0.0, 0.0);
}

static void two_references_cancel_their_noise(void **state)
{
    (void)state;
    /* x lies between the references: their noise explains all of the difference, and more. */
    float x[] = {2.0f}, a[] = {1.0f}, b[] = {3.0f};
    const quell_metrics m = compare(1, 1, 1, x, a, b, 1);
    assert_near(m.mse, -1.0, 0.0);
    assert_near(m.rel_mse, -1.0 / 4.01, 1e-15);
    assert_true(isinf(m.psnr) && m.psnr > 0.0);
}

static void bad_values_count_as_zero(void **state)
{
    (void)state;
    float x[] = {NAN, INFINITY, 1.0f, 7.0f, 0.0f, 0.0f, -INFINITY, NAN};
    float a[] = {0.0f, 0.0f, 1.0f, 9.0f, 0.0f, 0.0f, 2.0f, 9.0f};
    const quell_metrics m = compare(2, 1, 4, x, a, NULL, 1); /* the fourth channel is not compared */
    assert_int_equal(m.num_non_finite, 3);
    assert_near(m.mse, 4.0 / 6.0, 1e-15);
}

static void equal_images_are_perfect(void **state)
{
    (void)state;
    enum { W = 23, H = 37 };
    float x[W * H * 3];
    for (size_t i = 0; i < W * H * 3; i++) x[i] = (float)((i * 7919u) % 1000u) / 250.0f;
    const quell_metrics m = compare(W, H, 3, x, x, NULL, 2);
    assert_near(m.mse, 0.0, 0.0);
    assert_true(isinf(m.psnr));
    assert_near(m.ssim, 1.0, 1e-12);
    assert_near(m.gmsd, 0.0, 1e-12);
}

static void threads_do_not_change_a_bit(void **state)
{
    (void)state;
    enum { W = 61, H = 131 };
    static float x[W * H * 3], a[W * H * 3];
    for (size_t i = 0; i < W * H * 3; i++) {
        x[i] = (float)((i * 7919u) % 1009u) / 250.0f;
        a[i] = (float)((i * 104729u) % 997u) / 250.0f;
    }
    const quell_metrics one = compare(W, H, 3, x, a, NULL, 1), many = compare(W, H, 3, x, a, NULL, 5);
    assert_memory_equal(&one, &many, sizeof one);
    assert_true(one.ssim < 0.5 && one.gmsd > 0.0);
}

static void gmsd_of_a_step(void **state)
{
    (void)state;
    /* A column of 4 x 2 pixels, halved to 2 x 1: [t, 0] against [t, t] with t = 1/2. Beyond the edge is 0, so the
     * gradients (dx, dy) / 3 are: image (0, 0) and (-t, 0); reference (t, 0) and (-t, 0). */
    float x[] = {1.0f, 1.0f, 0.0f, 0.0f, 1.0f, 1.0f, 0.0f, 0.0f}, a[8];
    for (int i = 0; i < 8; i++) a[i] = 1.0f;
    const double g = 0.25 / 9.0, c = 170.0 / 65025.0;
    const double first = c / (g + c), second = 1.0;
    const double mean = 0.5 * (first + second);
    const double expected = sqrt((first - mean) * (first - mean) + (second - mean) * (second - mean));
    assert_near(compare(4, 2, 1, x, a, NULL, 1).gmsd, expected, 1e-12);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(one_pixel_with_one_reference), cmocka_unit_test(two_references_cancel_their_noise),
        cmocka_unit_test(bad_values_count_as_zero),     cmocka_unit_test(equal_images_are_perfect),
        cmocka_unit_test(threads_do_not_change_a_bit),  cmocka_unit_test(gmsd_of_a_step),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
