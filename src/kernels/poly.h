/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Coefficients of the exponential and the logarithm. Own polynomials rather than libm's, so that every instruction set
 * and every system gives nearly the same bits, and a vector twin exists.
 *
 * exp: x = n ln 2 + r, |r| <= ln 2 / 2, exp(r) by its Taylor series to r^7 (remainder 2^-27 relative at the ends).
 * log: z = m 2^e, m in [sqrt(1/2), sqrt(2)), s = (m - 1) / (m + 1), log(m) = 2 (s + s^3/3 + ... + s^9/9)
 *      (|s| <= 0.1716, remainder 2 s^11 / 11 < 1e-9).
 */
#ifndef QL_KERNELS_POLY_H
#define QL_KERNELS_POLY_H

#define QL_LOG2E 1.44269504088896341f
#define QL_LN2_HIGH 0.693359375f /* few bits, so that n * high is exact */
#define QL_LN2_LOW -2.12194440e-4f
#define QL_LN2 0.693147180559945f
#define QL_EXP_MIN -87.0f /* exp of it is normal: 1.6e-38 */
#define QL_EXP_MAX 87.0f
#define QL_SQRT2 1.41421356237309505f

#define QL_EXP_C2 0.5f
#define QL_EXP_C3 (1.0f / 6.0f)
#define QL_EXP_C4 (1.0f / 24.0f)
#define QL_EXP_C5 (1.0f / 120.0f)
#define QL_EXP_C6 (1.0f / 720.0f)
#define QL_EXP_C7 (1.0f / 5040.0f)

#define QL_LOG_C3 (2.0f / 3.0f)
#define QL_LOG_C5 (2.0f / 5.0f)
#define QL_LOG_C7 (2.0f / 7.0f)
#define QL_LOG_C9 (2.0f / 9.0f)

#define QL_SHARPNESS_RANGE 8.0f /* training/models/pyramid.py: MAX_SCALE */
#define QL_SIGMOID_RANGE 12.0f /* training/models/quell.py: IMPORTANCE_RANGE */

#endif
