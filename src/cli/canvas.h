/* SPDX-License-Identifier: Apache-2.0 */
/* An 8-bit sRGB picture in memory and small capital letters on it. */
#ifndef CLI_CANVAS_H
#define CLI_CANVAS_H

#include <stdint.h>

typedef struct cli_canvas {
    uint32_t width, height;
    uint8_t *pixels; /* [height][width][3] */
} cli_canvas;

/* 0, or -1 without memory. All pixels are `grey`. */
int cli_canvas_create(cli_canvas *canvas, uint32_t width, uint32_t height, uint8_t grey);
void cli_canvas_destroy(cli_canvas *canvas);

/* White letters of 5x7 cells, `size` pixels to a dot, on a dark box whose corner is (x, y). Letters without a glyph are
 * left blank; what lies outside the canvas or right of x_end is cut. */
void cli_canvas_text(cli_canvas *canvas, uint32_t x, uint32_t y, uint32_t x_end, uint32_t size, const char *text);

#endif
