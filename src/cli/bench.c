/* SPDX-License-Identifier: Apache-2.0 */
/* quell bench: times a denoise from memory to memory. */
#include "cli/bench_scene.h"
#include "cli/cli.h"
#include "cli/json.h"
#include "cli/model.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char help_text[] =
    "Usage: quell bench [OPTION...]\n"
    "\n"
    "Times a denoise from memory to memory, on a made-up noisy picture with Cycles' passes that is the same "
    "everywhere.\n"
    "One run before those that count is left out.\n"
    "\n"
    "      --size WxH        default 1920x1080\n"
    "      --layers N        1 to 64 layers in Blender's order: Combined, light passes and colours (10 with them "
    "all),\n"
    "                        volume, emission, environment, ambient occlusion, light groups; default 10\n"
    "      --features WHICH  all (default): Denoising Albedo, Normal and Depth beside them; none\n"
    "      --runs R          default 5\n"
    "      --quality LEVEL   fast, balanced (default) or high: larger networks, which take longer\n"
    "  -m, --model NAME|FILE instead: a built-in model (quell --version -v lists them) or a weight file\n"
    "      --json            the result as JSON\n"
    "      --threads N       default: one for each core\n"
    "      --max-memory MB   working memory beyond the image itself; smaller means smaller tiles; default 4096\n"
    "      --tile N          edge of a tile in pixels, instead of the one that --max-memory leads to\n"
    "      --cpu KERNELS     auto (default), c, avx2, avx512, avx512bf16, neon\n"
    "      --precision WHICH of numbers inside the network: auto (default; bfloat16 with the kernels avx512bf16,\n"
    "                        float32 with others), float32, bfloat16\n"
    "  -h, --help\n";

enum { OPT_SIZE = CLI_OPT_OWN, OPT_LAYERS, OPT_FEATURES, OPT_RUNS, OPT_TILE, OPT_JSON };
enum { MAX_RUNS = 1000, MAX_EDGE = 65536 };

typedef struct bench_args {
    cli_common common;
    uint32_t width, height, num_layers, num_runs, tile_size;
    int has_guides, is_json;
} bench_args;

/* ---- Arguments --------------------------------------------------------------------------------------------------- */

static int parse_size(const char *text, uint32_t *width, uint32_t *height)
{
    char left[16];
    uint64_t w, h;
    const char *const cross = strchr(text, 'x');
    if (!cross || (size_t)(cross - text) >= sizeof left) return -1;
    memcpy(left, text, (size_t)(cross - text));
    left[cross - text] = '\0';
    if (cli_parse_uint(left, MAX_EDGE, &w) != 0 || cli_parse_uint(cross + 1, MAX_EDGE, &h) != 0) return -1;
    if (w == 0 || h == 0) return -1;
    *width = (uint32_t)w;
    *height = (uint32_t)h;
    return 0;
}

static int parse_count(const char *option, const char *text, uint32_t max, uint32_t *out)
{
    uint64_t value;
    if (cli_parse_uint(text, max, &value) != 0 || value == 0) {
        return cli_usage_error("bench", "%s: '%s' is not a number from 1 to %u", option, text, max);
    }
    *out = (uint32_t)value;
    return 0;
}

static int own_option(bench_args *args, int code, const char *argument)
{
    switch (code) {
    case OPT_SIZE:
        if (parse_size(argument, &args->width, &args->height) == 0) return 0;
        return cli_usage_error("bench", "--size: '%s' is no size such as 1920x1080, at most %d each way", argument,
                               MAX_EDGE);
    case OPT_LAYERS: return parse_count("--layers", argument, CLI_BENCH_MAX_LAYERS, &args->num_layers);
    case OPT_RUNS: return parse_count("--runs", argument, MAX_RUNS, &args->num_runs);
    case OPT_TILE: return parse_count("--tile", argument, MAX_EDGE, &args->tile_size);
    case OPT_FEATURES:
        if (strcmp(argument, "all") != 0 && strcmp(argument, "none") != 0) {
            return cli_usage_error("bench", "--features: '%s' is neither all nor none", argument);
        }
        args->has_guides = argument[0] == 'a';
        return 0;
    case OPT_JSON: args->is_json = 1; return 0;
    case 'm': return cli_common_option(&args->common, "bench", CLI_OPT_MODEL, argument);
    default: return cli_common_option(&args->common, "bench", code, argument);
    }
}

static int parse(int argc, char **argv, bench_args *args, int *wants_help)
{
    static const struct option options[] = {
        CLI_COMMON_OPTIONS,
        {"model", required_argument, NULL, 'm'},
        {"quality", required_argument, NULL, CLI_OPT_QUALITY},
        {"precision", required_argument, NULL, CLI_OPT_PRECISION},
        {"size", required_argument, NULL, OPT_SIZE},
        {"layers", required_argument, NULL, OPT_LAYERS},
        {"features", required_argument, NULL, OPT_FEATURES},
        {"runs", required_argument, NULL, OPT_RUNS},
        {"tile", required_argument, NULL, OPT_TILE},
        {"json", no_argument, NULL, OPT_JSON},
        {NULL, 0, NULL, 0},
    };
    int code;
    while ((code = getopt_long(argc, argv, "m:h", options, NULL)) != -1) {
        if (code == CLI_OPT_HELP) {
            *wants_help = 1;
            return 0;
        }
        const int failure = own_option(args, code, optarg);
        if (failure) return failure;
    }
    return optind == argc ? 0 : cli_usage_error("bench", "'%s': it takes no files", argv[optind]);
}

