"""Links every stage below build/links/zerodrift, where type checkers look for packages.

python .ci/link_packages.py
"""

import os
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))

from setup import find_stages  # noqa: E402 - the root is not a package


def main() -> None:
    """Make the links anew."""
    folder = ROOT / "build" / "links" / "zerodrift"
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.iterdir():
        old.unlink()
    for path in [*(ROOT / stage for stage in find_stages()), *(ROOT / "src/zerodrift").iterdir()]:
        if path.name != "__pycache__":
            (folder / path.name).symlink_to(os.path.relpath(path, folder))


if __name__ == "__main__":
    main()
