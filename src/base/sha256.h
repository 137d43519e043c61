/* SPDX-License-Identifier: Apache-2.0 */
/* SHA-256 (FIPS 180-4), for naming and checking weight files. */
#ifndef QL_BASE_SHA256_H
#define QL_BASE_SHA256_H

#include <stddef.h>
#include <stdint.h>

typedef struct ql_sha256 {
    uint32_t state[8];
    uint64_t num_bytes;
    uint8_t block[64];
} ql_sha256;

void ql_sha256_init(ql_sha256 *hash);
void ql_sha256_add(ql_sha256 *hash, const void *data, size_t size_bytes);
void ql_sha256_end(const ql_sha256 *hash, uint8_t digest[32]); /* hash itself can go on */

#endif
