"""Docstrings as the site needs them: examples as code, and indices that are no links."""

import re
from typing import Any

import griffe

INDEX = re.compile(r"\](?=\[)")


class PlainDocstrings(griffe.Extension):
    """Rewrites docstrings before they are rendered."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Let `Example:` be a section of code, and `table[i][j]` be text."""
        if obj.docstring is not None:
            text = obj.docstring.value.replace("Example:\n", "Examples:\n")
            obj.docstring.value = INDEX.sub(r"]\\", text)
