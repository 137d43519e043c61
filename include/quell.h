/* SPDX-License-Identifier: Apache-2.0 */
/*
 * quell.h - the whole public interface of libquell, a denoiser for renders made with Blender's Cycles.
 *
 * The usual way through it:
 *
 *     quell_context_create -> quell_model_open -> quell_frame_read_exr (or quell_frame_create + quell_frame_add_layer)
 *     -> quell_denoise -> quell_frame_write_exr (or quell_frame_copy_layer) -> the _destroy calls
 *
 * Rules that hold everywhere:
 *   - Every call that can fail returns a quell_status: 0 is success, failures are negative.
 *     quell_context_last_error() then has one sentence with file, layer and what to do.
 *   - A struct that the caller fills starts with struct_size; a field of zero means its default,
 *     so `quell_options o = { .struct_size = sizeof o };` is full initialisation.
 *   - One context serves one thread at a time; several contexts run in parallel. quell_cancel() alone may be
 *     called from any thread.
 *   - Colour is scene-linear float, at any exposure. Row 0 is the top row. Sizes are pixels, strides are bytes.
 *   - The library prints nothing, reads no environment variable, and keeps no global state.
 */
#ifndef QUELL_H
#define QUELL_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define QUELL_VERSION_MAJOR 0
#define QUELL_VERSION_MINOR 1
#define QUELL_VERSION_PATCH 0

#if defined(QUELL_STATIC)
#define QUELL_API
#elif defined(_WIN32)
#if defined(QUELL_BUILDING)
#define QUELL_API __declspec(dllexport)
#else
#define QUELL_API __declspec(dllimport)
#endif
#elif defined(__GNUC__)
#define QUELL_API __attribute__((visibility("default")))
#else
#define QUELL_API
#endif

#if defined(__GNUC__)
#define QUELL_NODISCARD __attribute__((warn_unused_result))
#else
#define QUELL_NODISCARD
#endif

/* ---- Status ------------------------------------------------------------------------------------------------------ */

typedef int32_t quell_status;

enum {
    QUELL_OK = 0,
    QUELL_ERR_INVALID_ARGUMENT = -1, /* a NULL, a size or a value that the call does not allow */
    QUELL_ERR_OUT_OF_MEMORY = -2,    /* allocation failed, or max_memory_bytes is too small for any tile */
    QUELL_ERR_CANCELLED = -3,        /* quell_cancel or the progress callback asked for it */
    QUELL_ERR_FILE_NOT_FOUND = -4,   /* input missing, or the folder of an output missing */
    QUELL_ERR_FILE_READ = -5,        /* truncated, damaged, or the system failed to read */
    QUELL_ERR_FILE_WRITE = -6,       /* disk full, no permission; the previous file is untouched */
    QUELL_ERR_NOT_EXR = -7,          /* not an OpenEXR file */
    QUELL_ERR_UNSUPPORTED = -8,      /* valid, but nothing this version handles: deep or tiled data, a newer struct */
    QUELL_ERR_NO_LAYER = -9,         /* nothing denoisable in the frame, or a named layer is not there */
    QUELL_ERR_SIZE_MISMATCH = -10,   /* layers or images of different sizes */
    QUELL_ERR_BAD_MODEL = -11,       /* not a weight file, damaged, or of another version */
    QUELL_ERR_LIMIT = -12,           /* a size over the context's limits */
    QUELL_ERR_INTERNAL = -13         /* a fault of the library: please report it */
};

/* Name of a status, such as "QUELL_ERR_CANCELLED"; "QUELL_ERR_UNKNOWN" for others. Static text. Since: 0.1 */
QUELL_API const char *quell_status_name(quell_status status);

/* Version of the library that is running, as text ("0.1.0") and as major * 10000 + minor * 100 + patch. Since: 0.1 */
QUELL_API const char *quell_version_string(void);
QUELL_API uint32_t quell_version_number(void);

/* ---- Context ----------------------------------------------------------------------------------------------------- */

typedef struct quell_context quell_context;

