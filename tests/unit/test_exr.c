/* SPDX-License-Identifier: Apache-2.0 */
/* src/exr as its callers see it: frames of the fixtures and from memory, allocation failures one by one, cancel,
 * limits. What the files look like to other programs is tested in tests/exr. */
#include "base/half.h"
#include "base/pool.h"
#include "cmocka_all.h"
#include "exr/exr.h"
#include "system.h"

#include <dirent.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define DATA "tests/data/"

typedef struct fixture {
    ql_memory memory;
    ql_env env;
    atomic_int cancel;
    char folder[512];
    char out[544];
    char log[2048];
    ql_error error;
} fixture;

static void log_line(void *user, int32_t level, const char *message)
{
    fixture *fix = user;
    (void)level;
    const size_t used = strlen(fix->log);
    snprintf(fix->log + used, sizeof fix->log - used, "%s\n", message);
}

static int set_up(void **state)
{
    fixture *fix = calloc(1, sizeof *fix);
    if (!fix) return -1;
    ql_memory_init(&fix->memory, 0);
    atomic_init(&fix->cancel, 0);
    fix->env = (ql_env){.memory = &fix->memory, .cancel = &fix->cancel, .progress_to = 1.0, .log = log_line};
    fix->env.log_user = fix;
    if (ql_pool_create(2, &fix->memory, &fix->env.pool, NULL) != QUELL_OK) return -1;
    if (test_make_folder(fix->folder, sizeof fix->folder) != 0) return -1;
    snprintf(fix->out, sizeof fix->out, "%s/out.exr", fix->folder);
    *state = fix;
    return 0;
}

/* Entries of the test's folder; a temporary file that was left behind would be one. */
static int count_files(const fixture *fix)
{
    int count = 0;
    DIR *folder = opendir(fix->folder);
    assert_non_null(folder);
    for (struct dirent *entry = readdir(folder); entry; entry = readdir(folder)) count += entry->d_name[0] != '.';
    rewinddir(folder);
    for (struct dirent *entry = readdir(folder); entry; entry = readdir(folder)) {
        count += strncmp(entry->d_name, ".quell", 6) == 0;
    }
    closedir(folder);
    return count;
}

static int tear_down(void **state)
{
    fixture *fix = *state;
    unlink(fix->out);
    const int is_clean = rmdir(fix->folder) == 0;
    ql_pool_destroy(fix->env.pool);
    const int has_leak = fix->memory.used_bytes != 0;
    free(fix);
    return is_clean && !has_leak ? 0 : -1;
}

static ql_frame *read_frame(fixture *fix, const char *path)
{
    ql_frame *frame = NULL;
    const quell_status status = ql_exr_read(&fix->env, path, 0, &frame, &fix->error);
    if (status != QUELL_OK) fail_msg("%s", fix->error.text);
    return frame;
}

static ql_layer *layer_of(ql_frame *frame, const char *name)
{
    const int64_t index = ql_frame_find_layer(frame, name);
    assert_true(index >= 0);
    return &frame->layers[index];
}

static void set_result(ql_frame *frame, ql_layer *layer, float value)
{
    const size_t count = (size_t)frame->width * frame->height * layer->num_channels;
    layer->result = ql_alloc(frame->memory, count, sizeof(float));
    assert_non_null(layer->result);
    for (size_t i = 0; i < count; i++) layer->result[i] = value;
}

static float pixel(const ql_layer *layer, uint32_t width, uint32_t channel, uint32_t x, uint32_t y)
{
    float row[4096];
    assert_true(width <= 4096);
    ql_layer_read_row(layer, width, channel, y, row);
    return row[x];
}

/* ---- Reading ----------------------------------------------------------------------------------------------------- */

