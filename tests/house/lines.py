"""Lines that are kept by hand: `python -m tests.house.lines [--long N]`.

A line counts where it holds more than white space; comments and docstrings count. Product,
laboratory, tests and the rest are told apart, and the files above N lines, 400 unless told.
"""

import subprocess
import sys
from collections import Counter
from pathlib import Path

from tests.house.test_order import LINKED

ROOT = Path(__file__).resolve().parents[2]
WRITTEN = (".py", ".c", ".h", ".j2", ".js", ".css", ".html")
"""How the names of written files end; what is stored (data, golden files) ends otherwise."""
STORED = ("tests/frozen/", "tests/golden/")


def name_part(file: str) -> str:
    """Return the part of the repository that a file belongs to."""
    top, inner = file.split("/")[:2] if "/" in file else ("", "")
    if top in ("src", *LINKED):
        return "product"
    if top == "proof":
        return "proof"
    if top == "lab":
        return "benchmarks" if inner == "benchmarks" else "laboratory"
    return "tests" if top == "tests" else "others"


def count_lines() -> dict[str, int]:
    """Return the lines of every file that git keeps and that is written by hand."""
    command = ["git", "ls-files", "-z"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, check=True).stdout
    files = listed.decode("utf-8").split("\0")
    kept = [f for f in files if f.endswith(WRITTEN) and not f.startswith(STORED)]
    texts = {f: (ROOT / f).read_text("utf-8") for f in kept if "/stored/" not in f}
    return {f: sum(map(bool, map(str.strip, t.splitlines()))) for f, t in texts.items()}


def main() -> None:
    """Print the lines of each part, and the long files."""
    most = int(sys.argv[sys.argv.index("--long") + 1]) if "--long" in sys.argv else 400
    lines = count_lines()
    parts: Counter[str] = Counter()
    for file, count in lines.items():
        parts[name_part(file)] += count
    for file, count in sorted(lines.items(), key=lambda item: -item[1]):
        if count > most:
            print(f"{count:6d} {file}")
    for part, count in parts.most_common():
        print(f"{part}: {count}")


if __name__ == "__main__":
    main()
