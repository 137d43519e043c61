/* SPDX-License-Identifier: Apache-2.0 */
/* The public interface as a caller meets it: argument checks, sized structs, ownership, strides, cancel, reuse. */
#include "quell.h"

#include "base/half.h"

#include "cmocka_all.h"

#include <fenv.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { W = 77, H = 53 };

typedef struct fixture {
    quell_context *ctx;
    quell_model *model;
    float *color;  /* [H][W][4] */
    float *albedo; /* [H][W][3] */
    float *normal;
} fixture;

static float noise(uint32_t *seed)
{
    *seed = *seed * 1664525u + 1013904223u;
    return (float)(*seed >> 8) / 16777216.0f;
}

static int set_up(void **state)
{
    fixture *f = calloc(1, sizeof *f);
    quell_context_options options = {.struct_size = sizeof options, .num_threads = 2};
    assert_int_equal(quell_context_create(&options, &f->ctx), QUELL_OK);
    assert_int_equal(quell_model_open(f->ctx, NULL, &f->model), QUELL_OK);
    f->color = malloc(sizeof(float) * W * H * 4);
    f->albedo = malloc(sizeof(float) * W * H * 3);
    f->normal = malloc(sizeof(float) * W * H * 3);
    uint32_t seed = 7;
    for (size_t i = 0; i < W * H; i++) {
        const float level = i % W < W / 2 ? 0.2f : 0.8f;
        for (size_t c = 0; c < 3; c++) {
            f->color[4 * i + c] = level * 2.0f * noise(&seed);
            f->albedo[3 * i + c] = level;
            f->normal[3 * i + c] = c == 2 ? 1.0f : 0.0f;
        }
        f->color[4 * i + 3] = 1.0f;
    }
    *state = f;
    return 0;
}

static int tear_down(void **state)
{
    fixture *f = *state;
    quell_model_destroy(f->model);
    quell_context_destroy(f->ctx);
    free(f->color);
    free(f->albedo);
    free(f->normal);
    free(f);
    return 0;
}

static quell_image packed(float *data, uint32_t num_channels)
{
    const quell_image image = {
        .struct_size = sizeof image, .width = W, .height = H, .num_channels = num_channels, .data = data};
    return image;
}

static quell_frame *make_frame(const fixture *f, float *color, int32_t ownership)
{
    quell_frame *frame;
    const quell_image c = packed(color, 4), a = packed(f->albedo, 3), n = packed(f->normal, 3);
    assert_int_equal(quell_frame_create(f->ctx, W, H, &frame), QUELL_OK);
    assert_int_equal(quell_frame_add_layer(f->ctx, frame, "Combined", &c, ownership, NULL), QUELL_OK);
    assert_int_equal(quell_frame_add_layer(f->ctx, frame, "Denoising Albedo", &a, QUELL_LAYER_COPY, NULL), QUELL_OK);
    assert_int_equal(quell_frame_add_layer(f->ctx, frame, "Denoising Normal", &n, QUELL_LAYER_BORROW, NULL), QUELL_OK);
    assert_int_equal(quell_frame_set_samples(frame, 4), QUELL_OK);
    return frame;
}

static float *denoised_color(const fixture *f, quell_context *ctx, float *color, uint32_t tile_size, int32_t precision)
{
    float *out = malloc(sizeof(float) * W * H * 4);
    quell_frame *frame = make_frame(f, color, QUELL_LAYER_COPY);
    quell_options options = {.struct_size = sizeof options, .tile_size = tile_size, .precision = precision};
    const quell_image image = packed(out, 4);
    assert_int_equal(quell_denoise(ctx, f->model, frame, &options, NULL), QUELL_OK);
    assert_int_equal(quell_frame_copy_layer(ctx, frame, 0, &image), QUELL_OK);
    quell_frame_destroy(frame);
    return out;
}

static float *denoised(const fixture *f, quell_context *ctx, uint32_t tile_size)
{
    return denoised_color(f, ctx, f->color, tile_size, QUELL_PRECISION_AUTO);
}

static quell_context *context_of(int32_t cpu, uint32_t threads)
{
    quell_context *ctx;
    const quell_context_options options = {.struct_size = sizeof options, .num_threads = threads, .cpu = cpu};
    const quell_status status = quell_context_create(&options, &ctx);
    assert_true(status == QUELL_OK || status == QUELL_ERR_UNSUPPORTED);
    return status == QUELL_OK ? ctx : NULL;
}

