/* SPDX-License-Identifier: Apache-2.0 */
/* The kernel prediction network of DGAN-KPN, section 3.1.2 of the paper; training/dgan/kpn.py is the same in PyTorch. It
 * has no normalisation, so it runs on bands of rows: features of a band, then the logits of one row at a time. */
#ifndef QL_MODELS_KPN_H
#define QL_MODELS_KPN_H

#include "nn/conv.h"

enum {
    QL_KPN_AUXILIARY = 13, /* section 3.2 */
    QL_KPN_TAPS = 361,     /* 19x19 */
    QL_KPN_MAX_BLOCKS = 32
};

typedef struct ql_kpn {
    uint32_t width, num_blocks;
    ql_conv source[2], source_skip; /* 5x5 twice; 1x1 from the input */
    ql_conv blocks[QL_KPN_MAX_BLOCKS][2];
    ql_conv predictor[3]; /* 1x1 */
} ql_kpn;

quell_status ql_kpn_load(ql_kpn *kpn, const ql_weights *weights, ql_memory *memory, ql_error *err);
void ql_kpn_free(ql_kpn *kpn, ql_memory *memory);
double ql_kpn_macs_per_pixel(const ql_kpn *kpn);

/* Rows above and below that one row of features is made from. */
uint32_t ql_kpn_reach(const ql_kpn *kpn);

/* Fills out[width][QL_KPN_AUXILIARY] for row y of the image. */
typedef void ql_auxiliary_fn(void *user, uint32_t y, uint32_t worker, float *out);

/* Rows first_row .. first_row + num_rows - 1 of a feature map, two pixels of zeros on both sides of each row. */
typedef struct ql_band_map {
    float *data;
    int64_t first_row;
    uint32_t num_rows, width, channels;
} ql_band_map;

/* Working memory for bands of an image. */
typedef struct ql_kpn_band {
    uint32_t width, height; /* of the image */
    uint32_t max_rows;      /* of a band */
    uint32_t y0, y1;        /* the rows whose features are there */
    ql_band_map input, features, hidden;
    float *scratch; /* [workers] for ql_kpn_logits_row */
} ql_kpn_band;

quell_status ql_kpn_band_create(ql_kpn_band *band, const ql_kpn *kpn, ql_env *env, uint32_t width, uint32_t height,
                                uint32_t max_rows, ql_error *err);
void ql_kpn_band_destroy(ql_kpn_band *band, ql_memory *memory);
uint64_t ql_kpn_band_bytes(const ql_kpn *kpn, uint32_t width, uint32_t max_rows, uint32_t num_workers);

/* Features of rows y0 .. y1 - 1, at most max_rows. */
quell_status ql_kpn_run(const ql_kpn *kpn, const ql_kernels *kernels, ql_env *env, ql_kpn_band *band, uint32_t y0,
                        uint32_t y1, ql_auxiliary_fn *source, void *user);

/* Logits of row y of the band that was run last: out [QL_KPN_TAPS][width]. */
void ql_kpn_logits_row(const ql_kpn *kpn, const ql_kernels *kernels, const ql_kpn_band *band, uint32_t y,
                       uint32_t worker, float *out);

#endif
