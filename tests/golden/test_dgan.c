/* SPDX-License-Identifier: Apache-2.0 */
/*
 * DGAN-KPN against PyTorch, on vectors that training/dgan/golden.py wrote: frames of three sizes through the public
 * interface, for each switch and each instruction set; and what holds without PyTorch: same bits whatever the bands and
 * threads, exact scaling, bad pixels, wrong settings.
 */
#include "cmocka_all.h"

#include "base/cpu.h"
#include "nn/weights.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char path[] = "tests/golden/dgan_small.qwt";

enum { NUM_FRAMES = 3, NUM_PASSES = 7 };

#define MIN_PSNR 90.0 /* dB of the brightest value */

static const struct {
    const char *name, *record;
} passes[NUM_PASSES] = {
    {"Combined", "combined"},       {"Denoising Normal", "normal"}, {"Position", "position"},
    {"Denoising Albedo", "albedo"}, {"GlossCol", "glossy"},         {"TransCol", "transmission"},
    {"Denoising Depth", "depth"},
};

typedef struct fixture {
    uint8_t *data;
    ql_memory memory;
    ql_weights weights;
} fixture;

/* How a frame is run. */
typedef struct setting {
    int32_t cpu;
    uint32_t threads, tile, num_passes;
    quell_dgan_options dgan;
} setting;

static const setting usual = {
    .threads = 2, .num_passes = NUM_PASSES, .dgan = {.struct_size = sizeof(quell_dgan_options)}};

static int setup(void **state)
{
    fixture *const f = calloc(1, sizeof *f);
    FILE *const file = fopen(path, "rb");
    ql_error err;
    assert_non_null(file);
    assert_int_equal(fseek(file, 0, SEEK_END), 0);
    const size_t size_bytes = (size_t)ftell(file);
    rewind(file);
    f->data = malloc(size_bytes);
    assert_int_equal(fread(f->data, 1, size_bytes, file), size_bytes);
    fclose(file);
    ql_memory_init(&f->memory, 0);
    assert_int_equal(ql_weights_open(&f->weights, f->data, size_bytes, path, &f->memory, &err), QUELL_OK);
    *state = f;
    return 0;
}

static int teardown(void **state)
{
    fixture *const f = *state;
    ql_weights_close(&f->weights, &f->memory);
    free(f->data);
    free(f);
    return 0;
}

/* A planar record [channels][height][width]; freed by free(). */
static float *get(const fixture *f, const char *name, uint32_t dims[4])
{
    ql_error err;
    const ql_record *const record = ql_weights_find(&f->weights, name);
    if (record == NULL) fail_msg("%s lacks %s", path, name);
    float *const out = malloc(record->num_values * sizeof *out);
    assert_int_equal(ql_weights_get_floats(&f->weights, name, out, record->num_values, &err), QUELL_OK);
    memcpy(dims, record->dims, 4 * sizeof *dims);
    return out;
}

static float *pass_of(const fixture *f, int frame, uint32_t pass, uint32_t dims[4])
{
    char name[64];
    snprintf(name, sizeof name, "frame.%d.%s", frame, passes[pass].record);
    return get(f, name, dims);
}

static quell_image planar_image(float *data, uint32_t width, uint32_t height, uint32_t channels)
{
    return (quell_image){.struct_size = sizeof(quell_image),
                         .width = width,
                         .height = height,
                         .num_channels = channels,
                         .data = data,
                         .channel_stride_bytes = (int64_t)width * height * 4,
                         .pixel_stride_bytes = 4,
                         .row_stride_bytes = (int64_t)width * 4};
}