/* Kernels with bfloat16: this machine's, or the specification. */
static int32_t bf16_cpu(void)
{
    quell_context *const ctx = context_of(QUELL_CPU_AVX512BF16, 1);
    quell_context_destroy(ctx);
    return ctx ? QUELL_CPU_AVX512BF16 : QUELL_CPU_C;
}

/* ---- Contexts and structs ---------------------------------------------------------------------------------------- */

static void nothing_is_an_argument_too(void **state)
{
    const fixture *f = *state;
    quell_frame *frame = (quell_frame *)(uintptr_t)1;
    quell_model *model = (quell_model *)(uintptr_t)1;
    quell_metrics metrics = {.struct_size = sizeof metrics};
    assert_int_equal(quell_context_create(NULL, NULL), QUELL_ERR_INVALID_ARGUMENT);
    assert_int_equal(quell_frame_create(NULL, 1, 1, &frame), QUELL_ERR_INVALID_ARGUMENT);
    assert_null(frame);
    assert_int_equal(quell_frame_create(f->ctx, 0, 1, &frame), QUELL_ERR_INVALID_ARGUMENT);
    assert_int_equal(quell_frame_create(f->ctx, 1, 1, NULL), QUELL_ERR_INVALID_ARGUMENT);
    assert_int_equal(quell_frame_read_exr(f->ctx, NULL, &frame), QUELL_ERR_INVALID_ARGUMENT);
    assert_int_equal(quell_model_open_memory(f->ctx, NULL, 0, &model), QUELL_ERR_INVALID_ARGUMENT);
    assert_null(model);
    assert_int_equal(quell_denoise(f->ctx, f->model, NULL, NULL, NULL), QUELL_ERR_INVALID_ARGUMENT);
    assert_int_equal(quell_plan(f->ctx, f->model, NULL, NULL, NULL), QUELL_ERR_INVALID_ARGUMENT);
    assert_int_equal(quell_compare(f->ctx, NULL, NULL, NULL, &metrics), QUELL_ERR_INVALID_ARGUMENT);
    assert_int_equal(quell_frame_num_layers(NULL), 0);
    assert_int_equal(quell_frame_find_layer(NULL, "x"), -1);
    assert_string_equal(quell_context_last_error(NULL), "");
    quell_context_destroy(NULL);
    quell_frame_destroy(NULL);
    quell_model_destroy(NULL);
    quell_report_destroy(NULL);
    quell_cancel(NULL);
}

static void structs_grow_by_their_size(void **state)
{
    const fixture *f = *state;
    quell_context *ctx;
    struct {
        quell_context_options known;
        uint64_t unknown;
    } options;
    memset(&options, 0, sizeof options);

    options.known.struct_size = sizeof(quell_context_options) - 1; /* shorter than its first version */
    assert_int_equal(quell_context_create(&options.known, &ctx), QUELL_ERR_INVALID_ARGUMENT);
    assert_null(ctx);
    options.known.struct_size = sizeof options; /* from a newer header, with its new fields at their default */
    options.known.num_threads = 1;
    assert_int_equal(quell_context_create(&options.known, &ctx), QUELL_OK);
    quell_context_destroy(ctx);
    options.unknown = 1; /* a new field that asks for something */
    assert_int_equal(quell_context_create(&options.known, &ctx), QUELL_ERR_UNSUPPORTED);

    struct {
        quell_model_info known;
        uint64_t unknown;
    } info;
    memset(&info, 0xee, sizeof info);
    info.known.struct_size = sizeof info;
    assert_int_equal(quell_model_get_info(f->model, &info.known), QUELL_OK);
    assert_int_equal(info.known.struct_size, sizeof info);
    assert_int_equal(info.unknown, 0);
    assert_int_equal(strlen(info.known.sha256), 64);
    info.known.struct_size = 8;
    assert_int_equal(quell_model_get_info(f->model, &info.known), QUELL_ERR_INVALID_ARGUMENT);
}

