/* SPDX-License-Identifier: Apache-2.0 */
#ifndef QL_BASE_CLOCK_H
#define QL_BASE_CLOCK_H

double ql_clock_seconds(void); /* monotonic wall clock; only differences mean something */

#endif
