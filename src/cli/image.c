/* SPDX-License-Identifier: Apache-2.0 */
/* Finds the module that writes pictures, beside the tool's library, and calls it. */
#include "cli/image_oiio.h"

#include <dlfcn.h>
#include <stdio.h>
#include <string.h>

int cli_image_write(const char *path, uint32_t width, uint32_t height, const uint8_t *pixels, char *error,
                    size_t error_bytes)
{
    /* A name without '/': the loader looks where the tool's RUNPATH says. Never closed, as OpenImageIO's libraries do
     * not expect to be. */
    void *module = dlopen(CLI_IMAGE_MODULE, RTLD_NOW | RTLD_LOCAL);
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