static void kernels_are_those_asked_for(void **state)
{
    (void)state;
    quell_context *ctx;
    quell_context_options options = {.struct_size = sizeof options, .num_threads = 1, .cpu = QUELL_CPU_C};
    assert_int_equal(quell_context_create(&options, &ctx), QUELL_OK);
    assert_string_equal(quell_context_cpu_name(ctx), "c");
    assert_int_equal(quell_context_num_threads(ctx), 1);
    quell_context_destroy(ctx);
    options.cpu = 99;
    assert_int_equal(quell_context_create(&options, &ctx), QUELL_ERR_INVALID_ARGUMENT);
#if defined(__x86_64__)
    options.cpu = QUELL_CPU_NEON;
    assert_int_equal(quell_context_create(&options, &ctx), QUELL_ERR_UNSUPPORTED);
#endif
}

static void names_cover_all_values(void **state)
{
    (void)state;
    assert_string_equal(quell_status_name(QUELL_OK), "QUELL_OK");
    for (int32_t s = QUELL_ERR_INTERNAL; s <= QUELL_OK; s++)
        assert_string_not_equal(quell_status_name(s), "QUELL_ERR_UNKNOWN");
    assert_string_equal(quell_status_name(QUELL_ERR_INTERNAL - 1), "QUELL_ERR_UNKNOWN");
    assert_string_equal(quell_status_name(1), "QUELL_ERR_UNKNOWN");
    assert_int_equal(quell_version_number(),
                     QUELL_VERSION_MAJOR * 10000 + QUELL_VERSION_MINOR * 100 + QUELL_VERSION_PATCH);
    assert_string_equal(quell_role_name(QUELL_ROLE_DIFFUSE_DIRECT), "diffuse-direct");
    assert_string_equal(quell_role_name(12345), "other");
    assert_non_null(quell_model_builtin_name(0));
    assert_null(quell_model_builtin_name(1000));
}

/* ---- Layers ------------------------------------------------------------------------------------------------------ */

static void wrong_layers_are_refused(void **state)
{
    const fixture *f = *state;
    quell_frame *frame;
    quell_image image = packed(f->color, 4);
    assert_int_equal(quell_frame_create(f->ctx, W, H, &frame), QUELL_OK);
#define REFUSED(code) assert_int_equal(quell_frame_add_layer(f->ctx, frame, "Combined", &image, 0, NULL), (code))
    image.width = W + 1;
    REFUSED(QUELL_ERR_SIZE_MISMATCH);
    assert_non_null(strstr(quell_context_last_error(f->ctx), "Combined"));
    image = packed(f->color, 5);
    REFUSED(QUELL_ERR_INVALID_ARGUMENT);
    image = packed(NULL, 4);
    REFUSED(QUELL_ERR_INVALID_ARGUMENT);
    image = packed(f->color, 4);
    image.format = QUELL_FORMAT_UINT;
    REFUSED(QUELL_ERR_INVALID_ARGUMENT);
    image = packed(f->color, 1); /* a Combined of one channel is none */
    REFUSED(QUELL_ERR_INVALID_ARGUMENT);
#undef REFUSED
    image = packed(f->color, 4);
    assert_int_equal(quell_frame_num_layers(frame), 0);
    assert_int_equal(quell_frame_add_layer(f->ctx, frame, "Combined", &image, 7, NULL), QUELL_ERR_INVALID_ARGUMENT);
    uint32_t index = 99;
    assert_int_equal(quell_frame_add_layer(f->ctx, frame, "Combined", &image, 0, &index), QUELL_OK);
    assert_int_equal(index, 0);
    assert_string_equal(quell_context_last_error(f->ctx), "");
    assert_int_equal(quell_frame_add_layer(f->ctx, frame, "Combined", &image, 0, &index), QUELL_ERR_INVALID_ARGUMENT);
    quell_frame_destroy(frame);
}

static void layers_say_what_they_are(void **state)
{
    const fixture *f = *state;
    quell_frame *frame = make_frame(f, f->color, QUELL_LAYER_COPY);
    quell_layer_info info = {.struct_size = sizeof info};
    assert_int_equal(quell_frame_get_layer(frame, 1, &info), QUELL_OK);
    assert_int_equal(info.role, QUELL_ROLE_DENOISING_ALBEDO);
    assert_string_equal(info.pass, "Denoising Albedo");
    assert_string_equal(info.channels, "RGB");
    assert_int_equal(info.samples, 4);
    assert_int_equal(info.width, W);
    assert_int_equal(info.is_denoised, 0);
    assert_int_equal(quell_frame_get_layer(frame, 3, &info), QUELL_ERR_INVALID_ARGUMENT);
    assert_int_equal(quell_frame_find_layer(frame, "Denoising Normal"), 2);
    assert_int_equal(quell_frame_find_layer(frame, "DiffDir"), -1);
    quell_frame_destroy(frame);
}

