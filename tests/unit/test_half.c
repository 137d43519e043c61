/* SPDX-License-Identifier: Apache-2.0 */
/* Every half there is, and the borders of rounding, against the arithmetic of double. */
#include "base/half.h"

#include "cmocka_all.h"

#include <math.h>
#include <string.h>

static float float_of(uint32_t bits)
{
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static uint32_t bits_of(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

static double half_value(uint32_t half)
{
    const int exponent = (int)((half >> 10) & 31u);
    const double mantissa = (double)(half & 1023u);
    const double magnitude = exponent == 0 ? ldexp(mantissa, -24) : ldexp(1024.0 + mantissa, exponent - 25);
    return half & 0x8000u ? -magnitude : magnitude;
}

static void every_half_has_its_value(void **state)
{
    (void)state;
    for (uint32_t h = 0; h < 0x10000u; h++) {
        if ((h & 0x7c00u) == 0x7c00u) continue;
        const float f = ql_half_to_float((uint16_t)h);
        assert_true((double)f == half_value(h));
        assert_int_equal(signbit(f) != 0, (h & 0x8000u) != 0);
        assert_int_equal(ql_half_from_float(f), h);
    }
    assert_int_equal(bits_of(ql_half_to_float(0x7c00)), 0x7f800000);
    assert_int_equal(bits_of(ql_half_to_float(0xfc00)), 0xff800000);
    assert_int_equal(bits_of(ql_half_to_float(0x7e01)), 0x7fc02000);
    assert_int_equal(bits_of(ql_half_to_float(0x7c01)), 0x7fc02000); /* a signalling NaN becomes quiet */
}

static void halves_round_to_nearest_even(void **state)
{
    (void)state;
    for (uint32_t h = 0; h < 0x7bffu; h++) {
        const double low = half_value(h), high = half_value(h + 1u);
        const float middle = (float)((low + high) / 2.0); /* exact in float */
        assert_int_equal(ql_half_from_float(middle), h & 1u ? h + 1u : h);
        assert_int_equal(ql_half_from_float(nextafterf(middle, 0.0f)), h);
        assert_int_equal(ql_half_from_float(nextafterf(middle, 1e9f)), h + 1u);
        assert_int_equal(ql_half_from_float(-nextafterf(middle, 1e9f)), 0x8000u | (h + 1u));
    }
}

static void large_values_are_clamped_and_nan_kept(void **state)
{
    (void)state;
    assert_int_equal(ql_half_from_float(65504.0f), 0x7bff);
    assert_int_equal(ql_half_from_float(65520.0f), 0x7bff);
    assert_int_equal(ql_half_from_float(3.4e38f), 0x7bff);
    assert_int_equal(ql_half_from_float(-3.4e38f), 0xfbff);
    assert_int_equal(ql_half_from_float(INFINITY), 0x7c00);
    assert_int_equal(ql_half_from_float(-INFINITY), 0xfc00);
    assert_int_equal(ql_half_from_float(float_of(0x7fc00000)), 0x7e00);
    assert_int_equal(ql_half_from_float(float_of(0x7f800001)), 0x7e00); /* its payload does not fit: still a NaN */
    assert_int_equal(ql_half_from_float(float_of(0x00000001)), 0);
    assert_int_equal(ql_half_from_float(float_of(0x80000001)), 0x8000);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_half_has_its_value),
        cmocka_unit_test(halves_round_to_nearest_even),
        cmocka_unit_test(large_values_are_clamped_and_nan_kept),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