static void test_known_layers_have_pixels(void **state)
{
    fixture *fix = *state;
    ql_frame *frame = read_frame(fix, DATA "50_all.exr");
    assert_int_equal(frame->width, 45);
    assert_int_equal(frame->height, 29);
    for (uint32_t i = 0; i < frame->num_layers; i++) {
        const ql_layer *layer = &frame->layers[i];
        assert_int_equal(layer->pixels.data != NULL, layer->role != QUELL_ROLE_OTHER);
        assert_string_equal(layer->compression, "zip");
        assert_int_equal(layer->samples, 4);
        assert_null(layer->result);
    }
    const ql_layer *combined = layer_of(frame, "ViewLayer.Combined");
    assert_string_equal(combined->channels, "RGBA");
    assert_int_equal(combined->format, QUELL_FORMAT_HALF);
    assert_int_equal(combined->pixels.format, QUELL_FORMAT_HALF);
    assert_true(pixel(combined, 45, 3, 20, 10) == 1.0f);
    const ql_layer *normal = layer_of(frame, "ViewLayer.Normal");
    assert_string_equal(normal->channels, "XYZ");
    assert_int_equal(normal->pixels.format, QUELL_FORMAT_FLOAT);
    ql_frame_destroy(frame);
}

static void test_other_layers_are_loaded_later(void **state)
{
    fixture *fix = *state;
    ql_frame *frame = read_frame(fix, DATA "45_all_two_layers.exr");
    ql_layer *crypto = layer_of(frame, "ViewLayer.CryptoObject00");
    const uint32_t index = (uint32_t)(crypto - frame->layers);
    assert_string_equal(crypto->channels, "rgba");
    assert_null(crypto->pixels.data);
    const uint64_t before = frame->memory->used_bytes;
    assert_int_equal(ql_exr_load_layer(&fix->env, frame, index, &fix->error), QUELL_OK);
    assert_non_null(crypto->pixels.data);
    assert_true(frame->memory->used_bytes >= before + 45 * 29 * 16);
    const uint8_t *data = crypto->pixels.data;
    assert_int_equal(ql_exr_load_layer(&fix->env, frame, index, &fix->error), QUELL_OK);
    assert_ptr_equal(data, crypto->pixels.data);
    assert_int_equal(ql_exr_load_layer(&fix->env, frame, 100000, &fix->error), QUELL_ERR_INVALID_ARGUMENT);
    ql_frame_destroy(frame);
}

/* The same render in several codecs and layouts has the same pixels. */
static void test_lossless_codecs_agree(void **state)
{
    fixture *fix = *state;
    static const char *const pairs[][2] = {
        {DATA "50_zip_float.exr", DATA "conv_htj2k256.exr"},
        {DATA "45_zips_float.exr", DATA "conv_htj2k32_single.exr"},
        {DATA "45_beauty_guides.exr", DATA "conv_decreasing_y.exr"},
        {DATA "50_transparent.exr", DATA "conv_cropped_multi.exr"},
        {DATA "45_transparent.exr", DATA "conv_overscan_single.exr"},
    };
    for (size_t i = 0; i < sizeof pairs / sizeof pairs[0]; i++) {
        ql_frame *a = read_frame(fix, pairs[i][0]), *b = read_frame(fix, pairs[i][1]);
        assert_int_equal(a->num_layers, b->num_layers);
        for (uint32_t l = 0; l < a->num_layers; l++) {
            assert_int_equal(ql_exr_load_layer(&fix->env, a, l, &fix->error), QUELL_OK);
            ql_layer *other = layer_of(b, a->layers[l].full_name);
            assert_int_equal(ql_exr_load_layer(&fix->env, b, (uint32_t)(other - b->layers), &fix->error), QUELL_OK);
            const size_t bytes = (size_t)45 * 29 * a->layers[l].num_channels * ql_format_bytes(a->layers[l].format);
            assert_memory_equal(a->layers[l].owned, other->owned, bytes);
        }
        ql_frame_destroy(a);
        ql_frame_destroy(b);
    }
}