enum {
    QUELL_CPU_AUTO = 0, /* the best that the machine has */
    QUELL_CPU_C = 1,    /* plain C: the specification of every kernel */
    QUELL_CPU_AVX2 = 2,
    QUELL_CPU_AVX512 = 3,
    QUELL_CPU_NEON = 4,
    QUELL_CPU_AVX512BF16 = 5 /* QUELL_CPU_AVX512 with bfloat16: see quell_options.precision */
};

enum { QUELL_LOG_WARNING = 1, QUELL_LOG_INFO = 2 };

/* message: a finished line without newline, valid during the call. Runs on the thread that called the library. */
typedef void (*quell_log_fn)(void *user, int32_t level, const char *message);

typedef struct quell_context_options {
    uint32_t struct_size;
    uint32_t num_threads;      /* 0: one per available core */
    int32_t cpu;               /* QUELL_CPU_*; one that the machine lacks is QUELL_ERR_UNSUPPORTED */
    uint32_t reserved0;        /* zero */
    uint64_t max_memory_bytes; /* limit of the working memory of a denoise beyond the frame's own pixels; 0: 4 GiB. It
                                  takes some 128 MB and 128 bytes for each pixel, or less where that is the limit */
    uint64_t max_image_pixels; /* refuse larger images before anything is allocated; 0: 2^30 */
    quell_log_fn log;          /* NULL: silent */
    void *log_user;
} quell_context_options;

/* Makes a context with its own pool of threads. options may be NULL. *out is NULL on failure.
 * Returns QUELL_OK, QUELL_ERR_INVALID_ARGUMENT, QUELL_ERR_UNSUPPORTED, QUELL_ERR_OUT_OF_MEMORY. Since: 0.1 */
QUELL_API QUELL_NODISCARD quell_status quell_context_create(const quell_context_options *options, quell_context **out);

/* Ends the threads and frees the context. NULL is allowed. Frames and models may outlive it. Since: 0.1 */
QUELL_API void quell_context_destroy(quell_context *ctx);

/* The sentence about the last failure on this context, "" when there was none. Valid until the next call on the
 * context. Since: 0.1 */
QUELL_API const char *quell_context_last_error(const quell_context *ctx);

/* Name of the kernels in use ("c", "avx2", "avx512", "avx512bf16", "neon") and the number of threads. Since: 0.1 */
QUELL_API const char *quell_context_cpu_name(const quell_context *ctx);
QUELL_API uint32_t quell_context_num_threads(const quell_context *ctx);

/* Asks a running quell_denoise, read or write of this context to stop; it returns QUELL_ERR_CANCELLED soon after.
 * Callable from any thread; without a running call it does nothing. Since: 0.1 */
QUELL_API void quell_cancel(quell_context *ctx);

/* ---- Models ------------------------------------------------------------------------------------------------------ */

typedef struct quell_model quell_model;

typedef struct quell_model_info {
    uint32_t struct_size;
    uint32_t file_version;
    const char *name;        /* "quell-balanced"; lent: lives as long as the model */
    const char *description; /* one line; lent */
    const char *sha256;      /* 64 hex digits of the weight file; lent */
    uint64_t num_parameters;
    double macs_per_pixel;     /* multiply-adds per image pixel when one group of layers is filtered */
    double macs_per_pixel_all; /* ... when every group is */
    const char *weight_file;   /* path as it was opened, "quell-balanced.qwt" for one inside the library, "" for
                                  memory; lent */
    int32_t quality;           /* QUELL_QUALITY_* that this network of the library is; 0: none of them */
    uint32_t reserved0;
} quell_model_info;

/* Opens a model: NULL or "" for the default, a built-in name (quell_model_builtin_name), or the path of a weight file.
 * The model is immutable and may be shared by contexts and threads. *out is NULL on failure.
 * Returns QUELL_OK, QUELL_ERR_FILE_NOT_FOUND, QUELL_ERR_FILE_READ, QUELL_ERR_BAD_MODEL, QUELL_ERR_OUT_OF_MEMORY.
 * Since: 0.1 */
QUELL_API QUELL_NODISCARD quell_status quell_model_open(quell_context *ctx, const char *name_or_path,
                                                        quell_model **out);

/* The same from memory; data is copied. Since: 0.1 */
QUELL_API QUELL_NODISCARD quell_status quell_model_open_memory(quell_context *ctx, const void *data, size_t size_bytes,
                                                               quell_model **out);

