/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The network against PyTorch, on vectors that training/golden.py wrote: every layer on PyTorch's own input, then a frame
 * from its layers to the denoised passes through the public interface, for each instruction set, tiled and untiled.
 */
#include "cmocka_all.h"

#include "base/cpu.h"
#include "models/quell_net.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char path[] = "tests/golden/quell_small.qwt";

/* Sums of a few hundred products in another order, in float: 1e-5 of the largest value of the tensor. */
#define TOLERANCE 1e-5

/* Whole frames with bfloat16 inside the network: an untrained one, which the releases are below by far. Seen: 1.5e-3. */
#define BF16_TOLERANCE 4e-3

typedef struct fixture {
    uint8_t *data;
    size_t size_bytes;
    ql_memory memory;
    ql_weights weights;
} fixture;

static int setup(void **state)
{
    fixture *const f = calloc(1, sizeof *f);
    FILE *const file = fopen(path, "rb");
    ql_error err;
    assert_non_null(file);
    assert_int_equal(fseek(file, 0, SEEK_END), 0);
    f->size_bytes = (size_t)ftell(file);
    rewind(file);
    f->data = malloc(f->size_bytes);
    assert_int_equal(fread(f->data, 1, f->size_bytes, file), f->size_bytes);
    fclose(file);
    ql_memory_init(&f->memory, 0);
    assert_int_equal(ql_weights_open(&f->weights, f->data, f->size_bytes, path, &f->memory, &err), QUELL_OK);
    *state = f;
    return 0;
}

static int teardown(void **state)
{
    fixture *const f = *state;
    ql_weights_close(&f->weights, &f->memory);
    assert_int_equal(atomic_load(&f->memory.used_bytes), 0);
    free(f->data);
    free(f);
    return 0;
}

/* A float record and its shape; freed by free(). */
static float *get(const fixture *f, const char *name, uint32_t dims[4])
{
    ql_error err;
    const ql_record *const record = ql_weights_find(&f->weights, name);
    if (record == NULL) fail_msg("%s lacks %s", path, name);
    float *const out = malloc(record->num_values * sizeof *out);
    assert_int_equal(ql_weights_get_floats(&f->weights, name, out, record->num_values, &err), QUELL_OK);
    if (dims) memcpy(dims, record->dims, 4 * sizeof *dims);
    return out;
}

static void expect_close(const char *what, const float *got, const float *want, size_t num, double tolerance)
{
    double top = 0.0, worst = 0.0;
    for (size_t i = 0; i < num; ++i) {
        top = fmax(top, fabs((double)want[i]));
        const double error = fabs((double)got[i] - (double)want[i]);
        worst = error > worst || isnan(error) ? error : worst;
    }
    if (!(worst <= tolerance * top)) fail_msg("%s: off by %g, largest value %g", what, worst, top);
}

static void check_layer(const fixture *f, const ql_kernels *kernels, const char *name)
{
    char key[64];
    ql_error err;
    ql_conv conv;
    uint32_t in_dims[4], out_dims[4];
    snprintf(key, sizeof key, "in.%s", name);
    float *const in = get(f, key, in_dims);
    snprintf(key, sizeof key, "out.%s", name);
    float *const want = get(f, key, out_dims);
    snprintf(key, sizeof key, "%s.weight", name);
    const uint32_t size = ql_weights_find(&f->weights, key)->dims[0];
    ql_memory memory;
    ql_memory_init(&memory, 0);
    assert_int_equal(ql_conv_load(&conv, &f->weights, name, size, in_dims[2], out_dims[2], NULL, 0, &memory, &err),
                     QUELL_OK);
    ql_map map;
    assert_int_equal(ql_map_create(&map, in_dims[1], in_dims[0], in_dims[2], &memory, &err), QUELL_OK);
    for (uint32_t y = 0; y < in_dims[0]; ++y)
        memcpy(ql_map_row(&map, y), in + (size_t)y * in_dims[1] * in_dims[2],
               (size_t)in_dims[1] * in_dims[2] * sizeof *in);
    float *const row = malloc((size_t)out_dims[1] * conv.num_out * sizeof *row);
    for (uint32_t y = 0; y < out_dims[0]; ++y) {
        ql_conv_apply_row(&conv, kernels, &map, 0, y, out_dims[1], 0, row);
        for (uint32_t x = 0; x < out_dims[1]; ++x)
            expect_close(name, row + (size_t)x * conv.num_out, want + ((size_t)y * out_dims[1] + x) * out_dims[2],
                         out_dims[2], TOLERANCE);
    }
    free(row);
    ql_map_destroy(&map, &memory);
    ql_conv_free(&conv, &memory);
    assert_int_equal(atomic_load(&memory.used_bytes), 0);
    free(in);
    free(want);
}