static void strides_and_halves_are_followed(void **state)
{
    const fixture *f = *state;
    /* Rows bottom-up, planes instead of pixels, halves: the same picture as f->color in another order. */
    uint16_t *halves = malloc(sizeof(uint16_t) * W * H * 4);
    for (size_t y = 0; y < H; y++) {
        for (size_t x = 0; x < W; x++) {
            for (size_t c = 0; c < 4; c++) {
                halves[(c * H + (H - 1 - y)) * W + x] = ql_half_from_float(f->color[(y * W + x) * 4 + c]);
            }
        }
    }
    const quell_image image = {.struct_size = sizeof image,
                               .format = QUELL_FORMAT_HALF,
                               .width = W,
                               .height = H,
                               .num_channels = 4,
                               .data = halves + (size_t)(H - 1) * W,
                               .channel_stride_bytes = 2 * W * H,
                               .pixel_stride_bytes = 2,
                               .row_stride_bytes = -2 * W};
    quell_frame *frame;
    float *out = malloc(sizeof(float) * W * H * 3);
    const quell_image back = packed(out, 3); /* fewer channels: the first ones */
    assert_int_equal(quell_frame_create(f->ctx, W, H, &frame), QUELL_OK);
    assert_int_equal(quell_frame_add_layer(f->ctx, frame, "Combined", &image, QUELL_LAYER_COPY, NULL), QUELL_OK);
    assert_int_equal(quell_frame_copy_layer(f->ctx, frame, 0, &back), QUELL_OK);
    for (size_t i = 0; i < W * H; i++) {
        for (size_t c = 0; c < 3; c++) {
            assert_true(out[3 * i + c] == ql_half_to_float(ql_half_from_float(f->color[4 * i + c])));
        }
    }
    quell_frame_destroy(frame);
    free(halves);
    free(out);
}

/* ---- Denoise ----------------------------------------------------------------------------------------------------- */

static void borrowed_memory_receives_the_result(void **state)
{
    const fixture *f = *state;
    const size_t bytes = sizeof(float) * W * H * 4;
    float *copied = denoised(f, f->ctx, 0);
    float *lent = malloc(bytes);
    memcpy(lent, f->color, bytes);
    quell_frame *frame = make_frame(f, lent, QUELL_LAYER_BORROW);
    quell_report *report;
    assert_memory_equal(lent, f->color, bytes);
    assert_int_equal(quell_denoise(f->ctx, f->model, frame, NULL, &report), QUELL_OK);
    assert_memory_equal(lent, copied, bytes);
    assert_memory_not_equal(lent, f->color, bytes);

    quell_layer_info info = {.struct_size = sizeof info};
    assert_int_equal(quell_frame_get_layer(frame, 0, &info), QUELL_OK);
    assert_int_equal(info.is_denoised, 1);
    assert_int_equal(quell_frame_get_layer(frame, 1, &info), QUELL_OK);
    assert_int_equal(info.is_denoised, 0);

    quell_report_layer layer = {.struct_size = sizeof layer};
    quell_report_summary summary = {.struct_size = sizeof summary};
    assert_int_equal(quell_report_get_summary(report, &summary), QUELL_OK);
    assert_int_equal(summary.num_layers, 3);
    assert_true(summary.peak_bytes > 0 && summary.seconds_total > 0.0);
    assert_int_equal(quell_report_get_layer(report, 0, &layer), QUELL_OK);
    assert_int_equal(layer.action, QUELL_ACTION_DENOISED);
    assert_int_equal(quell_report_get_layer(report, 3, &layer), QUELL_ERR_INVALID_ARGUMENT);
    quell_report_destroy(report);

    /* The next picture in the same memory. */
    memcpy(lent, f->color, bytes);
    assert_int_equal(quell_denoise(f->ctx, f->model, frame, NULL, NULL), QUELL_OK);
    assert_memory_equal(lent, copied, bytes);
    quell_frame_destroy(frame);
    free(copied);
    free(lent);
}

