/* SPDX-License-Identifier: Apache-2.0 */
/* Pins every number that compiled callers and ctypes bindings have inside them: sizes, offsets, constants. A line here
 * changes only together with the SONAME; new members and values get new lines. */
#include "quell.h"

#include "cmocka_all.h"

#define SIZE(type, bytes) assert_int_equal(sizeof(type), bytes)
#define AT(type, member, offset) assert_int_equal(offsetof(type, member), offset)

static void structs_are_where_they_were(void **state)
{
    (void)state;
    SIZE(quell_status, 4);

    SIZE(quell_context_options, 48);
    AT(quell_context_options, struct_size, 0);
    AT(quell_context_options, num_threads, 4);
    AT(quell_context_options, cpu, 8);
    AT(quell_context_options, reserved0, 12);
    AT(quell_context_options, max_memory_bytes, 16);
    AT(quell_context_options, max_image_pixels, 24);
    AT(quell_context_options, log, 32);
    AT(quell_context_options, log_user, 40);

    SIZE(quell_model_info, 72);
    AT(quell_model_info, file_version, 4);
    AT(quell_model_info, name, 8);
    AT(quell_model_info, description, 16);
    AT(quell_model_info, sha256, 24);
    AT(quell_model_info, num_parameters, 32);
    AT(quell_model_info, macs_per_pixel, 40);
    AT(quell_model_info, macs_per_pixel_all, 48);
    AT(quell_model_info, weight_file, 56);
    AT(quell_model_info, quality, 64);
    AT(quell_model_info, reserved0, 68);

    SIZE(quell_image, 56);
    AT(quell_image, format, 4);
    AT(quell_image, width, 8);
    AT(quell_image, height, 12);
    AT(quell_image, num_channels, 16);
    AT(quell_image, reserved0, 20);
    AT(quell_image, data, 24);
    AT(quell_image, channel_stride_bytes, 32);
    AT(quell_image, pixel_stride_bytes, 40);
    AT(quell_image, row_stride_bytes, 48);

    SIZE(quell_layer_info, 80);
    AT(quell_layer_info, role, 4);
    AT(quell_layer_info, view_layer, 8);
    AT(quell_layer_info, pass, 16);
    AT(quell_layer_info, view, 24);
    AT(quell_layer_info, full_name, 32);
    AT(quell_layer_info, channels, 40);
    AT(quell_layer_info, compression, 48);
    AT(quell_layer_info, format, 56);
    AT(quell_layer_info, num_channels, 60);
    AT(quell_layer_info, width, 64);
    AT(quell_layer_info, height, 68);
    AT(quell_layer_info, samples, 72);
    AT(quell_layer_info, is_denoised, 76);

    SIZE(quell_write_options, 8);
    AT(quell_write_options, codec, 4);

    SIZE(quell_options, 56);
    AT(quell_options, flags, 4);
    AT(quell_options, layers, 8);
    AT(quell_options, tile_size, 16);
    AT(quell_options, reserved0, 20);
    AT(quell_options, progress, 24);
    AT(quell_options, progress_user, 32);
    AT(quell_options, dgan, 40);
    AT(quell_options, precision, 48);
    AT(quell_options, reserved1, 52);

    SIZE(quell_dgan_options, 24);
    AT(quell_dgan_options, parts, 4);
    AT(quell_dgan_options, iterate, 8);
    AT(quell_dgan_options, iterations, 12);
    AT(quell_dgan_options, flags, 16);
    AT(quell_dgan_options, reserved0, 20);

    SIZE(quell_report_layer, 80);
    AT(quell_report_layer, action, 4);
    AT(quell_report_layer, full_name, 8);
    AT(quell_report_layer, reason, 16);
    AT(quell_report_layer, num_bad_pixels, 24);
    AT(quell_report_layer, num_limited_pixels, 32);
    AT(quell_report_layer, mean_before, 40);
    AT(quell_report_layer, mean_after, 48);
    AT(quell_report_layer, noise, 56);
    AT(quell_report_layer, blend, 64);
    AT(quell_report_layer, change, 72);

    SIZE(quell_report_summary, 136);
    AT(quell_report_summary, num_layers, 4);
    AT(quell_report_summary, tile_width, 8);
    AT(quell_report_summary, tile_height, 12);
    AT(quell_report_summary, num_tiles, 16);
    AT(quell_report_summary, halo, 20);
    AT(quell_report_summary, peak_bytes, 24);
    AT(quell_report_summary, macs_per_pixel, 32);
    AT(quell_report_summary, seconds_features, 40);
    AT(quell_report_summary, seconds_network, 48);
    AT(quell_report_summary, seconds_filter, 56);
    AT(quell_report_summary, seconds_total, 64);
    AT(quell_report_summary, combined, 72);
    AT(quell_report_summary, model_name, 80);
    AT(quell_report_summary, seconds_decode, 88);
    AT(quell_report_summary, seconds_analyse, 96);
    AT(quell_report_summary, seconds_recombine, 104);
    AT(quell_report_summary, iterations, 112);
    AT(quell_report_summary, reserved0, 116);
    AT(quell_report_summary, num_cells, 120);
    AT(quell_report_summary, num_active_cells, 124);
    AT(quell_report_summary, precision, 128);
    AT(quell_report_summary, reserved1, 132);

    SIZE(quell_metrics, 56);
    AT(quell_metrics, reserved0, 4);
    AT(quell_metrics, mse, 8);
    AT(quell_metrics, rel_mse, 16);
    AT(quell_metrics, psnr, 24);
    AT(quell_metrics, ssim, 32);
    AT(quell_metrics, gmsd, 40);
    AT(quell_metrics, num_non_finite, 48);
}

