"""What the fuzzers kept, in one archive: `python -m tests.fuzz.corpus TARGET FILE ...` adds cases.

TARGET is a folder of the archive: state_effects, loader_csv. Without a file, all targets and how
many cases each has are printed. A case is named by its content's SHA-1, as libFuzzer names it.
"""

import argparse
import hashlib
import io
import tarfile
from collections.abc import Iterable
from pathlib import Path

ARCHIVE = Path(__file__).with_name("corpus.tar.xz")


def read_corpus() -> dict[str, list[bytes]]:
    """Return the cases of every target, in the order of their names."""
    found: dict[str, list[bytes]] = {}
    with tarfile.open(ARCHIVE) as packed:
        for member in packed:
            data = packed.extractfile(member)
            assert data is not None
            found.setdefault(member.name.partition("/")[0], []).append(data.read())
    return found


def write_corpus(corpus: dict[str, list[bytes]]) -> None:
    """Write the archive: the same cases give the same bytes, whatever their order and owner."""
    with tarfile.open(ARCHIVE, "w:xz", format=tarfile.USTAR_FORMAT) as packed:
        for target, cases in sorted(corpus.items()):
            for name, data in sorted((hashlib.sha1(data).hexdigest(), data) for data in set(cases)):
                member = tarfile.TarInfo(f"{target}/{name}")
                member.size = len(data)
                packed.addfile(member, io.BytesIO(data))


def unpack(cases: Iterable[bytes], folder: Path) -> list[Path]:
    """Write the cases to files of a folder, which is made, for a program that reads files."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for data in cases:
        paths.append(folder / hashlib.sha1(data).hexdigest())
        paths[-1].write_bytes(data)
    return paths


def main() -> None:
    """Add the files named to a target's cases, or tell what there is."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.corpus", description=__doc__)
    parser.add_argument("target", nargs="?")
    parser.add_argument("files", nargs="*", type=Path)
    arguments = parser.parse_args()
    corpus = read_corpus()
    if arguments.files:
        if arguments.target not in corpus:
            parser.error(f"no target '{arguments.target}'; there are {', '.join(corpus)}")
        corpus[arguments.target] += [path.read_bytes() for path in arguments.files]
        write_corpus(corpus)
    for target, cases in read_corpus().items():
        print(f"{target}: {len(set(cases))} cases")


if __name__ == "__main__":
    main()
