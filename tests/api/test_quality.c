/* SPDX-License-Identifier: Apache-2.0 */
/* Quality levels through the public interface, in a library of other weights: this program brings its own list of
 * built-in networks, so that the linker leaves out that of src/models/builtin.c. All are tests/golden/quell_small.qwt;
 * there is none for the level high. */
#include "models/builtin.h"
#include "quell.h"

#include "cmocka_all.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { NUM_BUILTINS = 3 };

static uint8_t *small; /* the weight file */
static ql_builtin builtins[NUM_BUILTINS] = {
    {"quell-balanced", "quell-balanced.qwt", NULL, NULL},
    {"another", "another.qwt", NULL, NULL},
    {"quell-fast", "quell-fast.qwt", NULL, NULL},
};

const ql_builtin *ql_builtin_get(uint32_t index)
{
    return index < NUM_BUILTINS ? &builtins[index] : NULL;
}

const ql_builtin *ql_builtin_find(const char *name)
{
    for (uint32_t i = 0; i < NUM_BUILTINS; i++)
        if (strcmp(builtins[i].name, name) == 0) return &builtins[i];
    return NULL;
}

const char *ql_builtin_folder(void)
{
    return "some/folder";
}

static int set_up(void **state)
{
    quell_context *ctx;
    FILE *const file = fopen("tests/golden/quell_small.qwt", "rb");
    assert_non_null(file);
    assert_int_equal(fseek(file, 0, SEEK_END), 0);
    const size_t size = (size_t)ftell(file);
    rewind(file);
    small = malloc(size);
    assert_int_equal(fread(small, 1, size, file), size);
    fclose(file);
    for (uint32_t i = 0; i < NUM_BUILTINS; i++) {
        builtins[i].begin = small;
        builtins[i].end = small + size;
    }
    assert_int_equal(quell_context_create(NULL, &ctx), QUELL_OK);
    *state = ctx;
    return 0;
}

static int tear_down(void **state)
{
    quell_context_destroy(*state);
    free(small);
    return 0;
}

static void levels_have_names(void **state)
{
    (void)state;
    assert_string_equal(quell_quality_name(QUELL_QUALITY_FAST), "fast");
    assert_string_equal(quell_quality_name(QUELL_QUALITY_BALANCED), "balanced");
    assert_string_equal(quell_quality_name(QUELL_QUALITY_HIGH), "high");
    assert_null(quell_quality_name(QUELL_QUALITY_DEFAULT));
    assert_null(quell_quality_name(QUELL_QUALITY_HIGH + 1));
    assert_null(quell_quality_name(-1));
}

static void a_level_opens_its_network(void **state)
{
    static const struct {
        int32_t asked, got;
        const char *file;
    } cases[] = {
        {QUELL_QUALITY_FAST, QUELL_QUALITY_FAST, "quell-fast.qwt"},
        {QUELL_QUALITY_BALANCED, QUELL_QUALITY_BALANCED, "quell-balanced.qwt"},
        {QUELL_QUALITY_DEFAULT, QUELL_QUALITY_BALANCED, "quell-balanced.qwt"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        quell_model *model;
        quell_model_info info = {.struct_size = sizeof info};
        assert_int_equal(quell_model_open_quality(*state, cases[i].asked, &model), QUELL_OK);
        assert_int_equal(quell_model_get_info(model, &info), QUELL_OK);
        assert_int_equal(info.quality, cases[i].got);
        assert_string_equal(info.weight_file, cases[i].file);
        quell_model_destroy(model);
    }
}

static void a_missing_level_names_its_file(void **state)
{
    quell_model *model = (quell_model *)(uintptr_t)1;
    assert_int_equal(quell_model_open_quality(*state, QUELL_QUALITY_HIGH, &model), QUELL_ERR_FILE_NOT_FOUND);
    assert_null(model);
    const char *const sentence = quell_context_last_error(*state);
    assert_non_null(strstr(sentence, "'high'"));
    assert_non_null(strstr(sentence, "some/folder/quell-high.qwt"));
    assert_non_null(strstr(sentence, "fast, balanced"));
}

static void what_is_no_level_is_refused(void **state)
{
    quell_model *model;
    assert_int_equal(quell_model_open_quality(*state, 4, &model), QUELL_ERR_INVALID_ARGUMENT);
    assert_null(model);
    assert_int_equal(quell_model_open_quality(*state, -1, &model), QUELL_ERR_INVALID_ARGUMENT);
    assert_int_equal(quell_model_open_quality(*state, QUELL_QUALITY_FAST, NULL), QUELL_ERR_INVALID_ARGUMENT);
    assert_int_equal(quell_model_open_quality(NULL, QUELL_QUALITY_FAST, &model), QUELL_ERR_INVALID_ARGUMENT);
}

static void other_models_have_no_level(void **state)
{
    static const char *const names[] = {"another", "tests/golden/quell_small.qwt"};
    static const char *const files[] = {"another.qwt", "tests/golden/quell_small.qwt"};
    quell_model *model;
    quell_model_info info = {.struct_size = sizeof info};
    for (size_t i = 0; i < 2; i++) {
        assert_int_equal(quell_model_open(*state, names[i], &model), QUELL_OK);
        assert_int_equal(quell_model_get_info(model, &info), QUELL_OK);
        assert_int_equal(info.quality, 0);
        assert_string_equal(info.weight_file, files[i]);
        quell_model_destroy(model);
    }
    assert_int_equal(quell_model_open_memory(*state, small, (size_t)(builtins[0].end - small), &model), QUELL_OK);
    assert_int_equal(quell_model_get_info(model, &info), QUELL_OK);
    assert_int_equal(info.quality, 0);
    assert_string_equal(info.weight_file, "");
    quell_model_destroy(model);
}

/* A caller compiled before these members were there passes a smaller struct. */
static void older_callers_are_filled_to_their_size(void **state)
{
    quell_model *model;
    quell_model_info info = {.struct_size = offsetof(quell_model_info, weight_file)};
    info.quality = 77;
    assert_int_equal(quell_model_open_quality(*state, QUELL_QUALITY_FAST, &model), QUELL_OK);
    assert_int_equal(quell_model_get_info(model, &info), QUELL_OK);
    assert_true(info.macs_per_pixel > 0.0);
    assert_int_equal(info.quality, 77);
    quell_model_destroy(model);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(levels_have_names),
        cmocka_unit_test(a_level_opens_its_network),
        cmocka_unit_test(a_missing_level_names_its_file),
        cmocka_unit_test(what_is_no_level_is_refused),
        cmocka_unit_test(other_models_have_no_level),
        cmocka_unit_test(older_callers_are_filled_to_their_size),
    };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
