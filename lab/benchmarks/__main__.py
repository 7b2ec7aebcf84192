"""Runs every benchmark in turn: `python -m benchmarks [--quick] [NAME...]`."""

import argparse
import importlib
import sys
import time

NAMES = (
    *(
        "bench_main_job",
        "bench_kernels",
        "bench_cores",
        "bench_recurrent",
        "bench_layer_norm",
        "bench_effects",
        "bench_logs",
    ),
    "bench_text",
    *("bench_loop", "bench_real", "bench_integer", "bench_training", "bench_fleet"),
    *("bench_random", "bench_certificate", "bench_int8", "bench_builds", "bench_six_axis"),
    "bench_conversion",
    *("bench_gate", "bench_copies", "bench_memory", "crash_points"),
    *("bench_apply", "bench_uncertainty", "bench_install", "bench_bound"),
    "bench_contracting",
    *("bench_proof", "bench_object_proof", "bench_lexical"),
    *("bench_steps", "bench_wasm", "bench_small", "bench_kinds"),
)
"""Modules of this folder, each with `main(quick: bool)`, which returns how many of its marks are
missed, or None where it has none."""


def main() -> int:
    """Run the benchmarks named on the command line, or all; return 1 where one misses a mark."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(NAMES)}")
    parser.add_argument("--quick", action="store_true", help="a reduced form, for CI")
    arguments = parser.parse_args()
    missed = []
    for name in arguments.names or NAMES:
        print(f"== {name}", flush=True)
        start = time.perf_counter()
        if importlib.import_module(f"benchmarks.{name}").main(arguments.quick):
            missed.append(name)
        print(f"   ({time.perf_counter() - start:.1f} s)\n", flush=True)
    if missed:
        print(f"missed a mark: {', '.join(missed)}")
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
