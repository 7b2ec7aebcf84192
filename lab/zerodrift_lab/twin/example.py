"""The logs of a bundled example, simulated when they are first needed."""

import hashlib
import json
from pathlib import Path

from zerodrift.base.errors import InputError
from zerodrift_lab.twin.logs import render_logs, replace_files
from zerodrift_lab.twin.recipe import Recipe, recipe_from_dict
from zerodrift_lab.twin.simulate import name_runs, simulate

RECIPE_FILE = "twin.json"
MARK_FILE = "logs/.made-of"


def read_recipe(path: Path) -> Recipe:
    """Return the recipe in a JSON file; its key `note` is for readers.

    Raises:
        InputError: the file is not JSON, or not a recipe.
    """
    try:
        plain = json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise InputError(
            f"{path}:{error.lineno}: not JSON ({error.msg}). Restore the file, or remove it if the "
            "logs are your own."
        ) from error
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(
            f"{path}: cannot be read ({error}). Restore the file, or remove it if the logs are"
            " your own."
        ) from error
    if not isinstance(plain, dict):
        raise InputError(f"{path}: holds {type(plain).__name__}; expected a JSON object.")
    return recipe_from_dict({k: v for k, v in plain.items() if k != "note"}, str(path))


def fingerprint(recipe_path: Path) -> str:
    """Return a hash of the recipe and of the generator's sources: what the logs follow from."""
    digest = hashlib.sha256(recipe_path.read_bytes())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()


def ensure_example_logs(directory: Path) -> bool:
    """Write the simulated logs of an example that has a `twin.json`, unless they are there.

    Logs of another recipe or of an earlier generator are written anew. Only files below `logs/`
    are written. Returns whether any were.

    Raises:
        InputError: `twin.json` is not a usable recipe, or the directory cannot be written.
    """
    recipe_path = directory / RECIPE_FILE
    if not recipe_path.is_file():
        return False
    recipe = read_recipe(recipe_path)
    made_of = fingerprint(recipe_path) + "\n"
    mark = directory / MARK_FILE
    logs = [directory / "logs" / f"{name}.csv" for name, _, _ in name_runs(recipe)]
    if mark.is_file() and mark.read_text() == made_of and all(log.is_file() for log in logs):
        return False
    replace_files(directory, {**render_logs(simulate(recipe)), MARK_FILE: made_of.encode()})
    return True
