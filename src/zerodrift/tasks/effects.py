"""The catalogue of physical effects, and everything about one of them."""

from dataclasses import dataclass
from pathlib import Path

from zerodrift.base.config import FILE_NAME
from zerodrift.base.errors import InputError
from zerodrift.base.journal import write_text
from zerodrift.base.progress import SILENT, Progress
from zerodrift.diagnosis.fingerprint import Fingerprint, draw_fingerprint
from zerodrift.physics.catalogue import Catalogue, load_catalogue
from zerodrift.physics.description import describe_effect
from zerodrift.physics.effect import Effect
from zerodrift.report.page import render_page
from zerodrift.report.pictures import draw_fingerprint as draw_picture
from zerodrift.report.results import EffectResult, EffectsResult
from zerodrift.tasks.project import ProjectFolder
from zerodrift.tasks.trust import require_trust


@dataclass(frozen=True)
class EffectsRequest:
    """Which effects are asked for."""

    project: ProjectFolder
    """Its own effects are listed too; it may have no zerodrift.toml."""
    name: str | None = None
    """None: all of them."""
    html: Path | None = None
    """With a name: where a page with its picture is written."""

    def __post_init__(self) -> None:
        """Refuse a page without an effect.

        Raises:
            InputError: none is named.
        """
        if self.html is not None and self.name is None:
            raise InputError("--html draws one effect; name it, as in: zerodrift effects creep")


@dataclass(frozen=True)
class EffectsOutcome:
    """The catalogue, and what one of its effects looks like."""

    result: EffectsResult | EffectResult
    catalogue: Catalogue
    effect: Effect | None = None
    """The one that was asked for."""
    picture: Fingerprint | None = None
    """None where it has none: it only sets samples aside."""


def list_effects(request: EffectsRequest, progress: Progress = SILENT) -> EffectsOutcome:
    """Return the effects there are, or one of them with its picture.

    Raises:
        InputError: there is no such effect, or the user does not agree to run the project's own.
    """
    project = request.project
    plugins: tuple[Path, ...] = ()
    if (project.directory / FILE_NAME).is_file():
        plugins = project.config.plugin_files
        require_trust(plugins, project.directory, progress)
    catalogue = load_catalogue(plugins)
    if request.name is None:
        told = tuple(describe_effect(effect) for effect in catalogue.listed())
        return EffectsOutcome(EffectsResult(told), catalogue)
    effect = catalogue[request.name]
    picture = draw_fingerprint(effect, catalogue)
    if request.html is not None:
        if picture is None:
            raise InputError(f"effect '{effect.kind}' has no picture: it only sets samples aside.")
        title = f"{effect.kind}: {effect.title}"
        page = render_page(title, [draw_picture(effect.title, picture)], [effect.equation])
        write_text(request.html, page)
    return EffectsOutcome(EffectResult(**vars(describe_effect(effect))), catalogue, effect, picture)