/* Denoises a frame of the file whose Combined is replaced by combined if that is not NULL; returns Combined, planar. */
static float *run(const fixture *f, int frame_index, const setting *s, const float *combined, size_t *num,
                  quell_report **report)
{
    const quell_context_options context = {
        .struct_size = sizeof context, .num_threads = s->threads, .cpu = s->cpu, .max_memory_bytes = 1u << 28};
    const quell_options options = {.struct_size = sizeof options, .tile_size = s->tile, .dgan = &s->dgan};
    quell_context *ctx;
    quell_model *model;
    quell_frame *frame = NULL;
    uint32_t dims[4] = {0};
    assert_int_equal(quell_context_create(&context, &ctx), QUELL_OK);
    assert_int_equal(quell_model_open(ctx, path, &model), QUELL_OK);
    for (uint32_t i = 0; i < s->num_passes; ++i) {
        float *const data = pass_of(f, frame_index, i, dims);
        const quell_image image = planar_image(data, dims[2], dims[1], dims[0]);
        if (i == 0) {
            *num = (size_t)3 * dims[1] * dims[2];
            if (combined) memcpy(data, combined, *num * sizeof *data);
            assert_int_equal(quell_frame_create(ctx, dims[2], dims[1], &frame), QUELL_OK);
        }
        assert_int_equal(quell_frame_add_layer(ctx, frame, passes[i].name, &image, QUELL_LAYER_COPY, NULL), QUELL_OK);
        free(data);
    }
    const quell_status status = quell_denoise(ctx, model, frame, &options, report);
    if (status != QUELL_OK) fail_msg("%s", quell_context_last_error(ctx));
    float *const out = malloc(*num * sizeof *out);
    const quell_image image = planar_image(out, dims[2], dims[1], 3);
    assert_int_equal(quell_frame_copy_layer(ctx, frame, 0, &image), QUELL_OK);
    quell_frame_destroy(frame);
    quell_model_destroy(model);
    quell_context_destroy(ctx);
    return out;
}

static void expect_psnr(const char *what, const float *got, const float *want, size_t num)
{
    double top = 0.0, squares = 0.0;
    for (size_t i = 0; i < num; ++i) {
        top = fmax(top, fabs((double)want[i]));
        squares += ((double)got[i] - (double)want[i]) * ((double)got[i] - (double)want[i]);
    }
    const double psnr = 10.0 * log10(top * top / (squares / (double)num));
    if (!(psnr >= MIN_PSNR)) fail_msg("%s: %.1f dB", what, psnr); /* equal: infinite */
}

static void check_case(const fixture *f, const char *name, const setting *given)
{
    static const struct {
        int32_t cpu;
        uint32_t bits;
    } sets[] = {{QUELL_CPU_C, 0}, {QUELL_CPU_AVX2, QL_CPU_AVX2}, {QUELL_CPU_AVX512, QL_CPU_AVX512}};
    for (size_t i = 0; i < sizeof sets / sizeof *sets; ++i) {
        if ((ql_cpu_probe() & sets[i].bits) != sets[i].bits) continue;
        for (int frame = 0; frame < NUM_FRAMES; ++frame) {
            char record[64], what[128];
            uint32_t dims[4];
            size_t num = 0;
            setting s = *given;
            s.cpu = sets[i].cpu;
            snprintf(record, sizeof record, "want.%d.%s", frame, name);
            snprintf(what, sizeof what, "%s, instruction set %d", record, s.cpu);
            float *const want = get(f, record, dims), *const got = run(f, frame, &s, NULL, &num, NULL);
            expect_psnr(what, got, want, num);
            free(want);
            free(got);
        }
    }
}

static void agrees_with_pytorch(void **state)
{
    setting s = usual;
    check_case(*state, "both", &s);
    s.dgan.iterations = 8;
    check_case(*state, "both_8", &s);
    s = usual;
    s.dgan.iterate = QUELL_ITERATE_NETWORK;
    s.dgan.iterations = 2;
    s.dgan.flags = QUELL_DGAN_RUN_ALL;
    check_case(*state, "network", &s);
    s = usual;
    s.dgan.parts = QUELL_DGAN_GENERATOR;
    check_case(*state, "dgan", &s);
    s.dgan.parts = QUELL_DGAN_KERNELS;
    s.dgan.iterations = 3;
    check_case(*state, "kpn", &s);
}

