/* SPDX-License-Identifier: Apache-2.0 */
/* Pass names of every Blender version, and channel names split from the right. */
#include "cmocka_all.h"
#include "frame/roles.h"
#include "quell.h"

#include <string.h>

/* Both name tables, as facts of Blender 3.4 to 5.2. */
static void test_both_name_tables_agree(void **state)
{
    (void)state;
    static const char *const pairs[][2] = {
        {"DiffDir", "Diffuse Direct"},
        {"DiffInd", "Diffuse Indirect"},
        {"DiffCol", "Diffuse Color"},
        {"GlossDir", "Glossy Direct"},
        {"GlossInd", "Glossy Indirect"},
        {"GlossCol", "Glossy Color"},
        {"TransDir", "Transmission Direct"},
        {"TransInd", "Transmission Indirect"},
        {"TransCol", "Transmission Color"},
        {"VolumeDir", "Volume Direct"},
        {"VolumeInd", "Volume Indirect"},
        {"Emit", "Emission"},
        {"Env", "Environment"},
        {"AO", "Ambient Occlusion"},
    };
    for (size_t i = 0; i < sizeof pairs / sizeof pairs[0]; i++) {
        assert_int_not_equal(ql_role_from_pass(pairs[i][0]), QUELL_ROLE_OTHER);
        assert_int_equal(ql_role_from_pass(pairs[i][0]), ql_role_from_pass(pairs[i][1]));
    }
}

static void test_roles(void **state)
{
    (void)state;
    assert_int_equal(ql_role_from_pass("Combined"), QUELL_ROLE_COMBINED);
    assert_int_equal(ql_role_from_pass("Combined_key"), QUELL_ROLE_LIGHT_GROUP);
    assert_int_equal(ql_role_from_pass("Combined_"), QUELL_ROLE_OTHER);
    assert_int_equal(ql_role_from_pass("combined"), QUELL_ROLE_OTHER);
    assert_int_equal(ql_role_from_pass("CryptoObject00"), QUELL_ROLE_OTHER);
    assert_int_equal(ql_role_from_pass("Object Index"), QUELL_ROLE_OTHER);
    assert_int_equal(ql_role_from_pass("Noisy Image"), QUELL_ROLE_NOISY_IMAGE);
    assert_int_equal(ql_role_from_pass("Denoising Depth"), QUELL_ROLE_DENOISING_DEPTH);
    assert_int_equal(ql_role_from_pass("Denoising Roughness"), QUELL_ROLE_OTHER);
    assert_int_equal(ql_role_from_pass(""), QUELL_ROLE_OTHER);

    assert_string_equal(ql_role_name(QUELL_ROLE_DIFFUSE_DIRECT), "diffuse-direct");
    assert_string_equal(ql_role_name(-1), "other");
    assert_string_equal(ql_role_name(1000), "other");
    for (int32_t role = 0; role <= QUELL_ROLE_VOLUME_TRANSMIT; role++) {
        assert_non_null(ql_role_name(role));
        for (int32_t other = 0; other < role; other++) {
            assert_string_not_equal(ql_role_name(role), ql_role_name(other));
        }
    }
}

static void test_groups_and_colors(void **state)
{
    (void)state;
    assert_int_equal(ql_role_group(QUELL_ROLE_COMBINED), QL_GROUP_BEAUTY);
    assert_int_equal(ql_role_group(QUELL_ROLE_LIGHT_GROUP), QL_GROUP_BEAUTY);
    assert_int_equal(ql_role_group(QUELL_ROLE_GLOSSY_INDIRECT), QL_GROUP_GLOSSY);
    assert_int_equal(ql_role_group(QUELL_ROLE_GLOSSY_COLOR), QL_GROUP_COLOR);
    assert_int_equal(ql_role_group(QUELL_ROLE_VOLUME_DIRECT), QL_GROUP_VOLUME);
    assert_int_equal(ql_role_group(QUELL_ROLE_DEPTH), QL_GROUP_NONE);
    assert_int_equal(ql_role_group(QUELL_ROLE_NOISY_IMAGE), QL_GROUP_NONE);
    assert_int_equal(ql_role_group(QUELL_ROLE_DENOISING_ALBEDO), QL_GROUP_NONE);
    assert_int_equal(ql_role_group(QUELL_ROLE_OTHER), QL_GROUP_NONE);
    assert_int_equal(ql_role_color(QUELL_ROLE_DIFFUSE_DIRECT), QUELL_ROLE_DIFFUSE_COLOR);
    assert_int_equal(ql_role_color(QUELL_ROLE_TRANSMISSION_INDIRECT), QUELL_ROLE_TRANSMISSION_COLOR);
    assert_int_equal(ql_role_color(QUELL_ROLE_VOLUME_DIRECT), QUELL_ROLE_OTHER);
    assert_int_equal(ql_role_color(QUELL_ROLE_COMBINED), QUELL_ROLE_OTHER);
}