static void planning_changes_nothing(void **state)
{
    const fixture *f = *state;
    const size_t bytes = sizeof(float) * W * H * 4;
    float *lent = malloc(bytes);
    memcpy(lent, f->color, bytes);
    quell_frame *frame = make_frame(f, lent, QUELL_LAYER_BORROW);
    quell_report *report;
    quell_report_summary summary = {.struct_size = sizeof summary};
    assert_int_equal(quell_plan(f->ctx, f->model, frame, NULL, &report), QUELL_OK);
    assert_int_equal(quell_report_get_summary(report, &summary), QUELL_OK);
    assert_true(summary.seconds_total == 0.0);
    assert_memory_equal(lent, f->color, bytes);
    quell_report_destroy(report);
    quell_frame_destroy(frame);
    free(lent);
}

static void threads_and_tiles_do_not_change_a_bit(void **state)
{
    const fixture *f = *state;
    const size_t bytes = sizeof(float) * W * H * 4;
    for (int32_t precision = QUELL_PRECISION_AUTO; precision <= QUELL_PRECISION_BFLOAT16; precision++) {
        float *expected = NULL;
        for (uint32_t threads = 1; threads <= 3; threads++) {
            quell_context *const ctx =
                context_of(precision == QUELL_PRECISION_BFLOAT16 ? bf16_cpu() : QUELL_CPU_AUTO, threads);
            if (!expected) expected = denoised_color(f, ctx, f->color, 0, precision);
            for (uint32_t tile = 32; tile <= 64; tile += 32) {
                float *out = denoised_color(f, ctx, f->color, tile, precision);
                assert_memory_equal(out, expected, bytes);
                free(out);
            }
            quell_context_destroy(ctx);
        }
        free(expected);
    }
}

static void radiance_scales_exactly_in_each_precision(void **state)
{
    const fixture *f = *state;
    quell_context *const ctx = context_of(bf16_cpu(), 2);
    float *scaled = malloc(sizeof(float) * W * H * 4);
    for (int32_t precision = QUELL_PRECISION_FLOAT32; precision <= QUELL_PRECISION_BFLOAT16; precision++) {
        float *once = denoised_color(f, ctx, f->color, 0, precision);
        for (int exponent = -20; exponent <= 40; exponent += 12) {
            for (size_t i = 0; i < W * H * 4; i++) scaled[i] = i % 4 == 3 ? 1.0f : ldexpf(f->color[i], exponent);
            float *out = denoised_color(f, ctx, scaled, 0, precision);
            for (size_t i = 0; i < W * H * 4; i++)
                assert_true(out[i] == (i % 4 == 3 ? once[i] : ldexpf(once[i], exponent)));
            free(out);
        }
        free(once);
    }
    free(scaled);
    quell_context_destroy(ctx);
}

/* What ran, by the report. */
static quell_status precision_used(const fixture *f, quell_context *ctx, const quell_model *model, int32_t precision,
                                   int32_t *used)
{
    quell_report *report;
    quell_report_summary summary = {.struct_size = sizeof summary};
    quell_options options = {.struct_size = sizeof options, .precision = precision};
    quell_frame *frame = make_frame(f, f->color, QUELL_LAYER_COPY);
    const quell_status status = quell_plan(ctx, model, frame, &options, &report);
    if (status == QUELL_OK) {
        assert_int_equal(quell_report_get_summary(report, &summary), QUELL_OK);
        quell_report_destroy(report);
        *used = summary.precision;
    }
    quell_frame_destroy(frame);
    return status;
}

