"""The page before anything is found, as plain HTML with the page's own classes and sizes.

It stands where the page will stand: while the page's libraries are being loaded, and while its
scripts are. What comes later takes its places, so nothing moves. Only the standard library is used.
"""

from collections.abc import Sequence
from html import escape

CONTENTS = (
    ("top", "Verdict"),
    ("measured", "Measured and model"),
    ("candidates-section", "What is missing"),
    ("staircase-section", "Staircase"),
    ("errors-section", "Errors"),
    ("model-section", "Effects"),
    ("firmware-section", "Firmware"),
    ("chip-section", "The chip's own C"),
    ("units-section", "Units in use"),
)
CHOICES = (
    ("output", "Output"),
    ("run", "Run"),
    ("ghost", "Drawn over what is left"),
    ("against", "What is left, against"),
)
CAUSE = "The cause: measured, model, what is left, and what it follows"
OTHER_STEPS = "Other steps: another effect, undo, redo, look again"
READING = "Reading the logs and fitting the model."
STEPS = ("Compare", "Diagnose", "Add what is missing", "Firmware", "Verify", "Apply", "Report")
TILES = 4
WAITING = "waiting"
"""In place of `1` for what is out of date: nothing can be pressed yet."""


def write_skeleton(name: str, subtitle: str, facts: Sequence[str]) -> str:
    """Return the page's frame.

    Args:
        name: of the sensor.
        subtitle: what its model holds.
        facts: what is known of the logs.
    """
    links = "".join(f'<li><a href="#{where}">{escape(words)}</a></li>' for where, words in CONTENTS)
    told = "".join(f'<p class="note">{escape(fact)}</p>' for fact in facts)
    steps = "".join(
        f'<li class="{"later" if number else "busy"}"><span class="sign" aria-hidden="true">'
        f'{"○" if number else "…"}</span><b>{step}</b><span class="found"></span></li>'
        for number, step in enumerate(STEPS)
    )
    lists = "".join(
        f'<label class="wide">{escape(words)}<select id="{place}" disabled></select></label>'
        for place, words in CHOICES
    )
    tiles = '<div class="tile"><b>…</b><span></span></div>' * TILES
    return (
        f'<div id="bench" class="layout" data-stale="{WAITING}">'
        f'<nav class="contents" aria-label="Contents"><ol>{links}</ol>'
        '<button class="theme" disabled>Dark page</button></nav>'
        f'<main id="top"><p id="kicker" class="kicker">Workbench</p>'
        f'<h1 id="sensor">{escape(name)}</h1><p class="subtitle">{escape(subtitle)}</p>'
        '<section id="verdict" class="verdict none">'
        f'<p class="sentence" role="status">{READING}</p>{told}</section>'
        '<p id="guess-told" class="note"></p>'
        f'<section id="way"><ol class="way">{steps}</ol>'
        '<div class="now"><p class="reason">The logs are being read.</p>'
        '<div class="adds"></div></div></section>'
        f'<details id="actions"><summary>{OTHER_STEPS}</summary></details>'
        f'<div id="tiles" class="tiles">{tiles}</div>'
        f'<section id="measured"><h2>{CAUSE}</h2><div class="choices">{lists}</div>'
        '<figure><div id="main"></div></figure></section></main></div>'
    )