static void numbers_mean_what_they_meant(void **state)
{
    (void)state;
    assert_int_equal(QUELL_ERR_INVALID_ARGUMENT, -1);
    assert_int_equal(QUELL_ERR_OUT_OF_MEMORY, -2);
    assert_int_equal(QUELL_ERR_CANCELLED, -3);
    assert_int_equal(QUELL_ERR_FILE_NOT_FOUND, -4);
    assert_int_equal(QUELL_ERR_FILE_READ, -5);
    assert_int_equal(QUELL_ERR_FILE_WRITE, -6);
    assert_int_equal(QUELL_ERR_NOT_EXR, -7);
    assert_int_equal(QUELL_ERR_UNSUPPORTED, -8);
    assert_int_equal(QUELL_ERR_NO_LAYER, -9);
    assert_int_equal(QUELL_ERR_SIZE_MISMATCH, -10);
    assert_int_equal(QUELL_ERR_BAD_MODEL, -11);
    assert_int_equal(QUELL_ERR_LIMIT, -12);
    assert_int_equal(QUELL_ERR_INTERNAL, -13);
    assert_int_equal(QUELL_CPU_NEON, 4);
    assert_int_equal(QUELL_CPU_AVX512BF16, 5);
    assert_int_equal(QUELL_PRECISION_AUTO, 0);
    assert_int_equal(QUELL_PRECISION_FLOAT32, 1);
    assert_int_equal(QUELL_PRECISION_BFLOAT16, 2);
    assert_int_equal(QUELL_QUALITY_DEFAULT, 0);
    assert_int_equal(QUELL_QUALITY_FAST, 1);
    assert_int_equal(QUELL_QUALITY_BALANCED, 2);
    assert_int_equal(QUELL_QUALITY_HIGH, 3);
    assert_int_equal(QUELL_FORMAT_UINT, 2);
    assert_int_equal(QUELL_ROLE_NOISY_IMAGE, 2);
    assert_int_equal(QUELL_ROLE_EMISSION, 14);
    assert_int_equal(QUELL_ROLE_LIGHT_GROUP, 19);
    assert_int_equal(QUELL_ROLE_VOLUME_TRANSMIT, 29);
    assert_int_equal(QUELL_CODEC_HTJ2K, 11);
    assert_int_equal(QUELL_DENOISE_KEEP_NOISY, 1);
    assert_int_equal(QUELL_DENOISE_NO_SKIP, 2);
    assert_int_equal(QUELL_DENOISE_NO_BLEND, 4);
    assert_int_equal(QUELL_DENOISE_DEBUG_LAYERS, 8);
    assert_int_equal(QUELL_ACTION_UNTOUCHED, 4);
    assert_int_equal(QUELL_LAYER_BORROW, 1);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(structs_are_where_they_were),
        cmocka_unit_test(numbers_mean_what_they_meant),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
