/* SPDX-License-Identifier: Apache-2.0 */
#include "models/quality.h"

#include "models/builtin.h"

#include <stdio.h>
#include <string.h>

typedef struct level {
    const char *name, *model;
} level;

enum { NUM_LEVELS = QUELL_QUALITY_HIGH + 1 };

static const level levels[NUM_LEVELS] = {
    [QUELL_QUALITY_FAST] = {"fast", "quell-fast"},
    [QUELL_QUALITY_BALANCED] = {"balanced", "quell-balanced"},
    [QUELL_QUALITY_HIGH] = {"high", "quell-high"},
};

static int is_level(int32_t quality)
{
    return quality >= QUELL_QUALITY_FAST && quality < NUM_LEVELS;
}

const char *ql_quality_name(int32_t quality)
{
    return is_level(quality) ? levels[quality].name : NULL;
}

int32_t ql_quality_of(const char *model_name)
{
    for (int32_t q = QUELL_QUALITY_FAST; q < NUM_LEVELS; ++q)
        if (strcmp(levels[q].model, model_name) == 0) return q;
    return 0;
}

static quell_status fail_missing(const level *missing, ql_error *err)
{
    char others[64] = "";
    for (int32_t q = QUELL_QUALITY_FAST; q < NUM_LEVELS; ++q) {
        const size_t length = strlen(others);
        if (ql_builtin_find(levels[q].model) != NULL)
            snprintf(others + length, sizeof others - length, "%s%s", length ? ", " : "", levels[q].name);
    }
    return ql_fail(err, QUELL_ERR_FILE_NOT_FOUND,
                   "quality '%s': this library was built without %s/%s.qwt: build it again with that file there, or "
                   "choose a level that it has (%s)",
                   missing->name, ql_builtin_folder(), missing->model, others[0] ? others : "none");
}

quell_status ql_quality_open(int32_t quality, ql_model **out, ql_error *err)
{
    *out = NULL;
    if (quality == QUELL_QUALITY_DEFAULT) quality = QUELL_QUALITY_BALANCED;
    if (!is_level(quality))
        return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "quality %d is no level: QUELL_QUALITY_FAST, _BALANCED, _HIGH",
                       quality);
    if (ql_builtin_find(levels[quality].model) == NULL) return fail_missing(&levels[quality], err);
    return ql_model_open(levels[quality].model, out, err);
}
