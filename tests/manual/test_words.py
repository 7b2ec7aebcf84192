"""One word for one thing, short sentences in the first hour, and a changelog that can be read."""

import re
from pathlib import Path

import pytest
from manual.pages import render_commands

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
CHANGELOG = ROOT / "CHANGELOG.md"
FRONT = [ROOT / "README.md", ROOT / "proof" / "README.md"]
FIRST_HOUR = [*FRONT, DOCS / "index.md", *DOCS.glob("tutorial/*.md"), *DOCS.glob("how-to/*.md")]
NO_PROSE = re.compile(
    r"(?ms)^ *```.*?^ *```|<!--.*?-->|!\[[^]]*\]\([^)]*\)|`[^`]*`|(?<=\])\([^)\s]*\)"
)
SENTENCES = re.compile(r"(?m)(?<=[.!?])[)*\"]*\s+|\n\s*\n|^ *[#|].*\n|\n(?= *(?:[-*]|\d+\.) )")


def read_prose(text):
    """Return a page with all that is no prose as an X and blanks, each line where it was."""
    return NO_PROSE.sub(lambda found: "X" + re.sub(r"[^\n]", " ", found.group())[1:], text)


def list_rules():
    """Return pattern and substitute of each phrase that the glossary rules out."""
    table = (
        (DOCS / "reference" / "glossary.md").read_text("utf-8").split("\n## Said otherwise\n")[1]
    )
    for line in re.findall(r"(?m)^\| `.*", table):
        _, phrases, instead, _ = line.split("|")
        for phrase in re.findall(r"`([^`]+)`", phrases):
            words = re.escape(phrase).replace(r"\.\.\.", r"[^.|:;]{0,60}?").replace(r"\ ", r"\s+")
            yield re.compile(rf"(?<![\w-]){words}\b(?!\s+of\s+measure)", re.I), instead.strip()


def list_lapses(text):
    prose = read_prose(text)
    return [
        f"line {prose.count(chr(10), 0, found.start()) + 1}: '{found.group()}', say {instead}"
        for pattern, instead in list_rules()
        for found in pattern.finditer(prose)
    ]


@pytest.mark.parametrize(
    "page", [CHANGELOG, *FRONT, *sorted(DOCS.rglob("*.md"))], ids=lambda p: p.name
)
def test_pages_keep_to_the_glossary(page):
    assert list_lapses(page.read_text("utf-8")) == []


def test_help_texts_keep_to_the_glossary():
    assert list_lapses(render_commands().replace("```", "")) == []


def test_a_phrase_that_is_ruled_out_is_found_over_a_line_end():
    (lapse,) = list_lapses("One.\n\nThe logs cannot\ntell `a` from `b`.\n```sh\ntold\n```")
    assert lapse.startswith("line 3: 'cannot\ntell', say ")
    assert list_lapses("In the outputs' units of\nmeasure.") == []


@pytest.mark.parametrize("page", FIRST_HOUR, ids=lambda page: page.name)
def test_sentences_of_the_first_hour_have_30_words_at_most(page):
    sentences = SENTENCES.split(read_prose(page.read_text("utf-8")))
    assert [s for s in sentences if len(s.split()) > 30] == []


def test_the_changelog_is_releases_of_200_lines_in_all():
    text = CHANGELOG.read_text("utf-8")
    releases = re.findall(r"(?m)^## (.*)\n\s*(?:[^#\n].*\n\s*)*### (.*)", text)
    assert [release.split(",")[0] for release, _ in releases] == ["0.2.0", "0.1.0"]
    assert releases[0][1] == "Breaking changes"
    assert len(text.splitlines()) <= 200
