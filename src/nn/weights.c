/* SPDX-License-Identifier: Apache-2.0 */
/* Reads weight files. Every offset is compared with what remains before it is used. */
#include "nn/weights.h"

#include "base/half.h"
#include "base/sha256.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { HEADER_BYTES = 24, ENTRY_BYTES = 88, DIGEST_BYTES = 32, MAX_RECORDS = 4096 };

static uint32_t read_u32(const uint8_t *p)
{
    return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

static uint64_t read_u64(const uint8_t *p)
{
    return (uint64_t)read_u32(p) | (uint64_t)read_u32(p + 4) << 32;
}

static size_t value_bytes(uint32_t type)
{
    return type == QL_RECORD_TEXT ? 1 : type == QL_RECORD_HALF ? 2 : 4;
}

static quell_status check_digest(ql_weights *weights, const uint8_t *data, size_t size_bytes, ql_error *err)
{
    ql_sha256 hash;
    uint8_t digest[DIGEST_BYTES];
    ql_sha256_init(&hash);
    ql_sha256_add(&hash, data, size_bytes - DIGEST_BYTES);
    ql_sha256_end(&hash, digest);
    if (memcmp(digest, data + size_bytes - DIGEST_BYTES, DIGEST_BYTES) != 0)
        return ql_fail(err, QUELL_ERR_BAD_MODEL, "%s: the weight file is damaged (its checksum differs); copy it again",
                       weights->origin);
    ql_sha256_add(&hash, digest, sizeof digest);
    ql_sha256_end(&hash, digest);
    for (size_t i = 0; i < DIGEST_BYTES; ++i) snprintf(weights->sha256 + 2 * i, 3, "%02x", digest[i]);
    return QUELL_OK;
}

/* One entry of the table: name 48, type 4, dims 4 + 4 x 4, offset 8, bytes 8. */
static quell_status read_entry(ql_record *record, const uint8_t *entry, const uint8_t *data, size_t data_bytes,
                               const char *origin, ql_error *err)
{
    memcpy(record->name, entry, QL_RECORD_NAME_BYTES);
    if (memchr(record->name, 0, QL_RECORD_NAME_BYTES) == NULL)
        return ql_fail(err, QUELL_ERR_BAD_MODEL, "%s: the weight file has a record without a name", origin);
    record->type = read_u32(entry + 48);
    record->num_dims = read_u32(entry + 52);
    const uint64_t offset = read_u64(entry + 72), num_bytes = read_u64(entry + 80);
    size_t num_values = 1;
    int bad = record->type > QL_RECORD_TEXT || record->num_dims < 1 || record->num_dims > 4;
    for (uint32_t i = 0; i < 4; ++i) {
        record->dims[i] = read_u32(entry + 56 + 4 * i);
        if (!bad && i < record->num_dims) bad = ql_mul_size(num_values, record->dims[i], &num_values) != 0;
    }
    size_t expected = 0;
    bad = bad || ql_mul_size(num_values, value_bytes(record->type), &expected) != 0;
    if (bad || expected != num_bytes || offset > data_bytes || num_bytes > data_bytes - offset)
        return ql_fail(err, QUELL_ERR_BAD_MODEL, "%s: record '%s' of the weight file does not fit the file", origin,
                       record->name);
    record->num_values = num_values;
    record->data = data + offset;
    return QUELL_OK;
}

quell_status ql_weights_open(ql_weights *weights, const void *data, size_t size_bytes, const char *origin,
                             ql_memory *memory, ql_error *err)
{
    const uint8_t *bytes = data;
    memset(weights, 0, sizeof *weights);
    weights->origin = origin;
    if (size_bytes < HEADER_BYTES + DIGEST_BYTES || memcmp(bytes, "QUELLWTS", 8) != 0)
        return ql_fail(err, QUELL_ERR_BAD_MODEL, "%s: not a Quell weight file", origin);
    const uint32_t version = read_u32(bytes + 8), num_records = read_u32(bytes + 12);
    if (version != QL_WEIGHTS_VERSION)
        return ql_fail(err, QUELL_ERR_BAD_MODEL, "%s: weight file of version %u; this library reads version %d", origin,
                       version, QL_WEIGHTS_VERSION);
    if (read_u64(bytes + 16) != size_bytes)
        return ql_fail(err, QUELL_ERR_BAD_MODEL, "%s: the weight file is cut short (%zu bytes)", origin, size_bytes);
    QL_TRY(check_digest(weights, bytes, size_bytes, err));
    if (num_records > MAX_RECORDS || (size_t)num_records * ENTRY_BYTES > size_bytes - HEADER_BYTES - DIGEST_BYTES)
        return ql_fail(err, QUELL_ERR_BAD_MODEL, "%s: the weight file's table is too long", origin);
    weights->records = ql_alloc_zero(memory, num_records, sizeof *weights->records);
    if (weights->records == NULL) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: out of memory", origin);
    weights->num_records = num_records;
    for (uint32_t i = 0; i < num_records; ++i) {
        const quell_status status = read_entry(&weights->records[i], bytes + HEADER_BYTES + (size_t)i * ENTRY_BYTES,
                                               bytes, size_bytes - DIGEST_BYTES, origin, err);
        if (status != QUELL_OK) {
            ql_weights_close(weights, memory);
            return status;
        }
    }
    return QUELL_OK;
}

void ql_weights_close(ql_weights *weights, ql_memory *memory)
{
    ql_free(memory, weights->records);
    weights->records = NULL;
    weights->num_records = 0;
}

const ql_record *ql_weights_find(const ql_weights *weights, const char *name)
{
    for (uint32_t i = 0; i < weights->num_records; ++i)
        if (strcmp(weights->records[i].name, name) == 0) return &weights->records[i];
    return NULL;
}

static quell_status find_sized(const ql_weights *weights, const char *name, size_t num, const ql_record **out,
                               ql_error *err)
{
    *out = ql_weights_find(weights, name);
    if (*out == NULL)
        return ql_fail(err, QUELL_ERR_BAD_MODEL, "%s: the weight file lacks the record '%s'", weights->origin, name);
    if ((*out)->num_values != num)
        return ql_fail(err, QUELL_ERR_BAD_MODEL, "%s: record '%s' has %zu values, expected %zu", weights->origin, name,
                       (*out)->num_values, num);
    return QUELL_OK;
}

quell_status ql_weights_get_ints(const ql_weights *weights, const char *name, int32_t *out, size_t num, ql_error *err)
{
    const ql_record *record;
    QL_TRY(find_sized(weights, name, num, &record, err));
    if (record->type != QL_RECORD_INT)
        return ql_fail(err, QUELL_ERR_BAD_MODEL, "%s: record '%s' is not of integers", weights->origin, name);
    for (size_t i = 0; i < num; ++i) out[i] = (int32_t)read_u32(record->data + 4 * i);
    return QUELL_OK;
}

quell_status ql_weights_get_floats(const ql_weights *weights, const char *name, float *out, size_t num, ql_error *err)
{
    const ql_record *record;
    QL_TRY(find_sized(weights, name, num, &record, err));
    if (record->type != QL_RECORD_FLOAT && record->type != QL_RECORD_HALF)
        return ql_fail(err, QUELL_ERR_BAD_MODEL, "%s: record '%s' is not of floats", weights->origin, name);
    for (size_t i = 0; i < num; ++i) {
        if (record->type == QL_RECORD_HALF) {
            out[i] = ql_half_to_float((uint16_t)(record->data[2 * i] | record->data[2 * i + 1] << 8));
        } else {
            const uint32_t bits = read_u32(record->data + 4 * i);
            memcpy(&out[i], &bits, sizeof bits);
        }
        if (!isfinite(out[i]))
            return ql_fail(err, QUELL_ERR_BAD_MODEL, "%s: record '%s' holds a value that is not finite",
                           weights->origin, name);
    }
    return QUELL_OK;
}

void ql_weights_get_text(const ql_weights *weights, const char *name, char *out, size_t size_bytes)
{
    const ql_record *const record = ql_weights_find(weights, name);
    const int found = record != NULL && record->type == QL_RECORD_TEXT;
    const size_t num = !found ? 0 : record->num_values < size_bytes ? record->num_values : size_bytes - 1;
    if (num > 0) memcpy(out, record->data, num);
    out[num] = '\0';
}