static void test_composite_is_not_a_render(void **state)
{
    fixture *fix = *state;
    ql_frame *frame = read_frame(fix, DATA "45_composite.exr");
    assert_int_equal(layer_of(frame, "Composite.Combined")->role, QUELL_ROLE_OTHER);
    assert_int_equal(layer_of(frame, "ViewLayer.Combined")->role, QUELL_ROLE_COMBINED);
    ql_frame_destroy(frame);
}

static void test_limits(void **state)
{
    fixture *fix = *state;
    ql_frame *frame = NULL;
    assert_int_equal(ql_exr_read(&fix->env, DATA "45_plain.exr", 45 * 29 - 1, &frame, &fix->error), QUELL_ERR_LIMIT);
    assert_null(frame);
    assert_non_null(strstr(fix->error.text, "45_plain.exr"));
    assert_non_null(strstr(fix->error.text, "45 x 29"));
    assert_int_equal(ql_exr_read(&fix->env, DATA "45_plain.exr", 45 * 29, &frame, &fix->error), QUELL_OK);
    ql_frame_destroy(frame);
}

static void test_errors_name_the_file(void **state)
{
    fixture *fix = *state;
    ql_frame *frame = NULL;
    assert_int_equal(ql_exr_read(&fix->env, DATA "none.exr", 0, &frame, &fix->error), QUELL_ERR_FILE_NOT_FOUND);
    assert_non_null(strstr(fix->error.text, "none.exr"));
    assert_int_equal(ql_exr_read(&fix->env, DATA, 0, &frame, &fix->error), QUELL_ERR_FILE_READ);
    assert_int_equal(ql_exr_read(&fix->env, "Makefile", 0, &frame, &fix->error), QUELL_ERR_NOT_EXR);
    assert_int_equal(ql_exr_read(&fix->env, DATA "conv_tiled.exr", 0, &frame, &fix->error), QUELL_ERR_UNSUPPORTED);
    assert_non_null(strstr(fix->error.text, "tiled"));
    assert_null(frame);
}

/* ---- Writing ----------------------------------------------------------------------------------------------------- */

static void test_result_replaces_one_layer(void **state)
{
    fixture *fix = *state;
    static const char *const files[] = {DATA "50_zip_float.exr", DATA "45_dwaa.exr", DATA "conv_decreasing_y.exr"};
    for (size_t i = 0; i < 3; i++) {
        ql_frame *frame = read_frame(fix, files[i]);
        set_result(frame, layer_of(frame, "ViewLayer.Combined"), 0.25f);
        assert_int_equal(ql_exr_write(&fix->env, frame, fix->out, QUELL_CODEC_KEEP, &fix->error), QUELL_OK);
        assert_int_equal(count_files(fix), 1);
        ql_frame *again = read_frame(fix, fix->out);
        assert_int_equal(again->num_layers, frame->num_layers);
        for (uint32_t l = 0; l < frame->num_layers; l++) {
            const ql_layer *before = &frame->layers[l];
            const ql_layer *after = &again->layers[l];
            assert_string_equal(before->full_name, after->full_name);
            if (before->result) {
                assert_true(pixel(after, 45, 2, 44, 28) == 0.25f);
            } else if (before->owned) {
                const size_t bytes = (size_t)45 * 29 * before->num_channels * ql_format_bytes(before->format);
                assert_memory_equal(before->owned, after->owned, bytes);
            }
        }
        ql_frame_destroy(frame);
        ql_frame_destroy(again);
    }
}

