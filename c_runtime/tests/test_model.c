/* A generated model (tests/golden/front_end.c) on this machine: self-test, flags and damage. */
#include "check.h"
#include "front_end.h"

static const front_end_input_t mild = {3000, 2000, 1000};

static void check_selftest(void) { CHECK_EQUAL(front_end_selftest(), 0); }

static void check_state_that_was_never_started(void) {
    front_end_state_t s = {0};
    int32_t drift[FRONT_END_OUTPUTS] = {1, 2, 3};
    CHECK_EQUAL(front_end_step(&s, &mild, drift), FRONT_END_FLAG_DAMAGED);
    for (uint32_t k = 0; k < FRONT_END_OUTPUTS; k++) {
        CHECK_EQUAL(drift[k], 0); /* toward the raw value */
    }
    CHECK_EQUAL(front_end_step(&s, &mild, drift), FRONT_END_FLAG_WARMING_UP); /* started anew */
}

static void check_warming_up_ends(void) {
    front_end_state_t s;
    int32_t drift[FRONT_END_OUTPUTS];
    front_end_init(&s);
    for (uint32_t step = 0; step < 8u; step++) {
        const uint32_t expected = (step < 5u) ? FRONT_END_FLAG_WARMING_UP : 0u;
        CHECK_EQUAL(front_end_step(&s, &mild, drift), expected);
    }
    front_end_settle(&s, &mild);
    CHECK_EQUAL(front_end_step(&s, &mild, drift), 0);
}

static void check_settled_drift_stays(void) {
    front_end_state_t s;
    int32_t first[FRONT_END_OUTPUTS];
    int32_t later[FRONT_END_OUTPUTS] = {0};
    front_end_settle(&s, &mild);
    (void)front_end_step(&s, &mild, first);
    for (uint32_t step = 0; step < 1000u; step++) {
        (void)front_end_step(&s, &mild, later);
    }
    for (uint32_t k = 0; k < FRONT_END_OUTPUTS; k++) {
        CHECK(later[k] - first[k] <= 1);
        CHECK(first[k] - later[k] <= 1);
    }
}

static void check_temperature_flags(void) {
    front_end_state_t s;
    int32_t drift[FRONT_END_OUTPUTS];
    const front_end_input_t hot = {12000, 2000, 1000};
    const front_end_input_t too_hot = {12001, 2000, 1000};
    const front_end_input_t jump = {10999, 2000, 1000}; /* 1002 codes; 1000 are calibrated */
    front_end_settle(&s, &hot);
    CHECK_EQUAL(front_end_step(&s, &hot, drift), 0);
    CHECK_EQUAL(front_end_step(&s, &too_hot, drift), FRONT_END_FLAG_TEMPERATURE_RANGE);
    CHECK_EQUAL(front_end_step(&s, &jump, drift), FRONT_END_FLAG_RATE_RANGE);
    CHECK_EQUAL(front_end_step(&s, &jump, drift), 0);
}

/* Each field of the state pushed out of what the proof admits is found, and the state restarted. */
static void check_damage_is_found(void) {
    int32_t drift[FRONT_END_OUTPUTS];
    for (uint32_t field = 0; field < 6u; field++) {
        front_end_state_t s;
        front_end_settle(&s, &mild);
        switch (field) {
        case 0:
            s.identity ^= 1u;
            break;
        case 1:
            s.steps = 6u;
            break;
        case 2:
            s.lowpass_3_v = INT64_MAX;
            break;
        case 3:
            s.delay_6_oldest = 5u; /* one past the end of the line */
            break;
        case 4:
            s.delay_6_line[4] = INT32_MIN;
            break;
        default:
            s.gru_h_q30[7] = INT32_MAX;
            break;
        }
        CHECK_EQUAL(front_end_step(&s, &mild, drift), FRONT_END_FLAG_DAMAGED);
        CHECK_EQUAL(drift[0], 0);
        CHECK_EQUAL(front_end_step(&s, &mild, drift), FRONT_END_FLAG_WARMING_UP);
    }
}

int main(void) {
    check_selftest();
    check_state_that_was_never_started();
    check_warming_up_ends();
    check_settled_drift_stays();
    check_temperature_flags();
    check_damage_is_found();
    return check_report("model");
}
