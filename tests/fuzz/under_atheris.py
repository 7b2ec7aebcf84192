"""One loader under atheris: `python -m tests.fuzz.under_atheris TARGET [libFuzzer's options]`."""

import sys

import atheris

with atheris.instrument_imports(include=["zerodrift", "tomllib", "json"]):
    from tests.fuzz import loaders


def main() -> None:
    """Fuzz until libFuzzer's own options say stop, or something gets out."""
    target = sys.argv.pop(1)

    def run(data: bytes) -> None:
        loaders.run_one(target, data)

    atheris.Setup(sys.argv, run)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
