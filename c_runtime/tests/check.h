/* The smallest possible test harness: CHECK_EQUAL counts and prints, main returns check_failures().
 */
#ifndef ZD_CHECK_H
#define ZD_CHECK_H

#include <inttypes.h>
#include <stdint.h>
#include <stdio.h>

static unsigned check_count;
static unsigned check_failed;

#define CHECK_EQUAL(actual, expected)                                                              \
    check_equal((int64_t)(actual), (int64_t)(expected), #actual, __FILE__, __LINE__)

#define CHECK(condition) CHECK_EQUAL((condition) ? 1 : 0, 1)

static inline void check_equal(int64_t actual, int64_t expected, const char *what, const char *file,
                               int line) {
    check_count++;
    if (actual != expected) {
        check_failed++;
        if (check_failed <= 20u) {
            printf("%s:%d: %s is %" PRId64 ", expected %" PRId64 "\n", file, line, what, actual,
                   expected);
        }
    }
}

/* 0 if every check held and there was at least one. */
static inline int check_report(const char *name) {
    printf("%s: %u checks, %u failed\n", name, check_count, check_failed);
    return ((check_failed == 0u) && (check_count > 0u)) ? 0 : 1;
}

#endif /* ZD_CHECK_H */