static void runs_on_combined_alone(void **state)
{
    setting s = usual;
    s.num_passes = 1;
    check_case(*state, "bare", &s);
}

static void bands_and_threads_do_not_show(void **state)
{
    static const setting others[] = {{.threads = 1, .tile = 32}, {.threads = 1, .tile = 0}, {.threads = 5, .tile = 32}};
    for (int32_t iterate = QUELL_ITERATE_FILTER; iterate <= QUELL_ITERATE_NETWORK; ++iterate) {
        size_t num;
        setting s = usual;
        s.dgan.iterate = iterate;
        float *const want = run(*state, 1, &s, NULL, &num, NULL);
        for (size_t i = 0; i < sizeof others / sizeof *others; ++i) {
            s.threads = others[i].threads;
            s.tile = others[i].tile;
            float *const got = run(*state, 1, &s, NULL, &num, NULL);
            assert_memory_equal(got, want, num * sizeof *got);
            free(got);
        }
        free(want);
    }
}

static void scaling_is_exact(void **state)
{
    size_t num;
    uint32_t dims[4];
    float *const combined = pass_of(*state, 1, 0, dims);
    float *const once = run(*state, 1, &usual, combined, &num, NULL);
    for (size_t i = 0; i < num; ++i) combined[i] *= 1024.0f;
    float *const scaled = run(*state, 1, &usual, combined, &num, NULL);
    for (size_t i = 0; i < num; ++i) assert_true(scaled[i] == 1024.0f * once[i]);
    free(combined);
    free(once);
    free(scaled);
}

/* Kernels alone: a bad pixel changes nothing beyond the reach of the iterations, and nothing comes out that is not
 * finite. The generator sees the whole image in its statistics, so there only finiteness is promised. */
static void bad_pixels_stay_local(void **state)
{
    enum { WIDTH = 17, HEIGHT = 33, ITERATIONS = 1, REACH = 9 * ITERATIONS + 9 };
    size_t num;
    uint32_t dims[4];
    float *const combined = pass_of(*state, 1, 0, dims);
    assert_int_equal(dims[2], WIDTH);
    setting s = usual;
    s.dgan.parts = QUELL_DGAN_KERNELS;
    s.dgan.iterations = ITERATIONS;
    float *const clean = run(*state, 1, &s, combined, &num, NULL);
    combined[0] = NAN;
    combined[1] = INFINITY;
    float *const marred = run(*state, 1, &s, combined, &num, NULL);
    s.dgan.parts = QUELL_DGAN_BOTH;
    float *const both = run(*state, 1, &s, combined, &num, NULL);
    for (size_t i = 0; i < num; ++i) {
        assert_true(isfinite(marred[i]) && isfinite(both[i]) && both[i] >= 0.0f);
        if (i / WIDTH % HEIGHT > REACH) assert_true(marred[i] == clean[i]);
    }
    free(combined);
    free(clean);
    free(marred);
    free(both);
}

static void the_report_tells(void **state)
{
    size_t num;
    quell_report *report;
    quell_report_summary summary = {.struct_size = sizeof summary};
    quell_report_layer layer = {.struct_size = sizeof layer};
    setting s = usual;
    s.num_passes = 2;
    free(run(*state, 1, &s, NULL, &num, &report));
    assert_int_equal(quell_report_get_summary(report, &summary), QUELL_OK);
    assert_int_equal(summary.iterations, 4);
    assert_true(summary.macs_per_pixel > 1000.0 && summary.peak_bytes > 0);
    assert_int_equal(quell_report_get_layer(report, 0, &layer), QUELL_OK);
    assert_int_equal(layer.action, QUELL_ACTION_DENOISED);
    assert_string_equal(layer.reason, "without all auxiliary passes");
    quell_report_destroy(report);

    s.num_passes = NUM_PASSES;
    free(run(*state, 1, &s, NULL, &num, &report));
    assert_int_equal(quell_report_get_layer(report, 0, &layer), QUELL_OK);
    assert_string_equal(layer.reason, "");
    quell_report_destroy(report);
}

