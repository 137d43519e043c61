/* SPDX-License-Identifier: Apache-2.0 */
/* A network's weights and shape, immutable once opened. */
#ifndef QL_MODELS_MODEL_H
#define QL_MODELS_MODEL_H

#include "base/memory.h"
#include "base/status.h"
#include "models/dgan.h"
#include "models/quell_net.h"

#include <stddef.h>

typedef struct ql_model ql_model;

/* name_or_path: NULL or "" for the default, a built-in name, or a weight file. */
quell_status ql_model_open(const char *name_or_path, ql_model **out, ql_error *err);
quell_status ql_model_open_memory(const void *data, size_t size_bytes, ql_model **out, ql_error *err);
void ql_model_destroy(ql_model *model);
void ql_model_get_info(const ql_model *model, quell_model_info *info); /* fills a full-size struct */
const char *ql_model_builtin_name(uint32_t index);

/* The network inside, by its family: NULL for a model of the other. */
const ql_net *ql_model_net(const ql_model *model);
const ql_dgan *ql_model_dgan(const ql_model *model);

#endif
