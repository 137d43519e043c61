/* SPDX-License-Identifier: Apache-2.0 */
/* The Windows build has no OpenImageIO, and says so. */
#include "cli/image_oiio.h"

#include <stdio.h>

int cli_image_write(const char *path, uint32_t width, uint32_t height, const uint8_t *pixels, char *error,
                    size_t error_bytes)
{
    (void)path;
    (void)width;
    (void)height;
    (void)pixels;
    snprintf(error, error_bytes, "pictures need OpenImageIO, which the Windows build of quell does not have");
    return -1;
}
