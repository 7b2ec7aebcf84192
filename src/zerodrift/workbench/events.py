"""What the processes behind the page say, and where they leave what they found."""

from pathlib import Path

SURVEYED, DIAGNOSED, PREVIEWED, CHIP_READY = "surveyed", "diagnosed", "previewed", "chip-ready"
DIAGNOSIS = "diagnosis.json"
SKIP_INVALID, SENSOR = "--skip-invalid", "--sensor"


def name_preview(result: Path, effect: str, run: str) -> Path:
    """Return where the preview of an effect in a run lies; names may hold any character."""
    return result / f"preview.{effect.encode().hex()}.{run.encode().hex()}.npy"