/* NULL is allowed. Not while a denoise uses the model. Since: 0.1 */
QUELL_API void quell_model_destroy(quell_model *model);

/* Fills info up to its struct_size. Since: 0.1 */
QUELL_API QUELL_NODISCARD quell_status quell_model_get_info(const quell_model *model, quell_model_info *info);

/* Names of the models inside the library, index 0 being the default; NULL past the end. Static text. Since: 0.1 */
QUELL_API const char *quell_model_builtin_name(uint32_t index);

/* Quality levels. Each is a network of its own inside the library, larger from level to level; all take the same
 * layers and options. */
enum {
    QUELL_QUALITY_DEFAULT = 0, /* QUELL_QUALITY_BALANCED */
    QUELL_QUALITY_FAST = 1,
    QUELL_QUALITY_BALANCED = 2,
    QUELL_QUALITY_HIGH = 3
};

/* Opens the network of a level: QUELL_QUALITY_*. *out is NULL on failure.
 * Returns QUELL_OK, QUELL_ERR_INVALID_ARGUMENT, QUELL_ERR_FILE_NOT_FOUND (the library was built without that level's
 * weight file), QUELL_ERR_BAD_MODEL, QUELL_ERR_OUT_OF_MEMORY. Since: 0.1 */
QUELL_API QUELL_NODISCARD quell_status quell_model_open_quality(quell_context *ctx, int32_t quality, quell_model **out);

/* Name of a level: "fast", "balanced" or "high"; NULL for other values, so that counting up from QUELL_QUALITY_FAST lists
 * them. Static text. Since: 0.1 */
QUELL_API const char *quell_quality_name(int32_t quality);

/* ---- Images and frames ------------------------------------------------------------------------------------------- */

enum { QUELL_FORMAT_FLOAT = 0, QUELL_FORMAT_HALF = 1, QUELL_FORMAT_UINT = 2 };

/* Pixels in the caller's memory. Channel c of pixel (x, y) stands at
 * data + y * row_stride_bytes + x * pixel_stride_bytes + c * channel_stride_bytes.
 * Strides may be negative (rows bottom-up: point data at the top row). */
typedef struct quell_image {
    uint32_t struct_size;
    int32_t format;         /* QUELL_FORMAT_FLOAT or QUELL_FORMAT_HALF */
    uint32_t width, height; /* at least 1 */
    uint32_t num_channels;  /* 1 to 4 */
    uint32_t reserved0;     /* zero */
    void *data;
    int64_t channel_stride_bytes; /* 0: packed (size of one value) */
    int64_t pixel_stride_bytes;   /* 0: packed (num_channels values) */
    int64_t row_stride_bytes;     /* 0: packed (width pixels) */
} quell_image;

typedef struct quell_frame quell_frame;

/* What a layer is, whatever its name in this or that version of Blender. */
enum {
    QUELL_ROLE_OTHER = 0, /* data or unknown: never touched unless named in quell_options.layers */
    QUELL_ROLE_COMBINED = 1,
    QUELL_ROLE_NOISY_IMAGE = 2, /* Combined before Blender's own denoiser */
    QUELL_ROLE_DIFFUSE_DIRECT = 3,
    QUELL_ROLE_DIFFUSE_INDIRECT = 4,
    QUELL_ROLE_DIFFUSE_COLOR = 5,
    QUELL_ROLE_GLOSSY_DIRECT = 6,
    QUELL_ROLE_GLOSSY_INDIRECT = 7,
    QUELL_ROLE_GLOSSY_COLOR = 8,
    QUELL_ROLE_TRANSMISSION_DIRECT = 9,
    QUELL_ROLE_TRANSMISSION_INDIRECT = 10,
    QUELL_ROLE_TRANSMISSION_COLOR = 11,
    QUELL_ROLE_VOLUME_DIRECT = 12,
    QUELL_ROLE_VOLUME_INDIRECT = 13,
    QUELL_ROLE_EMISSION = 14,
    QUELL_ROLE_ENVIRONMENT = 15,
    QUELL_ROLE_AMBIENT_OCCLUSION = 16,
    QUELL_ROLE_SHADOW_CATCHER = 17,
    QUELL_ROLE_NOISY_SHADOW_CATCHER = 18,
    QUELL_ROLE_LIGHT_GROUP = 19, /* Combined_NAME */
    QUELL_ROLE_DENOISING_ALBEDO = 20,
    QUELL_ROLE_DENOISING_NORMAL = 21,
    QUELL_ROLE_DENOISING_DEPTH = 22,
    QUELL_ROLE_DEPTH = 23,
    QUELL_ROLE_NORMAL = 24,
    QUELL_ROLE_POSITION = 25,
    QUELL_ROLE_SAMPLE_COUNT = 26,
    QUELL_ROLE_SHADOW = 27,         /* Blender 3.x */
    QUELL_ROLE_VOLUME_SCATTER = 28, /* Blender 5.x */
    QUELL_ROLE_VOLUME_TRANSMIT = 29 /* Blender 5.x */
};

