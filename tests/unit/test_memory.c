/* SPDX-License-Identifier: Apache-2.0 */
#include "base/memory.h"

#include "cmocka_all.h"

#include <string.h>

static void blocks_are_aligned_and_counted(void **state)
{
    (void)state;
    ql_memory memory;
    ql_memory_init(&memory, 0);
    const size_t sizes[] = {0, 1, 63, 64, 65, 100000};
    void *blocks[6];
    for (size_t i = 0; i < 6; i++) {
        blocks[i] = ql_alloc(&memory, sizes[i], 1);
        assert_non_null(blocks[i]);
        assert_int_equal((uintptr_t)blocks[i] % QL_ALIGNMENT, 0);
        memset(blocks[i], 0xa5, sizes[i]);
    }
    const uint64_t used = memory.used_bytes;
    assert_true(used >= 100293);
    assert_int_equal(memory.peak_bytes, used);
    for (size_t i = 0; i < 6; i++) ql_free(&memory, blocks[i]);
    ql_free(&memory, NULL);
    assert_int_equal(memory.used_bytes, 0);
    assert_int_equal(memory.peak_bytes, used);
}

static void overflow_is_no_memory(void **state)
{
    (void)state;
    ql_memory memory;
    ql_memory_init(&memory, 0);
    assert_null(ql_alloc(&memory, SIZE_MAX / 2, 3));
    assert_null(ql_alloc(&memory, SIZE_MAX, 1));
    assert_null(ql_alloc(&memory, SIZE_MAX - 64, 1));
    assert_null(ql_alloc_zero(&memory, SIZE_MAX / 4 + 1, 4));
    assert_int_equal(memory.used_bytes, 0);
    size_t out;
    assert_int_equal(ql_mul_size(SIZE_MAX, 0, &out), 0);
    assert_int_equal(out, 0);
    assert_int_equal(ql_mul_size(SIZE_MAX / 2, 2, &out), 0);
    assert_int_equal(ql_mul_size(SIZE_MAX / 2 + 1, 2, &out), -1);
    assert_int_equal(ql_add_size(SIZE_MAX, 0, &out), 0);
    assert_int_equal(ql_add_size(SIZE_MAX, 1, &out), -1);
}

static void limit_holds_and_frees_again(void **state)
{
    (void)state;
    ql_memory memory;
    ql_memory_init(&memory, 4096);
    void *first = ql_alloc(&memory, 3000, 1);
    assert_non_null(first);
    assert_null(ql_alloc(&memory, 3000, 1));
    ql_free(&memory, first);
    void *second = ql_alloc(&memory, 3000, 1);
    assert_non_null(second);
    ql_free(&memory, second);
    assert_true(memory.peak_bytes <= 4096);
}

static void chosen_allocation_fails_once(void **state)
{
    (void)state;
    ql_memory memory;
    ql_memory_init(&memory, 0);
    memory.fail_at = 2;
    void *first = ql_alloc(&memory, 1, 1);
    assert_non_null(first);
    assert_null(ql_alloc(&memory, 1, 1));
    void *third = ql_alloc(&memory, 1, 1);
    assert_non_null(third);
    ql_free(&memory, first);
    ql_free(&memory, third);
}

static void zeroed_memory_and_copied_text(void **state)
{
    (void)state;
    ql_memory memory;
    ql_memory_init(&memory, 0);
    unsigned char *zeros = ql_alloc_zero(&memory, 10, 7);
    assert_non_null(zeros);
    for (size_t i = 0; i < 70; i++) assert_int_equal(zeros[i], 0);
    char *text = ql_strdup(&memory, "Läyer");
    assert_string_equal(text, "Läyer");
    assert_null(ql_strdup(&memory, NULL));
    ql_free(&memory, zeros);
    ql_free(&memory, text);
    assert_int_equal(memory.used_bytes, 0);
}

static void spare_blocks_come_back_and_never_add_to_the_peak(void **state)
{
    (void)state;
    enum { LARGE = 3 << 20 };
    ql_memory memory;
    ql_memory_init(&memory, 0);
    memory.keeps_spare = 1;
    unsigned char *const first = ql_alloc(&memory, LARGE, 1);
    assert_non_null(first);
    ql_free(&memory, first);
    assert_int_equal(memory.used_bytes, 0);
    unsigned char *const again = ql_alloc_zero(&memory, LARGE, 1);
#if !defined(__SANITIZE_ADDRESS__)
    assert_ptr_equal(again, first);
#endif
    assert_int_equal(again[LARGE - 1], 0);
    const uint64_t peak = memory.peak_bytes;
    ql_free(&memory, again);
    ql_free(&memory, ql_alloc(&memory, LARGE - 4096, 1)); /* of another size: the spare one goes first */
    assert_int_equal(memory.peak_bytes, peak);

    void *blocks[QL_MEMORY_MAX_SPARE + 4];
    for (size_t i = 0; i < QL_MEMORY_MAX_SPARE + 4; i++) blocks[i] = ql_alloc(&memory, 1 << 20, 1);
    for (size_t i = 0; i < QL_MEMORY_MAX_SPARE + 4; i++) ql_free(&memory, blocks[i]);
    ql_memory_drop_spare(&memory);
    for (size_t i = 0; i < QL_MEMORY_MAX_SPARE; i++) assert_null(memory.spare[i]);
    assert_int_equal(memory.used_bytes, 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(blocks_are_aligned_and_counted),
        cmocka_unit_test(overflow_is_no_memory),
        cmocka_unit_test(limit_holds_and_frees_again),
        cmocka_unit_test(chosen_allocation_fails_once),
        cmocka_unit_test(zeroed_memory_and_copied_text),
        cmocka_unit_test(spare_blocks_come_back_and_never_add_to_the_peak),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