/* ---- The frame --------------------------------------------------------------------------------------------------- */

/* Gives the frame its layers; pixels is scratch for one of four channels. */
static quell_status fill_frame(quell_context *ctx, const bench_args *args, const cli_bench_scene *scene, float *pixels,
                               quell_frame *frame)
{
    quell_image image = {.struct_size = sizeof image, .format = QUELL_FORMAT_FLOAT};
    image.width = args->width;
    image.height = args->height;
    image.data = pixels;
    quell_status status = quell_frame_set_samples(frame, CLI_BENCH_SAMPLES);
    for (uint32_t i = 0; i < args->num_layers && status == QUELL_OK; i++) {
        image.num_channels = cli_bench_layer_channels(i);
        cli_bench_fill_layer(scene, i, pixels);
        status = quell_frame_add_layer(ctx, frame, cli_bench_layer_name(i), &image, QUELL_LAYER_COPY, NULL);
    }
    for (uint32_t i = 0; args->has_guides && i < CLI_BENCH_NUM_GUIDES && status == QUELL_OK; i++) {
        image.num_channels = cli_bench_guide_channels(i);
        cli_bench_fill_guide(scene, i, pixels);
        status = quell_frame_add_layer(ctx, frame, cli_bench_guide_name(i), &image, QUELL_LAYER_COPY, NULL);
    }
    return status;
}

static int make_frame(quell_context *ctx, const bench_args *args, quell_frame **out)
{
    *out = NULL;
    cli_bench_scene *const scene = cli_bench_scene_create(args->width, args->height, args->num_layers);
    float *const pixels = malloc((size_t)args->width * args->height * 4 * sizeof *pixels);
    int code = CLI_EXIT_OK;
    if (!scene || !pixels) {
        cli_error(NULL, "no memory for a picture of %ux%u", args->width, args->height);
        code = CLI_EXIT_MEMORY;
    } else {
        quell_status status = quell_frame_create(ctx, args->width, args->height, out);
        if (status == QUELL_OK) status = fill_frame(ctx, args, scene, pixels, *out);
        if (status != QUELL_OK) code = cli_error_status(NULL, ctx, status);
    }
    free(pixels);
    cli_bench_scene_destroy(scene);
    return code;
}

/* ---- Running ----------------------------------------------------------------------------------------------------- */

static int by_seconds(const void *a, const void *b)
{
    const quell_report_summary *const first = a, *const second = b;
    return (first->seconds_total > second->seconds_total) - (first->seconds_total < second->seconds_total);
}

static int run_once(quell_context *ctx, const quell_model *model, quell_frame *frame, const bench_args *args,
                    quell_report_summary *summary)
{
    quell_options options = {.struct_size = sizeof options, .tile_size = args->tile_size};
    options.precision = args->common.precision;
    quell_report *report;
    const quell_status status = quell_denoise(ctx, model, frame, &options, &report);
    if (status != QUELL_OK) {
        const int code = cli_error_status(NULL, ctx, status);
        return status == QUELL_ERR_UNSUPPORTED ? CLI_EXIT_USAGE : code; /* --precision */
    }
    *summary = (quell_report_summary){.struct_size = sizeof *summary};
    const quell_status got = quell_report_get_summary(report, summary);
    quell_report_destroy(report);
    summary->combined = summary->model_name = NULL; /* were the report's */
    return cli_exit_code(got);
}

static int run_all(quell_context *ctx, const quell_model *model, quell_frame *frame, const bench_args *args,
                   quell_report_summary *summaries)
{
    for (uint32_t i = 0; i <= args->num_runs; i++) { /* the first warms up */
        const int code = run_once(ctx, model, frame, args, &summaries[i ? i - 1 : 0]);
        if (code != CLI_EXIT_OK) return code;
    }
    qsort(summaries, args->num_runs, sizeof *summaries, by_seconds);
    return CLI_EXIT_OK;
}

/* ---- The result -------------------------------------------------------------------------------------------------- */

/* Runs are in rising order of time. */
static double median_seconds(const quell_report_summary *runs, uint32_t num)
{
    return 0.5 * (runs[(num - 1) / 2].seconds_total + runs[num / 2].seconds_total);
}

static uint64_t peak_bytes(const quell_report_summary *runs, uint32_t num)
{
    uint64_t peak = 0;
    for (uint32_t i = 0; i < num; i++) peak = runs[i].peak_bytes > peak ? runs[i].peak_bytes : peak;
    return peak;
}