/* Short name of a role, such as "diffuse-direct"; "other" for unknown values. Static text. Since: 0.1 */
QUELL_API const char *quell_role_name(int32_t role);

typedef struct quell_layer_info {
    uint32_t struct_size;
    int32_t role;            /* QUELL_ROLE_* */
    const char *view_layer;  /* "ViewLayer"; "" where the file has none. All texts are lent by the frame. */
    const char *pass;        /* "Diffuse Direct" or "DiffDir", as in the file */
    const char *view;        /* "left"; "" for a single view */
    const char *full_name;   /* "ViewLayer.DiffDir" */
    const char *channels;    /* letters in reading order: "RGBA", "XYZ", "Z" */
    const char *compression; /* "zip"; "" for layers that did not come from a file */
    int32_t format;          /* QUELL_FORMAT_* of its first channel */
    uint32_t num_channels;
    uint32_t width, height;
    uint32_t samples;    /* per pixel as the file states them; 0: unknown */
    int32_t is_denoised; /* 1 after quell_denoise filtered it */
} quell_layer_info;

/* An empty frame of layers from the caller's memory. Since: 0.1 */
QUELL_API QUELL_NODISCARD quell_status quell_frame_create(quell_context *ctx, uint32_t width, uint32_t height,
                                                          quell_frame **out);

/* Reads a multilayer or plain EXR file, all parts and all channels; the file is not changed.
 * Returns QUELL_OK, QUELL_ERR_FILE_NOT_FOUND, _FILE_READ, _NOT_EXR, _UNSUPPORTED, _LIMIT, _OUT_OF_MEMORY, _CANCELLED.
 * Since: 0.1 */
QUELL_API QUELL_NODISCARD quell_status quell_frame_read_exr(quell_context *ctx, const char *path_utf8,
                                                            quell_frame **out);

/* NULL is allowed. Since: 0.1 */
QUELL_API void quell_frame_destroy(quell_frame *frame);

enum {
    QUELL_LAYER_COPY = 0,  /* pixels are copied; the result is fetched by quell_frame_copy_layer */
    QUELL_LAYER_BORROW = 1 /* pixels are read from, and the result is written to, the caller's memory, which must
                              live until the frame is destroyed */
};

/* Adds a layer. name: a pass name of any Blender version, with or without "ViewLayer." before it ("Combined",
 * "DiffDir", "Diffuse Direct", "Denoising Normal", "Combined_key"); other names get QUELL_ROLE_OTHER.
 * image->width and height must be the frame's. *out_index, if not NULL, receives the layer's index.
 * Returns QUELL_OK, QUELL_ERR_INVALID_ARGUMENT (name taken, bad view, channels that do not fit the name, a frame that was
 * read from a file), QUELL_ERR_SIZE_MISMATCH, QUELL_ERR_OUT_OF_MEMORY. Since: 0.1 */
QUELL_API QUELL_NODISCARD quell_status quell_frame_add_layer(quell_context *ctx, quell_frame *frame, const char *name,
                                                             const quell_image *image, int32_t ownership,
                                                             uint32_t *out_index);

/* Samples per pixel of all layers, where no file says so; 0: unknown. Since: 0.1 */
QUELL_API QUELL_NODISCARD quell_status quell_frame_set_samples(quell_frame *frame, uint32_t samples);

