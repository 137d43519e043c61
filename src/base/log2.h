/* SPDX-License-Identifier: Apache-2.0 */
#ifndef QL_BASE_LOG2_H
#define QL_BASE_LOG2_H

#include <math.h>

/* C libraries' log2f differ in the last bit; rounded from their log2 they agree, and so do results on all systems. */
static inline float ql_log2f(float x)
{
    return (float)log2((double)x);
}

#endif
