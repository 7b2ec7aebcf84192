"""What commands keep in build/ for later commands: files that carry a hash of themselves."""

from collections.abc import Iterator

from zerodrift.base.config import Config
from zerodrift.base.sealed import read_sealed
from zerodrift.verify.manifest import DAMAGED, ManifestFinding

RECORDS = ("firmware.json", "refused.json", "uncertainty.json", "compensator.json")
"""Not of the firmware, so that the manifest does not name them: who reads one recomputes it, or
says that there is none, where it is gone or damaged."""
_OF_A_MODEL = ("firmware.json", "uncertainty.json")


def check_records(config: Config, model_hash: str) -> Iterator[ManifestFinding]:
    """Yield the records that are damaged, or of another model than the one in build/.

    Args:
        config: the project.
        model_hash: of the integer model; "" if that is not known.
    """
    for name in RECORDS:
        path = config.build_directory / name
        shown = f"{config.build_directory.name}/{name}"
        try:
            body = read_sealed(path.read_bytes())
        except FileNotFoundError:
            continue
        except (OSError, ValueError) as error:
            yield ManifestFinding(DAMAGED, shown, f"{shown}: is damaged ({error}).")
            continue
        if name in _OF_A_MODEL and model_hash and body.get("model_hash") != model_hash:
            theirs = str(body.get("model_hash"))[:12]
            text = f"{shown}: is of model {theirs}, not of {model_hash[:12]}."
            yield ManifestFinding(DAMAGED, shown, text)
