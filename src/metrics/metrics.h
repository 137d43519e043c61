/* SPDX-License-Identifier: Apache-2.0 */
/* How far an image is from what it should be. Sums are taken in double in a fixed order, so that results do not depend
 * on the number of threads. */
#ifndef QL_METRICS_METRICS_H
#define QL_METRICS_METRICS_H

#include "base/pool.h"
#include "frame/frame.h"

/* Rows that one task covers: part of the result, since it fixes the order of the sums. */
#define QL_METRICS_BAND 16

/* Compares the first (at most 3) channels of views of one size and number of channels; reference_b NULL: none. Writes
 * all fields of *out but struct_size. env->memory gives the scratch. */
quell_status ql_metrics_compare(ql_env *env, uint32_t width, uint32_t height, const ql_view *image,
                                const ql_view *reference_a, const ql_view *reference_b, quell_metrics *out,
                                ql_error *err);

/* Mean structural similarity of two planes [height][width] of range 0..1 (Wang et al. 2004, IEEE TIP 13(4), eq. 13):
 * 11x11 Gaussian window, sigma 1.5, K1 = 0.01, K2 = 0.03, over the pixels whose window lies inside the image. A side
 * shorter than the window counts all its pixels, with windows cut at the edge and weighed anew. */
quell_status ql_metrics_ssim(ql_env *env, uint32_t width, uint32_t height, const float *image, const float *reference,
                             double *out, ql_error *err);

/* Gradient magnitude similarity deviation of two planes [height][width] of range 0..1 (Xue et al. 2014, IEEE TIP 23(2),
 * eq. 1-6), as the authors' code does it: mean of 2x2, every second pixel, Prewitt / 3, zero beyond the edge,
 * c = 170 for a range of 255, deviation with n - 1. 0 is equal, larger is worse. */
quell_status ql_metrics_gmsd(ql_env *env, uint32_t width, uint32_t height, const float *image, const float *reference,
                             double *out, ql_error *err);

#endif