/* A frame of the caller's own strided pixels: interleaved floats upside down, halves, one value. */
static ql_frame *make_frame(fixture *fix, float *interleaved, uint16_t *halves, float *depth, uint32_t w, uint32_t h)
{
    ql_frame *frame = NULL;
    ql_layer *layer = NULL;
    assert_int_equal(ql_frame_create(w, h, &frame, &fix->error), QUELL_OK);
    for (uint32_t i = 0; i < w * h * 4; i++) interleaved[i] = (float)i * 0.5f;
    for (uint32_t i = 0; i < w * h * 3; i++) halves[i] = ql_half_from_float((float)(i % 1000));
    for (uint32_t i = 0; i < w * h; i++) depth[i] = (float)i;

    assert_int_equal(ql_frame_append_layer(frame, "Combined", NULL, &layer, &fix->error), QUELL_OK);
    layer->num_channels = 4;
    layer->format = QUELL_FORMAT_FLOAT;
    layer->samples = 16;
    layer->pixels = (ql_view){.data = (uint8_t *)(interleaved + (size_t)(h - 1) * w * 4),
                              .format = QUELL_FORMAT_FLOAT,
                              .num_channels = 4,
                              .channel_stride = 4,
                              .pixel_stride = 16,
                              .row_stride = -(int64_t)w * 16};
    assert_int_equal(ql_frame_append_layer(frame, "ViewLayer.Diffuse Direct", NULL, &layer, &fix->error), QUELL_OK);
    layer->num_channels = 3;
    layer->format = QUELL_FORMAT_HALF;
    layer->pixels = (ql_view){.data = (uint8_t *)halves,
                              .format = QUELL_FORMAT_HALF,
                              .num_channels = 3,
                              .channel_stride = 2,
                              .pixel_stride = 6,
                              .row_stride = (int64_t)w * 6};
    assert_int_equal(ql_frame_append_layer(frame, "Depth", NULL, &layer, &fix->error), QUELL_OK);
    layer->num_channels = 1;
    layer->format = QUELL_FORMAT_FLOAT;
    layer->pixels = (ql_view){.data = (uint8_t *)depth,
                              .format = QUELL_FORMAT_FLOAT,
                              .num_channels = 1,
                              .pixel_stride = 4,
                              .row_stride = (int64_t)w * 4};
    return frame;
}

static void test_frame_from_memory(void **state)
{
    fixture *fix = *state;
    enum { W = 33, H = 19 };
    static float interleaved[W * H * 4], depth[W * H];
    static uint16_t halves[W * H * 3];
    ql_frame *frame = make_frame(fix, interleaved, halves, depth, W, H);
    set_result(frame, layer_of(frame, "Combined"), 2.0f);
    frame->add_noisy_image = 1;
    assert_int_equal(ql_exr_write(&fix->env, frame, fix->out, QUELL_CODEC_KEEP, &fix->error), QUELL_OK);
    ql_frame_destroy(frame);

    frame = read_frame(fix, fix->out);
    assert_int_equal(frame->num_layers, 4);
    const ql_layer *combined = layer_of(frame, "ViewLayer.Combined"), *noisy = layer_of(frame, "ViewLayer.Noisy Image");
    const ql_layer *diffuse = layer_of(frame, "ViewLayer.Diffuse Direct");
    assert_string_equal(combined->channels, "RGBA");
    assert_string_equal(combined->compression, "zip");
    assert_int_equal(combined->samples, 16);
    assert_int_equal(diffuse->format, QUELL_FORMAT_HALF);
    assert_true(pixel(combined, W, 1, 5, 7) == 2.0f);
    for (uint32_t y = 0; y < H; y++) {
        for (uint32_t c = 0; c < 4; c++) {
            const float expected = (float)(((H - 1 - y) * W + 5) * 4 + c) * 0.5f;
            assert_true(pixel(noisy, W, c, 5, y) == expected);
        }
        assert_true(pixel(diffuse, W, 1, 6, y) == ql_half_to_float(halves[(y * W + 6) * 3 + 1]));
        assert_true(pixel(layer_of(frame, "Depth"), W, 0, 3, y) == (float)(y * W + 3));
    }
    ql_frame_destroy(frame);
}