/* Number of layers, and facts about one. Texts are lent until the frame is destroyed. Since: 0.1 */
QUELL_API uint32_t quell_frame_num_layers(const quell_frame *frame);
QUELL_API QUELL_NODISCARD quell_status quell_frame_get_layer(const quell_frame *frame, uint32_t index,
                                                             quell_layer_info *info);

/* Index of a layer by its full name ("ViewLayer.Combined") or its pass name ("Combined"; the first such), -1 if there
 * is none. Since: 0.1 */
QUELL_API int64_t quell_frame_find_layer(const quell_frame *frame, const char *name);

/* Copies the layer's present pixels (denoised, once it was) into the caller's image, converting its format. An image of
 * fewer channels receives the first ones. A layer that denoising does not use is read from its file only now.
 * Returns QUELL_OK, QUELL_ERR_INVALID_ARGUMENT, QUELL_ERR_SIZE_MISMATCH, QUELL_ERR_OUT_OF_MEMORY, QUELL_ERR_FILE_READ.
 * Since: 0.1 */
QUELL_API QUELL_NODISCARD quell_status quell_frame_copy_layer(quell_context *ctx, const quell_frame *frame,
                                                              uint32_t index, const quell_image *image);

enum {
    QUELL_CODEC_KEEP = 0, /* the file's own; a lossy one that must be encoded again becomes ZIP */
    QUELL_CODEC_NONE = 1,
    QUELL_CODEC_RLE = 2,
    QUELL_CODEC_ZIPS = 3,
    QUELL_CODEC_ZIP = 4,
    QUELL_CODEC_PIZ = 5,
    QUELL_CODEC_PXR24 = 6,
    QUELL_CODEC_B44 = 7,
    QUELL_CODEC_B44A = 8,
    QUELL_CODEC_DWAA = 9,
    QUELL_CODEC_DWAB = 10,
    QUELL_CODEC_HTJ2K = 11
};

typedef struct quell_write_options {
    uint32_t struct_size;
    int32_t codec; /* QUELL_CODEC_* for parts that are encoded again */
} quell_write_options;

/* Writes a frame that was read from an EXR file as the same file: parts, channels, types, windows and attributes as
 * they were, parts without a denoised layer copied chunk by chunk. The output appears whole under its name or not at
 * all. path_utf8 may name the input file itself. A frame made by quell_frame_create is written as a single-part
 * multilayer ZIP file. options may be NULL.
 * Returns QUELL_OK, QUELL_ERR_FILE_NOT_FOUND (no such folder), QUELL_ERR_FILE_WRITE, QUELL_ERR_OUT_OF_MEMORY,
 * QUELL_ERR_CANCELLED. Since: 0.1 */
QUELL_API QUELL_NODISCARD quell_status quell_frame_write_exr(quell_context *ctx, quell_frame *frame,
                                                             const char *path_utf8, const quell_write_options *options);

/* ---- Denoise ----------------------------------------------------------------------------------------------------- */

/* fraction: 0 to 1, never decreasing. Runs on the calling thread only. Non-zero cancels. It may call quell_cancel and
 * nothing else of the library. */
typedef int32_t (*quell_progress_fn)(void *user, double fraction);

/* Advanced settings of models of the kind DGAN-KPN; the defaults are the published ones. */
typedef struct quell_dgan_options {
    uint32_t struct_size;
    int32_t parts;       /* QUELL_DGAN_* */
    int32_t iterate;     /* QUELL_ITERATE_* */
    uint32_t iterations; /* 1 to 8; 0: 4. With QUELL_DGAN_GENERATOR they count in QUELL_ITERATE_NETWORK alone. */
    uint32_t flags;      /* QUELL_DGAN_RUN_ALL */
    uint32_t reserved0;  /* zero */
} quell_dgan_options;

enum {
    QUELL_DGAN_BOTH = 0,      /* generator, then kernels on its result */
    QUELL_DGAN_GENERATOR = 1, /* the generator alone */
    QUELL_DGAN_KERNELS = 2    /* kernels on the noisy image */
};

enum {
    QUELL_ITERATE_FILTER = 0, /* the kernels are applied to their own result */
    QUELL_ITERATE_NETWORK = 1 /* the result goes through generator and kernels again */
};

