/* SPDX-License-Identifier: Apache-2.0 */
/* Allocation n fails, for n = 1, 2, ... until the call succeeds: each time the status says so, nothing leaks, the
 * caller's pixels are as they were, and the context works on. */
#include "api/context.h"
#include "frame/frame.h"

#include "cmocka_all.h"

#include <stdlib.h>
#include <string.h>

enum { W = 45, H = 37, NUM_VALUES = W * H * 3 };

typedef struct fixture {
    quell_context *ctx;
    quell_model *model;
    float color[NUM_VALUES], lent[NUM_VALUES], expected[NUM_VALUES];
    quell_frame *frame;
    quell_options options;
} fixture;

static quell_image packed(float *data)
{
    const quell_image image = {.struct_size = sizeof image, .width = W, .height = H, .num_channels = 3, .data = data};
    return image;
}

static int set_up_with(void **state, const char *model, int32_t precision)
{
    fixture *f = calloc(1, sizeof *f);
    f->options = (quell_options){.struct_size = sizeof f->options, .precision = precision};
    quell_context_options options = {.struct_size = sizeof options, .num_threads = 2};
    assert_int_equal(quell_context_create(&options, &f->ctx), QUELL_OK);
    assert_int_equal(quell_model_open(f->ctx, model, &f->model), QUELL_OK);
    for (size_t i = 0; i < NUM_VALUES; i++) f->color[i] = (float)((i * 7919u) % 1013u) / 500.0f;
    memcpy(f->lent, f->color, sizeof f->color);
    const quell_image image = packed(f->lent);
    assert_int_equal(quell_frame_create(f->ctx, W, H, &f->frame), QUELL_OK);
    assert_int_equal(quell_frame_add_layer(f->ctx, f->frame, "Combined", &image, QUELL_LAYER_BORROW, NULL), QUELL_OK);
    assert_int_equal(quell_denoise(f->ctx, f->model, f->frame, &f->options, NULL), QUELL_OK);
    memcpy(f->expected, f->lent, sizeof f->lent);
    *state = f;
    return 0;
}

static int set_up(void **state)
{
    return set_up_with(state, NULL, QUELL_PRECISION_AUTO);
}

static int set_up_float32(void **state)
{
    return set_up_with(state, NULL, QUELL_PRECISION_FLOAT32);
}

static int set_up_dgan(void **state)
{
    return set_up_with(state, "tests/golden/dgan_small.qwt", QUELL_PRECISION_AUTO);
}

static int tear_down(void **state)
{
    fixture *f = *state;
    quell_frame_destroy(f->frame);
    quell_model_destroy(f->model);
    quell_context_destroy(f->ctx);
    free(f);
    return 0;
}

/* memory: whose n-th allocation fails. Returns the number of failures that were tried. */
static int fail_each_allocation(fixture *f, ql_memory *memory)
{
    for (int n = 1; n < 10000; n++) {
        memcpy(f->lent, f->color, sizeof f->color);
        const uint64_t used_before = f->ctx->memory.used_bytes;
        memory->fail_at = n;
        const quell_status status = quell_denoise(f->ctx, f->model, f->frame, &f->options, NULL);
        const int was_reached = memory->fail_at == 0;
        memory->fail_at = 0;
        assert_int_equal(f->ctx->memory.used_bytes, used_before);
        if (!was_reached) {
            assert_int_equal(status, QUELL_OK);
            assert_memory_equal(f->lent, f->expected, sizeof f->lent);
            return n - 1;
        }
        if (status == QUELL_OK) { /* it made do without */
            assert_memory_equal(f->lent, f->expected, sizeof f->lent);
            continue;
        }
        assert_int_equal(status, QUELL_ERR_OUT_OF_MEMORY);
        assert_true(strlen(quell_context_last_error(f->ctx)) > 0);
        assert_memory_equal(f->lent, f->color, sizeof f->lent);
    }
    fail_msg("the call never succeeds");
    return 0;
}

static void working_memory_may_fail(void **state)
{
    fixture *f = *state;
    assert_true(fail_each_allocation(f, &f->ctx->memory) > 3);
}

static void memory_of_the_frame_may_fail(void **state)
{
    fixture *f = *state;
    assert_true(fail_each_allocation(f, ((ql_frame *)f->frame)->memory) > 0);
}

static void layers_may_fail(void **state)
{
    fixture *f = *state;
    quell_frame *frame;
    assert_int_equal(quell_frame_create(f->ctx, W, H, &frame), QUELL_OK);
    ql_memory *memory = ((ql_frame *)frame)->memory;
    const quell_image image = packed(f->color);
    for (int n = 1;; n++) {
        memory->fail_at = n;
        const quell_status status = quell_frame_add_layer(f->ctx, frame, "Combined", &image, QUELL_LAYER_COPY, NULL);
        const int was_reached = memory->fail_at == 0;
        memory->fail_at = 0;
        if (!was_reached) {
            assert_int_equal(status, QUELL_OK);
            assert_true(n > 3);
            break;
        }
        assert_int_equal(status, QUELL_ERR_OUT_OF_MEMORY);
        assert_int_equal(quell_frame_num_layers(frame), 0);
    }
    quell_frame_destroy(frame);
}

