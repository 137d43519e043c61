/* SPDX-License-Identifier: Apache-2.0 */
/* quell preview: one layer of each file, side by side, as a picture for the screen. */
#include "cli/canvas.h"
#include "cli/cli.h"
#include "cli/image_oiio.h"
#include "cli/layers.h"
#include "cli/paths.h"
#include "cli/platform.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char help_text[] =
    "Usage: quell preview IN.exr [more.exr...] -o OUT.png [OPTION...]\n"
    "\n"
    "Writes a layer as a picture (PNG, or what the extension says): scaled by 2^EV, clipped to 0..1, sRGB curve.\n"
    "Several files of one size are put side by side.\n"
    "\n"
    "  -o, --output OUT.png\n"
    "  -l, --layer NAME      full name or pass; default Combined, else the file's first layer\n"
    "  -e, --exposure EV     stops; default 0\n"
    "      --labels[=A,B,C]  write a label on each picture: the file's name, or the given texts\n"
    "      --crop WxH+X+Y    only this part\n"
    "      --zoom N          each pixel N times as large\n"
    "  -h, --help\n";

enum { OPT_LABELS = CLI_OPT_OWN, OPT_CROP, OPT_ZOOM, GAP = 4, MAX_SIDE = 65535 };

typedef struct preview_args {
    cli_common common;
    const char *output, *layer;
    const char *label_list; /* NULL: file names */
    double exposure;
    int has_labels, has_crop;
    uint32_t crop_width, crop_height, crop_x, crop_y;
    uint32_t zoom;
    char **inputs;
    int num_inputs;
} preview_args;

/* ---- Arguments --------------------------------------------------------------------------------------------------- */

static int parse_crop(preview_args *args, const char *text)
{
    int end = 0;
    const int found =
        sscanf(text, "%ux%u+%u+%u%n", &args->crop_width, &args->crop_height, &args->crop_x, &args->crop_y, &end);
    if (found != 4 || text[end] != '\0' || args->crop_width == 0 || args->crop_height == 0) return -1;
    args->has_crop = 1;
    return 0;
}

static int own_option(preview_args *args, int code, const char *argument)
{
    uint64_t value;
    switch (code) {
    case 'o': args->output = argument; return 0;
    case 'l': args->layer = argument; return 0;
    case 'e':
        if (cli_parse_double(argument, &args->exposure) == 0 && fabs(args->exposure) <= 100.0) return 0;
        return cli_usage_error("preview", "--exposure: '%s' is not a number of stops", argument);
    case OPT_LABELS:
        args->has_labels = 1;
        args->label_list = argument;
        return 0;
    case OPT_CROP:
        if (parse_crop(args, argument) == 0) return 0;
        return cli_usage_error("preview", "--crop: '%s' is not of the form WxH+X+Y", argument);
    case OPT_ZOOM:
        if (cli_parse_uint(argument, 64, &value) != 0 || value == 0) {
            return cli_usage_error("preview", "--zoom: '%s' is not a number from 1 to 64", argument);
        }
        args->zoom = (uint32_t)value;
        return 0;
    default: return cli_common_option(&args->common, "preview", code, argument);
    }
}

static int parse(int argc, char **argv, preview_args *args, int *wants_help)
{
    static const struct option options[] = {
        CLI_COMMON_OPTIONS,
        {"output", required_argument, NULL, 'o'},
        {"layer", required_argument, NULL, 'l'},
        {"exposure", required_argument, NULL, 'e'},
        {"labels", optional_argument, NULL, OPT_LABELS},
        {"crop", required_argument, NULL, OPT_CROP},
        {"zoom", required_argument, NULL, OPT_ZOOM},
        {NULL, 0, NULL, 0},
    };
    int code;
    while ((code = getopt_long(argc, argv, "o:l:e:h", options, NULL)) != -1) {
        if (code == CLI_OPT_HELP) {
            *wants_help = 1;
            return 0;
        }
        const int failure = own_option(args, code, optarg);
        if (failure) return failure;
    }
    args->inputs = argv + optind;
    args->num_inputs = argc - optind;
    if (args->num_inputs == 0) return cli_usage_error("preview", "no input file");
    if (!args->output || !args->output[0]) return cli_usage_error("preview", "no output: say where with -o");
    for (int i = 0; i < args->num_inputs; i++) {
        if (cli_is_same_file(args->output, args->inputs[i])) {
            return cli_usage_error("preview", "'%s' would replace the input '%s'", args->output, args->inputs[i]);
        }
    }
    return 0;
}

/* ---- Pixels ------------------------------------------------------------------------------------------------------ */

/* IEC 61966-2-1. */
static uint8_t srgb_from_linear(double value)
{
    if (!(value > 0.0)) return 0; /* NaN too */
    if (value >= 1.0) return 255;
    const double encoded = value <= 0.0031308 ? 12.92 * value : 1.055 * pow(value, 1.0 / 2.4) - 0.055;
    return (uint8_t)(255.0 * encoded + 0.5);
}

static int64_t choose_layer(const preview_args *args, const quell_frame *frame)
{
    if (args->layer) return quell_frame_find_layer(frame, args->layer);
    quell_layer_info info = {.struct_size = sizeof info};
    for (uint32_t i = 0; quell_frame_get_layer(frame, i, &info) == QUELL_OK; i++) {
        if (info.role == QUELL_ROLE_COMBINED) return i;
    }
    return quell_frame_num_layers(frame) > 0 ? 0 : -1;
}