/* ---- Wrong input -------------------------------------------------------------------------------------------------- */

static quell_status try(const char *model_name, uint64_t max_memory_bytes, const char *layers,
                        const quell_dgan_options *dgan)
{
    static float pixels[3 * 64 * 64];
    const quell_context_options context = {.struct_size = sizeof context, .max_memory_bytes = max_memory_bytes};
    const quell_options options = {.struct_size = sizeof options, .layers = layers, .dgan = dgan};
    quell_context *ctx;
    quell_model *model;
    quell_frame *frame;
    for (size_t i = 0; i < sizeof pixels / sizeof *pixels; ++i) pixels[i] = (float)(i % 7);
    assert_int_equal(quell_context_create(&context, &ctx), QUELL_OK);
    assert_int_equal(quell_model_open(ctx, model_name, &model), QUELL_OK);
    assert_int_equal(quell_frame_create(ctx, 64, 64, &frame), QUELL_OK);
    const quell_image image = planar_image(pixels, 64, 64, 3);
    assert_int_equal(quell_frame_add_layer(ctx, frame, "Combined", &image, QUELL_LAYER_COPY, NULL), QUELL_OK);
    assert_int_equal(quell_frame_add_layer(ctx, frame, "AO", &image, QUELL_LAYER_COPY, NULL), QUELL_OK);
    const quell_status status = quell_denoise(ctx, model, frame, &options, NULL);
    if (status != QUELL_OK) assert_true(strlen(quell_context_last_error(ctx)) > 20);
    quell_layer_info info = {.struct_size = sizeof info};
    assert_int_equal(quell_frame_get_layer(frame, 1, &info), QUELL_OK);
    /* Other layers only when they are asked for. */
    assert_int_equal(info.is_denoised, status == QUELL_OK && layers != NULL);
    quell_frame_destroy(frame);
    quell_model_destroy(model);
    quell_context_destroy(ctx);
    return status;
}

static void wrong_settings_are_refused(void **state)
{
    (void)state;
    quell_dgan_options o = {.struct_size = sizeof o};
    assert_int_equal(try(path, 0, NULL, &o), QUELL_OK);
    assert_int_equal(try(path, 0, "all", &o), QUELL_OK);
    assert_int_equal(try(path, 0, NULL, NULL), QUELL_OK);
    assert_int_equal(try(NULL, 0, NULL, &o), QUELL_ERR_INVALID_ARGUMENT); /* a model of the other family */
    assert_int_equal(try(path, 1 << 16, NULL, &o), QUELL_ERR_OUT_OF_MEMORY);
    o.iterations = 9;
    assert_int_equal(try(path, 0, NULL, &o), QUELL_ERR_INVALID_ARGUMENT);
    o.iterations = 8;
    assert_int_equal(try(path, 0, NULL, &o), QUELL_OK);
    o.parts = 3;
    assert_int_equal(try(path, 0, NULL, &o), QUELL_ERR_INVALID_ARGUMENT);
    o.parts = 0;
    o.iterate = -1;
    assert_int_equal(try(path, 0, NULL, &o), QUELL_ERR_INVALID_ARGUMENT);
    o.iterate = 0;
    o.flags = 2;
    assert_int_equal(try(path, 0, NULL, &o), QUELL_ERR_UNSUPPORTED);
    o.flags = 0;
    o.struct_size = 8;
    assert_int_equal(try(path, 0, NULL, &o), QUELL_ERR_INVALID_ARGUMENT);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(agrees_with_pytorch, setup, teardown),
        cmocka_unit_test_setup_teardown(runs_on_combined_alone, setup, teardown),
        cmocka_unit_test_setup_teardown(bands_and_threads_do_not_show, setup, teardown),
        cmocka_unit_test_setup_teardown(scaling_is_exact, setup, teardown),
        cmocka_unit_test_setup_teardown(bad_pixels_stay_local, setup, teardown),
        cmocka_unit_test_setup_teardown(the_report_tells, setup, teardown),
        cmocka_unit_test(wrong_settings_are_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
