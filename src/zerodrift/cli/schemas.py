"""The JSON Schemas of what the commands print: `python -m zerodrift.cli.schemas [FOLDER]`."""

import json
import sys
from pathlib import Path

from zerodrift.base.records import describe_schema, get_schema_name
from zerodrift.report.results import RESULTS

FOLDER = Path("docs/reference/schemas")


def render_schemas() -> dict[str, str]:
    """Return every schema by the name of its file."""
    return {
        f"{get_schema_name(kind).split('/')[0]}.json": json.dumps(describe_schema(kind), indent=1)
        + "\n"
        for kind in RESULTS
    }


def main() -> None:
    """Write the schemas into a folder; others that lie there are removed."""
    folder = Path(sys.argv[1]) if sys.argv[1:] else FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    schemas = render_schemas()
    for path in folder.glob("*.json"):
        if path.name not in schemas:
            path.unlink()
    for name, text in schemas.items():
        (folder / name).write_text(text, encoding="utf-8", newline="\n")
    print(f"wrote {len(schemas)} schemas into {folder}/")


if __name__ == "__main__":
    main()
