/* SPDX-License-Identifier: Apache-2.0 */
/* Frames: rows of strided views in every format, layers by name, and memory that runs out. */
#include "base/half.h"
#include "cmocka_all.h"
#include "frame/frame.h"

#include <math.h>
#include <string.h>

static uint32_t bits_of(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

/* Rows must give the same bits as the plain converters, for every half and in every lane. */
static void test_all_halves_to_float(void **state)
{
    (void)state;
    static uint16_t halves[65536];
    static float out[65536];
    for (uint32_t i = 0; i < 65536; i++) halves[i] = (uint16_t)i;
    for (uint32_t start = 0; start < 3; start++) {
        const uint32_t width = 65536 - start - 5;
        const ql_view view = {
            .data = (uint8_t *)(halves + start), .format = QUELL_FORMAT_HALF, .num_channels = 1, .pixel_stride = 2};
        ql_view_read_row(&view, width, 0, 0, out);
        for (uint32_t i = 0; i < width; i++) {
            assert_int_equal(bits_of(out[i]), bits_of(ql_half_to_float(halves[start + i])));
        }
    }
}

static void check_floats_to_half(const float *values, uint32_t count)
{
    uint16_t packed[256], spread[512];
    const ql_view dense = {
        .data = (uint8_t *)packed, .format = QUELL_FORMAT_HALF, .num_channels = 1, .pixel_stride = 2};
    const ql_view sparse = {
        .data = (uint8_t *)spread, .format = QUELL_FORMAT_HALF, .num_channels = 1, .pixel_stride = 4};
    ql_view_write_row(&dense, count, 0, 0, values);
    ql_view_write_row(&sparse, count, 0, 0, values);
    for (uint32_t i = 0; i < count; i++) {
        assert_int_equal(packed[i], ql_half_from_float(values[i]));
        assert_int_equal(spread[2 * i], packed[i]);
    }
}

static void test_floats_to_half(void **state)
{
    (void)state;
    static const uint32_t edges[] = {
        0,          0x00000001, 0x007fffff, 0x00800000, 0x32ffffff, 0x33000000, 0x33000001, 0x387fffff,
        0x38800000, 0x38801000, 0x38801001, 0x3f800000, 0x3f801000, 0x3f803000, 0x477fe000, 0x477fefff,
        0x477ff000, 0x477fffff, 0x47800000, 0x7f7fffff, 0x7f800000, 0x7f800001, 0x7fc00000, 0x7fffffff,
    };
    float values[256];
    uint32_t seed = 12345;
    for (uint32_t round = 0; round < 20000; round++) {
        for (uint32_t i = 0; i < 256; i++) {
            seed = seed * 1664525u + 1013904223u;
            uint32_t bits = seed;
            if (round % 4 == 0) { /* halves' own range, so that the fast case runs whole blocks */
                bits = (seed & 0x80ffffffu) + 0x3a000000u;
            } else if (i % 64 == 7) {
                bits = edges[(seed >> 8) % (sizeof edges / sizeof edges[0])] | (seed & 0x80000000u);
            }
            memcpy(&values[i], &bits, sizeof bits);
        }
        check_floats_to_half(values, 256 - round % 70);
    }
}

static void test_uint_rows(void **state)
{
    (void)state;
    uint32_t stored[8] = {0};
    const float values[8] = {-1.0f, 0.4f, 0.6f, 16777216.0f, 4294967040.0f, 4294967296.0f, NAN, INFINITY};
    const uint32_t expected[8] = {0, 0, 1, 16777216u, 4294967040u, UINT32_MAX, 0, UINT32_MAX};
    float back[8];
    const ql_view view = {.data = (uint8_t *)stored, .format = QUELL_FORMAT_UINT, .num_channels = 1, .pixel_stride = 4};
    ql_view_write_row(&view, 8, 0, 0, values);
    assert_memory_equal(stored, expected, sizeof stored);
    ql_view_read_row(&view, 8, 0, 0, back);
    for (int i = 0; i < 8; i++) assert_true(back[i] == (float)expected[i]);
}

/* Interleaved, padded, upside down: every pixel at the place that the contract names. */
static void test_strides(void **state)
{
    (void)state;
    enum { W = 5, H = 3, C = 4, ROW = (W * C + 3) * 4 };
    static uint8_t memory[H * ROW];
    memset(memory, 0xee, sizeof memory);
    const ql_view view = {
        .data = memory + (H - 1) * ROW,
        .format = QUELL_FORMAT_FLOAT,
        .num_channels = C,
        .channel_stride = 4,
        .pixel_stride = C * 4,
        .row_stride = -ROW,
    };
    for (uint32_t c = 0; c < C; c++) {
        for (uint32_t y = 0; y < H; y++) {
            float row[W];
            for (uint32_t x = 0; x < W; x++) row[x] = (float)(x + 10 * y + 100 * c);
            ql_view_write_row(&view, W, c, y, row);
        }
    }
    for (uint32_t y = 0; y < H; y++) {
        for (uint32_t x = 0; x < W; x++) {
            float pixel[C];
            memcpy(pixel, memory + (H - 1 - y) * ROW + x * C * 4, sizeof pixel);
            for (uint32_t c = 0; c < C; c++) assert_true(pixel[c] == (float)(x + 10 * y + 100 * c));
        }
        for (size_t pad = W * C * 4; pad < ROW; pad++) assert_int_equal(memory[y * ROW + pad], 0xee);
    }
    float row[W];
    ql_view_read_row(&view, W, 3, 1, row);
    assert_true(row[4] == 314.0f);
}

static void test_layers(void **state)
{
    (void)state;
    ql_error error = {.status = QUELL_OK};
    ql_frame *frame = NULL;
    ql_layer *layer = NULL;
    assert_int_equal(ql_frame_create(7, 5, &frame, &error), QUELL_OK);
    assert_int_equal(ql_frame_append_layer(frame, "View.Layer 1.Combined", NULL, &layer, &error), QUELL_OK);
    assert_string_equal(layer->view_layer, "View.Layer 1");
    assert_string_equal(layer->pass, "Combined");
    assert_string_equal(layer->view, "");
    assert_string_equal(layer->compression, "");
    assert_int_equal(layer->role, QUELL_ROLE_COMBINED);
    assert_int_equal(ql_frame_append_layer(frame, "DiffDir", NULL, &layer, &error), QUELL_OK);
    assert_string_equal(layer->view_layer, "");
    assert_int_equal(layer->role, QUELL_ROLE_DIFFUSE_DIRECT);
    const char *const views[] = {"left", "right", NULL};
    assert_int_equal(ql_frame_append_layer(frame, "A.Combined.left", views, &layer, &error), QUELL_OK);
    assert_string_equal(layer->view, "left");
    assert_string_equal(layer->view_layer, "A");

    assert_int_equal(ql_frame_append_layer(frame, "DiffDir", NULL, &layer, &error), QUELL_ERR_INVALID_ARGUMENT);
    assert_non_null(strstr(error.text, "DiffDir"));
    assert_int_equal(ql_frame_append_layer(frame, "", NULL, &layer, &error), QUELL_ERR_INVALID_ARGUMENT);
    assert_int_equal(frame->num_layers, 3);
    assert_int_equal(ql_frame_find_layer(frame, "DiffDir"), 1);
    assert_int_equal(ql_frame_find_layer(frame, "A.Combined.left"), 2);
    assert_int_equal(ql_frame_find_layer(frame, "Combined"), 0);
    assert_int_equal(ql_frame_find_layer(frame, "Env"), -1);
    ql_frame_destroy(frame);
    assert_int_equal(ql_frame_create(0, 5, &frame, &error), QUELL_ERR_INVALID_ARGUMENT);
    assert_null(frame);
    ql_frame_destroy(NULL);
}

static void test_current_row_prefers_the_result(void **state)
{
    (void)state;
    ql_frame *frame = NULL;
    ql_layer *layer = NULL;
    float row[4];
    assert_int_equal(ql_frame_create(4, 2, &frame, NULL), QUELL_OK);
    assert_int_equal(ql_frame_append_layer(frame, "Combined", NULL, &layer, NULL), QUELL_OK);
    layer->num_channels = 3;
    layer->format = QUELL_FORMAT_HALF;
    assert_int_equal(ql_layer_alloc_pixels(frame, layer, NULL), QUELL_OK);
    assert_int_equal(layer->pixels.row_stride, 8);
    assert_int_equal(layer->pixels.channel_stride, 16);
    memset(layer->owned, 0, 48);
    const float written[4] = {1, 2, 3, 4};
    ql_view_write_row(&layer->pixels, 4, 2, 1, written);
    ql_layer_read_current_row(layer, 4, 2, 2, 1, row);
    assert_memory_equal(row, written, sizeof row);

    layer->result = ql_alloc_zero(frame->memory, 24, sizeof(float));
    for (int i = 0; i < 24; i++) layer->result[i] = (float)i;
    ql_layer_read_current_row(layer, 4, 2, 2, 1, row);
    assert_true(row[0] == 20.0f && row[3] == 23.0f);
    ql_layer_read_row(layer, 4, 2, 1, row);
    assert_memory_equal(row, written, sizeof row);
    ql_frame_destroy(frame);
}

static void test_every_failed_allocation(void **state)
{
    (void)state;
    ql_frame *frame = NULL;
    ql_layer *layer = NULL;
    ql_error error = {.status = QUELL_OK};
    assert_int_equal(ql_frame_create(64, 64, &frame, &error), QUELL_OK);
    for (int32_t n = 1;; n++) {
        const uint64_t before = frame->memory->used_bytes;
        const uint32_t layers = frame->num_layers;
        frame->memory->fail_at = n;
        const quell_status status = ql_frame_append_layer(frame, "L.Combined", NULL, &layer, &error);
        if (status == QUELL_OK) break;
        assert_int_equal(status, QUELL_ERR_OUT_OF_MEMORY);
        assert_null(layer);
        assert_int_equal(frame->num_layers, layers);
        assert_true(frame->memory->used_bytes == before || frame->capacity == 16);
    }
    frame->memory->fail_at = 1;
    layer->num_channels = 4;
    assert_int_equal(ql_layer_alloc_pixels(frame, layer, &error), QUELL_ERR_OUT_OF_MEMORY);
    assert_null(layer->pixels.data);
    assert_int_equal(ql_layer_alloc_pixels(frame, layer, &error), QUELL_OK);
    ql_frame_destroy(frame);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_all_halves_to_float),
        cmocka_unit_test(test_floats_to_half),
        cmocka_unit_test(test_uint_rows),
        cmocka_unit_test(test_strides),
        cmocka_unit_test(test_layers),
        cmocka_unit_test(test_current_row_prefers_the_result),
        cmocka_unit_test(test_every_failed_allocation),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
