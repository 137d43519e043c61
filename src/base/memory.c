/* SPDX-License-Identifier: Apache-2.0 */
/* Aligned, counted allocation. Each block has one alignment unit in front of it that holds its size, so that ql_free
 * needs no size and the count cannot drift. */
#include "base/memory.h"

#include "base/os.h"

#include <string.h>

#define HEADER_BYTES QL_ALIGNMENT
#define LARGE_BYTES ((size_t)1 << 20) /* blocks that are worth keeping */

/* Under the address sanitizer a block that is freed must be seen to be. */
#if defined(__SANITIZE_ADDRESS__)
#define MAY_KEEP 0
#else
#define MAY_KEEP 1
#endif

typedef struct block_header {
    uint64_t total_bytes; /* what was asked from the system, header included */
} block_header;

_Static_assert(sizeof(block_header) <= HEADER_BYTES, "the header must fit before the aligned block");

static int is_made_to_fail(ql_memory *memory)
{
    int_fast64_t left = atomic_load_explicit(&memory->fail_at, memory_order_relaxed);
    while (left > 0) {
        if (atomic_compare_exchange_weak(&memory->fail_at, &left, left - 1)) return left == 1;
    }
    return 0;
}

/* Counts first and gives back on refusal, so that two threads cannot pass the limit together. */
static int reserve(ql_memory *memory, uint64_t bytes)
{
    const uint64_t used = (uint64_t)atomic_fetch_add(&memory->used_bytes, bytes) + bytes;
    if (memory->limit_bytes && used > memory->limit_bytes) {
        atomic_fetch_sub(&memory->used_bytes, bytes);
        return -1;
    }
    uint_fast64_t peak = atomic_load(&memory->peak_bytes);
    while (used > peak && !atomic_compare_exchange_weak(&memory->peak_bytes, &peak, used)) {
    }
    return 0;
}

/* ---- Large blocks ------------------------------------------------------------------------------------------------ */

static size_t block_bytes(const void *base)
{
    return (size_t)((const block_header *)base)->total_bytes;
}

static void lock_spare(ql_memory *memory)
{
    while (atomic_flag_test_and_set_explicit(&memory->spare_lock, memory_order_acquire)) {
    }
}

static void unlock_spare(ql_memory *memory)
{
    atomic_flag_clear_explicit(&memory->spare_lock, memory_order_release);
}

/* A spare block of exactly that size, or NULL. */
static void *take_spare(ql_memory *memory, size_t total)
{
    void *found = NULL;
    lock_spare(memory);
    for (size_t i = 0; i < QL_MEMORY_MAX_SPARE && !found; i++) {
        if (!memory->spare[i] || block_bytes(memory->spare[i]) != total) continue;
        found = memory->spare[i];
        memory->spare[i] = NULL;
    }
    unlock_spare(memory);
    return found;
}

/* Returns 0 when there is no room. */
static int keep_spare(ql_memory *memory, void *base)
{
    int is_kept = 0;
    lock_spare(memory);
    for (size_t i = 0; i < QL_MEMORY_MAX_SPARE && !is_kept; i++) {
        if (memory->spare[i]) continue;
        memory->spare[i] = base;
        is_kept = 1;
    }
    unlock_spare(memory);
    return is_kept;
}

void ql_memory_drop_spare(ql_memory *memory)
{
    lock_spare(memory);
    for (size_t i = 0; i < QL_MEMORY_MAX_SPARE; i++) {
        if (memory->spare[i]) ql_os_free_aligned(memory->spare[i]);
        memory->spare[i] = NULL;
    }
    unlock_spare(memory);
}

static uint8_t *get_block(ql_memory *memory, size_t total)
{
    if (memory->keeps_spare && total >= LARGE_BYTES) {
        uint8_t *const spare = take_spare(memory, total);
        if (spare) return spare;
        ql_memory_drop_spare(memory);
    }
    return ql_os_alloc_aligned(QL_ALIGNMENT, total);
}

/* ---- All blocks -------------------------------------------------------------------------------------------------- */

int ql_mul_size(size_t a, size_t b, size_t *out)
{
    if (b != 0 && a > SIZE_MAX / b) return -1;
    *out = a * b;
    return 0;
}

int ql_add_size(size_t a, size_t b, size_t *out)
{
    if (a > SIZE_MAX - b) return -1;
    *out = a + b;
    return 0;
}

void ql_memory_init(ql_memory *memory, uint64_t limit_bytes)
{
    atomic_init(&memory->used_bytes, 0);
    atomic_init(&memory->peak_bytes, 0);
    atomic_init(&memory->fail_at, 0);
    memory->limit_bytes = limit_bytes;
    memory->keeps_spare = 0;
    atomic_flag_clear(&memory->spare_lock);
    memset(memory->spare, 0, sizeof memory->spare);
}

void *ql_alloc(ql_memory *memory, size_t num, size_t size_bytes)
{
    size_t bytes, total;
    if (ql_mul_size(num, size_bytes, &bytes) != 0) return NULL;
    if (ql_add_size(bytes, HEADER_BYTES + QL_ALIGNMENT - 1, &total) != 0) return NULL;
    total -= total % QL_ALIGNMENT; /* ql_os_alloc_aligned wants a multiple */

    if (is_made_to_fail(memory) || reserve(memory, total) != 0) return NULL;
    uint8_t *base = get_block(memory, total);
    if (!base) {
        atomic_fetch_sub(&memory->used_bytes, (uint64_t)total);
        return NULL;
    }
    *(block_header *)(void *)base = (block_header){.total_bytes = total};
    return base + HEADER_BYTES;
}

void *ql_alloc_zero(ql_memory *memory, size_t num, size_t size_bytes)
{
    void *pointer = ql_alloc(memory, num, size_bytes);
    if (pointer) memset(pointer, 0, num * size_bytes); /* the product was checked by ql_alloc */
    return pointer;
}

void ql_free(ql_memory *memory, void *pointer)
{
    if (!pointer) return;
    uint8_t *base = (uint8_t *)pointer - HEADER_BYTES;
    const size_t total = block_bytes(base);
    atomic_fetch_sub(&memory->used_bytes, (uint64_t)total);
    if (MAY_KEEP && memory->keeps_spare && total >= LARGE_BYTES && keep_spare(memory, base)) return;
    ql_os_free_aligned(base);
}

char *ql_strdup(ql_memory *memory, const char *text)
{
    if (!text) return NULL;
    const size_t bytes = strlen(text) + 1;
    char *copy = ql_alloc(memory, bytes, 1);
    if (copy) memcpy(copy, text, bytes);
    return copy;
}