/* Widths of 16 and 48 make every path of the packing; channels that are no multiple of 16 come from the heads. */
static void test_layers(void **state)
{
    const fixture *const f = *state;
    static const uint32_t sets[] = {0, QL_CPU_AVX2, QL_CPU_AVX2 | QL_CPU_AVX512};
    unsigned num_layers = 0;
    for (size_t s = 0; s < sizeof sets / sizeof *sets; ++s) {
        if ((ql_cpu_probe() & sets[s]) != sets[s]) continue;
        ql_kernels kernels;
        ql_kernels_init(&kernels, sets[s]);
        for (uint32_t i = 0; i < f->weights.num_records; ++i) {
            const char *const name = f->weights.records[i].name;
            if (strncmp(name, "in.", 3) != 0) continue;
            check_layer(f, &kernels, name + 3);
            ++num_layers;
        }
    }
    assert_true(num_layers >= 20);
}

/* ---- Whole frames ------------------------------------------------------------------------------------------------- */

typedef struct pass {
    const char *name, *from, *want;
    float *in, *out;
    uint32_t channels;
} pass;

static void run_frame(const fixture *f, int32_t cpu, int32_t precision, uint32_t tile, pass *passes, size_t num,
                      int with_samples)
{
    int32_t size[3];
    ql_error err;
    assert_int_equal(ql_weights_get_ints(&f->weights, "frame.size", size, 3, &err), QUELL_OK);
    const uint32_t width = (uint32_t)size[0], height = (uint32_t)size[1];
    const quell_context_options options = {.struct_size = sizeof options, .num_threads = 2, .cpu = cpu};
    quell_context *ctx;
    quell_model *model;
    quell_frame *frame;
    assert_int_equal(quell_context_create(&options, &ctx), QUELL_OK);
    assert_int_equal(quell_model_open(ctx, path, &model), QUELL_OK);
    assert_int_equal(quell_frame_create(ctx, width, height, &frame), QUELL_OK);
    for (size_t i = 0; i < num; ++i) {
        const quell_image image = {.struct_size = sizeof image,
                                   .width = width,
                                   .height = height,
                                   .num_channels = passes[i].channels,
                                   .data = passes[i].in};
        assert_int_equal(quell_frame_add_layer(ctx, frame, passes[i].name, &image, QUELL_LAYER_COPY, NULL), QUELL_OK);
    }
    if (with_samples) assert_int_equal(quell_frame_set_samples(frame, (uint32_t)size[2]), QUELL_OK);
    /* The network's result alone is what PyTorch has. */
    const quell_options denoise = {
        .struct_size = sizeof denoise, .flags = QUELL_DENOISE_NO_BLEND, .tile_size = tile, .precision = precision};
    assert_int_equal(quell_denoise(ctx, model, frame, &denoise, NULL), QUELL_OK);
    for (size_t i = 0; i < num; ++i) {
        const quell_image image = {.struct_size = sizeof image,
                                   .width = width,
                                   .height = height,
                                   .num_channels = passes[i].channels,
                                   .data = passes[i].out};
        const int64_t index = quell_frame_find_layer(frame, passes[i].name);
        assert_true(index >= 0);
        assert_int_equal(quell_frame_copy_layer(ctx, frame, (uint32_t)index, &image), QUELL_OK);
    }
    quell_frame_destroy(frame);
    quell_model_destroy(model);
    quell_context_destroy(ctx);
}

