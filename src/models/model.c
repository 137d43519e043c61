/* SPDX-License-Identifier: Apache-2.0 */
/* Opens models by name, by path or from memory. */
#include "models/model.h"

#include "base/os.h"
#include "models/builtin.h"
#include "models/quality.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MAX_FILE_BYTES = 1 << 28 };

enum { FAMILY_QUELL, FAMILY_DGAN, NUM_FAMILIES };

struct ql_model {
    ql_memory memory;
    int32_t family;
    union {
        ql_net net;
        ql_dgan dgan;
    };
    char name[64], description[256], sha256[65];
    char *file;      /* as quell_model_info has it */
    int32_t quality; /* QUELL_QUALITY_*, 0 for none */
};

static quell_status load_network(ql_model *model, const char *kind, const ql_weights *weights, ql_error *err)
{
    static const char *const kinds[NUM_FAMILIES] = {"quell-5", "dgan-kpn-1"};
    model->family = 0;
    while (model->family < NUM_FAMILIES && strcmp(kind, kinds[model->family]) != 0) ++model->family;
    if (model->family == FAMILY_QUELL) return ql_net_load(&model->net, weights, &model->memory, err);
    if (model->family == FAMILY_DGAN) return ql_dgan_load(&model->dgan, weights, &model->memory, err);
    return ql_fail(err, QUELL_ERR_BAD_MODEL, "%s: a network of kind '%s', which this version does not run",
                   weights->origin, kind);
}

static void free_model(ql_model *model)
{
    ql_free(&model->memory, model->file);
    free(model);
}

/* file: where the data is from, "" for memory; origin: what messages call it. */
static quell_status open_data(const void *data, size_t size_bytes, const char *file, const char *origin, ql_model **out,
                              ql_error *err)
{
    ql_weights weights;
    *out = NULL;
    ql_model *const model = calloc(1, sizeof *model);
    if (model == NULL) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: out of memory", origin);
    ql_memory_init(&model->memory, 0);
    model->file = ql_alloc(&model->memory, strlen(file) + 1, 1);
    if (model->file == NULL) {
        free_model(model);
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: out of memory", origin);
    }
    memcpy(model->file, file, strlen(file) + 1);
    quell_status status = ql_weights_open(&weights, data, size_bytes, origin, &model->memory, err);
    if (status == QUELL_OK) {
        char kind[32];
        ql_weights_get_text(&weights, "meta.kind", kind, sizeof kind);
        ql_weights_get_text(&weights, "meta.name", model->name, sizeof model->name);
        ql_weights_get_text(&weights, "meta.description", model->description, sizeof model->description);
        memcpy(model->sha256, weights.sha256, sizeof model->sha256);
        status = load_network(model, kind, &weights, err);
        ql_weights_close(&weights, &model->memory);
    }
    if (status != QUELL_OK) {
        free_model(model);
        return status;
    }
    *out = model;
    return QUELL_OK;
}

quell_status ql_model_open_memory(const void *data, size_t size_bytes, ql_model **out, ql_error *err)
{
    return open_data(data, size_bytes, "", "weights in memory", out, err);
}

static quell_status open_builtin(const ql_builtin *builtin, ql_model **out, ql_error *err)
{
    QL_TRY(open_data(builtin->begin, (size_t)(builtin->end - builtin->begin), builtin->file, builtin->name, out, err));
    (*out)->quality = ql_quality_of(builtin->name);
    return QUELL_OK;
}

static quell_status read_file(const char *path, ql_memory *memory, uint8_t **data, size_t *size_bytes, ql_error *err)
{
    FILE *const file = ql_os_fopen(path, "rb");
    if (file == NULL)
        return ql_fail(err, QUELL_ERR_FILE_NOT_FOUND,
                       "%s: no built-in model of that name, and no such weight file (%s)", path, strerror(errno));
    quell_status status = QUELL_ERR_FILE_READ;
    *data = NULL;
    long size = -1;
    if (fseek(file, 0, SEEK_END) == 0) size = ftell(file);
    if (size < 0 || fseek(file, 0, SEEK_SET) != 0) {
        ql_fail(err, status, "%s: cannot be read", path);
    } else if (size > MAX_FILE_BYTES) {
        status = ql_fail(err, QUELL_ERR_BAD_MODEL, "%s: too large for a weight file", path);
    } else if ((*data = ql_alloc(memory, (size_t)size, 1)) == NULL) {
        status = ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: out of memory", path);
    } else if (fread(*data, 1, (size_t)size, file) != (size_t)size) {
        ql_fail(err, status, "%s: cannot be read to its end", path);
        ql_free(memory, *data);
        *data = NULL;
    } else {
        *size_bytes = (size_t)size;
        status = QUELL_OK;
    }
    fclose(file);
    return status;
}

quell_status ql_model_open(const char *name_or_path, ql_model **out, ql_error *err)
{
    const char *const name = name_or_path && *name_or_path ? name_or_path : ql_builtin_get(0)->name;
    const ql_builtin *const builtin = ql_builtin_find(name);
    *out = NULL;
    if (builtin != NULL) return open_builtin(builtin, out, err);
    ql_memory memory;
    uint8_t *data = NULL;
    size_t size_bytes = 0;
    ql_memory_init(&memory, 0);
    QL_TRY(read_file(name, &memory, &data, &size_bytes, err));
    const quell_status status = open_data(data, size_bytes, name, name, out, err);
    ql_free(&memory, data);
    return status;
}

void ql_model_destroy(ql_model *model)
{
    if (model == NULL) return;
    if (model->family == FAMILY_DGAN)
        ql_dgan_free(&model->dgan, &model->memory);
    else
        ql_net_free(&model->net, &model->memory);
    free_model(model);
}

void ql_model_get_info(const ql_model *model, quell_model_info *info)
{
    memset(info, 0, sizeof *info);
    info->struct_size = sizeof *info;
    info->file_version = QL_WEIGHTS_VERSION;
    info->name = model->name;
    info->description = model->description;
    info->sha256 = model->sha256;
    info->weight_file = model->file;
    info->quality = model->quality;
    if (model->family == FAMILY_DGAN) {
        const double generator = ql_generator_macs_per_pixel(&model->dgan.generator);
        info->macs_per_pixel = generator + ql_kpn_macs_per_pixel(&model->dgan.kpn);
        info->macs_per_pixel_all = info->macs_per_pixel;
        info->num_parameters = model->dgan.num_parameters;
        return;
    }
    info->num_parameters = model->net.num_parameters;
    info->macs_per_pixel = ql_net_macs_per_pixel(&model->net, 2); /* Combined and its albedo */
    info->macs_per_pixel_all = ql_net_macs_per_pixel(&model->net, QL_NET_GROUPS - 1);
}

const char *ql_model_builtin_name(uint32_t index)
{
    const ql_builtin *const builtin = ql_builtin_get(index);
    return builtin ? builtin->name : NULL;
}

const ql_net *ql_model_net(const ql_model *model)
{
    return model->family == FAMILY_QUELL ? &model->net : NULL;
}

const ql_dgan *ql_model_dgan(const ql_model *model)
{
    return model->family == FAMILY_DGAN ? &model->dgan : NULL;
}
