"""One model as a Python package: its C as a shared library, called by ctypes. Texts by path."""

import keyword
from collections.abc import Mapping

from zerodrift import __version__
from zerodrift.codegen.generate import GeneratedCode, make_environment
from zerodrift.codegen.identifiers import sanitize_comment
from zerodrift.codegen.names import list_flags
from zerodrift.codegen.package_parts import Files, Given, list_given, split_code
from zerodrift.export.integer_model import IntegerModel

_TAKEN = ("self", "elapsed_s")
OLDEST_PYTHON = (3, 9)
"""The limited API's wheel holds from here on."""


def render_python(model: IntegerModel, code: GeneratedCode, runtime: Mapping[str, str]) -> Files:
    """Return a source tree that `pip wheel` makes one wheel per machine of, for all Pythons."""
    package = f"{code.prefix}_drift"
    given = list_given(model)
    names = [_name_argument(g) for g in given]
    environment = make_environment()
    environment.policies["json.dumps_kwargs"] = {"ensure_ascii": False}
    headers, sources = split_code(code, runtime)
    arguments = [
        f"{name}: float{' | None' if g.no_reading is not None else ''}"
        for name, g in zip(names, given, strict=True)
    ]
    context = {
        "title": sanitize_comment(model.name),
        "version": __version__,
        "hash": model.hash,
        "prefix": code.prefix,
        "PREFIX": code.prefix.upper(),
        "package": package,
        "period_s": model.sample_period_s,
        "channels": given,
        "outputs": model.outputs,
        "flags": list_flags(model),
        "variable": model.variable_step,
        "tare": model.tare,
        "arguments": ", ".join(arguments),
        "example": ", ".join(f"{name}=..." for name in names),
        "encoded": ", ".join(f"CHANNELS[{i}].encode({name})" for i, name in enumerate(names)),
    }
    compiled = [*sorted(f"src/{n}" for n in sources), "src/python_module.c"]
    oldest = ".".join(map(str, OLDEST_PYTHON))
    tag = "cp" + "".join(map(str, OLDEST_PYTHON))
    return {f"src/{name}": text for name, text in (headers | sources).items()} | {
        "src/python_module.c": environment.get_template("python_module.c.j2").render(context),
        f"{package}/__init__.py": environment.get_template("python_package.py.j2").render(context),
        f"{package}/py.typed": "",
        "MANIFEST.in": "include src/*.h\n",
        "pyproject.toml": f"""[build-system]
requires = ["setuptools>=70.1"]
build-backend = "setuptools.build_meta"

[project]
name = "{package.replace("_", "-")}"
version = "{__version__}"
description = "Temperature drift compensation, in the C that runs on the sensor's chip."
requires-python = ">={oldest}"

[tool.setuptools]
packages = ["{package}"]

[tool.setuptools.package-data]
{package} = ["py.typed"]
""",
        "setup.py": f"""from setuptools import Extension, setup

library = Extension(
    "{package}._model",
    sources={compiled},
    include_dirs=["src"],
    py_limited_api=True,
)
setup(ext_modules=[library], options={{"bdist_wheel": {{"py_limited_api": "{tag}"}}}})
""",
    }


def _name_argument(given: Given) -> str:
    is_taken = keyword.iskeyword(given.field) or given.field in _TAKEN
    return f"{given.field}_" if is_taken else given.field
