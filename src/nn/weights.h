/* SPDX-License-Identifier: Apache-2.0 */
/* Weight files: named records, bounds-checked, closed by a SHA-256 (docs/FORMATS.md). The reader trusts nothing. */
#ifndef QL_NN_WEIGHTS_H
#define QL_NN_WEIGHTS_H

#include "base/memory.h"
#include "base/status.h"

#include <stddef.h>
#include <stdint.h>

enum { QL_WEIGHTS_VERSION = 1, QL_RECORD_NAME_BYTES = 48 };
enum { QL_RECORD_FLOAT = 0, QL_RECORD_HALF = 1, QL_RECORD_INT = 2, QL_RECORD_TEXT = 3 };

typedef struct ql_record {
    char name[QL_RECORD_NAME_BYTES]; /* NUL-terminated */
    uint32_t type, num_dims, dims[4];
    size_t num_values;
    const uint8_t *data; /* little-endian values inside the file's bytes */
} ql_record;

typedef struct ql_weights {
    const char *origin; /* for messages; lent */
    char sha256[65];    /* of the whole file */
    ql_record *records;
    uint32_t num_records;
} ql_weights;

/* Checks data, which must outlive weights. origin: the file's name. */
quell_status ql_weights_open(ql_weights *weights, const void *data, size_t size_bytes, const char *origin,
                             ql_memory *memory, ql_error *err);
void ql_weights_close(ql_weights *weights, ql_memory *memory);

const ql_record *ql_weights_find(const ql_weights *weights, const char *name); /* NULL if absent */

/* Copies num int32 values of a record that must have just as many. */
quell_status ql_weights_get_ints(const ql_weights *weights, const char *name, int32_t *out, size_t num, ql_error *err);

/* Copies a float or half record of the given number of values as floats. Non-finite values are QUELL_ERR_BAD_MODEL. */
quell_status ql_weights_get_floats(const ql_weights *weights, const char *name, float *out, size_t num, ql_error *err);

/* Copies a text record, cut at size_bytes - 1; "" if absent. */
void ql_weights_get_text(const ql_weights *weights, const char *name, char *out, size_t size_bytes);

#endif