static void check_split(const char *name, const char *const *views, const char *layer, const char *pass,
                        const char *view, char channel)
{
    char buffer[300], letter = 0;
    const char *found_layer, *found_pass, *found_view;
    assert_int_equal(ql_split_channel_name(name, views, buffer, &found_layer, &found_pass, &found_view, &letter), 0);
    assert_string_equal(found_layer, layer);
    assert_string_equal(found_pass, pass);
    assert_string_equal(found_view, view);
    assert_int_equal(letter, channel);
}

static void test_split(void **state)
{
    (void)state;
    static const char *const views[] = {"left", "right", NULL};
    check_split("ViewLayer.DiffDir.R", NULL, "ViewLayer", "DiffDir", "", 'R');
    check_split("View.Layer 1.Combined.R", NULL, "View.Layer 1", "Combined", "", 'R');
    check_split("Ünï/côdé Läyer.Depth.Z", NULL, "Ünï/côdé Läyer", "Depth", "", 'Z');
    check_split("ViewLayer.Combined.left.R", views, "ViewLayer", "Combined", "left", 'R');
    check_split("Right.left.Combined.R", views, "Right.left", "Combined", "", 'R');
    check_split("Right.left.Combined.right.A", views, "Right.left", "Combined", "right", 'A');
    check_split("ViewLayer.Combined.left.R", NULL, "ViewLayer.Combined", "left", "", 'R');
    check_split("Combined.Combined.R", NULL, "Combined", "Combined", "", 'R');
    check_split("my depth.V", NULL, "", "my depth", "", 'V');
    check_split("beauty.denoised.R", NULL, "beauty", "denoised", "", 'R');
    check_split("Combined.left.G", views, "", "Combined", "left", 'G');
    check_split("R", NULL, "", "Combined", "", 'R');
    check_split("Z", NULL, "", "Depth", "", 'Z');
    check_split("V", NULL, "", "V", "", 'V');
    check_split("L.CryptoObject00.r", NULL, "L", "CryptoObject00", "", 'r');
    check_split("left.R", views, "", "left", "", 'R');
}

static void test_names_without_a_letter(void **state)
{
    (void)state;
    static const char *const names[] = {
        "", ".", ".R", "xxx.", "ViewLayer.bbbb", "L.Combined.RR", "L.Combined.Q", "Q", "L.Combined.\xc3\xa4", "L.P.",
    };
    char buffer[300], letter;
    const char *layer, *pass, *view;
    for (size_t i = 0; i < sizeof names / sizeof names[0]; i++) {
        assert_int_equal(ql_split_channel_name(names[i], NULL, buffer, &layer, &pass, &view, &letter), -1);
    }
    char cut[64];
    memset(cut, 'x', 63);
    cut[62] = '.';
    cut[63] = '\0';
    assert_int_equal(ql_split_channel_name(cut, NULL, buffer, &layer, &pass, &view, &letter), -1);
}

static void test_channels(void **state)
{
    (void)state;
    assert_true(ql_channel_order('R') < ql_channel_order('G') && ql_channel_order('B') < ql_channel_order('A'));
    assert_true(ql_channel_order('X') < ql_channel_order('W') && ql_channel_order('V') < ql_channel_order('A'));
    assert_true(ql_channel_order('r') < ql_channel_order('a'));
    assert_int_equal(ql_channel_order('\0'), -1);
    assert_int_equal(ql_channel_order('q'), -1);
    assert_string_equal(ql_role_channels(QUELL_ROLE_COMBINED, 4), "RGBA");
    assert_string_equal(ql_role_channels(QUELL_ROLE_DENOISING_NORMAL, 3), "XYZ");
    assert_string_equal(ql_role_channels(QUELL_ROLE_DENOISING_DEPTH, 1), "Z");
    assert_string_equal(ql_role_channels(QUELL_ROLE_SAMPLE_COUNT, 1), "X");
    assert_string_equal(ql_role_channels(QUELL_ROLE_OTHER, 3), "RGB");
    assert_int_equal(strlen(ql_role_channels(QUELL_ROLE_OTHER, 2)), 2);
    assert_true(ql_role_fits_channels(QUELL_ROLE_COMBINED, "RGBA"));
    assert_false(ql_role_fits_channels(QUELL_ROLE_COMBINED, "G"));
    assert_false(ql_role_fits_channels(QUELL_ROLE_DEPTH, "RGB"));
    assert_true(ql_role_fits_channels(QUELL_ROLE_DEPTH, "V"));
    assert_true(ql_role_fits_channels(QUELL_ROLE_NORMAL, "XYZ"));
    assert_true(ql_role_fits_channels(QUELL_ROLE_OTHER, "Q"));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_both_name_tables_agree), cmocka_unit_test(test_roles),
        cmocka_unit_test(test_groups_and_colors),      cmocka_unit_test(test_split),
        cmocka_unit_test(test_names_without_a_letter), cmocka_unit_test(test_channels),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
