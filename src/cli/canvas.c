/* SPDX-License-Identifier: Apache-2.0 */
/* The letters are our own and drawn here, because a machine that renders often has no fonts. */
#include "cli/canvas.h"

#include <stdlib.h>
#include <string.h>

#define GLYPH_WIDTH 5
#define GLYPH_HEIGHT 7

typedef struct glyph {
    char letter;
    const char *rows; /* GLYPH_HEIGHT rows of GLYPH_WIDTH dots */
} glyph;

/* clang-format off */
static const glyph glyphs[] = {
    {'A', " ### #   ##   #######   ##   ##   #"}, {'B', "#### #   ##   ##### #   ##   ##### "},
    {'C', " ### #   ##    #    #    #   # ### "}, {'D', "#### #   ##   ##   ##   ##   ##### "},
    {'E', "######    #    #### #    #    #####"}, {'F', "######    #    #### #    #    #    "},
    {'G', " ### #   ##    # ####   ##   # ### "}, {'H', "#   ##   ##   #######   ##   ##   #"},
    {'I', " ###   #    #    #    #    #   ### "}, {'J', "  ###   #    #    #    # #  #  ##  "},
    {'K', "#   ##  # # #  ##   # #  #  # #   #"}, {'L', "#    #    #    #    #    #    #####"},
    {'M', "#   ### ### # ## # ##   ##   ##   #"}, {'N', "#   ###  ## # ##  ###   ##   ##   #"},
    {'O', " ### #   ##   ##   ##   ##   # ### "}, {'P', "#### #   ##   ##### #    #    #    "},
    {'Q', " ### #   ##   ##   ## # ##  #  ## #"}, {'R', "#### #   ##   ##### # #  #  # #   #"},
    {'S', " #####    #     ###     #    ##### "}, {'T', "#####  #    #    #    #    #    #  "},
    {'U', "#   ##   ##   ##   ##   ##   # ### "}, {'V', "#   ##   ##   ##   ##   # # #   #  "},
    {'W', "#   ##   ##   ## # ## # ### ###   #"}, {'X', "#   ##   # # #   #   # # #   ##   #"},
    {'Y', "#   ##   # # #   #    #    #    #  "}, {'Z', "#####    #   #   #   #   #    #####"},
    {'0', " ### #   ##  ### # ###  ##   # ### "}, {'1', "  #   ##    #    #    #    #   ### "},
    {'2', " ### #   #    #   #   #   #   #####"}, {'3', "#####   #   #     #     ##   # ### "},
    {'4', "   #   ##  # # #  # #####   #    # "}, {'5', "######    ####     #    ##   # ### "},
    {'6', "  ##  #   #    #### #   ##   # ### "}, {'7', "#####    #   #   #   #    #    #   "},
    {'8', " ### #   ##   # ### #   ##   # ### "}, {'9', " ### #   ##   # ####    #   #  ##  "},
    {'.', "                           ##   ## "}, {'-', "               #####               "},
    {'_', "                              #####"}, {'/', "         #   #   #   #   #         "},
    {'(', "   #   #   #    #    #     #     # "}, {')', " #     #     #    #    #   #   #   "},
    {':', "      ##   ##        ##   ##       "}, {'+', "       #    #  #####  #    #       "},
};
/* clang-format on */

static const char *find_glyph(char letter)
{
    if (letter >= 'a' && letter <= 'z') letter = (char)(letter - 'a' + 'A');
    for (size_t i = 0; i < sizeof glyphs / sizeof *glyphs; i++) {
        if (glyphs[i].letter == letter) return glyphs[i].rows;
    }
    return NULL;
}

static void fill(cli_canvas *canvas, uint32_t x, uint32_t y, uint32_t width, uint32_t height, uint32_t x_end,
                 uint8_t grey)
{
    for (uint32_t j = y; j < y + height && j < canvas->height; j++) {
        for (uint32_t i = x; i < x + width && i < canvas->width && i < x_end; i++) {
            memset(canvas->pixels + 3 * ((size_t)j * canvas->width + i), grey, 3);
        }
    }
}

int cli_canvas_create(cli_canvas *canvas, uint32_t width, uint32_t height, uint8_t grey)
{
    const uint64_t bytes = 3 * (uint64_t)width * height;
    canvas->width = width;
    canvas->height = height;
    canvas->pixels = bytes < SIZE_MAX ? malloc((size_t)bytes) : NULL;
    if (!canvas->pixels) return -1;
    memset(canvas->pixels, grey, (size_t)bytes);
    return 0;
}

void cli_canvas_destroy(cli_canvas *canvas)
{
    free(canvas->pixels);
    canvas->pixels = NULL;
}

void cli_canvas_text(cli_canvas *canvas, uint32_t x, uint32_t y, uint32_t x_end, uint32_t size, const char *text)
{
    const uint32_t advance = (GLYPH_WIDTH + 1) * size;
    const uint32_t length = (uint32_t)strlen(text);
    fill(canvas, x, y, length * advance + 3 * size, (GLYPH_HEIGHT + 4) * size, x_end, 20);
    for (uint32_t k = 0; k < length; k++) {
        const char *rows = find_glyph(text[k]);
        if (!rows) continue;
        for (uint32_t dot = 0; dot < GLYPH_WIDTH * GLYPH_HEIGHT; dot++) {
            if (rows[dot] != '#') continue;
            fill(canvas, x + 2 * size + k * advance + dot % GLYPH_WIDTH * size, y + (2 + dot / GLYPH_WIDTH) * size,
                 size, size, x_end, 240);
        }
    }
}
