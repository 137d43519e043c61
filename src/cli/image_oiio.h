/* SPDX-License-Identifier: Apache-2.0 */
/* Pictures for the screen, written by OpenImageIO: the C interface of a module that the tool loads when it first needs
 * it. OpenImageIO brings some 250 libraries along, whose loading would cost every run of the tool a third of a second. */
#ifndef CLI_IMAGE_OIIO_H
#define CLI_IMAGE_OIIO_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define CLI_IMAGE_MODULE "quell_oiio.so"
#define CLI_IMAGE_SYMBOL "cli_image_write_oiio"

/* Writes packed 8-bit sRGB pixels [height][width][3]; the format is that of the path's extension (png, jpg, ...).
 * Returns 0, or -1 with a sentence in error. */
typedef int cli_image_write_fn(const char *path, uint32_t width, uint32_t height, const uint8_t *pixels, char *error,
                               size_t error_bytes);

#if defined(__GNUC__)
__attribute__((visibility("default")))
#endif
cli_image_write_fn cli_image_write_oiio; /* in the module */

cli_image_write_fn cli_image_write; /* in the tool: loads the module and passes on */

#ifdef __cplusplus
}
#endif

#endif
