/* The signals of effects, worked by hand. */
#include "check.h"
#include "zd_exp2.h"

#define OCTAVE (1 << 24) /* one doubling in t_q24 */

/* Whole exponents are exact: 2^t in units of 2^(top - 27). */
static void check_whole_powers_of_two(void) {
    CHECK_EQUAL(zd_exp2(0, 0), 1 << 27);
    CHECK_EQUAL(zd_exp2(5 * OCTAVE, 5), 1 << 27);
    CHECK_EQUAL(zd_exp2(-3 * OCTAVE, 0), 1 << 24);
    CHECK_EQUAL(zd_exp2(-27 * OCTAVE, 0), 1);
    CHECK_EQUAL(zd_exp2(-28 * OCTAVE, 0), 1); /* a half, upwards */
    CHECK_EQUAL(zd_exp2(-29 * OCTAVE, 0), 0); /* a quarter */
    CHECK_EQUAL(zd_exp2(-60 * OCTAVE, 60), 0);
    CHECK_EQUAL(zd_exp2(-64 * OCTAVE, -64), 1 << 27);
}

/* sqrt(2) 2^27 = 189812531.3; the octave's 4.1 LSB of 2^-29 are one of these. */
static void check_half_an_octave(void) {
    const int32_t half = zd_exp2(OCTAVE / 2, 0);
    CHECK((half >= 189812530) && (half <= 189812533));
}

/* x^1 by the same way as x^p: octave 1 + f, gains 2^n. */
static void check_power_of_one_is_the_number(void) {
    static const int32_t octave[2] = {1 << 29, 1 << 29};
    static const int32_t gains[31] = {
        1 << 0,  1 << 1,  1 << 2,  1 << 3,  1 << 4,  1 << 5,  1 << 6,  1 << 7,
        1 << 8,  1 << 9,  1 << 10, 1 << 11, 1 << 12, 1 << 13, 1 << 14, 1 << 15,
        1 << 16, 1 << 17, 1 << 18, 1 << 19, 1 << 20, 1 << 21, 1 << 22, 1 << 23,
        1 << 24, 1 << 25, 1 << 26, 1 << 27, 1 << 28, 1 << 29, 1 << 30,
    };
    const zd_power_t one = {octave, gains, 1 << 29, 1 << 30, 2, 29};
    static const int32_t x[10] = {
        1, 2, 3, 7, 1000003, 1 << 29, (1 << 30) - 1, 1 << 30, 0, -5,
    };
    for (uint32_t i = 0; i < 8u; i++) {
        CHECK_EQUAL(zd_power(&one, x[i]), x[i]);
    }
    CHECK_EQUAL(zd_power(&one, x[8]), 0);
    CHECK_EQUAL(zd_power(&one, x[9]), 0);
    CHECK_EQUAL(zd_power(&one, INT32_MIN), 0);
}

static void check_play_follows_on_its_slack(void) {
    int32_t y = 0;
    CHECK_EQUAL(zd_play(&y, 3, 5), 0);   /* within the slack */
    CHECK_EQUAL(zd_play(&y, 9, 5), 4);   /* pushed up: 9 - 5 */
    CHECK_EQUAL(zd_play(&y, 0, 5), 4);   /* stays */
    CHECK_EQUAL(zd_play(&y, -3, 5), 2);  /* pushed down: -3 + 5 */
    CHECK_EQUAL(zd_play(&y, -3, 0), -3); /* no slack */
}

static void check_between_two_samples(void) {
    CHECK_EQUAL(zd_between(10, 20, 1 << 30), 15);
    CHECK_EQUAL(zd_between(10, 11, 1 << 30), 11); /* 10.5, upwards */
    CHECK_EQUAL(zd_between(10, 9, 1 << 30), 10);  /* 9.5, upwards */
    CHECK_EQUAL(zd_between(7, -1000000, 0), 7);
    CHECK_EQUAL(zd_between(-1, INT32_MAX / 2, INT32_MAX), INT32_MAX / 2);
}

static void check_load_at_the_ends_of_int32(void) {
    CHECK_EQUAL(zd_load(100, 30, -1000, 1000), 70);
    CHECK_EQUAL(zd_load(INT32_MAX, INT32_MIN, -1000, 1000), 1000);
    CHECK_EQUAL(zd_load(INT32_MIN, INT32_MAX, -1000, 1000), -1000);
}

int main(void) {
    check_whole_powers_of_two();
    check_half_an_octave();
    check_power_of_one_is_the_number();
    check_play_follows_on_its_slack();
    check_between_two_samples();
    check_load_at_the_ends_of_int32();
    return check_report("signals");
}