static void test_layer_added_to_a_file(void **state)
{
    fixture *fix = *state;
    static const char *const files[] = {DATA "45_plain.exr", DATA "50_zip_float.exr"};
    static float values[45 * 29];
    for (size_t i = 0; i < 2; i++) {
        ql_frame *frame = read_frame(fix, files[i]);
        const uint32_t before = frame->num_layers;
        ql_layer *layer = NULL;
        assert_int_equal(ql_frame_append_layer(frame, "ViewLayer.Confidence", NULL, &layer, &fix->error), QUELL_OK);
        for (size_t k = 0; k < 45 * 29; k++) values[k] = (float)k;
        layer->num_channels = 1;
        layer->format = QUELL_FORMAT_FLOAT;
        layer->pixels = (ql_view){.data = (uint8_t *)values,
                                  .format = QUELL_FORMAT_FLOAT,
                                  .num_channels = 1,
                                  .pixel_stride = 4,
                                  .row_stride = 45 * 4};
        assert_int_equal(ql_exr_write(&fix->env, frame, fix->out, QUELL_CODEC_KEEP, &fix->error), QUELL_OK);
        ql_frame_destroy(frame);
        frame = read_frame(fix, fix->out);
        assert_int_equal(frame->num_layers, before + 1);
        layer = layer_of(frame, "ViewLayer.Confidence");
        assert_string_equal(layer->channels, "V");
        assert_int_equal(ql_exr_load_layer(&fix->env, frame, (uint32_t)(layer - frame->layers), &fix->error), QUELL_OK);
        assert_true(pixel(layer, 45, 0, 44, 28) == (float)(45 * 29 - 1));
        ql_frame_destroy(frame);
    }
}

static void test_bad_frames_and_codecs(void **state)
{
    fixture *fix = *state;
    ql_frame *frame = NULL;
    ql_layer *layer = NULL;
    assert_int_equal(ql_frame_create(4, 4, &frame, &fix->error), QUELL_OK);
    assert_int_equal(ql_exr_write(&fix->env, frame, fix->out, QUELL_CODEC_KEEP, &fix->error), QUELL_ERR_NO_LAYER);
    assert_int_equal(ql_frame_append_layer(frame, "Combined", NULL, &layer, &fix->error), QUELL_OK);
    layer->num_channels = 3;
    assert_int_equal(ql_exr_write(&fix->env, frame, fix->out, QUELL_CODEC_KEEP, &fix->error),
                     QUELL_ERR_INVALID_ARGUMENT);
    assert_int_equal(ql_exr_write(&fix->env, frame, fix->out, 99, &fix->error), QUELL_ERR_INVALID_ARGUMENT);
    assert_int_equal(count_files(fix), 0);
    ql_frame_destroy(frame);
}

/* ---- Faults ------------------------------------------------------------------------------------------------------ */

static void test_every_failed_allocation(void **state)
{
    fixture *fix = *state;
    static const char *const files[] = {DATA "50_stereo.exr", DATA "45_stereo.exr"};
    for (size_t i = 0; i < 2; i++) {
        int32_t n = 1;
        ql_frame *frame = NULL;
        for (;; n++) {
            fix->memory.fail_at = n;
            const quell_status status = ql_exr_read(&fix->env, files[i], 0, &frame, &fix->error);
            if (status == QUELL_OK) break;
            assert_int_equal(status, QUELL_ERR_OUT_OF_MEMORY);
            assert_null(frame);
        }
        assert_true(n > 3);
        fix->memory.fail_at = 0;
        set_result(frame, layer_of(frame, "ViewLayer.Combined.left"), 1.0f);
        frame->add_noisy_image = 1;
        for (n = 1;; n++) {
            fix->memory.fail_at = n;
            const quell_status status = ql_exr_write(&fix->env, frame, fix->out, QUELL_CODEC_KEEP, &fix->error);
            if (status == QUELL_OK) break;
            assert_int_equal(status, QUELL_ERR_OUT_OF_MEMORY);
            assert_int_equal(count_files(fix), 0);
        }
        assert_true(n > 20);
        fix->memory.fail_at = 0;
        assert_int_equal(count_files(fix), 1);
        unlink(fix->out);
        ql_frame_destroy(frame);
    }
}