static int load(quell_context *ctx, const preview_args *args, const char *path, quell_image *image)
{
    quell_frame *frame;
    const quell_status status = quell_frame_read_exr(ctx, path, &frame);
    if (status != QUELL_OK) return cli_error_status(path, ctx, status);
    const int64_t layer = choose_layer(args, frame);
    int code;
    if (layer < 0) {
        cli_error(path, args->layer ? "has no layer '%s'; quell inspect lists those it has" : "has no layers",
                  args->layer);
        code = CLI_EXIT_NO_LAYER;
    } else {
        code = cli_layer_pixels(ctx, path, frame, (uint32_t)layer, 3, image);
    }
    quell_frame_destroy(frame);
    return code;
}

static void draw_image(const preview_args *args, const quell_image *image, cli_canvas *canvas, uint32_t left)
{
    const float *pixels = image->data;
    const double scale = exp2(args->exposure);
    const uint32_t channels = image->num_channels;
    const uint32_t width = args->crop_width * args->zoom;
    for (uint32_t y = 0; y < canvas->height; y++) {
        const size_t row = (size_t)(args->crop_y + y / args->zoom) * image->width;
        for (uint32_t x = 0; x < width; x++) {
            const float *in = pixels + (row + args->crop_x + x / args->zoom) * channels;
            uint8_t *out = canvas->pixels + 3 * ((size_t)y * canvas->width + left + x);
            for (uint32_t c = 0; c < 3; c++) {
                out[c] = channels == 2 && c == 2 ? 0 : srgb_from_linear(scale * (double)in[channels == 1 ? 0 : c]);
            }
        }
    }
}

/* The index-th text of a comma-separated list, or the file's name without extension. */
static void label_of(const preview_args *args, int index, char *out, size_t out_bytes)
{
    const char *text = args->label_list ? args->label_list : cli_base_name(args->inputs[index]);
    const char *stop = args->label_list ? "," : ".";
    for (int i = 0; args->label_list && i < index && text; i++) {
        text = strchr(text, ',');
        if (text) text++;
    }
    if (!text) text = "";
    snprintf(out, out_bytes, "%.*s", (int)strcspn(text, stop), text);
}

static int check_crop(preview_args *args, const quell_image *image, const char *path)
{
    if (!args->has_crop) {
        args->crop_width = image->width;
        args->crop_height = image->height;
    }
    if ((uint64_t)args->crop_x + args->crop_width > image->width ||
        (uint64_t)args->crop_y + args->crop_height > image->height) {
        cli_error(path, "--crop lies outside its %u x %u pixels", image->width, image->height);
        return CLI_EXIT_SIZE;
    }
    const uint64_t width = ((uint64_t)args->crop_width * args->zoom + GAP) * (uint64_t)args->num_inputs;
    if (width > MAX_SIDE || (uint64_t)args->crop_height * args->zoom > MAX_SIDE) {
        cli_error(path, "the picture would be larger than %d pixels", MAX_SIDE);
        return CLI_EXIT_SIZE;
    }
    return CLI_EXIT_OK;
}

static int add_file(quell_context *ctx, preview_args *args, int index, cli_canvas *canvas)
{
    const char *path = args->inputs[index];
    quell_image image = {0};
    int code = load(ctx, args, path, &image);
    if (code == CLI_EXIT_OK) code = check_crop(args, &image, path);
    const uint32_t width = args->crop_width * args->zoom, height = args->crop_height * args->zoom;
    const uint32_t left = (uint32_t)index * (width + GAP);
    if (code == CLI_EXIT_OK && index == 0) {
        const uint32_t total = (uint32_t)args->num_inputs * (width + GAP) - GAP;
        if (cli_canvas_create(canvas, total, height, 255) != 0) {
            cli_error(args->output, "no memory for the picture");
            code = CLI_EXIT_MEMORY;
        }
    } else if (code == CLI_EXIT_OK && (height != canvas->height || left + width > canvas->width)) {
        cli_error(path, "has %u x %u pixels, unlike %s", image.width, image.height, args->inputs[0]);
        code = CLI_EXIT_SIZE;
    }
    if (code == CLI_EXIT_OK) {
        draw_image(args, &image, canvas, left);
        char label[64];
        label_of(args, index, label, sizeof label);
        const uint32_t size = height < 400 ? 1 : height / 400 + 1;
        if (args->has_labels) cli_canvas_text(canvas, left, 0, left + width, size, label);
    }
    free(image.data);
    return code;
}

static int run(quell_context *ctx, preview_args *args)
{
    cli_canvas canvas = {0};
    int code = CLI_EXIT_OK;
    for (int i = 0; i < args->num_inputs && code == CLI_EXIT_OK; i++) code = add_file(ctx, args, i, &canvas);
    char error[256];
    if (code == CLI_EXIT_OK &&
        cli_image_write(args->output, canvas.width, canvas.height, canvas.pixels, error, sizeof error) != 0) {
        cli_error(args->output, "cannot be written: %s", error);
        code = CLI_EXIT_OUTPUT;
    }
    cli_canvas_destroy(&canvas);
    return code;
}

int cli_preview(int argc, char **argv)
{
    preview_args args = {.zoom = 1};
    int wants_help = 0;
    int code = parse(argc, argv, &args, &wants_help);
    if (wants_help) fputs(help_text, stdout);
    if (wants_help || code) return code;

    quell_context *ctx;
    code = cli_context_create(&args.common, &ctx);
    if (code != CLI_EXIT_OK) return code;
    code = run(ctx, &args);
    cli_context_destroy(ctx);
    return code;
}