/* Numbers in the middle of a network of the quell family: its feature maps at half resolution and below, and the weights
 * between them. Everything else, and every sum, is float32. Results of one precision and one set of kernels are the same
 * bits for any number of threads, any tiles and every run; docs/NUMERICS.md has what bfloat16 changes. */
enum {
    QUELL_PRECISION_AUTO = 0, /* bfloat16 with the kernels "avx512bf16", where it is faster; float32 with all others */
    QUELL_PRECISION_FLOAT32 = 1,
    QUELL_PRECISION_BFLOAT16 = 2 /* QUELL_ERR_UNSUPPORTED with kernels other than "avx512bf16" and, slowly, "c";
                                    QUELL_ERR_INVALID_ARGUMENT with models of the kind DGAN-KPN, which have none */
};

enum {
    QUELL_DGAN_RUN_ALL =
        1 /* run all iterations of QUELL_ITERATE_NETWORK, also those that would change nothing visible */
};

typedef struct quell_options {
    uint32_t struct_size;
    uint32_t flags; /* QUELL_DENOISE_* */
    const char
        *layers; /* "all": every light pass; "beauty": Combined alone; else names, comma-separated. NULL: all, with
                           DGAN-KPN models Combined alone */
    uint32_t tile_size;         /* edge in pixels, rounded up to a multiple of 32; 0: chosen from max_memory_bytes */
    uint32_t reserved0;         /* zero */
    quell_progress_fn progress; /* NULL: none */
    void *progress_user;
    const quell_dgan_options *dgan; /* NULL: defaults; with a model of another kind QUELL_ERR_INVALID_ARGUMENT */
    int32_t precision;              /* QUELL_PRECISION_* */
    uint32_t reserved1;             /* zero */
} quell_options;

enum {
    QUELL_DENOISE_KEEP_NOISY = 1, /* keep the noisy Combined as a layer "Noisy Image" beside the denoised one */
    QUELL_DENOISE_NO_SKIP = 2,    /* compute everything, also what needs no work */
    QUELL_DENOISE_NO_BLEND = 4,   /* the kernels' result alone: changes finished renders too */
    /* Append layers "Quell Noise", "Quell Confidence" and "Quell Skipped" to the frame for each view of each view layer,
     * of one channel 'Y' in half floats: the estimated deviation of Combined's noise relative to its local mean (-1: not
     * measured); the share of the kernels' result in the denoised Combined; and what was not computed (1; 0.5: needs
     * nothing, but was computed for what is beside it). Where Combined is not denoised they are of the first layer that
     * is. QUELL_ERR_INVALID_ARGUMENT where the frame has such layers already, and with models of the kind DGAN-KPN.
     * Reports leave them out. */
    QUELL_DENOISE_DEBUG_LAYERS = 8
};

typedef struct quell_report quell_report;

/* Denoises the frame's layers in place (borrowed layers: in the caller's memory). options may be NULL.
 * out_report: NULL, or receives a report that the caller destroys; it is also made when nothing needed work.
 * On any error the pixels of the frame are as they were.
 * Returns QUELL_OK, QUELL_ERR_NO_LAYER, QUELL_ERR_INVALID_ARGUMENT, QUELL_ERR_UNSUPPORTED (a precision that the context's
 * kernels lack), QUELL_ERR_OUT_OF_MEMORY, QUELL_ERR_CANCELLED. Since: 0.1 */
QUELL_API QUELL_NODISCARD quell_status quell_denoise(quell_context *ctx, const quell_model *model, quell_frame *frame,
                                                     const quell_options *options, quell_report **out_report);

/* Says what quell_denoise would do, without doing it. Since: 0.1 */
QUELL_API QUELL_NODISCARD quell_status quell_plan(quell_context *ctx, const quell_model *model,
                                                  const quell_frame *frame, const quell_options *options,
                                                  quell_report **out_report);

/* ---- Report ------------------------------------------------------------------------------------------------------ */

enum {
    QUELL_ACTION_DENOISED = 1,
    QUELL_ACTION_SKIPPED = 2,  /* a layer that could be denoised, but need not be: see reason */
    QUELL_ACTION_GUIDE = 3,    /* read as a feature, not changed */
    QUELL_ACTION_UNTOUCHED = 4 /* data, or not asked for */
};