static int32_t stop_at_third(void *user, double fraction)
{
    int *calls = user;
    assert_true(fraction >= 0.0 && fraction <= 1.0);
    return ++*calls >= 2;
}

static void test_cancel(void **state)
{
    fixture *fix = *state;
    ql_frame *frame = NULL;
    atomic_store(&fix->cancel, 1);
    assert_int_equal(ql_exr_read(&fix->env, DATA "50_all.exr", 0, &frame, &fix->error), QUELL_ERR_CANCELLED);
    assert_null(frame);
    assert_non_null(strstr(fix->error.text, "cancelled"));
    atomic_store(&fix->cancel, 0);

    frame = read_frame(fix, DATA "50_all.exr");
    set_result(frame, layer_of(frame, "ViewLayer.Combined"), 1.0f);
    FILE *precious = fopen(fix->out, "w");
    assert_non_null(precious);
    fputs("precious", precious);
    fclose(precious);
    atomic_store(&fix->cancel, 1);
    assert_int_equal(ql_exr_write(&fix->env, frame, fix->out, QUELL_CODEC_KEEP, &fix->error), QUELL_ERR_CANCELLED);
    atomic_store(&fix->cancel, 0);
    int calls = 0;
    fix->env.progress = stop_at_third;
    fix->env.progress_user = &calls;
    const quell_status status = ql_exr_write(&fix->env, frame, fix->out, QUELL_CODEC_KEEP, &fix->error);
    fix->env.progress = NULL;
    atomic_store(&fix->cancel, 0);
    assert_true(status == QUELL_ERR_CANCELLED || status == QUELL_OK);
    assert_int_equal(count_files(fix), 1);
    if (status == QUELL_ERR_CANCELLED) {
        char text[16] = "";
        precious = fopen(fix->out, "r");
        assert_non_null(precious);
        assert_non_null(fgets(text, sizeof text, precious));
        fclose(precious);
        assert_string_equal(text, "precious");
    }
    ql_frame_destroy(frame);
}

/* A truncated copy: the message is the first bad part's, however the threads ran. */
static void test_first_error_wins(void **state)
{
    fixture *fix = *state;
    static char whole[200000];
    FILE *in = fopen(DATA "50_all.exr", "rb");
    assert_non_null(in);
    const size_t bytes = fread(whole, 1, sizeof whole, in);
    fclose(in);
    FILE *cut = fopen(fix->out, "wb");
    assert_non_null(cut);
    assert_int_equal(fwrite(whole, 1, bytes / 2, cut), bytes / 2);
    fclose(cut);
    char first[QL_ERROR_TEXT_BYTES] = "";
    for (int i = 0; i < 20; i++) {
        ql_frame *frame = NULL;
        assert_int_equal(ql_exr_read(&fix->env, fix->out, 0, &frame, &fix->error), QUELL_ERR_FILE_READ);
        assert_null(frame);
        if (i == 0) strcpy(first, fix->error.text);
        assert_string_equal(first, fix->error.text);
    }
    assert_non_null(strstr(first, "part "));
}

#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, tear_down)

int main(void)
{
    const struct CMUnitTest tests[] = {
        TEST(test_known_layers_have_pixels),
        TEST(test_other_layers_are_loaded_later),
        TEST(test_lossless_codecs_agree),
        TEST(test_composite_is_not_a_render),
        TEST(test_limits),
        TEST(test_errors_name_the_file),
        TEST(test_result_replaces_one_layer),
        TEST(test_frame_from_memory),
        TEST(test_layer_added_to_a_file),
        TEST(test_bad_frames_and_codecs),
        TEST(test_every_failed_allocation),
        TEST(test_cancel),
        TEST(test_first_error_wins),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