static void precision_is_what_was_asked_for(void **state)
{
    const fixture *f = *state;
    quell_model *dgan;
    int32_t used = -1;
    assert_int_equal(quell_model_open(f->ctx, "tests/golden/dgan_small.qwt", &dgan), QUELL_OK);
    for (int32_t cpu = QUELL_CPU_C; cpu <= QUELL_CPU_AVX512BF16; cpu++) {
        const int32_t fastest = cpu == QUELL_CPU_AVX512BF16 ? QUELL_PRECISION_BFLOAT16 : QUELL_PRECISION_FLOAT32;
        quell_context *const ctx = context_of(cpu, 1);
        if (!ctx) continue;
        assert_int_equal(precision_used(f, ctx, f->model, QUELL_PRECISION_AUTO, &used), QUELL_OK);
        assert_int_equal(used, fastest);
        assert_int_equal(precision_used(f, ctx, f->model, QUELL_PRECISION_FLOAT32, &used), QUELL_OK);
        assert_int_equal(used, QUELL_PRECISION_FLOAT32);
        assert_int_equal(precision_used(f, ctx, dgan, QUELL_PRECISION_AUTO, &used), QUELL_OK);
        assert_int_equal(used, QUELL_PRECISION_FLOAT32);
        const quell_status status = precision_used(f, ctx, f->model, QUELL_PRECISION_BFLOAT16, &used);
        if (cpu == QUELL_CPU_C || cpu == QUELL_CPU_AVX512BF16) {
            assert_int_equal(status, QUELL_OK);
            assert_int_equal(used, QUELL_PRECISION_BFLOAT16);
        } else {
            assert_int_equal(status, QUELL_ERR_UNSUPPORTED);
            assert_non_null(strstr(quell_context_last_error(ctx), quell_context_cpu_name(ctx)));
        }
        assert_int_equal(precision_used(f, ctx, dgan, QUELL_PRECISION_BFLOAT16, &used), QUELL_ERR_INVALID_ARGUMENT);
        assert_int_equal(precision_used(f, ctx, f->model, 3, &used), QUELL_ERR_INVALID_ARGUMENT);
        assert_int_equal(precision_used(f, ctx, f->model, -1, &used), QUELL_ERR_INVALID_ARGUMENT);
        quell_context_destroy(ctx);
    }
    quell_model_destroy(dgan);
}

/* Float is float: the kernels with bfloat16 give the bits of those without, and bfloat16 gives others, near them. */
static void bfloat16_changes_little_and_only_where_asked_for(void **state)
{
    const fixture *f = *state;
    quell_context *const with = context_of(QUELL_CPU_AVX512BF16, 2), *const without = context_of(QUELL_CPU_AVX512, 2);
    if (!with) {
        print_message("SKIP: this machine lacks AVX512_BF16\n");
        quell_context_destroy(without);
        return;
    }
    float *expected = denoised(f, without, 0);
    float *same = denoised_color(f, with, f->color, 0, QUELL_PRECISION_FLOAT32);
    float *other = denoised(f, with, 0);
    assert_memory_equal(same, expected, sizeof(float) * W * H * 4);
    assert_memory_not_equal(other, expected, sizeof(float) * W * H * 4);
    for (size_t i = 0; i < W * H * 4; i++)
        assert_true(fabsf(other[i] - expected[i]) <= 0.03f * fabsf(expected[i]) + 1e-3f);
    free(expected);
    free(same);
    free(other);
    quell_context_destroy(with);
    quell_context_destroy(without);
}

static void caller_keeps_its_floating_point_mode(void **state)
{
    const fixture *f = *state;
    float *expected = denoised(f, f->ctx, 0);
    assert_int_equal(fesetround(FE_UPWARD), 0);
    float *out = denoised(f, f->ctx, 0);
    const int mode = fegetround();
    fesetround(FE_TONEAREST);
    assert_int_equal(mode, FE_UPWARD);
    assert_memory_equal(out, expected, sizeof(float) * W * H * 4);
    free(out);
    free(expected);
}

static int32_t stop_at_once(void *user, double fraction)
{
    int *calls = user;
    (void)fraction;
    (*calls)++;
    return 1;
}

static int32_t stop_by_cancel(void *user, double fraction)
{
    (void)fraction;
    quell_cancel(user);
    return 0;
}

static void cancelled_jobs_leave_no_trace(void **state)
{
    const fixture *f = *state;
    const size_t bytes = sizeof(float) * W * H * 4;
    float *lent = malloc(bytes);
    memcpy(lent, f->color, bytes);
    quell_frame *frame = make_frame(f, lent, QUELL_LAYER_BORROW);
    int calls = 0;
    quell_report *report;
    quell_options options = {.struct_size = sizeof options, .progress = stop_at_once, .progress_user = &calls};
    assert_int_equal(quell_denoise(f->ctx, f->model, frame, &options, &report), QUELL_ERR_CANCELLED);
    assert_int_equal(calls, 1);
    assert_null(report);
    assert_string_equal(quell_context_last_error(f->ctx), "cancelled");
    options.progress = stop_by_cancel;
    options.progress_user = f->ctx;
    assert_int_equal(quell_denoise(f->ctx, f->model, frame, &options, NULL), QUELL_ERR_CANCELLED);
    assert_memory_equal(lent, f->color, bytes);
    quell_cancel(f->ctx); /* nothing runs: it must not hit the next call */
    assert_int_equal(quell_denoise(f->ctx, f->model, frame, NULL, NULL), QUELL_OK);
    quell_frame_destroy(frame);
    free(lent);
}

