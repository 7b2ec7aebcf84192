"""Writes one simulated case: `python -m benchmarks.third_simulator --seed 1 --out DIR`."""

import argparse
import sys
from pathlib import Path

from benchmarks.third_simulator import EFFECTS, FAMILIES, KINDS, OUTSIDE, draw_case


def main() -> int:
    """Write the case that the command line asks for and tell what is in it."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.third_simulator", description=__doc__
    )
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--family", choices=list(FAMILIES), help="drawn where left out")
    parser.add_argument("--runs", type=int, default=6, help="training runs, 2 to 12")
    parser.add_argument(
        "--effect",
        action="append",
        choices=[*EFFECTS, *OUTSIDE],
        metavar="NAME",
        help=f"hidden; repeat it for several: {', '.join([*EFFECTS, *OUTSIDE])}",
    )
    parser.add_argument("--size", type=float, default=3.0, help="in RMS of the noise")
    parser.add_argument("--outliers", type=float, default=0.0, help="share of rows")
    parser.add_argument("--noise", choices=KINDS, default="white")
    parser.add_argument("--no-dwell", action="store_true")
    parser.add_argument("--temperature-rows", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True, help="folder")
    given = parser.parse_args()
    try:
        case = draw_case(
            given.seed,
            family=given.family,
            runs=given.runs,
            effect=tuple(given.effect or ()),
            size=given.size,
            outliers=given.outliers,
            noise=given.noise,
            dwell=not given.no_dwell,
            temperature_rows=given.temperature_rows,
        )
    except ValueError as error:
        print(f"third_simulator: {error}", file=sys.stderr)
        return 2
    case.write(given.out)
    rows = sum(len(log.drift) for log in case.logs)
    print(f"{given.out}: {case.family.name}, {len(case.logs)} runs, {rows} rows, simulated")
    for name, size in case.truth.sizes.items():
        print(
            f"hidden {name}: {size.train:.2f} x noise beyond the base model on training runs, "
            f"{size.test:.2f} on test runs; {100 * size.taken_up:.0f} % of it is taken up"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
