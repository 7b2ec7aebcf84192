"""The manual: every page in the contents, every link whole, every command and effect told of."""

import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from manual.hooks import ASKED, HOME, ask_for_effects, list_contents, name_outsiders, put_pictures
from manual.pages import MODULES, list_pages, render_commands
from manual.pictures import PICTURES, count_alarms, draw_picture, follow, measure_stall

from zerodrift.cli.main import list_commands
from zerodrift.physics.catalogue import load_catalogue

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
LINK = re.compile(r"(?<!!)\[[^\]]*\]\(([^)\s]+)\)")
WRITTEN = sorted(DOCS.rglob("*.md"))


def read_headings(text):
    """Return the anchors of a page's headings."""
    plain = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    headings = re.findall(r"(?m)^#+ +(.*)$", plain)
    return {re.sub(r"[^\w -]", "", h).strip().lower().replace(" ", "-") for h in headings}


def flatten(contents):
    for entry in contents:
        if isinstance(entry, str):
            yield entry
        else:
            for value in entry.values():
                yield from [value] if isinstance(value, str) else flatten(value)


def test_every_page_is_in_the_contents_once():
    pages = [path.relative_to(DOCS).as_posix() for path in WRITTEN]
    pages += [path for path, _ in list_pages() if path.endswith(".md")]
    listed = list(flatten(list_contents(pages)))
    assert sorted(listed) == sorted(pages)
    assert listed[0] == HOME


def test_page_outside_of_the_sections_is_refused():
    with pytest.raises(ValueError, match="is in no section"):
        list_contents(["index.md", "stray/page.md"])


@pytest.mark.parametrize("path", WRITTEN, ids=lambda path: path.relative_to(DOCS).as_posix())
def test_links_of_a_page_lead_somewhere(path):
    text = re.sub(r"```.*?```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    made = {DOCS / name for name, _ in list_pages()}
    for link in LINK.findall(text):
        if link.startswith(("http://", "https://", "mailto:")):
            continue
        target, _, anchor = link.partition("#")
        to = (path.parent / target).resolve() if target else path
        assert to.exists() or to in made, f"{path.name}: {link}"
        if anchor and to.suffix == ".md" and to not in made:
            assert anchor in read_headings(to.read_text(encoding="utf-8")), f"{path.name}: {link}"


def test_every_command_is_in_the_reference_and_in_a_page_written_by_hand():
    text = render_commands()
    by_hand = "\n".join(path.read_text(encoding="utf-8") for path in WRITTEN)
    for name in list_commands():
        assert f"\n## zerodrift {name}\n" in text
        assert f"Usage: zerodrift {name} " in text
        assert re.search(rf"zerodrift {name}\b", by_hand), f"no page tells of zerodrift {name}"


def test_every_effect_has_its_section_and_picture():
    text = (DOCS / "reference" / "effects.md").read_text(encoding="utf-8")
    kinds = [effect.kind for effect in load_catalogue().listed()]
    asked = ask_for_effects(text, kinds)
    assert [name.removeprefix("effect ") for name in ASKED.findall(asked)] == kinds


def test_pictures_that_pages_ask_for_are_there():
    texts = [re.sub(r"`[^`]*`", "", path.read_text(encoding="utf-8")) for path in WRITTEN]
    assert {name for text in texts for name in ASKED.findall(text)} == set(PICTURES)


def test_files_that_are_no_pages_are_named_instead_of_linked():
    text = (
        "[the example](../../examples/ft40/README.md), [an effect](../reference/effects.md#creep)"
    )
    told = name_outsiders(text, "how-to/page.md")
    assert told == (
        "the example (`examples/ft40/README.md`), [an effect](../reference/effects.md#creep)"
    )
    with pytest.raises(ValueError, match=r"docs/how-to/page\.md: nowhere\.md does not exist"):
        name_outsiders("[x](../../nowhere.md)", "how-to/page.md")


def test_unknown_picture_stops_the_build():
    with pytest.raises(ValueError, match=r"docs/page\.md: asks for the picture 'nowhere'"):
        put_pictures("<!-- picture: nowhere -->", "page.md")


def test_picture_of_an_effect_is_put_into_its_page():
    html = put_pictures("before <!-- picture: effect creep --> after", "page.md")
    assert html.startswith("<style>") and 'before <figure class="picture"><svg' in html
    assert "Creep and creep recovery, computed from the declaration." in html


@pytest.mark.parametrize("bits", [15, 30])
@pytest.mark.parametrize("tau_steps", [100.0, 3600.0])
def test_stall_is_half_a_bit_per_step_of_the_time_constant(bits, tau_steps):
    # The page says: (time constant in steps) x LSB / 2; whole numbers stop within one LSB of it.
    expected = tau_steps * 2.0**-bits / 2.0
    assert abs(measure_stall(tau_steps, bits) - expected) <= 2.0**-bits


def test_stall_is_where_the_walk_of_every_step_ends():
    import numpy as np

    target = np.where(np.arange(2500) < 1, 0.0, 0.5)
    walked = follow(target, 100.0, 15)[-1]
    assert 0.5 - walked == pytest.approx(measure_stall(100.0, 15), abs=2.0**-15)
    assert follow(target, 100.0, None)[-1] == pytest.approx(0.5, abs=1e-9)


@pytest.mark.long
def test_samples_raise_false_alarms_and_runs_do_not():
    by_samples, by_runs = count_alarms()
    assert (by_samples <= 0.05).mean() > 0.5
    assert (by_runs <= 0.05).mean() <= 0.05


def test_captions_hold_what_was_computed():
    assert f"{measure_stall(3600.0, 15):.3f}" in draw_picture("stall").caption


def test_every_module_of_the_python_reference_is_there():
    for _, _, modules in MODULES.values():
        for name in modules:
            assert importlib.util.find_spec(f"zerodrift.{name}") is not None


@pytest.mark.slow
def test_site_is_built_without_a_warning_and_fetches_nothing(tmp_path):
    pytest.importorskip("mkdocs", reason="MkDocs is not installed; `make docs` installs it")
    shutil.rmtree(tmp_path / "site", ignore_errors=True)
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-d", str(tmp_path / "site")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    pages = list((tmp_path / "site").rglob("*.html"))
    assert len(pages) > len(WRITTEN)
    fetched = re.compile(
        r"<(?:script|img|iframe|source)[^>]+src=[\"']?(https?:)?//"
        r"|<link[^>]+rel=[\"']?(?:stylesheet|preload|preconnect|icon)[^>]+href=[\"']?(https?:)?//"
    )
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert fetched.search(text) is None, page
        assert "<!-- picture:" not in text, page
    for style in (tmp_path / "site").rglob("*.css"):
        assert not re.search(r"(?:@import|url\()\s*[\"']?https?:", style.read_text("utf-8")), style