typedef struct quell_report_layer {
    uint32_t struct_size;
    int32_t action;              /* QUELL_ACTION_* */
    const char *full_name;       /* lent by the report, as is reason */
    const char *reason;          /* "zero everywhere", "already denoised by Blender", ... */
    uint64_t num_bad_pixels;     /* NaN, infinite or absurd input pixels that were replaced from their neighbours */
    uint64_t num_limited_pixels; /* fireflies limited before filtering */
    double mean_before;          /* over valid pixels and colour channels */
    double mean_after;
    double noise; /* estimated deviation of the input relative to its local mean, root mean square over the image; 0 for
                      layers that are not filtered */
    double blend; /* share of the kernels' result in the output, 0 to 1, mean over the image; 0 from quell_plan */
    double change; /* output - input relative to the local mean, root mean square; 0 from quell_plan */
} quell_report_layer;

typedef struct quell_report_summary {
    uint32_t struct_size;
    uint32_t num_layers;
    uint32_t tile_width, tile_height; /* without halo */
    uint32_t num_tiles;               /* that are computed */
    uint32_t halo;                    /* pixels read beyond a tile's edge */
    uint64_t peak_bytes;              /* working memory: planned by quell_plan, measured by quell_denoise */
    double macs_per_pixel;            /* of the network parts that ran */
    /* Wall clock of the stages; 0 from quell_plan. The rest of seconds_total is results and the report itself. */
    double seconds_features; /* making the network's inputs: what the threads spent on it, over their number */
    double seconds_network;
    double seconds_filter;
    double seconds_total;     /* of quell_denoise: all but reading the file */
    const char *combined;     /* how Combined was rebuilt: "direct", "from passes", "from passes and
                                         environment"; lent */
    const char *model_name;   /* lent */
    double seconds_decode;    /* reading the frame's file; 0 for a frame from memory */
    double seconds_analyse;   /* looking at the layers, and the plan */
    double seconds_recombine; /* putting Combined together from its parts */
    uint32_t iterations;      /* that DGAN-KPN ran; 0 with other models, and from quell_plan */
    uint32_t reserved0;
    uint32_t num_cells;        /* cells of 32x32 pixels, over all view layers that have something to denoise */
    uint32_t num_active_cells; /* those that are computed: elsewhere nothing is noisy */
    int32_t precision;         /* QUELL_PRECISION_FLOAT32 or QUELL_PRECISION_BFLOAT16 */
    uint32_t reserved1;
} quell_report_summary;

/* NULL is allowed. Since: 0.1 */
QUELL_API void quell_report_destroy(quell_report *report);
QUELL_API QUELL_NODISCARD quell_status quell_report_get_summary(const quell_report *report,
                                                                quell_report_summary *summary);
QUELL_API QUELL_NODISCARD quell_status quell_report_get_layer(const quell_report *report, uint32_t index,
                                                              quell_report_layer *layer);

/* ---- Metrics ----------------------------------------------------------------------------------------------------- */

typedef struct quell_metrics {
    uint32_t struct_size;
    uint32_t reserved0;
    double mse;
    double rel_mse; /* mean of (x - a)(x - b) / (m^2 + 0.01), m = (a + b) / 2; b = a where there is no second */
    double psnr;    /* dB, after z / (1 + z) */
    double ssim;    /* on luminance after z / (1 + z); 11x11 Gaussian, sigma 1.5 */
    double gmsd;    /* gradient magnitude similarity deviation of the same luminance */
    uint64_t num_non_finite; /* values of the image that are NaN or infinite; they count as 0 above */
} quell_metrics;

/* Compares up to 3 colour channels of an image with one reference, or with two independent ones (reference_b not
 * NULL), whose own noise then cancels. All have the same size and number of channels.
 * Returns QUELL_OK, QUELL_ERR_SIZE_MISMATCH, QUELL_ERR_INVALID_ARGUMENT, QUELL_ERR_OUT_OF_MEMORY. Since: 0.1 */
QUELL_API QUELL_NODISCARD quell_status quell_compare(quell_context *ctx, const quell_image *image,
                                                     const quell_image *reference_a, const quell_image *reference_b,
                                                     quell_metrics *out);

#ifdef __cplusplus
}
#endif

#endif
