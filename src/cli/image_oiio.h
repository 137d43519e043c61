/* SPDX-License-Identifier: Apache-2.0 */
/* Pictures for the screen, written by OpenImageIO. The only door to C++ and to OpenImageIO in the tool. */
#ifndef CLI_IMAGE_OIIO_H
#define CLI_IMAGE_OIIO_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Writes packed 8-bit sRGB pixels [height][width][3]; the format is that of the path's extension (png, jpg, ...).
 * Returns 0, or -1 with a sentence in error. */
int cli_image_write(const char *path, uint32_t width, uint32_t height, const uint8_t *pixels, char *error,
                    size_t error_bytes);

#ifdef __cplusplus
}
#endif

#endif