static void options_are_checked(void **state)
{
    const fixture *f = *state;
    quell_frame *frame = make_frame(f, f->color, QUELL_LAYER_COPY);
    quell_options options = {.struct_size = sizeof options, .flags = 0x80000000u};
    assert_int_equal(quell_denoise(f->ctx, f->model, frame, &options, NULL), QUELL_ERR_UNSUPPORTED);
    options.flags = 0;
    options.reserved0 = 1;
    assert_int_equal(quell_denoise(f->ctx, f->model, frame, &options, NULL), QUELL_ERR_INVALID_ARGUMENT);
    options.reserved0 = 0;
    options.reserved1 = 1;
    assert_int_equal(quell_denoise(f->ctx, f->model, frame, &options, NULL), QUELL_ERR_INVALID_ARGUMENT);
    options.reserved1 = 0;
    options.layers = "No Such Layer";
    assert_int_equal(quell_denoise(f->ctx, f->model, frame, &options, NULL), QUELL_ERR_NO_LAYER);
    assert_non_null(strstr(quell_context_last_error(f->ctx), "No Such Layer"));
    quell_frame_destroy(frame);
}

static void bad_weights_are_refused(void **state)
{
    const fixture *f = *state;
    quell_model *model;
    char data[4096];
    memset(data, 'x', sizeof data);
    assert_int_equal(quell_model_open_memory(f->ctx, data, sizeof data, &model), QUELL_ERR_BAD_MODEL);
    assert_null(model);
    assert_int_equal(quell_model_open_memory(f->ctx, data, 0, &model), QUELL_ERR_BAD_MODEL);
    assert_int_equal(quell_model_open(f->ctx, "/nowhere/at/all.qwt", &model), QUELL_ERR_FILE_NOT_FOUND);
    assert_non_null(strstr(quell_context_last_error(f->ctx), "/nowhere/at/all.qwt"));
}

static void comparing_checks_sizes(void **state)
{
    const fixture *f = *state;
    const quell_image a = packed(f->color, 4);
    quell_image b = packed(f->color, 4);
    quell_metrics metrics = {.struct_size = sizeof metrics};
    assert_int_equal(quell_compare(f->ctx, &a, &b, NULL, &metrics), QUELL_OK);
    assert_true(metrics.mse == 0.0 && isinf(metrics.psnr));
    b.height = H - 1;
    assert_int_equal(quell_compare(f->ctx, &a, &b, NULL, &metrics), QUELL_ERR_SIZE_MISMATCH);
    assert_int_equal(quell_compare(f->ctx, &a, &a, &b, &metrics), QUELL_ERR_SIZE_MISMATCH);
    metrics.struct_size = 4;
    assert_int_equal(quell_compare(f->ctx, &a, &a, NULL, &metrics), QUELL_ERR_INVALID_ARGUMENT);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(nothing_is_an_argument_too),
        cmocka_unit_test(structs_grow_by_their_size),
        cmocka_unit_test(kernels_are_those_asked_for),
        cmocka_unit_test(names_cover_all_values),
        cmocka_unit_test(wrong_layers_are_refused),
        cmocka_unit_test(layers_say_what_they_are),
        cmocka_unit_test(strides_and_halves_are_followed),
        cmocka_unit_test(borrowed_memory_receives_the_result),
        cmocka_unit_test(planning_changes_nothing),
        cmocka_unit_test(threads_and_tiles_do_not_change_a_bit),
        cmocka_unit_test(radiance_scales_exactly_in_each_precision),
        cmocka_unit_test(precision_is_what_was_asked_for),
        cmocka_unit_test(bfloat16_changes_little_and_only_where_asked_for),
        cmocka_unit_test(caller_keeps_its_floating_point_mode),
        cmocka_unit_test(cancelled_jobs_leave_no_trace),
        cmocka_unit_test(options_are_checked),
        cmocka_unit_test(bad_weights_are_refused),
        cmocka_unit_test(comparing_checks_sizes),
    };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
