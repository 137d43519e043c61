/* SPDX-License-Identifier: Apache-2.0 */
/* The quality levels: which network of the library each of them is. */
#ifndef QL_MODELS_QUALITY_H
#define QL_MODELS_QUALITY_H

#include "models/model.h"

/* Name of a level, "fast"; NULL for numbers that are none. QUELL_QUALITY_DEFAULT is none. */
const char *ql_quality_name(int32_t quality);

/* Level of a built-in model by its name, QUELL_QUALITY_*; 0 where it is none. */
int32_t ql_quality_of(const char *model_name);

/* Opens the network of a level, QUELL_QUALITY_*. Errors: QUELL_ERR_INVALID_ARGUMENT; QUELL_ERR_FILE_NOT_FOUND where the
 * library was built without its weight file; those of ql_model_open. */
quell_status ql_quality_open(int32_t quality, ql_model **out, ql_error *err);

#endif
