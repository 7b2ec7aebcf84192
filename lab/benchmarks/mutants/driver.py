"""The C program that runs a model over sequences and prints what it did, phase by phase.

Written from the shipped header alone: whatever builds on a chip can be asked.
"""

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

Codes = NDArray[np.int64]
PHASES = ("header", "step", "node", "state", "saved", "damaged", "selftest", "bound")
_LIMITS = {
    "int16_t": (-(2**15), 2**15 - 1),
    "uint16_t": (0, 2**16 - 1),
    "int32_t": (-(2**31), 2**31 - 1),
}

TIMES_US = tuple(
    f"UINT64_C({time})"
    for time in (500_000, 0, 1, 77, 4_003, 500_000, 1_000_003, 500_000, 63_000_001, 2**32 - 1)
) + tuple(f"UINT64_C({time})" for time in (2**32, 7 * 10**9 + 1, 500_000, 10**13, 2**61, 2**64 - 1))
AGES_US = ("UINT64_C(1)", "UINT64_C(86400000000)", "UINT64_MAX")
_AGED = """    feed_number(4, {prefix}_restore_after(&other, copy, {age}));
    feed(4, &other, sizeof other);
"""
_PROGRAM = """\
/* Judges @P@: a 64-bit hash per phase. ZD_CHIP: no C library, hashes left in `judged`. */
#include <stddef.h>
#include <stdint.h>
#ifndef ZD_CHIP
#include <stdio.h>
#include <string.h>
#endif
static uint64_t judged_now[@PHASES@];
volatile uint64_t judged[@PHASES@];
static void feed(int phase, const volatile void *bytes, size_t n) {
    uint64_t hash = judged_now[phase];
    for (size_t i = 0; i < n; i++) {
        hash = (hash ^ ((const volatile uint8_t *)bytes)[i]) * UINT64_C(1099511628211) + 1u;
    }
    judged_now[phase] = hash;
}
static void feed_number(int phase, int64_t x) { feed(phase, &x, sizeof x); }
#ifdef ZD_CHIP
void *memset(void *to, int value, size_t n) {
    volatile uint8_t *bytes = to;
    for (size_t i = 0; i < n; i++) { bytes[i] = (uint8_t)value; }
    return to;
}
void *memcpy(void *to, const void *from, size_t n) {
    volatile uint8_t *bytes = to;
    for (size_t i = 0; i < n; i++) { bytes[i] = ((const uint8_t *)from)[i]; }
    return to;
}
void *memmove(void *to, const void *from, size_t n) {
    volatile uint8_t *bytes = to;
    if ((uintptr_t)to < (uintptr_t)from) { return memcpy(to, from, n); }
    for (size_t i = n; i > 0; i--) { bytes[i - 1] = ((const uint8_t *)from)[i - 1]; }
    return to;
}
#else
static int watching = 1;
static void leave(const char *name, uint32_t i, int64_t x) {
    if (judged_now[7] == 0) { printf("left %s[%u] = %lld\\n", name, i, (long long)x); }
    judged_now[7]++;
}
static void watch(const char *name, const void *values, size_t size, uint32_t count) {
    static const struct { const char *name; uint32_t i; int64_t low, high; } bounds[] = {
@BOUNDS@        {"", 0, 0, 0}
    };
    static const char *names[256];
    static int first[256];
    static int known;
    int k = 0;
    if (watching == 0) { return; }
    while (k < known && names[k] != name) { k++; }
    if (k == known && known < 256) {
        int b = 0;
        while (bounds[b].name[0] != 0 && strcmp(bounds[b].name, name) != 0) { b++; }
        names[k] = name;
        first[k] = b;
        known++;
    }
    for (uint32_t i = 0; i < count; i++) {
        const uint8_t *at = (const uint8_t *)values + size * i;
        int64_t x = 0;
        if (size == 1) { x = *(const int8_t *)at; }
        if (size == 2) { x = *(const int16_t *)at; }
        if (size == 4) { x = *(const int32_t *)at; }
        if (size == 8) { x = *(const int64_t *)at; }
        feed_number(2, x);
        for (int b = first[k]; bounds[b].name[0] != 0 && strcmp(bounds[b].name, name) == 0; b++) {
            if (bounds[b].i != i) { continue; }
            if (x < bounds[b].low || x > bounds[b].high) { leave(name, i, x); }
        }
    }
}
#define ZD_OBSERVE(values, count) watch(#values, (values), sizeof(*(values)), (count))
#endif
#ifndef ZD_CHIP
#define ZD_QUIET(on) (watching = !(on))
#endif
#include "@P@.c"
#include "zd_runtime.c"
static const @CODE@ codes[][@C@] = {
@CODES@};
static const uint32_t lengths[] = {@LENGTHS@};
@TIMES@static @P@_state_t live, other;
static uint8_t copy[sizeof(@P@_state_t) + 64];
static void put(@P@_input_t *in, const @CODE@ *row) {
    const @P@_input_t read = {@FIELDS@};
    *in = read;
}
static void tell(int phase, const int32_t *drift, uint32_t flags) {
@TELL@    feed(phase, &flags, sizeof flags);
}
static void run(uint32_t first, uint32_t count, int settled) {
    @P@_input_t in;
    int32_t drift[@K@];
    put(&in, codes[first]);
    for (size_t i = 0; i < sizeof live; i++) { ((volatile uint8_t *)&live)[i] = 0xA5; }
    if (settled) { @P@_settle(&live, &in); } else { @P@_init(&live); }
    feed(3, &live, sizeof live);
    for (uint32_t t = 0; t < count; t++) {
        uint32_t flags;
        put(&in, codes[first + t]);
        for (int k = 0; k < @K@; k++) { drift[k] = 123456789; }
        flags = @STEP@;
        tell(1, drift, flags);
        if (t % 8 == 0) { feed(3, &live, sizeof live); }
    }
}
static void keep(void) {
    for (size_t i = 0; i < sizeof copy; i++) { copy[i] = 0x5A; }
    @P@_save(&live, copy);
    feed(4, copy, sizeof copy);
    for (size_t i = 0; i < sizeof other; i++) { ((volatile uint8_t *)&other)[i] = 0xA5; }
    feed_number(4, @P@_restore(&other, copy));
    feed(4, &other, sizeof other);
@AGED@    for (size_t i = 0; i < sizeof live + 16u; i++) {
        copy[i] ^= (uint8_t)(1u << (i % 8u));
        feed_number(4, @P@_restore(&other, copy));
        feed(4, &other, sizeof other);
        copy[i] ^= (uint8_t)(1u << (i % 8u));
    }
}
static void damage(uint32_t first) {
    @P@_input_t in;
    int32_t drift[@K@];
    other = live;
    put(&in, codes[first]);
    for (size_t i = 0; i < sizeof live; i++) {
        for (uint32_t way = 0; way < 3u; way++) {
            uint8_t *byte = (uint8_t *)&live + i;
            live = other;
            *byte = (uint8_t)((way == 0u) ? *byte ^ 0x80u : (way == 1u) ? 0x7Fu : *byte ^ 1u);
            for (int k = 0; k < @K@; k++) { drift[k] = 123456789; }
            tell(5, drift, @P@_step(&live, &in, drift));
            tell(5, drift, @P@_step(&live, &in, drift));
            feed(5, &live, sizeof live);
        }
    }
    live = other;
}
void judge(void) {
    uint32_t first = 0;
@HEADER@    for (uint32_t k = 0; k < sizeof lengths / sizeof lengths[0]; k++) {
        run(first, lengths[k], (int)(k % 2u));
        keep();
        if (k < 2u) {
#ifndef ZD_CHIP
            watching = 0; /* what is damaged may lie anywhere */
#endif
            damage(first);
#ifndef ZD_CHIP
            watching = 1;
#endif
        }
        run(first, 4u, (int)((k + 1u) % 2u));
        first += lengths[k];
    }
    feed_number(6, @P@_selftest());
    for (int k = 0; k < @PHASES@; k++) { judged[k] = judged_now[k]; }
}
#ifdef ZD_CHIP
void _start(void) { judge(); }
#else
int main(void) {
    judge();
    for (int k = 0; k < @PHASES@; k++) { printf("%016llx\\n", (unsigned long long)judged[k]); }
    return 0;
}
#endif
"""


