/* SPDX-License-Identifier: Apache-2.0 */
#if !defined(_GNU_SOURCE)
#define _GNU_SOURCE /* MAP_ANONYMOUS */
#endif
#define _DARWIN_C_SOURCE
#include "system.h"

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

static size_t page_bytes(void)
{
    return (size_t)sysconf(_SC_PAGESIZE);
}

static size_t used_bytes(size_t num_bytes)
{
    return (num_bytes + page_bytes() - 1) / page_bytes() * page_bytes();
}

void *test_alloc_guarded(size_t num_bytes)
{
    const size_t used = used_bytes(num_bytes);
    uint8_t *const base = mmap(NULL, used + page_bytes(), PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (base == MAP_FAILED || mprotect(base + used, page_bytes(), PROT_NONE) != 0) abort();
    return base + used - num_bytes;
}

void test_free_guarded(void *pointer, size_t num_bytes)
{
    const size_t used = used_bytes(num_bytes);
    munmap((uint8_t *)pointer + num_bytes - used, used + page_bytes());
}

int test_make_folder(char *path, size_t path_bytes)
{
    const char *temporary = getenv("TMPDIR");
    snprintf(path, path_bytes, "%s/quell-test-XXXXXX", temporary ? temporary : "/tmp");
    return mkdtemp(path) ? 0 : -1;
}