static void check_frame(const fixture *f, pass *passes, size_t num, int with_samples)
{
    static const struct {
        int32_t cpu;
        uint32_t bits, tile;
        int32_t precision;
        double tolerance;
    } runs[] = {{QUELL_CPU_C, 0, 0, QUELL_PRECISION_AUTO, TOLERANCE},
                {QUELL_CPU_AVX2, QL_CPU_AVX2, 0, QUELL_PRECISION_AUTO, TOLERANCE},
                {QUELL_CPU_AVX512, QL_CPU_AVX512, 0, QUELL_PRECISION_AUTO, TOLERANCE},
                {QUELL_CPU_AUTO, 0, 64, QUELL_PRECISION_FLOAT32, TOLERANCE},
                {QUELL_CPU_C, 0, 0, QUELL_PRECISION_BFLOAT16, BF16_TOLERANCE},
                {QUELL_CPU_AVX512BF16, QL_CPU_AVX512_BF16, 64, QUELL_PRECISION_AUTO, BF16_TOLERANCE}};
    int32_t size[3];
    ql_error err;
    assert_int_equal(ql_weights_get_ints(&f->weights, "frame.size", size, 3, &err), QUELL_OK);
    const size_t pixels = (size_t)size[0] * (size_t)size[1];
    for (size_t i = 0; i < num; ++i) {
        uint32_t dims[4];
        passes[i].in = get(f, passes[i].from, dims);
        passes[i].channels = dims[2];
        if (strcmp(passes[i].name, "Combined") == 0) { /* its alpha is a record of its own */
            float *const alpha = get(f, "frame.alpha", NULL), *const rgba = malloc(4 * pixels * sizeof *rgba);
            for (size_t p = 0; p < pixels; ++p) {
                memcpy(rgba + 4 * p, passes[i].in + 3 * p, 3 * sizeof *rgba);
                rgba[4 * p + 3] = alpha[p];
            }
            free(alpha);
            free(passes[i].in);
            passes[i].in = rgba;
            passes[i].channels = with_samples ? 4 : 3;
            if (!with_samples)
                for (size_t p = 0; p < pixels; ++p) memmove(rgba + 3 * p, rgba + 4 * p, 3 * sizeof *rgba);
        }
        passes[i].out = malloc(pixels * passes[i].channels * sizeof(float));
    }
    for (size_t r = 0; r < sizeof runs / sizeof *runs; ++r) {
        if ((ql_cpu_probe() & runs[r].bits) != runs[r].bits) continue;
        run_frame(f, runs[r].cpu, runs[r].precision, runs[r].tile, passes, num, with_samples);
        for (size_t i = 0; i < num; ++i) {
            if (passes[i].want == NULL) continue;
            float *const want = get(f, passes[i].want, NULL), *const got = malloc(3 * pixels * sizeof *got);
            for (size_t p = 0; p < pixels; ++p)
                memcpy(got + 3 * p, passes[i].out + passes[i].channels * p, 3 * sizeof *got);
            expect_close(passes[i].want, got, want, 3 * pixels, runs[r].tolerance);
            free(want);
            free(got);
        }
    }
    for (size_t i = 0; i < num; ++i) {
        free(passes[i].in);
        free(passes[i].out);
    }
}

static void test_all_passes(void **state)
{
    pass passes[] = {
        {.name = "Combined", .from = "frame.beauty", .want = "want.combined"},
        {.name = "DiffDir", .from = "frame.diffuse_direct", .want = "want.diffuse_direct"},
        {.name = "DiffInd", .from = "frame.diffuse_indirect", .want = "want.diffuse_indirect"},
        {.name = "DiffCol", .from = "frame.diffuse_color", .want = "want.diffuse_color"},
        {.name = "GlossDir", .from = "frame.glossy_direct", .want = "want.glossy_direct"},
        {.name = "GlossInd", .from = "frame.glossy_indirect", .want = "want.glossy_indirect"},
        {.name = "GlossCol", .from = "frame.glossy_color", .want = "want.glossy_color"},
        {.name = "TransDir", .from = "frame.transmission_direct", .want = "want.transmission_direct"},
        {.name = "TransInd", .from = "frame.transmission_indirect", .want = "want.transmission_indirect"},
        {.name = "TransCol", .from = "frame.transmission_color", .want = "want.transmission_color"},
        {.name = "VolumeDir", .from = "frame.volume_direct", .want = "want.volume_direct"},
        {.name = "VolumeInd", .from = "frame.volume_indirect", .want = "want.volume_indirect"},
        {.name = "Emit", .from = "frame.emission", .want = "want.emission"},
        {.name = "Denoising Albedo", .from = "frame.albedo"},
        {.name = "Denoising Normal", .from = "frame.normal"},
        {.name = "Denoising Depth", .from = "frame.depth"},
    };
    check_frame(*state, passes, sizeof passes / sizeof *passes, 1);
}

static void test_combined_and_guides(void **state)
{
    pass passes[] = {
        {.name = "Combined", .from = "frame.beauty", .want = "want.combined_alone"},
        {.name = "Denoising Albedo", .from = "frame.albedo"},
        {.name = "Denoising Normal", .from = "frame.normal"},
        {.name = "Denoising Depth", .from = "frame.depth"},
    };
    check_frame(*state, passes, sizeof passes / sizeof *passes, 1);
}

static void test_combined_bare(void **state)
{
    pass passes[] = {{.name = "Combined", .from = "frame.beauty", .want = "want.combined_bare"}};
    check_frame(*state, passes, 1, 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(test_layers, setup, teardown),
        cmocka_unit_test_setup_teardown(test_all_passes, setup, teardown),
        cmocka_unit_test_setup_teardown(test_combined_and_guides, setup, teardown),
        cmocka_unit_test_setup_teardown(test_combined_bare, setup, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
