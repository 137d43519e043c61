/* SPDX-License-Identifier: Apache-2.0 */
/* Finds the module that writes pictures, beside the tool's library, and calls it. */
#include "cli/image_oiio.h"

#include <dlfcn.h>
#include <limits.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#define FOLDER "/../lib/quell/"

/* From the tool's own place, as its RUNPATH would have it: sanitizers stand between dlopen and the RUNPATH. */
static void *open_module(void)
{
    char path[PATH_MAX + sizeof FOLDER + sizeof CLI_IMAGE_MODULE];
    const ssize_t length = readlink("/proc/self/exe", path, PATH_MAX);
    if (length <= 0) return dlopen(CLI_IMAGE_MODULE, RTLD_NOW | RTLD_LOCAL);
    path[length] = '\0';
    char *slash = strrchr(path, '/');
    memcpy(slash ? slash : path, FOLDER CLI_IMAGE_MODULE, sizeof FOLDER CLI_IMAGE_MODULE);
    return dlopen(path, RTLD_NOW | RTLD_LOCAL);
}

int cli_image_write(const char *path, uint32_t width, uint32_t height, const uint8_t *pixels, char *error,
                    size_t error_bytes)
{
    /* Never closed: OpenImageIO's libraries do not expect to be. */
    void *module = open_module();
    void *symbol = module ? dlsym(module, CLI_IMAGE_SYMBOL) : NULL;
    if (!symbol) {
        const char *reason = dlerror();
        snprintf(error, error_bytes, "pictures need OpenImageIO (%s)", reason ? reason : "unknown reason");
        return -1;
    }
    cli_image_write_fn *write;
    memcpy(&write, &symbol, sizeof write); /* ISO C has no cast from data to functions; POSIX says that they fit */
    return write(path, width, height, pixels, error, error_bytes);
}
