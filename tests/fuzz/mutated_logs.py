"""Mutated logs of every format: `python -m tests.fuzz.mutated_logs [--count N] [--seed S]`.

Each is read twice, as `init` does and as a project does, and has to be read or refused by a
message; anything else is a finding, which is kept in build/fuzz/mutated. The mutator knows bytes
and lines, nothing of the readers. Exit codes: 0 no finding, 1 a finding.
"""

import argparse
import random
import subprocess
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from tests.dataset.log_writers import COLUMNS, NAMES, WRITERS

ROOT = Path(__file__).parents[2]
KEPT = ROOT / "build" / "fuzz" / "mutated"
BATCH = 50
"""Files for one process, so that a crash of a library costs no more."""
LIMIT_S = 600

Mutation = Callable[[random.Random, bytes], bytes]


def flip_bits(rng: random.Random, data: bytes) -> bytes:
    """Flip some bits."""
    changed = bytearray(data)
    for _ in range(rng.randint(1, 30)):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def set_bytes(rng: random.Random, data: bytes) -> bytes:
    """Overwrite a stretch with one byte."""
    begin = rng.randrange(len(data))
    length = rng.randint(1, 200)
    fill = bytes([rng.choice((0, 10, 34, 44, 59, 255))])
    return data[:begin] + fill * min(length, len(data) - begin) + data[begin + length :]


def cut(rng: random.Random, data: bytes) -> bytes:
    """Keep a part."""
    begin, end = sorted(rng.choices(range(len(data) + 1), k=2))
    return data[begin:end] if rng.random() < 0.3 else data[:end]


def remove(rng: random.Random, data: bytes) -> bytes:
    """Take a stretch out."""
    begin = rng.randrange(len(data))
    return data[:begin] + data[begin + rng.randint(1, 300) :]


def insert(rng: random.Random, data: bytes) -> bytes:
    """Put random bytes in."""
    at = rng.randrange(len(data) + 1)
    return data[:at] + rng.randbytes(rng.randint(1, 100)) + data[at:]


def repeat(rng: random.Random, data: bytes) -> bytes:
    """Repeat a stretch elsewhere."""
    begin, at = rng.randrange(len(data)), rng.randrange(len(data))
    return data[:at] + data[begin : begin + rng.randint(1, 500)] + data[at:]


def shuffle_lines(rng: random.Random, data: bytes) -> bytes:
    """Swap, repeat or drop lines."""
    lines = data.split(b"\n")
    for _ in range(rng.randint(1, 6)):
        i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
        lines[i] = rng.choice((lines[j], b"", lines[i] + lines[j]))
    return b"\n".join(lines)


def change_text(rng: random.Random, data: bytes) -> bytes:
    """Replace a token wherever, or somewhere, it occurs."""
    old = rng.choice((b",", b";", b"\t", b".", b"T", b":", b"-", b"\n", b"1", b"e", b" "))
    tokens = (b"", b",", b";", b"\t", b'"', b"1e999", b"-", b"nan", b"\r", b"\xb0", b"9" * 40, b"#")
    new = rng.choice(tokens)
    if rng.random() < 0.5:
        return data.replace(old, new, rng.randint(1, 50))
    at = data.find(old, rng.randrange(len(data)))
    return data if at < 0 else data[:at] + new + data[at + len(old) :]


def encode_again(rng: random.Random, data: bytes) -> bytes:
    """Take the bytes for text of one encoding and write it in another."""
    text = data.decode(rng.choice(("latin-1", "cp1252", "utf-8")), "replace")
    return text.encode(rng.choice(("utf-16", "utf-8", "utf-8-sig", "utf-32")), "replace")


MUTATIONS: tuple[Mutation, ...] = (
    *(flip_bits, set_bytes, cut, remove, insert, repeat, shuffle_lines, change_text, encode_again),
)


def mutate(rng: random.Random, data: bytes) -> bytes:
    """Return a file with one to four mutations."""
    for _ in range(rng.randint(1, 4)):
        if data:
            data = rng.choice(MUTATIONS)(rng, data)
    return data


