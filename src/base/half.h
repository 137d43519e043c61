/* SPDX-License-Identifier: Apache-2.0 */
/* IEEE 754 binary16 to float and back, bit-exact, round to nearest even. The plain twins of the SIMD converters. */
#ifndef QL_BASE_HALF_H
#define QL_BASE_HALF_H

#include <stdint.h>

float ql_half_to_float(uint16_t half);

/* Finite values beyond the range become +-65504, as Cycles writes them; infinities and NaN stay what they are. */
uint16_t ql_half_from_float(float value);

#endif
