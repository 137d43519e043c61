/* SPDX-License-Identifier: Apache-2.0 */
#include "system.h"

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <windows.h>

static size_t page_bytes(void)
{
    SYSTEM_INFO info;
    GetSystemInfo(&info);
    return info.dwPageSize;
}

static size_t used_bytes(size_t num_bytes)
{
    return (num_bytes + page_bytes() - 1) / page_bytes() * page_bytes();
}

void *test_alloc_guarded(size_t num_bytes)
{
    const size_t used = used_bytes(num_bytes);
    DWORD before;
    uint8_t *const base = VirtualAlloc(NULL, used + page_bytes(), MEM_RESERVE | MEM_COMMIT, PAGE_READWRITE);
    if (!base || !VirtualProtect(base + used, page_bytes(), PAGE_NOACCESS, &before)) abort();
    return base + used - num_bytes;
}

void test_free_guarded(void *pointer, size_t num_bytes)
{
    VirtualFree((uint8_t *)pointer + num_bytes - used_bytes(num_bytes), 0, MEM_RELEASE);
}

int test_make_folder(char *path, size_t path_bytes)
{
    char temporary[MAX_PATH];
    const DWORD length = GetTempPathA(sizeof temporary, temporary);
    if (length == 0 || length > sizeof temporary) return -1;
    snprintf(path, path_bytes, "%squell-test-%lu-%lu", temporary, GetCurrentProcessId(), GetTickCount());
    return CreateDirectoryA(path, NULL) ? 0 : -1;
}