def render_driver(
    header: str, source: str, prefix: str, certificate: dict[str, Any], steps: int
) -> str:
    """Return the program for a model.

    Args:
        header: the model's, as it was shipped.
        source: the model's, for the ends of its inputs.
        prefix: of its names.
        certificate: what its bounds are taken from.
        steps: of each sequence.
    """
    upper = prefix.upper()
    struct = re.search(rf"typedef struct \{{([^}}]*)\}} {prefix}_input_t", header)
    assert struct, "the header has no input"
    types = re.findall(r"(u?int\d+_t) \w+;", struct[1])
    rows = draw_codes(types, steps)
    outputs = re.search(rf"#define {upper}_OUTPUTS (\d+)", header)
    assert outputs
    macros = re.findall(rf"(?m)^#define ({upper}_\w+) (.+?)(?:/\*.*)?$", header)
    numbers = [name for name, value in macros if re.match(r"-?\d|U?INT\d+_C|\(", value)]
    texts = [name for name, value in macros if value.startswith('"')]
    timed = f"{prefix}_step_after(" in header
    indices = [
        f"drift[{name}]" for name, _ in macros if f"{name}_LSB_PER_UNIT" in dict(macros)
    ] or [f"drift[{k}]" for k in range(int(outputs[1]))]
    values = {
        "P": prefix,
        "PHASES": str(len(PHASES)),
        "C": str(len(types)),
        "K": outputs[1],
        "CODE": "int16_t" if set(types) == {"int16_t"} else "int32_t",
        "CODES": "".join(
            "    {" + ", ".join(_literal(int(x)) for x in row) + "},\n"
            for part in rows
            for row in part
        ),
        "LENGTHS": ", ".join(f"{len(part)}u" for part in rows),
        "FIELDS": ", ".join(f"({kind})row[{k}]" for k, kind in enumerate(types)),
        "STEP": f"{prefix}_step_after(&live, &in, times[(first + t) % {len(TIMES_US)}u], drift)"
        if timed
        else f"{prefix}_step(&live, &in, drift)",
        "TIMES": f"static const uint64_t times[] = {{{', '.join(TIMES_US)}}};\n" if timed else "",
        "AGED": "".join(_AGED.format(prefix=prefix, age=age) for age in AGES_US) if timed else "",
        "TELL": "".join(f"    feed(phase, &{place}, sizeof(int32_t));\n" for place in indices),
        "HEADER": "".join(f"    feed_number(0, (int64_t)({name}));\n" for name in numbers)
        + "".join(f"    feed(0, {name}, sizeof({name}));\n" for name in texts),
        "BOUNDS": "".join(
            f'        {{"{n}", {i}u, {lo}, {hi}}},\n' for n, i, lo, hi in list_bounds(certificate)
        ),
    }
    return re.sub(r"@(\w+)@", lambda match: values[match[1]], _PROGRAM)


