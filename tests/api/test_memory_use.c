/* SPDX-License-Identifier: Apache-2.0 */
/* Working memory: what large frames are planned to need, and that a job keeps to what was planned and to its limit, by
 * strips and tiles that do not change a bit of the result. */
#include "quell.h"

#include "cmocka_all.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char *const names[] = {
    "Combined",   "DiffDir",    "DiffInd",    "DiffCol",          "GlossDir",   "GlossInd",
    "GlossCol",   "TransDir",   "TransInd",   "TransCol",         "VolumeDir",  "VolumeInd",
    "Emit",       "Env",        "AO",         "Combined_a",       "Combined_b", "Combined_c",
    "Combined_d", "Combined_e", "Combined_f", "Denoising Albedo",
};
enum {
    NUM_NAMES = sizeof names / sizeof *names,
    LONGEST_ROW = 3840,
    MOST_ROWS = 2160,
    SHIFT = 37,
    WIDTH = 1280,
    HEIGHT = 224
};

typedef struct fixture {
    quell_context *ctx;
    quell_model *model;
    float row[3 * (LONGEST_ROW + MOST_ROWS * SHIFT)];
} fixture;

static quell_context *new_context(uint64_t max_memory_bytes)
{
    quell_context *ctx;
    const quell_context_options options = {
        .struct_size = sizeof options, .num_threads = 2, .max_memory_bytes = max_memory_bytes};
    assert_int_equal(quell_context_create(&options, &ctx), QUELL_OK);
    return ctx;
}

static int set_up(void **state)
{
    fixture *const f = calloc(1, sizeof *f);
    uint32_t random = 1;
    assert_non_null(f);
    for (size_t i = 0; i < sizeof f->row / sizeof *f->row; i++) {
        random = random * 1664525u + 1013904223u;
        f->row[i] = 0.2f + (float)(random >> 8) / (float)(1 << 24);
    }
    f->ctx = new_context(0);
    assert_int_equal(quell_model_open(f->ctx, NULL, &f->model), QUELL_OK);
    *state = f;
    return 0;
}

static int tear_down(void **state)
{
    fixture *const f = *state;
    quell_model_destroy(f->model);
    quell_context_destroy(f->ctx);
    free(f);
    return 0;
}

/* A frame of noise that needs next to no memory: each row is the one above, some pixels on. To borrow it is for plans
 * alone: all layers lie in the same place. */
static quell_frame *new_frame(fixture *f, uint32_t width, uint32_t height, uint32_t num_layers, int32_t ownership)
{
    const quell_image image = {.struct_size = sizeof image,
                               .width = width,
                               .height = height,
                               .num_channels = 3,
                               .data = f->row,
                               .row_stride_bytes = 3 * SHIFT * sizeof(float)};
    quell_frame *frame;
    assert_int_equal(quell_frame_create(f->ctx, width, height, &frame), QUELL_OK);
    for (uint32_t i = 0; i < num_layers; i++)
        assert_int_equal(quell_frame_add_layer(f->ctx, frame, names[i], &image, ownership, NULL), QUELL_OK);
    return frame;
}

static quell_report_summary planned(fixture *f, int32_t precision, uint32_t width, uint32_t height, uint32_t num_layers)
{
    const quell_options options = {.struct_size = sizeof options, .precision = precision};
    quell_report_summary summary = {.struct_size = sizeof summary};
    quell_report *report;
    quell_frame *const frame = new_frame(f, width, height, num_layers, QUELL_LAYER_BORROW);
    assert_int_equal(quell_plan(f->ctx, f->model, frame, &options, &report), QUELL_OK);
    assert_int_equal(quell_report_get_summary(report, &summary), QUELL_OK);
    quell_report_destroy(report);
    quell_frame_destroy(frame);
    return summary;
}

/* The aims of docs/performance.md, for one layer and for many. */
static void large_frames_stay_modest(void **state)
{
    static const struct {
        uint32_t width, height, num_layers;
        uint64_t most;
    } cases[] = {
        {1920, 1080, 1, 400000000},
        {1920, 1080, NUM_NAMES, 400000000},
        {3840, 2160, 1, 1200000000},
        {3840, 2160, 4, 1200000000},
    };
    for (size_t i = 0; i < 2 * sizeof cases / sizeof *cases; i++) {
        const uint32_t width = cases[i / 2].width, height = cases[i / 2].height, num = cases[i / 2].num_layers;
        const int32_t precision = i % 2 ? QUELL_PRECISION_FLOAT32 : QUELL_PRECISION_AUTO;
        const quell_report_summary s = planned(*state, precision, width, height, num);
        print_message("%ux%u, %u layers, %s: %.1f MB, tiles of %ux%u\n", width, height, num,
                      s.precision == QUELL_PRECISION_FLOAT32 ? "float32" : "bfloat16", (double)s.peak_bytes / 1e6,
                      s.tile_width, s.tile_height);
        assert_true(s.peak_bytes <= cases[i / 2].most);
    }
}

/* Denoises the noise of 1280x224 pixels within a limit; result: [height][width][3]. */
static quell_report_summary denoised(fixture *f, int32_t precision, uint64_t limit, float *result)
{
    const quell_options options = {.struct_size = sizeof options, .precision = precision};
    quell_report_summary summary = {.struct_size = sizeof summary};
    const quell_image image = {
        .struct_size = sizeof image, .width = WIDTH, .height = HEIGHT, .num_channels = 3, .data = result};
    quell_report *report;
    quell_context *const ctx = new_context(limit);
    quell_frame *const frame = new_frame(f, WIDTH, HEIGHT, 4, QUELL_LAYER_COPY);
    assert_int_equal(quell_denoise(ctx, f->model, frame, &options, &report), QUELL_OK);
    assert_int_equal(quell_report_get_summary(report, &summary), QUELL_OK);
    assert_int_equal(quell_frame_copy_layer(ctx, frame, 0, &image), QUELL_OK);
    quell_report_destroy(report);
    quell_frame_destroy(frame);
    quell_context_destroy(ctx);
    return summary;
}

static void limits_make_strips_and_tiles_in(fixture *f, int32_t precision)
{
    const size_t num_bytes = (size_t)WIDTH * HEIGHT * 3 * sizeof(float);
    float *const whole = malloc(num_bytes), *const within = malloc(num_bytes);
    assert_true(whole && within);
    const uint64_t plan = planned(f, precision, WIDTH, HEIGHT, 4).peak_bytes;
    const quell_report_summary first = denoised(f, precision, 0, whole);
    assert_true(first.peak_bytes <= plan && first.num_tiles == 1);
    int num_strips = 0, num_tiled = 0;
    for (uint64_t limit = plan - plan / 16; limit > plan / 4; limit -= plan / 8) {
        const quell_report_summary s = denoised(f, precision, limit, within);
        assert_true(s.peak_bytes <= limit);
        assert_memory_equal(within, whole, num_bytes);
        num_strips += s.num_tiles == 1; /* less memory, and still one tile */
        num_tiled += s.num_tiles > 1;
    }
    assert_true(num_strips > 0 && num_tiled > 0);
    free(whole);
    free(within);
}

static void limits_make_strips_and_tiles(void **state)
{
    limits_make_strips_and_tiles_in(*state, QUELL_PRECISION_AUTO);
    limits_make_strips_and_tiles_in(*state, QUELL_PRECISION_FLOAT32);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(large_frames_stay_modest),
        cmocka_unit_test(limits_make_strips_and_tiles),
    };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