def make_files(folder: Path, count: int, seed: int) -> list[Path]:
    """Write mutated files of all formats whose writers are installed, evenly."""
    rng = random.Random(seed)
    good: dict[str, bytes] = {}
    for name, write in WRITERS.items():
        try:
            write(folder / f"good-{name}")
        except ImportError as error:
            print(f"left out: {name} ({error})")
            continue
        good[name] = (folder / f"good-{name}").read_bytes()
        (folder / f"good-{name}").unlink()
    files = []
    for number in range(count):
        name = list(good)[number % len(good)]
        path = folder / f"{number:05d}-{name}"
        path.write_bytes(mutate(rng, good[name]))
        files.append(path)
    return files


def write_project(folder: Path, log: Path) -> None:
    """Write the project that the unspoilt log would have."""
    time, temperature, force = COLUMNS.get(log.name[6:], NAMES)
    (folder / "zerodrift.toml").write_text(
        f'[sensor]\nname = "s"\ntime = "{time}"\ntemperature = "{temperature}"\n'
        f'sample_period_s = 1.0\n[outputs.F]\nmeasured = "{force}"\nunit = "N"\n'
        f'full_scale = 100\n[logs]\ntrain = ["{log.as_posix()}"]\n'
    )


def read_file(path: Path) -> list[str]:
    """Return what came of a file: `read` or `refused`, twice; a traceback is raised."""
    from zerodrift.base.config import load_config
    from zerodrift.base.errors import InputError
    from zerodrift.dataset.guess import guess_project
    from zerodrift.dataset.load import load_dataset

    def run(read: Callable[[], object]) -> str:
        try:
            read()
        except InputError as error:
            return "refused" if len(str(error)) > 20 else f"refused without a reason: {error}"
        return "read"

    with tempfile.TemporaryDirectory() as folder:
        write_project(Path(folder), path)
        config = load_config(Path(folder))
        return [run(lambda: guess_project([path])), run(lambda: load_dataset(config))]


def read_batch(paths: list[Path]) -> None:
    """Print what comes of each file, one line per file; the first word is its name."""
    for path in paths:
        print(f"{path.name} begins", flush=True)
        try:
            found = " ".join(read_file(path))
        except BaseException:  # noqa: BLE001  Polars' panics are no Exceptions
            last = traceback.format_exc().strip().splitlines()
            found = f"TRACEBACK {last[-1][:200]} at {last[-3].strip() if len(last) > 3 else ''}"
        print(f"{path.name} {found}", flush=True)


def main() -> None:
    """Mutate, read, and tell what came of it."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.mutated_logs", description=__doc__)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("files", nargs="*", type=Path, help="read these, and nothing else")
    arguments = parser.parse_args()
    if arguments.files:
        read_batch(arguments.files)
        return
    counts: Counter[str] = Counter()
    findings = []
    with tempfile.TemporaryDirectory() as folder:
        files = make_files(Path(folder), arguments.count, arguments.seed)
        for begin in range(0, len(files), BATCH):
            batch = files[begin : begin + BATCH]
            while batch:
                command = [sys.executable, "-W", "ignore", "-m", "tests.fuzz.mutated_logs"]
                result = subprocess.run(
                    [*command, *map(str, batch)],
                    capture_output=True,
                    text=True,
                    timeout=LIMIT_S,
                    check=False,
                )
                told = dict(
                    line.split(" ", 1) for line in result.stdout.splitlines() if " " in line
                )
                done = [path for path in batch if path.name in told]
                for path in done:
                    outcome = told[path.name]
                    if outcome == "begins":
                        outcome = f"TRACEBACK: the process ended ({result.returncode})"
                    is_finding = "TRACEBACK" in outcome or "without a reason" in outcome
                    counts["finding" if is_finding else outcome] += 1
                    if is_finding:
                        findings.append(f"{path.name}: {outcome}")
                        KEPT.mkdir(parents=True, exist_ok=True)
                        (KEPT / path.name).write_bytes(path.read_bytes())
                batch = batch[len(done) :] if done else []
    print(f"{sum(counts.values())} mutated files (init, project):")
    for outcome, count in counts.most_common():
        print(f"  {count:5d}  {outcome}")
    print("\n".join(findings))
    print(f"tracebacks: {len(findings)}")
    sys.exit(bool(findings))


if __name__ == "__main__":
    main()
