/* SPDX-License-Identifier: Apache-2.0 */
/* Aligned memory with a count of what is in use, and sizes whose overflow is an error rather than a surprise. */
#ifndef QL_BASE_MEMORY_H
#define QL_BASE_MEMORY_H

#include "base/status.h"

#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>

#define QL_ALIGNMENT 64 /* a cache line, and the widest vector */

enum { QL_MEMORY_MAX_SPARE = 16 };

/* Counts bytes from several threads; limit_bytes of 0 means none. fail_at is for tests: the n-th allocation from now
 * (1-based) fails, 0 never.
 *
 * Pages that are new to a process cost more than most of what is done to their pixels, so a long call may keep large
 * blocks that it has freed for its next steps (keeps_spare). They are given back to the system before it is asked for
 * another block, so that they never add to the peak, and no longer count as used. */
typedef struct ql_memory {
    atomic_uint_fast64_t used_bytes;
    atomic_uint_fast64_t peak_bytes;
    uint64_t limit_bytes;
    atomic_int_fast64_t fail_at;
    int keeps_spare; /* set while no other thread uses it; ql_memory_drop_spare must follow in the end */
    atomic_flag spare_lock;
    void *spare[QL_MEMORY_MAX_SPARE]; /* freed blocks, NULL where there is none */
} ql_memory;

void ql_memory_init(ql_memory *memory, uint64_t limit_bytes);

/* Gives the spare blocks back to the system. */
void ql_memory_drop_spare(ql_memory *memory);

/* num * size bytes aligned to QL_ALIGNMENT, or NULL (overflow, limit, or the system has none). Zero bytes give a valid
 * pointer. ql_free takes NULL. Memory is counted in `memory`, which must be the same for both calls. */
void *ql_alloc(ql_memory *memory, size_t num, size_t size_bytes);
void *ql_alloc_zero(ql_memory *memory, size_t num, size_t size_bytes);
void ql_free(ql_memory *memory, void *pointer);
char *ql_strdup(ql_memory *memory, const char *text); /* NULL text gives NULL */

/* 0 and *out on success, -1 on overflow. */
int ql_mul_size(size_t a, size_t b, size_t *out);
int ql_add_size(size_t a, size_t b, size_t *out);

#endif