def list_bounds(certificate: dict[str, Any]) -> list[tuple[str, int, str, str]]:
    """Return observed expression, index, low and high of the bounds that can be looked at."""
    found = []
    for bound in certificate["bounds"]:
        match = re.fullmatch(r"(\w+)(?:\[(\d+)\])?", bound["where"])
        if match and not bound["where"].startswith(("drift", "features")):
            name = match[1] if match[2] is not None else f"&{match[1]}"
            found.append((name, int(match[2] or 0), *_ends(bound)))
    for claim in certificate["invariants"]:
        field = claim["where"].replace(".", "_")
        found += [(f"s->{field}", i, *_ends(claim)) for i in range(64)]
    return sorted(found)


def _ends(claim: dict[str, Any]) -> tuple[str, str]:
    return _wide(claim["low"]), _wide(claim["high"])


def _wide(value: int) -> str:
    return "INT64_MIN" if value <= -(2**63) else f"INT64_C({min(value, 2**63 - 1)})"


def _literal(value: int) -> str:
    return "(-2147483647 - 1)" if value == -(2**31) else str(value)


def draw_codes(types: list[str], steps: int) -> list[Codes]:
    """Return sequences [T, C]: rails, noise, jumps, a walk, a ramp over all codes, a dwell."""
    rng = np.random.default_rng(20)
    ends = np.array([_LIMITS[kind] for kind in types], dtype=np.int64)
    low, high = ends.T
    shape = (steps, len(types))
    middle = np.select([high > 70_000, high > 40_000], [4_000_000, 60_000], 12_800)
    walk = np.clip(
        rng.integers(-middle // 12, middle // 12 + 1, shape).cumsum(axis=0) + 3000,
        np.maximum(low, -5120),
        middle,
    )
    jumps = np.where(rng.random(shape) < 0.2, rng.integers(low, high + 1, shape), walk)
    part = np.linspace(0.0, 1.0, 2 * steps)[:, None]
    ramp = (low + part * (high - low)).astype(np.int64)
    dwell = np.repeat(rng.integers(-2000, 8000, (2, len(types))), [8, steps - 8], axis=0)
    return [
        walk,
        np.where(rng.random(shape) < 0.5, low, high),
        rng.integers(low, high + 1, shape),
        jumps,
        ramp,
        dwell,
    ]