/* A frame gets all of its debug layers, or none. */
static void debug_layers_may_fail(void **state)
{
    fixture *f = *state;
    const quell_options options = {.struct_size = sizeof options, .flags = QUELL_DENOISE_DEBUG_LAYERS};
    ql_memory *const memory = ((ql_frame *)f->frame)->memory;
    for (int n = 1;; n++) {
        memcpy(f->lent, f->color, sizeof f->color);
        memory->fail_at = n;
        const quell_status status = quell_denoise(f->ctx, f->model, f->frame, &options, NULL);
        const int was_reached = memory->fail_at == 0;
        memory->fail_at = 0;
        assert_int_equal(f->ctx->memory.used_bytes, 0);
        if (!was_reached) {
            assert_int_equal(status, QUELL_OK);
            assert_memory_equal(f->lent, f->expected, sizeof f->lent);
            assert_int_equal(quell_frame_num_layers(f->frame), 4);
            assert_true(n > 4);
            break;
        }
        assert_int_equal(status, QUELL_ERR_OUT_OF_MEMORY);
        assert_memory_equal(f->lent, f->color, sizeof f->lent);
        assert_int_equal(quell_frame_num_layers(f->frame), 1);
    }
    assert_int_equal(quell_denoise(f->ctx, f->model, f->frame, &options, NULL), QUELL_ERR_INVALID_ARGUMENT);
    assert_non_null(strstr(quell_context_last_error(f->ctx), "'Quell Noise'"));
}

static void comparing_may_fail(void **state)
{
    fixture *f = *state;
    const quell_image image = packed(f->color);
    quell_metrics metrics = {.struct_size = sizeof metrics};
    for (int n = 1;; n++) {
        f->ctx->memory.fail_at = n;
        const quell_status status = quell_compare(f->ctx, &image, &image, NULL, &metrics);
        const int was_reached = f->ctx->memory.fail_at == 0;
        f->ctx->memory.fail_at = 0;
        assert_int_equal(f->ctx->memory.used_bytes, 0);
        if (!was_reached) {
            assert_int_equal(status, QUELL_OK);
            assert_true(n > 8);
            return;
        }
        assert_int_equal(status, QUELL_ERR_OUT_OF_MEMORY);
    }
}

/* A limit is a smaller tile or a clear refusal, never another picture. */
static void limits_hold(void **state)
{
    fixture *f = *state;
    int num_refused = 0, num_done = 0;
    for (uint64_t limit = 1 << 12; limit <= 1 << 28; limit *= 4) {
        quell_context *ctx;
        quell_context_options options = {.struct_size = sizeof options, .num_threads = 1, .max_memory_bytes = limit};
        assert_int_equal(quell_context_create(&options, &ctx), QUELL_OK);
        memcpy(f->lent, f->color, sizeof f->color);
        const quell_status status = quell_denoise(ctx, f->model, f->frame, &f->options, NULL);
        if (status == QUELL_OK) {
            assert_memory_equal(f->lent, f->expected, sizeof f->lent);
            num_done++;
        } else {
            assert_int_equal(status, QUELL_ERR_OUT_OF_MEMORY);
            assert_memory_equal(f->lent, f->color, sizeof f->lent);
            num_refused++;
        }
        assert_true(ctx->memory.peak_bytes <= limit);
        assert_int_equal(ctx->memory.used_bytes, 0);
        quell_context_destroy(ctx);
    }
    assert_true(num_refused > 0 && num_done > 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(working_memory_may_fail),
        cmocka_unit_test(memory_of_the_frame_may_fail),
        cmocka_unit_test(layers_may_fail),
        cmocka_unit_test(comparing_may_fail),
        cmocka_unit_test(limits_hold),
        cmocka_unit_test(debug_layers_may_fail), /* leaves the frame with more layers: the last */
    };
    const struct CMUnitTest denoise_tests[] = {
        cmocka_unit_test(working_memory_may_fail),
        cmocka_unit_test(memory_of_the_frame_may_fail),
        cmocka_unit_test(limits_hold),
    };
    const int failed = cmocka_run_group_tests(tests, set_up, tear_down) +
                       cmocka_run_group_tests(denoise_tests, set_up_float32, tear_down);
    return failed + cmocka_run_group_tests(denoise_tests, set_up_dgan, tear_down);
}