static double gmacs_per_second(const bench_args *args, const quell_report_summary *runs)
{
    const double pixels = (double)args->width * (double)args->height;
    return 1e-9 * pixels * runs[0].macs_per_pixel / median_seconds(runs, args->num_runs);
}

static int print_json(quell_context *ctx, const bench_args *args, const quell_model_info *model,
                      const quell_report_summary *runs)
{
    const uint32_t num = args->num_runs;
    const char *const level = quell_quality_name(model->quality);
    cJSON *const json = cJSON_CreateObject();
    cJSON_AddStringToObject(json, "quell", quell_version_string());
    cJSON_AddStringToObject(json, "model", model->name);
    cJSON_AddItemToObject(json, "quality", level ? cJSON_CreateString(level) : cJSON_CreateNull());
    cJSON_AddStringToObject(json, "isa", quell_context_cpu_name(ctx));
    cJSON_AddStringToObject(json, "precision", cli_precision_name(runs[0].precision));
    cli_json_number(json, "threads", quell_context_num_threads(ctx));
    cli_json_number(json, "width", args->width);
    cli_json_number(json, "height", args->height);
    cli_json_number(json, "layers", args->num_layers);
    cJSON_AddStringToObject(json, "features", args->has_guides ? "all" : "none");
    cli_json_number(json, "runs", num);
    cli_json_number(json, "median_s", median_seconds(runs, num));
    cli_json_number(json, "min_s", runs[0].seconds_total);
    cli_json_number(json, "max_s", runs[num - 1].seconds_total);
    cli_json_number(json, "peak_bytes", (double)peak_bytes(runs, num));
    cli_json_number(json, "macs_per_pixel", runs[0].macs_per_pixel);
    cli_json_number(json, "gmacs_per_s", gmacs_per_second(args, runs));
    cli_json_number(json, "tiles", runs[0].num_tiles);
    cJSON_AddItemToObject(json, "stages", cli_json_stages(&runs[(num - 1) / 2]));
    return cli_json_write(json, "-");
}

static void print_text(quell_context *ctx, const bench_args *args, const quell_model_info *model,
                       const quell_report_summary *runs)
{
    const quell_report_summary *const middle = &runs[(args->num_runs - 1) / 2];
    printf("%s, %ux%u, %u %s, %s, %s, %u threads\n", model->name, args->width, args->height, args->num_layers,
           args->num_layers == 1 ? "layer" : "layers", quell_context_cpu_name(ctx),
           cli_precision_name(middle->precision), quell_context_num_threads(ctx));
    printf("  %.4f s (median of %u; %.4f to %.4f)\n", median_seconds(runs, args->num_runs), args->num_runs,
           runs[0].seconds_total, runs[args->num_runs - 1].seconds_total);
    printf("  analyse %.4f, features %.4f, network %.4f, filter %.4f, recombine %.4f\n", middle->seconds_analyse,
           middle->seconds_features, middle->seconds_network, middle->seconds_filter, middle->seconds_recombine);
    printf("  %.0f multiply-adds per pixel, %.1f billion a second; %llu MB of working memory, %u %s\n",
           middle->macs_per_pixel, gmacs_per_second(args, runs),
           (unsigned long long)(peak_bytes(runs, args->num_runs) >> 20), middle->num_tiles,
           middle->num_tiles == 1 ? "tile" : "tiles");
}

static int bench(quell_context *ctx, const quell_model *model, const bench_args *args)
{
    quell_model_info info = {.struct_size = sizeof info};
    quell_frame *frame = NULL;
    quell_report_summary *const runs = calloc(args->num_runs, sizeof *runs);
    int code = runs ? cli_exit_code(quell_model_get_info(model, &info)) : CLI_EXIT_MEMORY;
    if (code == CLI_EXIT_OK) code = make_frame(ctx, args, &frame);
    if (code == CLI_EXIT_OK) code = run_all(ctx, model, frame, args, runs);
    if (code == CLI_EXIT_OK && args->is_json) code = print_json(ctx, args, &info, runs);
    if (code == CLI_EXIT_OK && !args->is_json) print_text(ctx, args, &info, runs);
    quell_frame_destroy(frame);
    free(runs);
    return code;
}

int cli_bench(int argc, char **argv)
{
    bench_args args = {.width = 1920, .height = 1080, .num_layers = 10, .num_runs = 5, .has_guides = 1};
    int wants_help = 0;
    int code = parse(argc, argv, &args, &wants_help);
    if (wants_help) fputs(help_text, stdout);
    if (wants_help || code) return code;

    quell_context *ctx = NULL;
    quell_model *model = NULL;
    code = cli_context_create(&args.common, &ctx);
    if (code == CLI_EXIT_OK) code = cli_model_open(&args.common, "bench", ctx, &model);
    if (code == CLI_EXIT_OK) code = bench(ctx, model, &args);
    quell_model_destroy(model);
    cli_context_destroy(ctx);
    return code;
}
